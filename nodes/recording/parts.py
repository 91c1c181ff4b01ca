"""A recording in several files: a logger that is started again goes on in a numbered one, and readers take them as one.

``run.mcap`` is followed by ``run.2.mcap``, ``run.3.mcap`` and so on, as long as they are of the
same run.
"""

from __future__ import annotations

import contextlib
from pathlib import Path

import msgspec

from nodes.recording import mcap_walk
from nodes.recording.writer import MANIFEST, RecordError


def part(path: Path, number: int) -> Path:
    """Name a part of a recording."""
    return path if number == 1 else path.with_name(f"{path.stem}.{number}{path.suffix}")


def _run_of(path: Path) -> str:
    """Read the run from the manifest, which stands at the beginning; empty when there is none."""
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
    """Find the parts of a recording."""
    found = [path]
    # A folder such as . or / has no name that could be followed by another; who opens it says so.
    if not path.name or not part(path, 2).is_file():
        return found
    run = _run_of(path)
    while run and (following := part(path, len(found) + 1)).is_file() and _run_of(following) == run:
        found.append(following)
    return found


def next_part(path: Path, diary: Path) -> tuple[Path, bool]:
    """Choose the file of a logger, so that one that is started again leaves alone what was recorded before."""
    begun = msgspec.json.decode(diary.read_bytes(), type=int) if diary.exists() else 0
    diary.write_bytes(msgspec.json.encode(begun + 1))
    return part(path, begun + 1), begun == 0
