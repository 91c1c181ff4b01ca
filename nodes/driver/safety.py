"""The last line before the device: no force is handed over that is stale, unlimited or unasked for.

A small machine of states, the same for the virtual device and for hardware::

    waiting ──first force──▶ ramp ──▶ active ──no fresh force for `watchdog` ticks──▶ damping ──▶
    zero
                              ▲                                                                  │
                              ├──────────────────────── a fresh force ───────────────────────────┘
                            zero ◀──back inside── fault ◀──outside the workspace── any of them
                         stopped ◀──the force swings between its limits, and gives out energy── any
                         of them

``stopped`` is for good: damping, then no force, until somebody asks for it (`rearm`) or the driver
is started again. While there is no force, a hand that keeps pushing sinks in, and the law then asks
for far more than before. So every force that was away comes back by a ramp: each tick away takes
`REGAIN` ticks of ramp, up to the whole one (`recovery`). A ramp that pushes the device fast grows
slowly, and goes back beyond `RETURN_SPEED`: whoever has sunk in is let out, not thrown.

A force that no motion made has a ramp too: the first one of a run, unless it is zero, and the one
after a jump of the position (`rebase`: a clutch, a re-centre, a device that was read again
elsewhere), during which what was felt before fades.

Limits come from the device and from the launch file, whichever is lower; one that asks for more
gets an event that says so. Whatever messages come in whatever order: on each axis the force stays
within the peak, all changes made during one tick add up to no more than the slew, and the mean
square of the force stays within the continuous limit, see motor_heat.py.

The rules are plain functions on the driver's state: the interpreter calls them, and the compiled
tick compiles them.
"""

from __future__ import annotations

import math
from typing import Final

from messages.types import ZERO, Vector
from nodes.arithmetic import limit, limit_within_tick
from nodes.compiled.rules import rule
from nodes.driver import notes
from nodes.driver.limits import STOP_TIME, Limits, SafetyParameters, recovery_ramp, start_ramp
from nodes.driver.motion import find_velocity
from nodes.driver.motor_heat import close_tick, lower_heat, note_heat, set_heat
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

# farther than this no device is: a position beyond is a fault of whoever measured it [m]
REACH: Final = 1e6

# a loop is stopped that reaches the largest force `stop_after` times in it, and gives out energy
# [s]
STOP_WINDOW: Final = 2.0
# a force that stays at its limit and gives out energy stops the loop within the window divided by
# this
PRESSES: Final = 2
# ticks of ramp that one tick without a force costs: after a fifth of `recovery` the whole ramp is
# due
REGAIN: Final = 5
# faster than this a force that comes back must not push [m/s]: the reduced speed of ISO 10218-1
RETURN_SPEED: Final = 0.25

FUTURE, REPLAYED, STALE, NOT_FINITE = range(4)
PEAK, SLEW, HEAT = range(3)


def set_safety(s: DriverState, parameters: SafetyParameters, limits: Limits, period: float) -> None:
    """Lay down what holds for a run."""
    s.peak = math.inf if limits.peak is None else limits.peak
    s.slew = math.inf if limits.slew is None else limits.slew
    s.unlimited = limits.peak is None and limits.slew is None and limits.continuous is None
    s.max_age, s.watchdog, s.damping_ticks = limits.max_age, limits.watchdog, limits.damping_ticks
    s.damping = parameters.damping
    s.start_ticks = round(start_ramp(parameters) / period)
    s.recovery_ticks = round(recovery_ramp(parameters) / period)
    s.ramp_ticks, s.ramp_seq = s.start_ticks, -1
    # Before the first force nothing is felt, and whatever that force is, no motion made it.
    s.begins, s.felt_seq, s.always_ramp = 1, -1, parameters.ramp is not None
    set_workspace(s, limits)
    s.reach = REACH
    set_heat(s, limits.continuous, parameters.thermal_time, period)
    # Only a largest force tells what a swing is.
    s.stop_after = 0 if limits.peak is None else parameters.stop_after or 0
    s.pressed_since, s.pressed_ticks = -1, pressed_ticks(s.stop_after, period)
    s.safety, s.force_seq, s.since, s.limited_at = IDLE, -1, 0, -1


def pressed_ticks(stop_after: int, period: float) -> int:
    """Return after how many ticks at its limit a force counts once more as coming to it."""
    return max(round(STOP_WINDOW / (PRESSES * max(stop_after, 1) * period)), 1)


