"""What a launch knows of a recording that its logger did not finish, beside the file: a part is not taken for the whole."""

from __future__ import annotations

import contextlib
from pathlib import Path

import msgspec


class Ended(msgspec.Struct, frozen=True):
    """The end of the run that a recording misses."""

    ticks: int  # ticks of the whole run
    why: str  # how the logger ended


def beside(path: Path) -> Path:
    """Name the file that tells it."""
    return path.with_name(f"{path.name}.ended.json")


def write_ended(path: Path, ended: Ended) -> None:
    """Write it beside the recording; on a disk that is full too, nothing is lost but this."""
    with contextlib.suppress(OSError):
        beside(path).write_bytes(msgspec.json.encode(ended))


def read_ended(path: Path) -> Ended | None:
    """Read it; None without such a file."""
    try:
        return msgspec.json.decode(beside(path).read_bytes(), type=Ended)
    except (OSError, msgspec.DecodeError):
        return None
