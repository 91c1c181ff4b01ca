"""Rendering on one axis: one deflection history that all laws share, and the law that reads it now.

A swap replaces the law between two ticks; because the history is shared there is no start-up
transient, and a cross-fade is a weighted sum of laws over the same history. Laws with recursive
sections are brought up to date by replaying it.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, TypeAlias, cast

from nodes.arithmetic import newest_gain, push, revise_sections, sections, settle, warm_up
from nodes.compiled.layout import state_of
from nodes.coupling.state import LEAVING, CouplingState
from nodes.laws import CompiledLaw

# of more, numpy's multiply and running sum are faster than a written-out sum: ``haptic bench taps``
UNROLLED_TAPS = 30


def _in_state(name: str) -> Any:
    """Let a number of a history stand in the coupling's state, by its axis."""

    def store(history: History, value: int) -> None:
        getattr(history._state, name)[history._n] = value

    return property(lambda history: int(getattr(history._state, name)[history._n]), store)


class History:
    """The newest deflections of the n-th axis, each written twice so that they are contiguous (see arithmetic.push)."""

    def __init__(self, length: int, state: Any = None, n: int = 0) -> None:
        state = state_of(CouplingState) if state is None else state
        self._state, self._n = state, n
        # how many of the newest values can be relied on: all, but for a snapshot
        self.length = self.known = length
        self.values = array("d", [0.0]) * (2 * length)  # the ring [m], shape (2 * length,)
        self.filled_at, self.level = 0, 0.0  # pushes after it was last filled, and with what [m]
        state.history[n] = self.values.buffer_info()[0]

    head = _in_state("head")  # index of the newest value
    pushes = _in_state("pushes")  # values pushed so far

    def push(self, value: float) -> None:
        """Put the newest deflection in front."""
        self.head = push(self.values, self.head, self.length, value)
        self.pushes += 1

    def fill(self, value: float) -> None:
        """Replace all values by one: the deflection has always been the same."""
        self.values[:] = array("d", [value]) * len(self.values)
        # for a snapshot under way, and for laws that have seen what is gone now
        self.pushes += self.length
        self.filled_at, self.level = self.pushes, value

    def snapshot(self) -> History:
        """Copy the history from another thread than the one that pushes, once: a long one takes longer than a tick."""
        copy = History(0)
        copy.pushes = self.pushes
        copy.values = self.values[:]
        # Each push meanwhile has overwritten the oldest value, and one more may be under way.
        copy.length, copy.known = self.length, max(self.length - 1 - (self.pushes - copy.pushes), 0)
        # Not self.head, which a push under way may have moved already: each push moves it down by
        # one.
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
    """Write out the sum of `arithmetic.fir`, term by term: the same additions in the same order, without a loop."""
    return _written_out(len(taps))(values, *taps)


def sum_of_taps(taps: tuple[float, ...], history: History) -> Callable[[int], float]:
    """Choose the fastest way to add the taps that gives the bits of `arithmetic.fir`."""
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
        # A running sum adds in order, as the kernel does; numpy's own sum and dot do not. + 0.0
        # turns −0.0 into 0.0.
        return float(running_sum(products, out=products)[-1]) + 0.0

    return add


