"""A recording that a page sends to its server: checked, stored in private, then opened.

It comes over the page's own connection, so that token and origin are checked already. The folder
contains nothing else, so that a recording finds no mesh or scene of this machine beside it.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, TypeVar

from nodes.view.commands import CommandError

LARGEST = 1 << 29  # limit of a file [bytes]: an hour at 1 kHz along three axes
T = TypeVar("T")


class Upload:
    """The file that a page is sending, at most one at a time."""

    def __init__(self) -> None:
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._file: IO[bytes] | None = None
        self._size = self._received = 0
        self.name = ""  # its name on the page's side
        self.over = False  # whether to draw it over the recording that is shown

    def begin(self, request: dict[str, Any]) -> None:
        """Begin a file; CommandError if its name or size cannot be accepted."""
        name = request.get("name")
        size = request.get("size")
        if not isinstance(name, str) or not 0 < len(name) < 256:
            raise CommandError("open: name is the file's name")
        name = name.replace("\\", "/").rpartition("/")[2]
        if Path(name).suffix != ".mcap":
            raise CommandError(
                f"{name}: a page opens recordings (.mcap), and pages of them (.html)"
            )
        if not isinstance(size, int) or not 0 < size <= LARGEST:
            raise CommandError(
                f"{name}: {size} bytes, limit {LARGEST}; use: haptic view --replay {name}"
            )
        self.close()
        self._folder = tempfile.TemporaryDirectory(prefix="haptic-view-")
        self._file = self._path.open("wb")
        self.name, self.over = name, request.get("over") is True
        self._size = size
        self._received = 0

    @property
    def _path(self) -> Path:
        assert self._folder is not None  # noqa: S101  # for the type checker
        return Path(self._folder.name) / "sent.mcap"

    def add(self, data: bytes) -> bool:
        """Append bytes; return False if nobody announced them."""
        if self._file is None or self._received + len(data) > self._size:
            return False
        self._file.write(data)
        self._received += len(data)
        return True

    def open(self, opener: Callable[[Path], T]) -> T:
        """Return what `opener` makes of the complete file, which is then deleted."""
        if self._file is None or self._received < self._size:
            raise CommandError(
                f"open: {self._received} of {self._size} bytes came; send it again"
            )
        self._file.close()
        try:
            return opener(self._path)
        finally:
            self.close()

    def close(self) -> None:
        """Delete the file."""
        if self._file is not None:
            self._file.close()
        if self._folder is not None:
            self._folder.cleanup()
        self._file = self._folder = None