def set_workspace(s: DriverState, limits: Limits) -> None:
    """Lay down where there may be a force."""
    s.workspace[:] = [bound for bounds in limits.workspace for bound in bounds]
    s.bounded = any(map(math.isfinite, s.workspace))


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
    """Change what is done with forces."""
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
    """Let a driver that has stopped take forces again, on request, from nothing, by the whole ramp; whether it had."""
    if s.safety != STOPPED:
        return False
    # Swings are counted anew; what the motor has been heated by, and energy, are not forgotten.
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
    """Judge whether the message that was taken may be used at all."""
    answers = s.got_seq
    x, y, z = s.got[0], s.got[1], s.got[2]
    if not math.isfinite(x + y + z):
        why, a, b, c, d = NOT_FINITE, float(answers), x, y, z
    elif answers > seq:
        why, a, b, c, d = FUTURE, float(answers), float(seq), 0.0, 0.0
    elif answers <= s.force_seq:
        why, a, b, c, d = REPLAYED, float(answers), float(s.force_seq), 0.0, 0.0
    elif seq - answers > s.max_age:
        why, a, b, c, d = STALE, float(seq - answers), float(s.max_age), 0.0, 0.0
    else:
        return True
    s.refused_for[why] += 1
    count = s.refused_for[why]
    if seldom(count):
        note(s, notes.REFUSED_FIRST + why, seq, -1, float(count), a, b, c, d)
    return False


@rule
def command(s: DriverState, seq: int, share: float) -> None:
    """Turn the admitted message into `force`; what is on the device acts for a `share` of the tick before it."""
    s.force_seq = s.got_seq
    s.since = seq
    # Along an axis that nobody computes there is no force, and none that ramp, guard and heat would
    # reckon with.
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
            # The ramp goes on from what the guard lets through: else a force that it took away
            # would be back at once.
            passed = abs(s.wanted[0]) + abs(s.wanted[1]) + abs(s.wanted[2])
            s.regained = s.regained * min(passed / asked, 1.0)
    hand_over(s, seq)


@rule
def _become_active(s: DriverState, seq: int) -> None:
    """Let forces in again: none in a fault, a brake when stopped, a growing share of them during the ramp."""
    if s.safety in (FAULT, STOPPED):
        for n in range(s.axes):
            i = s.axis[n]
            s.wanted[i] = 0.0 if s.safety == FAULT else s.brake[i]
        return
    if s.safety not in (IDLE, ACTIVE, RAMP):
        s.ramp_ticks = s.recovery_ticks
        away = REGAIN * math.ceil(seq - s.away_from)
        s.regained = max(s.regained - away, 0.0) if s.begins == 0 else 0.0
        # Nothing of before a jump is felt any more.
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
        # It fades by one tick a tick, and the share grows by no more: together they are at most 1.
        for n in range(s.axes):
            i = s.axis[n]
            s.wanted[i] += s.fading / s.ramp_ticks * s.felt[i]


@rule
def _begin(s: DriverState, seq: int) -> bool:
    """Begin the ramp of a force that no motion made; return whether the force may leave what is felt."""
    if s.got_seq < s.felt_seq:
        # It answers a position before the jump.
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
        s.ramp_ticks, s.regained, s.fading = s.recovery_ticks, 0.0, float(s.recovery_ticks)
    return True


@rule
def rebase(s: DriverState, seq: int) -> None:
    """Note that the position of a tick is elsewhere without a motion, and the force that is felt meanwhile."""
    s.rebased = s.felt_seq = seq
    s.begins = 1
    for i in range(3):
        s.felt[i] = s.handed[i]


@rule
def _regrowth(pushed: float, size: float) -> float:
    """Tell by how many ticks a ramp grows in one, by the power of the whole force [W] and its size [N].

    It slows down from half of `RETURN_SPEED` on. With whole steps, forth below that speed and
    `REGAIN` back above it, a hand could swing around it without an end: one in thirty did, of three
    thousand with other springs, devices and laws.
    """
    if size <= 0.0:
        return 1.0
    return max(min(2.0 - 2.0 * pushed / (RETURN_SPEED * size), 1.0), -float(REGAIN))


