"""A recording in several files: a restarted logger continues in a numbered file.

``run.mcap`` is followed by ``run.2.mcap``, ``run.3.mcap`` and so on; readers treat the parts of one
run as one recording.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

import msgspec

from nodes.recording import mcap_walk
from nodes.recording.writer import MANIFEST, RecordError


def part(path: Path, number: int) -> Path:
    """Return the path of part `number` of a recording."""
    return path if number == 1 else path.with_name(f"{path.stem}.{number}{path.suffix}")


def _run_of(path: Path) -> str:
    """Return the run named in the manifest at the beginning of a file; empty without one."""
    with contextlib.suppress(RecordError, mcap_walk.CutError):
        for record in mcap_walk.walk(path):
            if record.opcode == mcap_walk.METADATA:
                name, values = mcap_walk.parse_metadata(path, record)
                if name == MANIFEST:
                    return values.get("run", "")
            elif record.opcode == mcap_walk.CHUNK:
                break
    return ""


def parts_of(path: Path) -> list[Path]:
    """Return the paths of all parts of a recording."""
    found = [path]
    # A folder such as . or / has no name to number; opening it raises the error.
    if not path.name or not part(path, 2).is_file():
        return found
    run = _run_of(path)
    while (
        run
        and (following := part(path, len(found) + 1)).is_file()
        and _run_of(following) == run
    ):
        found.append(following)
    return found


def next_part(path: Path, diary: Path) -> tuple[Path, bool]:
    """Return the next file of a logger and whether it is the first; `diary` counts its starts."""
    begun = msgspec.json.decode(diary.read_bytes(), type=int) if diary.exists() else 0
    diary.write_bytes(msgspec.json.encode(begun + 1))
    return part(path, begun + 1), begun == 0
