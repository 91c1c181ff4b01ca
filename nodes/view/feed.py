"""Bin the loop's messages for a page: smallest and largest value per bin of some ticks.

A spike of one tick is never lost, whatever the bin size. The bins of the last minute are stored, so
a page opened late sees the past and a slow page catches up; memory is bounded whatever a page does.
"""

from __future__ import annotations

import math
import struct
from bisect import bisect_right
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from messages import topics
from messages.types import DeviceState, Force, Message, Proxy, Vector
from nodes.base.setup import AXIS_INDEX

# Limit of bins per second of the run: more than a screen's columns in the shortest useful span.
BINS_PER_SECOND = 500.0
GRACE = 0.06  # time that a bin waits for messages in flight [s]
# Kind (1; 2 for all of a recording), number of bins, of series, 1 if earlier bins are void; then
# `Feed.now`.
HEAD = struct.Struct("<4I22d")
_FIELDS = ("position", "proxy", "target", "law_force", "force")
_SCALARS = ("energy", "response")
_EMPTY = float("inf")


class Feed:
    """Bins of the last minute, and the latest message of each topic."""

    def __init__(
        self,
        axes: Sequence[str],
        period: float,
        seconds: float = 60.0,
        bins_per_second: float = BINS_PER_SECOND,
    ) -> None:
        # Names of the series.
        self.names = [
            *(f"{field}.{axis}" for field in _FIELDS for axis in axes),
            *_SCALARS,
        ]
        # ticks in a bin
        self.per_bin = max(1, math.ceil(1.0 / (period * bins_per_second) - 1e-9))
        self._period = period
        self._axes = [AXIS_INDEX[axis] for axis in axes]
        self._grace = max(2, math.ceil(GRACE / (self.per_bin * period)))
        self._size = max(64, math.ceil(seconds / (self.per_bin * period)))
        count = len(self.names)
        self._times = np.full(self._size, np.nan)
        self._values: NDArray[np.float32] = np.full(
            (2 * count, self._size), np.nan, dtype=np.float32
        )
        self._open: dict[int, list[float]] = {}
        self._fresh = [_EMPTY] * count + [-_EMPTY] * count
        self._filed = -1
        self._newest: dict[str, int] = dict.fromkeys(topics.LOOP, -1)
        self.head = 0  # bins filed so far; the newest is number ``head`` − 1
        self.late = 0  # messages that came after their bin was filed
        # Latest messages.
        self.state: DeviceState | None = None
        self.proxy: Proxy | None = None
        self.force: Force | None = None
        self.force_before: Force | None = None  # force before the latest
        width = len(axes)
        self._at = {field: i * width for i, field in enumerate(_FIELDS)}
        self._energy = len(_FIELDS) * width
        self._response = self._energy + 1

    def take(self, topic: str, message: Message) -> None:
        """Add a message of the loop to its bin."""
        number = message.seq // self.per_bin
        if isinstance(message, DeviceState):
            self.state = message
        elif isinstance(message, Proxy):
            self.proxy = message
        elif isinstance(message, Force):
            self.force_before = self.force
            self.force = message
        else:
            return
        if number > self._newest[topic]:
            self._newest[topic] = number
        if number <= self._filed:
            self.late += 1
            return
        row = self._open.get(number)
        if row is None:
            row = self._open[number] = self._fresh.copy()
        if isinstance(message, DeviceState):
            self._put_vector(row, "position", message.position)
            self._put_vector(row, "force", message.force)
            self._put_vector(row, "target", message.target)
            self._put(row, self._energy, message.energy)
            if message.response > 0.0:
                self._put(row, self._response, message.response)
        elif isinstance(message, Proxy):
            self._put_vector(row, "proxy", message.proxy)
        else:
            self._put_vector(row, "law_force", message.force)

    def _put_vector(self, row: list[float], field: str, value: Vector) -> None:
        at = self._at[field]
        for i, axis in enumerate(self._axes):
            self._put(row, at + i, value[axis])

    def _put(self, row: list[float], at: int, value: float) -> None:
        if value < row[at]:
            row[at] = value
        at += len(self.names)
        if value > row[at]:
            row[at] = value

    def file(self, all_of_them: bool = False) -> None:
        """Finish the bins for which no more messages are expected."""
        newest = self._newest.values()
        # A bin is complete when every topic is past it, or when the newest one is well past it.
        until = max(min(newest) - 1, max(newest) - self._grace)
        if all_of_them:
            until = max(newest)
        for number in sorted(number for number in self._open if number <= until):
            row = self._open.pop(number)
            slot = self.head % self._size
            self._times[slot] = number * self.per_bin * self._period
            values = np.array(row)
            values[np.isinf(values)] = np.nan
            # Clip to float32, so that a diverging loop can still be drawn.
            self._values[:, slot] = np.clip(values, -3e38, 3e38)
            self._filed = number
            self.head += 1

    def oldest(self, seconds: float = math.inf) -> int:
        """Return the number of the oldest stored bin, at most `seconds` back."""
        kept = max(0, self.head - self._size)
        if math.isinf(seconds):
            return kept
        return max(kept, self.head - math.ceil(seconds / (self.per_bin * self._period)))

    def until(self, time: float) -> int:
        """Return the number of the first bin after `time` [s]."""
        kept = range(self.oldest(), self.head)
        return kept.start + bisect_right(
            kept, time, key=lambda number: self._times[number % self._size]
        )

    def frame(
        self,
        first: int,
        end: int,
        void: bool = False,
        now: Sequence[float] | None = None,
    ) -> bytes:
        """Encode bins for the page, little endian.

        After the head come the times as float64, then each series' smallest and largest values as
        float32.
        """
        first = max(first, self.oldest())
        slots = np.arange(first, max(end, first)) % self._size
        head = HEAD.pack(
            1,
            len(slots),
            len(self.names),
            int(void),
            *(self.now() if now is None else now),
        )
        return b"".join(
            (head, self._times[slots].tobytes(), self._values[:, slots].tobytes())
        )

    def stored(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return times [s], and each series' smallest and largest value, of all stored bins."""
        slots = np.arange(self.oldest(), self.head) % self._size
        series = len(self.names)
        values = self._values[:, slots]
        return self._times[slots], values[:series], values[series:]

    def overview(self, most: int) -> bytes:
        """Encode all bins as at most `most` coarser ones, as a frame of kind 2."""
        times, low, high = self.stored()
        begins = np.arange(0, len(times), max(1, -(-len(times) // most)))
        head = HEAD.pack(2, len(begins), len(self.names), 1, *self.now())
        if len(times):
            low = np.fmin.reduceat(low, begins, axis=1)
            high = np.fmax.reduceat(high, begins, axis=1)
        return b"".join((head, times[begins].tobytes(), low.tobytes(), high.tobytes()))

    def now(self) -> tuple[float, ...]:
        """Return the present state of the scene, 22 numbers; NaN if unknown."""
        nowhere = (math.nan, math.nan, math.nan)
        state, proxy, force = self.state, self.proxy, self.force
        position = state.position if state else nowhere
        if state and proxy and 0 <= state.seq - proxy.seq <= self._grace * self.per_bin:
            # Of the same tick as the proxy: a tick later the device is elsewhere, and a surface at
            # the proxy's distance from there would be, too.
            position = proxy.position
        return (
            state.seq * self._period if state else math.nan,
            *position,
            *(proxy.proxy if proxy else nowhere),
            *(proxy.normal if proxy else nowhere),
            *(force.force if force else nowhere),
            *(state.force if state else nowhere),
            *(state.target if state else nowhere),
            proxy.distance if proxy else math.nan,
            float(proxy.contact) if proxy else math.nan,
            state.delay if state else math.nan,
        )
