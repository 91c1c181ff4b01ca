"""Why a run ended: a file in its directory, written before its nodes are stopped."""

from __future__ import annotations

from pathlib import Path

import msgspec

STOPPED = "stopped by haptic stop"  # reason of a run ended from another terminal


class RunEnd(msgspec.Struct, frozen=True):
    """Why a run ended; empty while it runs."""

    reason: str = ""
    node: str = ""  # name of the node whose failure ended it; empty for any other end


def write_end(path: Path, reason: str, node: str = "") -> None:
    """Write why a run ends, before its nodes are stopped."""
    (path / "end.json").write_bytes(msgspec.json.encode(RunEnd(reason, node)))


def end_of(run_dir: str) -> RunEnd:
    """Read why a run ended."""
    path = Path(run_dir) / "end.json"
    if not run_dir or not path.exists():
        return RunEnd()
    try:
        return msgspec.json.decode(path.read_bytes(), type=RunEnd)
    except msgspec.DecodeError:
        # The file is just being written.
        return RunEnd()


def ended_why(run_dir: str) -> str:
    """Return the reason why a run ended; empty while it runs."""
    return end_of(run_dir).reason
