"""Rendering on one axis: one deflection history that all laws share, and the law that reads it now.

A swap replaces the law between two ticks; because the history is shared there is no start-up transient, and a cross-fade is
a weighted sum of laws over the same history. Laws with recursive sections are brought up to date by replaying it.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Sequence
from functools import cache
from typing import cast

from nodes.kernels import cross_fade, push, sections, warm_up
from nodes.laws import CompiledLaw

UNROLLED_TAPS = 30
"""Up to so many taps a written-out sum is fastest, beyond it numpy's multiply and running sum: ``haptic bench taps``."""

MAX_LEAVING = 8
"""Laws that may fade out together when swaps come faster than their ramps; then some are joined, to bound a tick's work."""


class History:
    """The newest deflections of one axis, each written twice so that they are contiguous (see kernels.push).

    Parameters
    ----------
    length : int
        How many ticks it remembers.

    Attributes
    ----------
    values : array of float, shape (2 * length,)
        The ring [m].
    head : int
        Index of the newest value.
    pushes : int
        Values pushed so far.
    known : int
        How many of the newest values can be relied on: all, but for a snapshot.
    """

    def __init__(self, length: int) -> None:
        self.length = self.known = length
        self.values = array("d", [0.0]) * (2 * length)
        self.head = 0
        self.pushes = 0

    def push(self, value: float) -> None:
        """Put the newest deflection in front."""
        self.head = push(self.values, self.head, self.length, value)
        self.pushes += 1

    def fill(self, value: float) -> None:
        """Take it that the deflection has always been the same."""
        for i in range(len(self.values)):
            self.values[i] = value

    def bridge(self, value: float, missing: int) -> None:
        """Fill ticks that were lost by a straight line up to the newest deflection, which is not yet pushed.

        Laws assume evenly spaced deflections; leaving ticks out would read as a jump in velocity.
        """
        before = self.values[self.head]
        for i in range(max(1, missing + 1 - self.length), missing + 1):
            self.push(before + (value - before) * i / (missing + 1))

    def snapshot(self) -> History:
        """Copy the history from another thread than the one that pushes."""
        copy = History(0)
        while True:
            copy.pushes = self.pushes
            copy.values = self.values[:]
            if copy.pushes == self.pushes:
                break
        copy.length, copy.known = self.length, self.length - 1
        # Not self.head, which a push under way may have moved already: each push moves it down by one.
        copy.head = -copy.pushes % self.length
        return copy


@cache
def _written_out(taps: int) -> Callable[..., Callable[[int], float]]:
    terms = ["0.0", *(f"tap_{m} * values[head + {m}]" for m in range(taps))]
    names = ["values", *(f"tap_{m}" for m in range(taps))]
    # Made of our own names only. The first term is the kernel's own start: it turns −0.0 into 0.0.
    made = eval(f"lambda {', '.join(names)}: lambda head: {' + '.join(terms)}")  # noqa: S307
    return cast(Callable[..., Callable[[int], float]], made)


def unrolled(taps: tuple[float, ...], values: Sequence[float]) -> Callable[[int], float]:
    """Write out the sum of `kernels.fir`, term by term: the same additions in the same order, without a loop."""
    return _written_out(len(taps))(values, *taps)


def sum_of_taps(taps: tuple[float, ...], history: History) -> Callable[[int], float]:
    """Choose the fastest way to add the taps that gives the bits of `kernels.fir`."""
    values = history.values
    if len(taps) <= UNROLLED_TAPS:
        return unrolled(taps, values)
    import numpy as np

    n = len(taps)
    ring = np.frombuffer(values)
    weights = np.array(taps)
    products = np.empty(n)
    multiply, running_sum = np.multiply, np.add.accumulate

    def add(head: int) -> float:
        multiply(weights, ring[head : head + n], products)
        # A running sum adds in order, as the kernel does; numpy's own sum and dot do not. + 0.0 turns −0.0 into 0.0.
        return float(running_sum(products, out=products)[-1]) + 0.0

    return add


