"""Acting as another machine, with keys of its own."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from messages.transport import keys
from messages.transport.keys import Identity


@contextlib.contextmanager
def as_somebody_else(folder: Path) -> Iterator[Identity]:
    """Act with the keys of a folder, made at the first use, for the length of a with block."""
    before = os.environ["HAPTIC_KEYS"]
    os.environ["HAPTIC_KEYS"] = str(folder)
    try:
        yield keys.identity() if (folder / "identity.key").exists() else keys.new_identity()
    finally:
        os.environ["HAPTIC_KEYS"] = before
