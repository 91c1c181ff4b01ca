"""The last check before the device: no stale, unlimited or unwanted force passes.

A small state machine, the same for the virtual device and for hardware::

    waiting ──first force──▶ ramp ──▶ active ──no fresh force for `watchdog` ticks──▶ damping ──▶
    zero
    damping, zero ──a fresh force──▶ ramp
    any state ──outside the workspace──▶ fault ──back inside──▶ zero
    any state ──the force oscillates between its limits and generates energy──▶ stopped

``stopped`` is permanent: damping, then no force, until `rearm` is requested or the driver is
restarted. While there is no force, a hand that keeps pushing sinks in, and the law then requests
far more force than before. So every force returns by a ramp after a gap: each missing tick costs
`REGAIN` ticks of ramp, up to the whole one (`recovery`). A ramp that pushes the device fast grows
slowly, and shrinks beyond `RETURN_SPEED`, so that a hand that has sunk in is let out, not thrown.

A force without a cause in motion has a ramp too: the first one of a run, unless it is zero, and the
one after a jump of the position (`rebase`: a clutch, a re-centring, a device that was read again
elsewhere), during which the previous force fades.

Limits come from the device and from the launch file, whichever is lower; an overruled one is
reported by an event. Whatever messages arrive, in whatever order: on each axis the force stays
within the peak, all changes during one tick add up to no more than the slew, and the mean square of
the force stays within the continuous limit (motor_heat.py).

The rules are plain functions on the driver's state: the interpreter calls them, and the compiled
tick compiles them.
"""

from __future__ import annotations

import math
from typing import Final

from nodes.arithmetic import limit, limit_within_tick
from nodes.compiled.rules import rule
from nodes.driver import notes
from nodes.driver.motion import find_velocity
from nodes.driver.motor_heat import close_tick, lower_heat, note_heat
from nodes.driver.passivity import guarded
from nodes.driver.state import (
    ACTIVE,
    DAMPING,
    FAULT,
    IDLE,
    NOTHING,
    RAMP,
    STOPPED,
    DriverState,
    note,
    seldom,
)

# position beyond which no device can be: a measurement fault [m]
REACH: Final = 1e6

# ticks of ramp per tick without force; after a fifth of `recovery` the whole ramp is due
REGAIN: Final = 5
# speed above which a returning force must not push [m/s]: the reduced speed of ISO 10218-1
RETURN_SPEED: Final = 0.25

FUTURE, REPLAYED, STALE, NOT_FINITE = range(4)
PEAK, SLEW, HEAT = range(3)


@rule
def enter(
    s: DriverState,
    state: int,
    seq: int,
    why: int,
    a: float = 0.0,
    b: float = 0.0,
    c: float = 0.0,
    d: float = 0.0,
) -> None:
    """Change the state of the safety."""
    before = s.safety
    if state == before or before == STOPPED:
        return
    if before == ACTIVE:
        s.regained = float(s.recovery_ticks)
    if before in (ACTIVE, RAMP):
        s.away_from = float(seq)
    if state == FAULT:
        s.regained = 0.0
    s.safety = state
    s.entered[state] += 1
    note(s, why, seq, 8 * before + state, a, b, c, d)


def rearm(s: DriverState, seq: int) -> bool:
    """Leave STOPPED on request, ramping from zero. Return whether it was stopped."""
    if s.safety != STOPPED:
        return False
    # Oscillations are counted from zero; motor heat and energy are kept.
    s.peaks_count = s.peaked = 0
    s.pressed_since = -1
    s.regained, s.away_from = 0.0, float(seq)
    for i in range(3):
        s.brake[i], s.sides[i] = 0.0, 0
    s.safety = NOTHING
    s.entered[NOTHING] += 1
    note(s, notes.REARMED, seq, 8 * STOPPED + NOTHING)
    return True


@rule
def admit(s: DriverState, seq: int) -> bool:
    """Return whether the received message may be used at all."""
    answers = s.got_seq
    x, y, z = s.got[0], s.got[1], s.got[2]
    if not math.isfinite(x + y + z):
        why = NOT_FINITE
        a = float(answers)
        b = x
        c = y
        d = z
    elif answers > seq:
        why = FUTURE
        a = float(answers)
        b = float(seq)
        c = 0.0
        d = 0.0
    elif answers <= s.force_seq:
        why = REPLAYED
        a = float(answers)
        b = float(s.force_seq)
        c = 0.0
        d = 0.0
    elif seq - answers > s.max_age:
        why = STALE
        a = float(seq - answers)
        b = float(s.max_age)
        c = 0.0
        d = 0.0
    else:
        return True
    s.refused_for[why] += 1
    count = s.refused_for[why]
    if seldom(count):
        note(s, notes.REFUSED_FIRST + why, seq, -1, float(count), a, b, c, d)
    return False


