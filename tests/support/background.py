"""What compiles in the background."""

from __future__ import annotations

import contextlib
from pathlib import Path


def background(base: Path) -> dict[int, str]:
    """List the processes that compile in the background into a folder."""
    found = {}
    for process in Path("/proc").iterdir():
        with contextlib.suppress(OSError):
            if (
                process.name.isdigit()
                and str(base).encode() in (process / "environ").read_bytes()
            ):
                line = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                if "nodes.compiled.build --idle" in line:
                    found[int(process.name)] = line
    return found


def parent_of(process: int) -> int:
    """Return the parent of a process; 0 if the process has ended."""
    try:
        text = Path(f"/proc/{process}/stat").read_text(encoding="utf-8")
    except OSError:
        return 0
    # The second field is the name, in parentheses.
    return int(text.rpartition(")")[2].split()[1])
