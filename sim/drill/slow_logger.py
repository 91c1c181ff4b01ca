"""A logger whose disk is slow on command, for the drill."""

import os
import time
from typing import Any, ClassVar

import msgspec

from nodes.recording.logger import Logger, LoggerParameters
from nodes.recording.writer import RecordWriter

PER_MESSAGE = 0.002  # delay per message: slower than messages arrive [s]


class SlowLoggerParameters(
    LoggerParameters, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of the logger."""

    order: str  # file; while it exists, the disk is slow


class _SlowWriter:
    """Forwards every call, and delays messages."""

    def __init__(self, writer: RecordWriter, order: str) -> None:
        self._writer, self._order = writer, order

    def write(self, *message: Any) -> None:
        """Write a message, slowly if ordered."""
        if os.path.exists(self._order):
            time.sleep(PER_MESSAGE)
        self._writer.write(*message)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._writer, name)


class SlowLogger(Logger):
    """A logger node with a slow disk."""

    Parameters: ClassVar[type[msgspec.Struct]] = SlowLoggerParameters

    def configure(self) -> None:
        """Create the file."""
        super().configure()
        parameters: Any = self.store.current
        slow: Any = _SlowWriter(self._writer, parameters.order)
        self._writer = slow
