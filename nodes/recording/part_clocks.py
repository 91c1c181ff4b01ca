"""From MCAP times to the time of the run, for each part of a recording.

A part with a clock record (nodes/recording/wall_clock.py) restores the recorded times exactly. One
without, because a tool dropped the record or the file is another program's, is judged by the stamps
inside its messages.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import msgspec

from nodes.recording.foreign_channels import Stamped
from nodes.recording.mcap_walk import RawMessage
from nodes.recording.wall_clock import read_offsets

_NANO = 1e9


class PartClock(NamedTuple):
    """Offsets of a part's times to the time of the run [ns]."""

    log: int
    publish: int
    trusted: bool  # whether publish times tell the stamps


class PartClocks:
    """The clocks of a recording's parts, by the number of the part."""

    def __init__(self) -> None:
        self._clocks: dict[int, PartClock] = {}
        self._header = msgspec.json.Decoder(Stamped)

    @property
    def first(self) -> PartClock:
        """The clock of the first part that has one; that of MCAP's own times without any."""
        return next(iter(self._clocks.values()), PartClock(0, 0, True))

    def set(self, part: int, values: Mapping[str, str]) -> None:
        """Set the clock of a part by its record; ValueError for a damaged one."""
        self._clocks[part] = PartClock(*read_offsets(values), True)

    def _stamped(self, raw: RawMessage) -> Stamped | None:
        """Return tick and stamp inside a message; None if it has none."""
        try:
            return self._header.decode(raw.data)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError):
            return None

    def count(self, part: int, raw: RawMessage) -> tuple[int, float]:
        """Return sequence and stamp [s] of a message, while a part is read the first time.

        The first message of a part without a record sets its clock.
        """
        clock = self._clocks.get(part)
        if clock is not None and clock.trusted:
            return raw.sequence, (raw.publish_time - clock.publish) / _NANO
        inside = self._stamped(raw)
        if clock is None:
            begin = (
                raw.publish_time - round(inside.stamp * _NANO)
                if inside is not None
                else 0
            )
            clock = self._clocks[part] = PartClock(begin, begin, False)
        if inside is None:
            return raw.sequence, (raw.publish_time - clock.publish) / _NANO
        return inside.seq & 0xFFFFFFFF, inside.stamp

    def stamp_ns(self, part: int, raw: RawMessage, is_ours: bool) -> int:
        """Return the stamp of a message [ns]; of another program's, its publish time counts."""
        clock = self._clocks.get(part, PartClock(0, self.first.publish, True))
        if not clock.trusted and is_ours:
            inside = self._stamped(raw)
            if inside is not None:
                return round(inside.stamp * _NANO)
        return raw.publish_time - clock.publish

    def log_time(self, part: int, raw: RawMessage) -> float:
        """Return when a message was received [s]."""
        return (raw.log_time - self._clocks[part].log) / _NANO