@rule
def command(s: DriverState, seq: int, share: float) -> None:
    """Turn the admitted message into `force`; the previous one acts for `share` of the tick."""
    s.force_seq = s.got_seq
    s.since = seq
    # An axis that is not computed has no force, also for ramp, guard and heat.
    s.wanted[0] = s.wanted[1] = s.wanted[2] = 0.0
    for i in range(3):
        s.normal[i] = s.got_normal[i]
    at = s.external_at
    for n in range(s.axes):
        i = s.axis[n]
        s.wanted[i] = s.got[i]
        if seq < s.external_until[at]:
            s.wanted[i] += s.external[3 * at + i]
    if s.safety != ACTIVE or s.begins != 0:
        _become_active(s, seq)
    if s.guard_on != 0 and s.safety in (ACTIVE, RAMP):
        asked = abs(s.wanted[0]) + abs(s.wanted[1]) + abs(s.wanted[2])
        guarded(s, share)
        if s.safety == RAMP and asked > 0.0:
            # The ramp continues from the guarded force; otherwise a removed force would return at
            # once.
            passed = abs(s.wanted[0]) + abs(s.wanted[1]) + abs(s.wanted[2])
            s.regained = s.regained * min(passed / asked, 1.0)
    hand_over(s, seq)


@rule
def _become_active(s: DriverState, seq: int) -> None:
    """Scale the wanted force while not active: none in a fault, a brake when stopped, a ramp."""
    if s.safety in (FAULT, STOPPED):
        for n in range(s.axes):
            i = s.axis[n]
            s.wanted[i] = 0.0 if s.safety == FAULT else s.brake[i]
        return
    if s.safety not in (IDLE, ACTIVE, RAMP):
        s.ramp_ticks = s.recovery_ticks
        away = REGAIN * math.ceil(seq - s.away_from)
        s.regained = max(s.regained - away, 0.0) if s.begins == 0 else 0.0
        # nothing from before a jump is felt any more
        s.begins, s.fading = 0, 0.0
        enter(s, RAMP if s.ramp_ticks > 0 else ACTIVE, seq, notes.FRESH_FORCE)
    elif s.begins != 0 and not _begin(s, seq):
        return
    if s.safety == ACTIVE:
        return
    pushed = squared = 0.0
    find_velocity(s)
    for i in range(3):
        s.wanted[i] = limit(s.wanted[i], 0.0, s.peak, math.inf)
        pushed += s.wanted[i] * s.velocity[i]
        squared += s.wanted[i] * s.wanted[i]
    if seq != s.ramp_seq:
        s.ramp_seq = seq
        s.regained = max(s.regained + _regrowth(pushed, math.sqrt(squared)), 0.0)
        s.fading = max(s.fading - 1.0, 0.0)
    if s.regained >= s.ramp_ticks:
        enter(s, ACTIVE, seq, notes.DONE_RAMP, float(s.ramp_ticks))
        return
    share = s.regained / s.ramp_ticks
    for i in range(3):
        s.wanted[i] = s.wanted[i] * share
    if s.fading > 0.0:
        # It fades by one tick a tick, and the share grows by no more: their sum is at most 1.
        for n in range(s.axes):
            i = s.axis[n]
            s.wanted[i] += s.fading / s.ramp_ticks * s.felt[i]


@rule
def _begin(s: DriverState, seq: int) -> bool:
    """Begin the ramp of a force without motion. Return whether the force may change."""
    if s.got_seq < s.felt_seq:
        # it answers a position before the jump
        for i in range(3):
            s.wanted[i] = s.felt[i]
        return False
    s.begins = 0
    is_felt = False
    for i in range(3):
        is_felt = is_felt or s.wanted[i] != 0.0 or s.felt[i] != 0.0
    if s.safety == IDLE:
        has_ramp = s.ramp_ticks > 0 and (is_felt or s.always_ramp != 0)
        enter(s, RAMP if has_ramp else ACTIVE, seq, notes.FIRST_FORCE)
    elif is_felt and s.recovery_ticks > 0:
        enter(s, RAMP, seq, notes.JUMPED)
        s.ramp_ticks = s.recovery_ticks
        s.regained = 0.0
        s.fading = float(s.recovery_ticks)
    return True


@rule
def rebase(s: DriverState, seq: int) -> None:
    """Record a jump of the position without motion, and the force felt at that time."""
    s.rebased = s.felt_seq = seq
    s.begins = 1
    for i in range(3):
        s.felt[i] = s.handed[i]


