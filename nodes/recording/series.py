"""Recordings reduced to lines that a figure can draw, in bounded memory.

Up to POINTS messages, a line contains every value. A longer one stores the smallest and largest
value of each of BINS time intervals, so every extreme is drawn at its time, within a line's width.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from messages.event_kinds import MARK
from messages.topics import DEVICE_STATE, FORCE, PROXY, RECEIPT, message_type
from messages.types import DeviceState, Event, Force, Proxy, Receipt
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordError

AnyArray = np.ndarray[Any, Any]

POINTS = 4000  # longest line stored unreduced
BINS = POINTS // 2  # time intervals of a longer line; about two per pixel
_BLOCK = 8192
_FLAT = 1e-9  # spread of a flat surface's positions by rounding [m]
_MOST = 200  # changes, and marks, that are drawn


class Line:
    """Values over time: one or more columns at the same times."""

    def __init__(self, start: float, stop: float, columns: int) -> None:
        self._start = start
        self._width = (stop - start) / BINS or 1.0
        self._columns = columns
        self._rows: list[tuple[float, ...]] = []
        self._folded: tuple[AnyArray, AnyArray] | None = None

    def add(self, time: float, *values: float) -> None:
        """Add one value per column."""
        self._rows.append((time, *values))
        if len(self._rows) >= _BLOCK:
            self._fold()

    def _fold(self) -> None:
        if self._folded is None:
            empty = np.full((BINS, self._columns), np.nan)
            self._folded = empty, empty.copy()
        rows = np.array(self._rows, dtype=np.float64)
        self._rows.clear()
        since = (rows[:, 0] - self._start) / self._width
        place = np.clip(since, 0, BINS - 1).astype(int)
        order = np.argsort(place, kind="stable")
        bins, first = np.unique(place[order], return_index=True)
        # fmin and fmax ignore NaN.
        for held, smaller in zip(self._folded, (np.fmin, np.fmax), strict=True):
            found = smaller.reduceat(rows[order, 1:], first, axis=0)
            held[bins] = smaller(held[bins], found)

    def arrays(self) -> tuple[AnyArray, AnyArray]:
        """Return times, shape (N,), and values, shape (N, columns)."""
        if self._folded is None and len(self._rows) <= POINTS:
            rows = np.array(self._rows, dtype=np.float64).reshape(-1, 1 + self._columns)
            return rows[:, 0], rows[:, 1:]
        if self._rows:
            self._fold()
        assert self._folded is not None  # noqa: S101  # more than POINTS rows were folded
        low, high = self._folded
        times = self._start + self._width * (
            np.arange(BINS)[:, None] + np.array([0.25, 0.75])
        )
        values = np.stack((low, high), axis=1)
        kept = ~np.isnan(low).all(axis=1)
        return times[kept].reshape(-1), values[kept].reshape(-1, self._columns)


class Spans:
    """Intervals during which named states were active, at the resolution of a line."""

    def __init__(self, start: float, stop: float) -> None:
        self._start = start
        self._width = (stop - start) / BINS or 1.0
        self._seen: dict[str, bytearray] = {}

    def add(self, begin: float, end: float, name: str) -> None:
        """Mark `name` as active from `begin` to `end` [s]."""
        low, high = (
            min(max(int((time - self._start) / self._width), 0), BINS - 1)
            for time in (begin, end)
        )
        self._seen.setdefault(name, bytearray(BINS))[low : high + 1] = b"\1" * (
            high + 1 - low
        )

    def spans(self) -> Iterator[tuple[str, float, float]]:
        """Yield name, begin and end [s] of each interval."""
        for name, seen in self._seen.items():
            begin = seen.find(1)
            while begin >= 0:
                end = seen.find(0, begin)
                end = BINS if end < 0 else end
                yield (
                    name,
                    self._start + begin * self._width,
                    self._start + end * self._width,
                )
                begin = seen.find(1, end)


class Lines:
    """Data for the figure of a run, from `start` to `stop` after the first state [s]."""

    def __init__(
        self, recording: Recording, start: float = 0.0, stop: float = math.inf
    ) -> None:
        recording.require_ticks()
        figures = recording.topics[DEVICE_STATE]
        if figures.messages < 2:
            raise RecordError(
                f"{recording.path}: fewer than two messages on {DEVICE_STATE}; a plot needs at"
                " least two"
            )
        # Stamp of the recording's first state: time 0 of the figure [s].
        self.begin = figures.first_stamp
        self._declared = recording.manifest.get("axes", "").split(",")
        # Interval drawn, as stamps [s].
        self.start = max(self.begin + start, self.begin)
        self.stop = min(self.begin + stop, figures.last_stamp)
        if not self.start < self.stop and figures.first_stamp < figures.last_stamp:
            lasts = f"it lasts {recording.duration:.6g} s"
            raise RecordError(
                f"{recording.path}: nothing between {start:g} and {stop:g} s; {lasts}"
            )
        ends = self.start, self.stop
        # Per axis: position [m], force handed to the device at its tick [N], force of the law
        # before limits [N].
        self.position, self.force, self.asked = (
            Line(*ends, 3),
            Line(*ends, 3),
            Line(*ends, 3),
        )
        # Energy given out and the passivity guard's account [J]; response time of ticks answered
        # in time [s]; proxy, and surface where one faces the axis [m].
        self.energy, self.response, self.proxy = (
            Line(*ends, 2),
            Line(*ends, 1),
            Line(*ends, 6),
        )
        # Safety states other than active, and ticks that were not answered in time (named
        # ``missed``).
        self.safety, self.missed = Spans(*ends), Spans(*ends)
        # Every `_stride`-th (time, response) sample [s]; `response` holds the extremes.
        self.sampled: list[tuple[float, float]] = []
        self._stride = -(-figures.messages // POINTS)
        # Largest normal component seen per axis, signed, shape (3,).
        self.normal = [0.0, 0.0, 0.0]
        # First 200 changes: stamp, action, and the law afterwards.
        self.receipts: list[tuple[float, str, str]] = []
        self.marks: list[tuple[float, str]] = []  # first 200 marks: stamp and text
        self.laws: list[str] = []  # laws that computed a force
        self._before: DeviceState | None = None
        self._named = -1
        self._read(recording)

    def _read(self, recording: Recording) -> None:
        wanted = [
            topic
            for topic in recording.topics
            if topic in (DEVICE_STATE, PROXY, FORCE, RECEIPT)
            or message_type(topic) is Event
        ]
        # If ticks are recorded in order, the first state after the interval ends the reading.
        ordered = not recording.topics[DEVICE_STATE].back
        for entry in recording.entries(wanted):
            message: Any = entry.message
            if self.start <= message.stamp <= self.stop:
                self._take(message)
            elif isinstance(message, DeviceState):
                if ordered and message.stamp > self.stop:
                    self._take_outcome(message)
                    return
                self._before = message

    def _take(self, message: DeviceState | Proxy | Force | Receipt | Event) -> None:
        if isinstance(message, DeviceState):
            self._take_outcome(message)
            self._before = message
            self.position.add(message.stamp, *message.position)
            self.energy.add(message.stamp, message.energy, message.guard)
        elif isinstance(message, Proxy):
            self._take_proxy(message)
        elif isinstance(message, Force):
            self.asked.add(message.stamp, *message.force)
            if message.law and message.law not in self.laws[-100:]:
                self.laws.append(message.law)
            if message.seq >= self._named >= 0 and self.receipts:
                stamp, action, _ = self.receipts[-1]
                self.receipts[-1] = (stamp, action, message.law)
                self._named = -1
        elif isinstance(message, Event):
            if message.kind == MARK and len(self.marks) < _MOST:
                self.marks.append((message.stamp, message.reason))
        elif len(self.receipts) < _MOST:
            self.receipts.append((message.stamp, message.action, ""))
            self._named = message.seq

    def _take_outcome(self, state: DeviceState) -> None:
        """Add what a state reports about the tick before it."""
        before = self._before
        if before is None or before.stamp < self.start:
            return
        self.force.add(before.stamp, *state.force)
        # Every run begins waiting for the first force.
        if before.safety not in ("active", "waiting"):
            self.safety.add(before.stamp, state.stamp, before.safety)
        if state.response > 0.0:
            self.response.add(before.stamp, state.response)
            if state.seq % self._stride == 0:
                self.sampled.append((before.stamp, state.response))
        if state.missed > before.missed:
            self.missed.add(before.stamp, before.stamp, "missed")

    def _take_proxy(self, message: Proxy) -> None:
        surface = [
            position - message.distance * part if part else math.nan
            for position, part in zip(message.position, message.normal, strict=True)
        ]
        self.proxy.add(message.stamp, *message.proxy, *surface)
        for axis, part in enumerate(message.normal):
            if abs(part) > abs(self.normal[axis]):
                self.normal[axis] = part

    @property
    def axes(self) -> list[int]:
        """Return the axes to draw: the only one of a scene of one axis, else those that moved."""
        if len(self._declared) == 1:
            return [self.axis]
        motion = np.ptp(self.position.arrays()[1], axis=0) > 0.0
        force = self.force.arrays()[1]
        pushed = np.ptp(force, axis=0) > 0.0 if len(force) else motion
        found = [axis for axis in range(3) if motion[axis] or pushed[axis]]
        return found if len(found) > 1 else [self.axis]

    def level(self, axis: int) -> float | None:
        """Return where a flat surface across an axis is [m]; None without one."""
        values = self.proxy.arrays()[1][:, 3 + axis]
        seen = values[~np.isnan(values)]
        # A reduced line holds extremes of a bin; of a curved surface they differ.
        if not len(seen):
            return None
        size = max(1.0, float(np.abs(seen).max()))
        return None if np.ptp(seen) > _FLAT * size else float(seen[0])

    @property
    def axis(self) -> int:
        """Return the axis to draw: the one the surface faces, else the one of largest motion."""
        if any(self.normal):
            return int(np.argmax(np.abs(self.normal)))
        motion = np.ptp(self.position.arrays()[1], axis=0)
        return int(np.argmax(motion)) if motion.any() else 2

    def rest(self) -> float:
        """Return the time [s] after which position stays within 1 % of its range, force 2 %."""
        last = self.begin
        for line, share in ((self.position, 0.01), (self.force, 0.02)):
            time, values = line.arrays()
            values = values[:, self.axis]
            away = (
                np.abs(values - values[-1]) > share * np.ptp(values)
                if len(values)
                else np.zeros(0, dtype=bool)
            )
            last = max([last, *time[away][-1:]])
        return last - self.begin