class LawOnAxis:
    """A compiled law over one history, on one of the axes that the scene computes; ValueError when it is longer than that."""

    def __init__(self, law: CompiledLaw, history: History, axis: int = 0) -> None:
        if len(law.taps) > history.length:
            raise ValueError(
                f"{len(law.taps)} taps, but the history remembers {history.length}: raise memory"
            )
        self._history = history
        # Taps and coefficients of its sections (see `nodes.arithmetic.sections`) as compiled ticks
        # take them.
        self.numbers = array("d", law.taps)
        self.coefficients = array("d", [c for section in law.sections for c in section])
        # state of the sections [N], shape (2 * s,)
        self.state = array("d", [0.0]) * (2 * len(law.sections))
        self._pushes = history.pushes
        self.taps = law.taps  # its taps [N/m], shape (n + 1,)
        # of taps and sections on the newest deflection [N/m]
        self.gain = newest_gain(self.numbers, self.coefficients)
        self.plain = not law.sections and law.evaluate is None  # whether it is nothing but taps
        # adds them, from the history's head to the force [N]
        self.sum_of_taps = sum_of_taps(law.taps, history)
        self._own = law.own_code(axis)
        self._own_force: float | None = None
        self._law, self._axis = law, axis

    def warm_up(self, history: History) -> None:
        """Bring the sections to where they would be had the law run all the time."""
        if self.state:
            self.state[:] = array("d", [0.0]) * len(self.state)
            warm_up(self.coefficients, self.state, history.values, history.head, history.known)
        self._pushes = history.pushes

    def settle(self, value: float) -> None:
        """Put the sections where they rest under a deflection that has always been the same."""
        settle(self.coefficients, self.state, value)
        self._pushes = self._history.pushes

    def catch_up(self) -> None:
        """Let the sections see what was pushed since they last did (loop's thread)."""
        history = self._history
        if self._pushes < history.filled_at:
            # What it has seen is gone: it rests, as the laws do that rendered then.
            settle(self.coefficients, self.state, history.level)
            self._pushes = history.filled_at
        if self.state:
            unseen = min(history.pushes - self._pushes, history.length - 1)
            for age in range(unseen - 1, -1, -1):
                at = history.head + age
                sections(self.coefficients, self.state, history.values[at], history.values[at + 1])
        self._pushes = history.pushes

    def see(self, head: int) -> None:
        """Let the sections see a deflection."""
        if self.state:
            values = self._history.values
            sections(self.coefficients, self.state, values[head], values[head + 1])

    def revise(self, by: float) -> None:
        """Correct the sections for a newest deflection that was too large by so much [m]."""
        if self.state:
            revise_sections(self.coefficients, self.state, by)

    def first_force(self, history: History) -> float:
        """Force that the law's own code begins with; nothing of it is remembered."""
        own = self._law.own_code(self._axis)
        return 0.0 if own is None else own(history.values, history.head)

    def force(self, head: int) -> float:
        """Render the newest deflection, which is at `head`; once per tick."""
        force = self.sum_of_taps(head)
        if self.state:
            values = self._history.values
            force = force + sections(self.coefficients, self.state, values[head], values[head + 1])
            self._pushes = self._history.pushes
        if self._own is not None:
            self._own_force = self._own(self._history.values, head)
            force = force + self._own_force
        return force

    def present(self) -> float:
        """Force for the newest deflection, which the sections have already seen; changes nothing."""
        force = self.sum_of_taps(self._history.head) + sum(self.state[::2])
        return force + (
            self.first_force(self._history) if self._own_force is None else self._own_force
        )


Share: TypeAlias = tuple[LawOnAxis, float]  # a law and its part in the force


def _joined(shares: list[Share]) -> list[Share]:
    """Bound the number of laws: those of taps alone add up to one of taps; beyond that the least give way to the most."""
    plain = [(law, share) for law, share in shares if law.plain]
    if len(plain) > 1:
        total = math.fsum(share for _, share in plain)
        shares = [(law, share) for law, share in shares if not law.plain]
        taps = weighted_taps([(law.taps, share / total) for law, share in plain])
        shares.append((LawOnAxis(CompiledLaw(taps), plain[0][0]._history), total))
    shares.sort(key=lambda share: share[1], reverse=True)
    while len(shares) > LEAVING:
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


def shares_of(leaving: Sequence[Share], new: LawOnAxis, weight: float) -> list[Share]:
    """Tell what the force of the last tick was mixed of: `weight` of the law that came, to let just that mixture fade out."""
    shares = [*((law, share * (1.0 - weight)) for law, share in leaving), (new, weight)]
    shares = [share for share in shares if share[1] > 0.0]
    return shares if len(shares) <= LEAVING else _joined(shares)
