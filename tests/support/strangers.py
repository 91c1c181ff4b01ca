"""Act as another machine, with its own keys."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from messages.transport import keys
from messages.transport.keys import Identity


@contextlib.contextmanager
def as_somebody_else(folder: Path) -> Iterator[Identity]:
    """Use the keys of a folder, created at first use, for a with block."""
    before = os.environ["HAPTIC_KEYS"]
    os.environ["HAPTIC_KEYS"] = str(folder)
    try:
        yield (
            keys.identity()
            if (folder / "identity.key").exists()
            else keys.new_identity()
        )
    finally:
        os.environ["HAPTIC_KEYS"] = before
