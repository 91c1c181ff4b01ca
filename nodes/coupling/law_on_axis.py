"""Rendering on one axis: a deflection history that all laws share, and the active law.

A change replaces the law between two ticks. Because the history is shared there is no start-up
transient, and a cross-fade is a weighted sum of laws over the same history. Laws with recursive
sections catch up by replaying it.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, TypeAlias, cast

from nodes.arithmetic import (
    newest_gain,
    push,
    revise_sections,
    sections,
    settle,
    warm_up,
)
from nodes.compiled.layout import state_of
from nodes.coupling.state import LEAVING, CouplingState
from nodes.laws import CompiledLaw

# number of taps above which numpy is faster than a written-out sum: ``haptic bench taps``
UNROLLED_TAPS = 30


def _in_state(name: str) -> Any:
    """Return a property that stores a number of a history in the coupling's state, by axis."""

    def store(history: History, value: int) -> None:
        getattr(history._state, name)[history._n] = value

    return property(
        lambda history: int(getattr(history._state, name)[history._n]), store
    )


class History:
    """Deflections of the n-th axis in a ring, stored twice for contiguous reading.

    See `nodes.arithmetic.push`.
    """

    def __init__(self, length: int, state: Any = None, n: int = 0) -> None:
        state = state_of(CouplingState) if state is None else state
        self._state, self._n = state, n
        # number of newest values that are valid: all, except in a snapshot
        self.length = self.known = length
        # the ring [m], shape (2 * length,)
        self.values = array("d", [0.0]) * (2 * length)
        self.filled_at, self.level = (
            0,
            0.0,
        )  # pushes when it was last filled, and the value [m]
        state.history[n] = self.values.buffer_info()[0]

    head = _in_state("head")  # index of the newest value
    pushes = _in_state("pushes")  # values pushed so far

    def push(self, value: float) -> None:
        """Add the newest deflection [m]."""
        self.head = push(self.values, self.head, self.length, value)
        self.pushes += 1

    def fill(self, value: float) -> None:
        """Set all values [m], as if the deflection had always been the same."""
        self.values[:] = array("d", [value]) * len(self.values)
        # invalidates a snapshot under way, and laws that saw the old values
        self.pushes += self.length
        self.filled_at = self.pushes
        self.level = value

    def snapshot(self) -> History:
        """Return a copy made from another thread, which may take longer than a tick."""
        copy = History(0)
        copy.pushes = self.pushes
        copy.values = self.values[:]
        # Each push during the copy overwrites the oldest value, and one more may be under way.
        copy.length, copy.known = (
            self.length,
            max(self.length - 1 - (self.pushes - copy.pushes), 0),
        )
        # Not self.head, which a push under way may have moved: each push decrements it.
        copy.head = -copy.pushes % self.length
        return copy


@cache
def _written_out(taps: int) -> Callable[..., Callable[[int], float]]:
    terms = ["0.0", *(f"tap_{m} * values[head + {m}]" for m in range(taps))]
    names = ["values", *(f"tap_{m}" for m in range(taps))]
    # Contains our own names only. The first term is the kernel's own start: it turns −0.0 into 0.0.
    made = eval(f"lambda {', '.join(names)}: lambda head: {' + '.join(terms)}")  # noqa: S307
    return cast(Callable[..., Callable[[int], float]], made)


def unrolled(
    taps: tuple[float, ...], values: Sequence[float]
) -> Callable[[int], float]:
    """Return `arithmetic.fir` written out term by term: the same additions without a loop."""
    return _written_out(len(taps))(values, *taps)


def sum_of_taps(taps: tuple[float, ...], history: History) -> Callable[[int], float]:
    """Return the fastest sum of taps with the same bits as `arithmetic.fir`."""
    values = history.values
    if len(taps) <= UNROLLED_TAPS:
        return unrolled(taps, values)
    import numpy as np

    n = len(taps)
    ring = np.frombuffer(values)
    weights = np.array(taps)
    products = np.empty(n)
    multiply = np.multiply
    running_sum = np.add.accumulate

    def add(head: int) -> float:
        multiply(weights, ring[head : head + n], products)
        # A running sum adds in order, as the kernel does; numpy's sum and dot do not. + 0.0 turns
        # −0.0 into 0.0.
        return float(running_sum(products, out=products)[-1]) + 0.0

    return add


def still_of(law: CompiledLaw) -> float:
    """Return a law's stiffness to a constant deflection [N/m]; 0 if not finite, or unknown."""
    if law.evaluate is not None:
        return 0.0
    still = math.fsum(law.taps)
    for b0, b1, a1, a2 in law.sections:
        whole = 1.0 + a1 + a2
        if whole == 0.0:
            return 0.0
        still += (b0 + b1) / whole
    return still if math.isfinite(still) else 0.0


