"""How far back a law's own code reads, before it renders."""

from __future__ import annotations

import contextlib
from array import array
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

_HEAD: Final = 64  # index of the newest deflection in the history that is read on trial
_DEPTHS: Final = ((0.0, 0.0), (1e-3, 0.0), (1e-3, 1e-4), (-1e-3, 0.0))
"""Deflections on trial: the newest [m], and what each tick before it had less [m]."""


class _ReadHistory(array):  # type: ignore[type-arg]
    """A ring of deflections that notes the furthest places that are read."""

    first = last = _HEAD

    def _note(self, begin: int, end: int) -> None:
        self.first, self.last = min(self.first, begin), max(self.last, end)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            # As it was asked for, not cut at the end of the ring.
            begin = 0 if index.start is None else index.start
            end = (len(self) if index.stop is None else index.stop) - 1
            if begin <= end:
                self._note(begin, end)
        else:
            self._note(index, index)
        return super().__getitem__(index)

    def __iter__(self) -> Iterator[float]:
        self._note(0, len(self) - 1)
        return super().__iter__()


def reads_outside(own: Callable[[Sequence[float], int], float], count: int) -> str:
    """Return which place own code reads though there is no tap for it; empty if none.

    Parameters
    ----------
    own : callable
        Code of one axis, made for this trial; it is called at rest, in a constant deflection, on
        the way in and in free space.
    count : int
        Number of taps.

    Returns
    -------
    str
        E.g. ``ring[head + 5]``.
    """
    for newest, step in _DEPTHS:
        values = [newest - step * age for age in range(-_HEAD, 4 * count + 4 * _HEAD)]
        ring = _ReadHistory("d", values)
        # What it raises is reported where it is tried on the history of the loop.
        with contextlib.suppress(Exception):
            own(ring, _HEAD)
        for place in (ring.last, ring.first):
            if not _HEAD <= place < _HEAD + count:
                return (
                    f"ring[head {'+' if place >= _HEAD else '-'} {abs(place - _HEAD)}]"
                )
    return ""
