"""Places to write to: refused before the work is done, not after."""

import errno
import os
import tempfile
from pathlib import Path

from messages.errors import UsageError


def refuse_unwritable(path: Path, option: str = "--out") -> None:
    """Refuse a place that cannot be written to, and name the option that chooses another."""
    there = next(place for place in (path, *path.absolute().parents) if place.exists() or place.is_symlink())
    if there != path and not there.is_dir():
        raise UsageError(f"{path}: {there} is not a directory; choose another {option}")
    try:
        if there.is_dir():
            # Asked by doing it: root may do what the mode forbids, and nobody may write to a read-only disk.
            with tempfile.TemporaryFile(dir=there):
                pass
        elif not os.access(there, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise UsageError(f"{path}: {there} cannot be written to: {error.strerror}; choose another {option}") from error