class LawOnAxis:
    """A compiled law over the history of one axis; ValueError if it is longer than that."""

    def __init__(self, law: CompiledLaw, history: History, axis: int = 0) -> None:
        if len(law.taps) > history.length:
            raise ValueError(
                f"{len(law.taps)} taps, but the history remembers {history.length}: raise memory"
            )
        self._history = history
        # Taps and section coefficients (`nodes.arithmetic.sections`) as compiled ticks use them.
        self.numbers = array("d", law.taps)
        self.coefficients = array("d", [c for section in law.sections for c in section])
        # state of the sections [N], shape (2 * s,)
        self.state = array("d", [0.0]) * (2 * len(law.sections))
        self._pushes = history.pushes
        self.taps = law.taps  # taps [N/m], shape (n + 1,)
        # gain of taps and sections on the newest deflection [N/m]
        self.gain = newest_gain(self.numbers, self.coefficients)
        # stiffness to a constant deflection [N/m]; 0 of a law that has none, or code of its own
        self.still = still_of(law)
        # whether the law has taps only
        self.plain = not law.sections and law.evaluate is None
        # sums the taps, from the history's head to a force [N]
        self.sum_of_taps = sum_of_taps(law.taps, history)
        self._own = law.own_code(axis)
        self._own_force: float | None = None
        self._law, self._axis = law, axis

    def warm_up(self, history: History) -> None:
        """Set the sections as if the law had run all the time."""
        if self.state:
            self.state[:] = array("d", [0.0]) * len(self.state)
            warm_up(
                self.coefficients,
                self.state,
                history.values,
                history.head,
                history.known,
            )
        self._pushes = history.pushes

    def settle(self, value: float) -> None:
        """Set the sections at rest under a constant deflection [m]."""
        settle(self.coefficients, self.state, value)
        self._pushes = self._history.pushes

    def catch_up(self) -> None:
        """Update the sections with deflections pushed since the last update (loop's thread)."""
        history = self._history
        if self._pushes < history.filled_at:
            # The deflections it missed are gone: it rests, as the rendering laws do.
            settle(self.coefficients, self.state, history.level)
            self._pushes = history.filled_at
        if self.state:
            unseen = min(history.pushes - self._pushes, history.length - 1)
            for age in range(unseen - 1, -1, -1):
                at = history.head + age
                sections(
                    self.coefficients,
                    self.state,
                    history.values[at],
                    history.values[at + 1],
                )
        self._pushes = history.pushes

    def see(self, head: int) -> None:
        """Update the sections with the deflection at `head`."""
        if self.state:
            values = self._history.values
            sections(self.coefficients, self.state, values[head], values[head + 1])

    def revise(self, by: float) -> None:
        """Correct the sections for a newest deflection that was too large by `by` [m]."""
        if self.state:
            revise_sections(self.coefficients, self.state, by)

    def first_force(self, history: History) -> float:
        """Return the first force of the law's own code [N], without changing its memory."""
        own = self._law.own_code(self._axis)
        return 0.0 if own is None else own(history.values, history.head)

    def force(self, head: int) -> float:
        """Return the force for the newest deflection, at `head` [N]; call once per tick."""
        force = self.sum_of_taps(head)
        if self.state:
            values = self._history.values
            force = force + sections(
                self.coefficients, self.state, values[head], values[head + 1]
            )
            self._pushes = self._history.pushes
        if self._own is not None:
            self._own_force = self._own(self._history.values, head)
            force = force + self._own_force
        return force

    def present(self) -> float:
        """Return the force for the newest deflection, already seen by the sections; pure."""
        force = self.sum_of_taps(self._history.head) + sum(self.state[::2])
        return force + (
            self.first_force(self._history)
            if self._own_force is None
            else self._own_force
        )


Share: TypeAlias = tuple[LawOnAxis, float]  # a law and its weight in the force


def _joined(shares: list[Share]) -> list[Share]:
    """Reduce a mixture to `LEAVING` laws: merge laws of taps, drop the smallest others."""
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
    """Return the weighted sum of laws of taps as one law."""
    if max(len(taps) for taps, _ in laws) > UNROLLED_TAPS:
        import numpy as np

        mixed = np.zeros(max(len(taps) for taps, _ in laws))
        for taps, weight in laws:
            mixed[: len(taps)] += weight * np.array(taps)
        return tuple(mixed.tolist())
    # Added in order, as numpy does; the built-in sum rounds differently from Python 3.12 on.
    total = [0.0] * max(len(taps) for taps, _ in laws)
    for taps, weight in laws:
        for m, tap in enumerate(taps):
            total[m] += weight * tap
    return tuple(total)


def shares_of(leaving: Sequence[Share], new: LawOnAxis, weight: float) -> list[Share]:
    """Return the mixture that rendered the last tick, so that it can fade out.

    `weight` is that of the arriving law.
    """
    shares = [*((law, share * (1.0 - weight)) for law, share in leaving), (new, weight)]
    shares = [share for share in shares if share[1] > 0.0]
    return shares if len(shares) <= LEAVING else _joined(shares)