@rule
def _regrowth(pushed: float, size: float) -> float:
    """Return the growth of a ramp in a tick [ticks], by power [W] and size [N] of the force.

    It slows down above half of `RETURN_SPEED`. With whole steps, forward below that speed and
    `REGAIN` back above it, a hand could oscillate around it for ever; one in thirty of three
    thousand did, with other springs, devices and laws.
    """
    if size <= 0.0:
        return 1.0
    return max(min(2.0 - 2.0 * pushed / (RETURN_SPEED * size), 1.0), -float(REGAIN))


@rule
def missed(s: DriverState, seq: int) -> bool:
    """Close a tick without its answer. Return whether `force` must be handed over."""
    for i in range(3):
        s.wanted[i] = s.force[i]
    if s.guard_on != 0:
        guarded(s, 1.0)
    if s.safety == IDLE:
        return False
    silent = seq - s.since
    if s.safety in (ACTIVE, RAMP):
        if silent < s.watchdog:
            x, y, z = s.force[0], s.force[1], s.force[2]
            hand_over(s, seq)
            return bool(s.force[0] != x or s.force[1] != y or s.force[2] != z)
        enter(s, DAMPING, seq, notes.SILENT, float(silent), float(s.watchdog))
    if s.safety == DAMPING and silent >= s.watchdog + s.damping_ticks:
        enter(s, NOTHING, seq, notes.STILL_SILENT, float(silent))
    if s.safety == DAMPING:
        find_velocity(s)
    for n in range(s.axes):
        i = s.axis[n]
        s.wanted[i] = 0.0
        if s.safety == DAMPING:
            s.wanted[i] = -s.damping * s.velocity[i]
        elif s.safety == STOPPED:
            s.wanted[i] = s.brake[i]
    hand_over(s, seq)
    return True


@rule
def let_go(s: DriverState, seq: int, since: float) -> None:
    """Record that the device let go by itself; a force then returns as after any other gap."""
    for i in range(3):
        s.force[i] = s.handed[i] = 0.0
    if s.safety in (ACTIVE, RAMP):
        enter(s, NOTHING, seq, notes.LET_GO)
        s.away_from = since


@rule
def watch_position(s: DriverState, seq: int) -> bool:
    """Return whether the position is valid and inside the workspace; else there is no force."""
    x, y, z = s.place[0], s.place[1], s.place[2]
    reach = s.reach
    if not (-reach <= x <= reach and -reach <= y <= reach and -reach <= z <= reach):
        enter(s, FAULT, seq, notes.NO_POSITION, x, y, z)
        s.brake[0] = s.brake[1] = s.brake[2] = 0.0
        return False
    if s.bounded != 0:
        for i in range(3):
            low = s.workspace[2 * i]
            high = s.workspace[2 * i + 1]
            if not low <= s.place[i] <= high:
                enter(s, FAULT, seq, notes.OUTSIDE, float(i), s.place[i], low, high)
                s.brake[0] = s.brake[1] = s.brake[2] = 0.0
                return False
    if s.safety == FAULT:
        # Not active yet: a fresh force must come first, which grows by the ramp. The motion back
        # was not seen.
        s.rebased = seq
        enter(s, NOTHING, seq, notes.BACK_INSIDE)
    return True


@rule
def hand_over(s: DriverState, seq: int) -> None:
    """Apply all limits to the wanted force; several forces in one tick share one slew."""
    if s.unlimited != 0:
        s.force[0] = s.force[1] = s.force[2] = 0.0
        for n in range(s.axes):
            s.force[s.axis[n]] = s.wanted[s.axis[n]]
        return
    if seq != s.limited_at:
        close_tick(s, seq - s.limited_at if s.limited_at >= 0 else 0)
        s.limited_at = seq
        s.slewed[0] = s.slewed[1] = s.slewed[2] = 0.0
    for n in range(s.axes):
        i = s.axis[n]
        asked = s.wanted[i]
        s.wanted[i] = limit_within_tick(asked, s.force[i], s.peak, s.slew, s.slewed[i])
        side = 0
        if abs(asked) > s.peak:
            side = 1 if asked > 0.0 else -1
        if s.wanted[i] != asked:
            s.limited_by[PEAK if side != 0 else SLEW] += 1
        if side not in (0, s.sides[i]):
            s.peaked = 1
        s.sides[i] = side
    if s.heat_keep < 1.0:
        if lower_heat(s):
            s.limited_by[HEAT] += 1
            if seldom(s.limited_by[HEAT]):
                note(
                    s,
                    notes.CONTINUOUS,
                    seq,
                    -1,
                    float(s.limited_by[HEAT]),
                    s.continuous,
                )
        note_heat(s)
    for n in range(s.axes):
        i = s.axis[n]
        s.slewed[i] += abs(s.wanted[i] - s.force[i])
        s.force[i] = s.wanted[i]
