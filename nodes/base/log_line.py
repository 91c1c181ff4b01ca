"""A line of standard error: text for people, or data for programs.

With ``HAPTIC_LOG=json``, `haptic` and all nodes of a launch write one JSON object a line. Lines of
other origin, such as a traceback or the output of a library, stay as they are.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from typing import Final

import msgspec

from messages.errors import Remedy
from nodes.base.printable import printable
from nodes.base.stderr_queue import MAX_TEXT

VARIABLE: Final = "HAPTIC_LOG"
LAUNCH: Final = "launch"  # writer of the launcher's lines
COMMAND: Final = "haptic"  # writer of a command's error
WARNS: Final = "warning"  # kind of a launcher's line that warns
FAILS: Final = "error"  # kind of a command's error

AS_JSON: Final = os.environ.get(VARIABLE) == "json"
"""Whether this process writes its lines as data."""


class LogLine(msgspec.Struct, frozen=True, omit_defaults=True):
    """One line of standard error.

    Attributes
    ----------
    text : str
        The sentence for people.
    node : str
        Writer: a node, ``launch`` or ``haptic``; empty for a line of other origin.
    kind : str
        Kind of an event (messages/event_kinds.py), ``warning`` of a launcher or ``error`` of a
        command; empty for information.
    data : dict of str to float
        Numbers of the event.
    remedies : tuple of Remedy
        Ways out of a command's error.
    """

    text: str
    node: str = ""
    kind: str = ""
    data: Mapping[str, float] = {}
    remedies: tuple[Remedy, ...] = ()

    def __str__(self) -> str:
        """Return the line as text mode has it; others may have sent what it quotes."""
        if not self.node:
            return self.text
        text = printable(self.text)
        if self.node == COMMAND:
            return f"{COMMAND}: {text}"
        kind = f"{self.kind}: " if self.kind else ""
        return f"[{self.node}] {kind}{text}"

    def as_json(self) -> str:
        """Return the line as data, without its end; cut a text too long for the queue."""
        line = msgspec.json.encode(_encodable(self))
        if len(line) >= MAX_TEXT:
            # an escaped character takes up to six
            text = f"{self.text[: MAX_TEXT // 8]}…"
            line = msgspec.json.encode(
                _encodable(msgspec.structs.replace(self, text=text))
            )
        return line.decode()


def _encodable(line: LogLine) -> LogLine:
    """Return the line in types of JSON, without lone surrogates, which file names may have."""
    return msgspec.structs.replace(
        line,
        text=_valid(line.text),
        data={k: float(v) for k, v in line.data.items() if math.isfinite(v)},
        remedies=tuple(
            msgspec.structs.replace(one, text=_valid(one.text)) for one in line.remedies
        ),
    )


def _valid(text: str) -> str:
    return text.encode(errors="replace").decode()


_line = msgspec.json.Decoder(LogLine)


def read_lines(errors: str) -> list[LogLine]:
    """Return the lines of a process that ran with ``HAPTIC_LOG=json``."""
    found = []
    # A text may contain other separators of lines, such as U+2028.
    for line in errors.removesuffix("\n").split("\n") if errors else ():
        try:
            found.append(_line.decode(line))
        except msgspec.DecodeError:
            found.append(LogLine(line))
    return found