@rule
def missed(s: DriverState, seq: int) -> bool:
    """Decide about a tick that closes without the force that answers it; whether `force` must be handed over."""
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
    """Note that the device let go by itself at a tick: a force then comes back as after any other gap."""
    for i in range(3):
        s.force[i] = s.handed[i] = 0.0
    if s.safety in (ACTIVE, RAMP):
        enter(s, NOTHING, seq, notes.LET_GO)
        s.away_from = since


@rule
def watch_position(s: DriverState, seq: int) -> bool:
    """Look whether the position that was read is one, and inside the workspace; otherwise there is no force."""
    x, y, z = s.place[0], s.place[1], s.place[2]
    reach = s.reach
    if not (-reach <= x <= reach and -reach <= y <= reach and -reach <= z <= reach):
        enter(s, FAULT, seq, notes.NO_POSITION, x, y, z)
        s.brake[0] = s.brake[1] = s.brake[2] = 0.0
        return False
    if s.bounded != 0:
        for i in range(3):
            low, high = s.workspace[2 * i], s.workspace[2 * i + 1]
            if not low <= s.place[i] <= high:
                enter(s, FAULT, seq, notes.OUTSIDE, float(i), s.place[i], low, high)
                s.brake[0] = s.brake[1] = s.brake[2] = 0.0
                return False
    if s.safety == FAULT:
        # Not active yet: a force must come first, which then grows by the ramp. How it came here
        # was not seen.
        s.rebased = seq
        enter(s, NOTHING, seq, notes.BACK_INSIDE)
    return True


@rule
def watch_swings(s: DriverState, seq: int) -> None:
    """Stop for good when the force comes to its limit again and again and the loop gives out energy meanwhile.

    Energy is compared between moments at which the force comes to its limit, so that what a surface
    has in store then is no part of it. A surface that takes energy, as one does that somebody taps
    hard, is not stopped. A force that stays at its limit counts again and again while more was
    given out than when it came there: a hand that pushes on only takes energy.
    """
    if s.safety != STOPPED:
        _watch_press(s, seq)
    if s.safety != STOPPED and s.peaked != 0:
        s.peaked = 0
        # A ring of the newest moments: tick, and the energy given out until then [J].
        at = s.peaks_count % s.stop_after
        s.peaks[2 * at], s.peaks[2 * at + 1] = float(seq), s.energy
        s.peaks_count += 1
        first = s.peaks_count % s.stop_after if s.peaks_count >= s.stop_after else 0
        span, gained = (seq - s.peaks[2 * first]) * s.period, s.energy - s.peaks[2 * first + 1]
        if s.peaks_count >= s.stop_after and span <= STOP_WINDOW and gained > 0.0:
            s.stopped_at = seq
            enter(s, STOPPED, seq, notes.SWINGS, s.peak, float(s.stop_after), span, gained)
    if s.safety == STOPPED:
        find_velocity(s)
        damped = seq - s.stopped_at < s.damping_ticks
        for i in range(3):
            s.brake[i] = -s.damping * s.velocity[i] if damped else 0.0


@rule
def _watch_press(s: DriverState, seq: int) -> None:
    """Count a force that stays at its limit, and gives out energy, as one that comes to it again."""
    if s.sides[0] == 0 and s.sides[1] == 0 and s.sides[2] == 0:
        s.pressed_since = -1
    elif s.pressed_since < 0 or s.peaked != 0:
        s.pressed_since = s.pressed_at = seq
        s.pressed_energy = s.energy
    elif seq - s.pressed_at >= s.pressed_ticks and s.energy > s.pressed_energy:
        s.pressed_at, s.peaked = seq, 1


@rule
def hand_over(s: DriverState, seq: int) -> None:
    """Apply all limits to what is wanted, tick by tick: several forces in one tick share one slew."""
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
                note(s, notes.CONTINUOUS, seq, -1, float(s.limited_by[HEAT]), s.continuous)
        note_heat(s)
    for n in range(s.axes):
        i = s.axis[n]
        s.slewed[i] += abs(s.wanted[i] - s.force[i])
        s.force[i] = s.wanted[i]


def soft_stop(start: Vector, slew: float, period: float) -> list[Vector]:
    """Plan the way to zero force for the end of the loop."""
    if start == ZERO:
        return [ZERO]
    steps = max(1, min(10, int(STOP_TIME / period)))
    if math.isfinite(slew):
        steps = max(steps, math.ceil(max(map(abs, start)) / slew))
    return [
        (start[0] * left / steps, start[1] * left / steps, start[2] * left / steps)
        for left in range(steps - 1, -1, -1)
    ]
