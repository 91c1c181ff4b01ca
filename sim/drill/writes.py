"""Oracle of permitted forces, computed from the device's log and nothing of the driver's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from messages.types import ZERO, Vector

EPSILON = 1e-9
"""Tolerance [N]: some hundred rounded sums of newtons are off by 1e-13 N."""


class Promise(NamedTuple):
    """Limits that a driver must respect.

    Attributes
    ----------
    period : float
        Sampling period [s].
    peak : float
        Largest force on an axis [N].
    slew : float
        Largest change of the force on an axis in a tick [N].
    hold : float
        Time without a write after which the device releases the force [s].
    ramp : float
        Time in which a force not caused by motion grows to its full size [s].
    regain : float
        Part of the ramp that a gap costs, as a multiple of the gap.
    """

    period: float
    peak: float
    slew: float = math.inf
    hold: float = math.inf
    ramp: float = 0.15
    regain: float = 5.0


class Write(NamedTuple):
    """One force that the device received.

    Attributes
    ----------
    at : float
        Time of the write [s].
    force : Vector
        Force [N].
    due : float
        Start of its tick [s], from any zero; NaN if unknown. A ramp is counted in ticks, and a
        delayed driver writes the force of a tick late.
    """

    at: float
    force: Vector
    due: float = math.nan


class LogFindings(NamedTuple):
    """Result of judging a log.

    Attributes
    ----------
    broken : list of str
        Violations; empty if there are none.
    above : int
        Number of forces above a limit.
    steepest : float
        Largest ratio of a force to what its ramp allowed, while a ramp was due.
    """

    broken: list[str]
    above: int
    steepest: float


def broken(
    log: Sequence[Write], bounds: Promise, begins: Sequence[float] = ()
) -> list[str]:
    """Return the violations in a log; see `judge`."""
    return judge(log, bounds, begins).broken


def judge(
    log: Sequence[Write], bounds: Promise, begins: Sequence[float] = ()
) -> LogFindings:
    """Judge a log: peak, slew, the ramp after every gap and beginning, and zero at the end.

    A ramp is due from the first write on, unless it is zero; from the first write after the device
    released; and from the first one after each of `begins`.

    Parameters
    ----------
    log : sequence of Write
        All forces that the device received, in order.
    bounds : Promise
        Limits to check.
    begins : sequence of float
        Times of position jumps without motion, and of forces due again after an absence [s].

    Returns
    -------
    LogFindings
        Violations and margins.
    """
    found: list[str] = []
    above, steepest = 0, 0.0
    coming = sorted(begins)
    felt = ZERO
    last = -math.inf
    # Start of the present ramp, and the force at that time; none before the first force.
    ramp_from = -math.inf
    due_from = math.nan
    before = ZERO
    changes: list[tuple[float, list[float]]] = []
    for n, (at, force, due) in enumerate(log):
        where = f"{at:.4f} s"
        if not all(map(math.isfinite, force)):
            found.append(f"{where}: {force} N is no force")
            continue
        has_let_go = at - last >= bounds.hold
        if has_let_go:
            felt = ZERO
        if n == 0 and any(force):
            ramp_from, due_from, before = at, due, ZERO
        elif n > 0 and has_let_go:
            # Part of the ramp that the gap costs, in whole ticks, the first one not full.
            cost = bounds.regain * (at - last - bounds.hold - bounds.period)
            over = at - max(at - max(bounds.ramp - cost, 0.0), min(ramp_from, at))
            ramp_from = at - over
            due_from = due - over
            before = ZERO
        while coming and coming[0] <= at:
            coming.pop(0)
            ramp_from, due_from, before = at, due, felt
        if max(map(abs, force)) > bounds.peak + EPSILON:
            above += 1
            found.append(f"{where}: {force} N, largest {bounds.peak:g} N")
        # Half a tick contains at most one boundary between two ticks, each with its slew. A
        # delayed driver runs several late ticks at once, so changes are counted per tick if known.
        known = not math.isnan(due)
        changes = [
            one
            for one in changes
            if (one[0] == due if known else at - one[0] < 0.5 * bounds.period)
        ]
        changes.append(
            (
                due if known else at,
                [abs(new - old) for new, old in zip(force, felt, strict=True)],
            )
        )
        moved = max(sum(change[i] for _, change in changes) for i in range(3))
        if moved > 2.0 * bounds.slew + EPSILON:
            within = "one tick" if known else "half a tick"
            found.append(
                f"{where}: changed by {moved:g} N within {within}, slew {bounds.slew:g} N a tick"
            )
        # The first force of a ramp is one step of it, and may come a tick after the assumed start.
        since = (
            at - ramp_from
            if math.isnan(due - due_from)
            else max(at - ramp_from, due - due_from)
        )
        share = (
            min((since + 2.0 * bounds.period) / bounds.ramp, 1.0)
            if bounds.ramp > 0.0
            else 1.0
        )
        for i in range(3):
            allowed = share * bounds.peak + (1.0 - share) * abs(before[i])
            steepest = (
                max(steepest, abs(force[i]) / allowed) if share < 1.0 else steepest
            )
            if abs(force[i]) > allowed + EPSILON:
                found.append(
                    f"{where}: {force[i]:g} N along {'xyz'[i]}, {since:.4f} s after a force that no"
                    " motion made"
                )
        felt, last = force, at
    if log and any(log[-1].force):
        found.append(f"{log[-1].at:.4f} s: {log[-1].force} N is left on the device")
    return LogFindings(found, above, steepest)
