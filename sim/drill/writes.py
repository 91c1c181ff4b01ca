"""An oracle of what a device may be given, recomputed from the device's own log and from nothing of the driver's."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from messages.types import ZERO, Vector

EPSILON = 1e-9
"""Some hundred sums of newtons, each rounded once, are off by 1e-13 N; a nanonewton is no force."""


class Promise(NamedTuple):
    """What a driver was asked to keep.

    Attributes
    ----------
    period : float
        Of a tick [s].
    peak : float
        Largest force on an axis [N].
    slew : float
        Largest change of the force on an axis in a tick [N].
    hold : float
        After so long without a write the device has let go by itself [s].
    ramp : float
        Time in which a force that no motion made grows to its full size [s].
    regain : float
        How much of it a gap costs: so many times as long as the gap.
    """

    period: float
    peak: float
    slew: float = math.inf
    hold: float = math.inf
    ramp: float = 0.15
    regain: float = 5.0


class Write(NamedTuple):
    """One force that the device was given.

    Attributes
    ----------
    at : float
        When [s].
    force : Vector
        What [N].
    due : float
        When its tick began [s], from any zero; NaN where that is not known. A ramp is counted in
        ticks, and a driver that was held up writes the force of a tick late.
    """

    at: float
    force: Vector
    due: float = math.nan


class LogFindings(NamedTuple):
    """What an oracle found in a log.

    Attributes
    ----------
    broken : list of str
        Each promise that was not kept; empty where all were.
    above : int
        How many forces were above a limit.
    steepest : float
        Largest share of what its ramp allowed that a force used, while a ramp was due; 1 is the
        ramp itself.
    """

    broken: list[str]
    above: int
    steepest: float


def broken(log: Sequence[Write], bounds: Promise, begins: Sequence[float] = ()) -> list[str]:
    """Return each promise that a log breaks; see `judge`."""
    return judge(log, bounds, begins).broken


def judge(log: Sequence[Write], bounds: Promise, begins: Sequence[float] = ()) -> LogFindings:
    """Judge a log: peak, slew, the ramp after every gap and beginning, and zero at the end.

    A ramp is due from the first write on, unless it is zero; from the first one after the device
    let go; and from the first one after each of `begins`.

    Parameters
    ----------
    log : sequence of Write
        All that the device was given, in order.
    bounds : Promise
        What was to be kept.
    begins : sequence of float
        When the position was elsewhere without a motion, or a force was due again after it had been
        away [s].

    Returns
    -------
    LogFindings
        What it breaks, and how close it came.
    """
    found: list[str] = []
    above, steepest = 0, 0.0
    coming = sorted(begins)
    felt, last = ZERO, -math.inf
    # When the ramp began that is due, and what was felt then; none before the first force.
    ramp_from, due_from, before = -math.inf, math.nan, ZERO
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
            # Of the ramp, what the gap costs: whole ticks, of which the first is not full.
            cost = bounds.regain * (at - last - bounds.hold - bounds.period)
            over = at - max(at - max(bounds.ramp - cost, 0.0), min(ramp_from, at))
            ramp_from, due_from, before = at - over, due - over, ZERO
        while coming and coming[0] <= at:
            coming.pop(0)
            ramp_from, due_from, before = at, due, felt
        if max(map(abs, force)) > bounds.peak + EPSILON:
            above += 1
            found.append(f"{where}: {force} N, largest {bounds.peak:g} N")
        # Within half a tick there is at most one boundary between two ticks, each of which has its
        # slew; a driver that was held up begins several ticks late, one right after the other, so
        # that what is known to belong to one tick is counted.
        known = not math.isnan(due)
        changes = [
            one
            for one in changes
            if (one[0] == due if known else at - one[0] < 0.5 * bounds.period)
        ]
        changes.append(
            (due if known else at, [abs(new - old) for new, old in zip(force, felt, strict=True)])
        )
        moved = max(sum(change[i] for _, change in changes) for i in range(3))
        if moved > 2.0 * bounds.slew + EPSILON:
            within = "one tick" if known else "half a tick"
            found.append(
                f"{where}: changed by {moved:g} N within {within}, slew {bounds.slew:g} N a tick"
            )
        # The first force of a ramp is one step of it, and may come a tick after the write that the
        # ramp is taken to begin at.
        since = (
            at - ramp_from if math.isnan(due - due_from) else max(at - ramp_from, due - due_from)
        )
        share = min((since + 2.0 * bounds.period) / bounds.ramp, 1.0) if bounds.ramp > 0.0 else 1.0
        for i in range(3):
            allowed = share * bounds.peak + (1.0 - share) * abs(before[i])
            steepest = max(steepest, abs(force[i]) / allowed) if share < 1.0 else steepest
            if abs(force[i]) > allowed + EPSILON:
                found.append(
                    f"{where}: {force[i]:g} N along {'xyz'[i]}, {since:.4f} s after a force that no"
                    " motion made"
                )
        felt, last = force, at
    if log and any(log[-1].force):
        found.append(f"{log[-1].at:.4f} s: {log[-1].force} N is left on the device")
    return LogFindings(found, above, steepest)