class LawOnAxis:
    """A compiled law over one history.

    Parameters
    ----------
    law : CompiledLaw
        Taps, sections or an evaluator of its own.
    history : History
        What it reads.

    Attributes
    ----------
    taps : tuple of float, shape (n + 1,)
        Its taps [N/m].
    coefficients : tuple of float, shape (4 * s,)
        Of its sections: see `nodes.kernels.sections`.
    state : array of float, shape (2 * s,)
        State of the sections [N]; a compiled tick goes on from it.
    plain : bool
        Whether it is nothing but taps.
    sum_of_taps : callable
        Adds them, from the history's head to the force [N].

    Raises
    ------
    ValueError
        When the law is longer than the history.
    """

    def __init__(self, law: CompiledLaw, history: History) -> None:
        if len(law.taps) > history.length:
            raise ValueError(f"{len(law.taps)} taps, but the history remembers {history.length}: raise memory")
        self._history = history
        self.coefficients = tuple(c for section in law.sections for c in section)
        self.state = array("d", [0.0]) * (2 * len(law.sections))
        self._pushes = history.pushes
        self.taps = law.taps
        self.plain = not law.sections and law.evaluate is None
        self.sum_of_taps = sum_of_taps(law.taps, history)
        self._own = law.evaluate

    def of_taps(self, taps: tuple[float, ...]) -> LawOnAxis:
        """Make another law over the same history."""
        return LawOnAxis(CompiledLaw(taps), self._history)

    def warm_up(self, history: History) -> None:
        """Bring the sections to where they would be had the law run all the time."""
        if self.state:
            self.state[:] = array("d", [0.0]) * len(self.state)
            warm_up(self.coefficients, self.state, history.values, history.head, history.known)
        self._pushes = history.pushes

    def catch_up(self) -> None:
        """Let the sections see what was pushed since they last did (loop's thread)."""
        history = self._history
        if self.state:
            unseen = min(history.pushes - self._pushes, history.length - 1)
            for age in range(unseen - 1, -1, -1):
                at = history.head + age
                sections(self.coefficients, self.state, history.values[at], history.values[at + 1])
        self._pushes = history.pushes

    def seen(self) -> None:
        """Note that the sections have seen all that was pushed (loop's thread)."""
        self._pushes = self._history.pushes

    def own(self, history: History) -> float:
        """Call the law's own code once."""
        return 0.0 if self._own is None else self._own(history.values, history.head)

    def force(self) -> float:
        """Render the newest deflection; once per tick."""
        history = self._history
        head = history.head
        force = self.sum_of_taps(head)
        if self.state:
            force = force + sections(self.coefficients, self.state, history.values[head], history.values[head + 1])
            self._pushes = history.pushes
        if self._own is not None:
            force = force + self._own(history.values, head)
        return force

    def present(self) -> float:
        """Force for the newest deflection, which the sections have already seen; changes nothing."""
        force = self.sum_of_taps(self._history.head) + sum(self.state[::2])
        return force + self.own(self._history)


def _joined(shares: list[tuple[LawOnAxis, float]]) -> list[tuple[LawOnAxis, float]]:
    """Bound the number of laws: those of taps alone add up to one of taps; beyond that the least give way to the most."""
    plain = [(law, share) for law, share in shares if law.plain]
    if len(plain) > 1:
        total = math.fsum(share for _, share in plain)
        shares = [(law, share) for law, share in shares if not law.plain]
        shares.append((plain[0][0].of_taps(weighted_taps([(law.taps, share / total) for law, share in plain])), total))
    shares.sort(key=lambda share: share[1], reverse=True)
    while len(shares) > MAX_LEAVING:
        _, least = shares.pop()
        shares[0] = (shares[0][0], shares[0][1] + least)
    return shares


def weighted_taps(laws: list[tuple[tuple[float, ...], float]]) -> tuple[float, ...]:
    """Mix laws of taps alone into one."""
    if max(len(taps) for taps, _ in laws) > UNROLLED_TAPS:
        import numpy as np

        mixed = np.zeros(max(len(taps) for taps, _ in laws))
        for taps, weight in laws:
            mixed[: len(taps)] += weight * np.array(taps)
        return tuple(mixed.tolist())
    # Added in order, as numpy does above; the built-in sum rounds otherwise from Python 3.12 on.
    total = [0.0] * max(len(taps) for taps, _ in laws)
    for taps, weight in laws:
        for m, tap in enumerate(taps):
            total[m] += weight * tap
    return tuple(total)


class Fade:
    """A cross-fade under way on one axis.

    Parameters
    ----------
    leaving : list of tuple of LawOnAxis and float
        The laws that leave and their weights, which add up to 1: several when a swap came during another's fade.
    ramp : int
        Length [ticks].

    Attributes
    ----------
    leaving : list of tuple of LawOnAxis and float
        The same.
    ramp, done : int
        Its length, and how much of it is done [ticks].
    """

    def __init__(self, leaving: list[tuple[LawOnAxis, float]], ramp: int) -> None:
        self.leaving = leaving
        self.ramp = ramp
        self.done = 0

    def mix(self, new: float) -> float:
        """Blend the leaving laws into the new one's force; once per tick."""
        old = 0.0
        for law, weight in self.leaving:
            old += weight * law.force()
        force = cross_fade(old, new, self.done, self.ramp)
        self.done += 1
        return force

    def shares(self, new: LawOnAxis) -> list[tuple[LawOnAxis, float]]:
        """Tell what the force of the last tick was mixed of, to let just that fade out."""
        weight = min(self.done / self.ramp, 1.0)
        shares = [(law, share * (1.0 - weight)) for law, share in self.leaving] + [(new, weight)]
        shares = [share for share in shares if share[1] > 0.0]
        return shares if len(shares) <= MAX_LEAVING else _joined(shares)

    @property
    def over(self) -> bool:
        """Whether the new law has all the weight."""
        return self.done >= self.ramp
