"""The loop of a scene: the kernels of the nodes, called in the same order as by the nodes.

It is a plain function, compiled unchanged. Its inputs are a few tuples of numbers and arrays. In
lockstep each tick's force takes effect by the rule; in real time forces arrive at the times of
`Arrivals`, late or never.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any

from nodes.arithmetic import (
    cross_fade,
    deflection,
    eased,
    limit,
    limit_within_tick,
    one_sided,
    push,
    settle,
    warm_up,
)
from nodes.compiled.kernels.sources import kernel
from nodes.coupling.render import evaluate
from nodes.driver.passivity import backlog, control, forget, observe, through
from nodes.environment.flat import meet_plane
from nodes.environment.state import ANCHOR, PLANE
from sim.device.friction import move
from sim.device.model import Coefficients, coefficients, end_stop, quantise, saturate
from sim.play.compiled import compiled, own_force
from sim.play.one_axis_tables import (
    Arrivals,
    Contact,
    Guard,
    LawTables,
    Motion,
    Records,
    Values,
)

kernel(meet_plane)


@kernel
def respond(
    measured: float,
    kind: int,
    surface: float,
    normal: float,
    raw: bool,
    history: Values,
    head: int,
    length: int,
) -> tuple[int, float, bool]:
    """Environment and first half of the coupling: from the sample to the newest deflection."""
    proxy = measured
    distance = 0.0
    contact = kind == ANCHOR
    if kind == PLANE:
        proxy, distance, contact = meet_plane(measured, surface, normal)
    elif contact:
        proxy = surface
    newest = deflection(measured, proxy, distance, normal, contact, raw)
    return push(history, head, length, newest), newest, contact


kernel(evaluate)


NUDGE = 0.1  # correction of the velocity: this fraction of a nudge per tick


@kernel
def nudge(
    x: float, read: float, resolution: float | None, period: float
) -> tuple[float, float, float]:
    """Return the least jumps of position and velocity that reproduce an encoder reading."""
    if quantise(x, resolution) == read:
        return 0.0, 0.0, 0.0
    # A millionth short of the step's edges, where rounding decides.
    room = 0.0 if resolution is None else 0.499999 * resolution
    off = min(max(x, read - room), read + room) - x
    return off, NUDGE * off / period, read - quantise(x + off, resolution)


# Small functions, because numba prunes a branch only if an *argument* is None, not a field.
@kernel
def _note(row: Values | None, k: int, value: float) -> None:
    if row is not None:
        row[k] = value


@kernel
def _stopped(
    x: float, v: float, ends: tuple[float, float] | None
) -> tuple[float, float]:
    if ends is None:
        return x, v
    return end_stop(x, v, ends[0], ends[1])


@kernel
def _load_at(loads: Values | None, load: float, k: int) -> float:
    if loads is None:
        return load
    value: float = loads[k]
    return value


@kernel
def _slice(numbers: Any, start: int, end: int) -> Any:
    if numbers is None:
        return None
    return numbers[start:end]


@kernel
def _warm_up(recursive: Any, state: Any, history: Any, head: int, length: int) -> None:
    if recursive is not None:
        warm_up(recursive, state, history, head, length)


@kernel
def _settle(recursive: Any, state: Any, value: float) -> None:
    if recursive is not None:
        settle(recursive, state, value)


@kernel
def _move_early(
    x: float,
    v: float,
    force: float,
    early: float,
    early_map: Coefficients | None,
    mass: float,
    damping: float,
    grip: float,
    friction: float | None,
) -> tuple[float, float]:
    if early_map is None:
        return x, v
    if early == 0.0:
        return x, v
    return move(x, v, force, early, early_map, mass, damping, grip, friction)


@kernel
def _guarded(
    guard: Guard, energy: float, force: float, step: float, pending: float, share: float
) -> tuple[float, float]:
    """Return the guard's energy account and the force that it allows.

    The pending force acts for `share` of the tick.
    """
    energy = forget(energy, force, guard.stiffness)
    expected = (
        energy
        - guard.allowance
        + (share * pending + backlog(guard.line, guard.part)) * step
    )
    return energy, control(expected, force, step, guard.damping)


@kernel
def _move_part(
    x: float, v: float, u: float, ticks: float, motion: Motion
) -> tuple[float, float]:
    """Move the device for part of a tick."""
    duration = ticks * motion.period
    if duration <= 0.0:
        return x, v
    step = coefficients(motion.mass, motion.damping, motion.grip, duration)
    x, v = move(
        x,
        v,
        u,
        duration,
        step,
        motion.mass,
        motion.damping,
        motion.grip,
        motion.friction,
    )
    return _stopped(x, v, motion.ends)


# Long because it is one compiled function; calls would cost the gained speed.
def play(  # noqa: C901, PLR0915
    ticks: int,
    motion: Motion,
    contact: Contact,
    laws: LawTables,
    states: Values,
    history: Values,
    commands: Values,
    records: Records,
    guard: Guard | None = None,
    own: Callable[[Sequence[float], int], float] | None = None,
    arrivals: Arrivals | None = None,
    nudged: Values = None,
    read: Values | None = None,
) -> tuple[float, float]:
    """Play a scene from rest; `sim.play.one_axis.run` prepares it and reads the records.

    `nudged` are jumps of position, velocity and reading at each tick. With `read`, the readings of
    a recording, they are computed here.
    """
    x, v = motion.position, motion.velocity
    length = len(history) // 2
    waiting = motion.waiting
    head = 0
    applied = 0.0
    done = 0
    ramp = 0
    slot = 0
    energy = 0.0
    acting = 0.0
    before = 0.0
    step = 0.0
    came = 0
    gone = 0
    handed = 0.0
    following = 0.0
    moving = 0.0
    easing = 0
    ease_done = 0
    ease_offset = 0.0
    now_taps = laws.taps[laws.taps_from[0] : laws.taps_from[1]]
    now_state = states[laws.states_from[0] : laws.states_from[1]]
    old_taps = now_taps
    old_state = now_state
    now_recursive = _slice(
        laws.recursive, 2 * laws.states_from[0], 2 * laws.states_from[1]
    )
    old_recursive = now_recursive
    # One span per law: the law is constant within a span, which is 1.7 times faster.
    start = 0
    for law in range(len(laws.swap_at) + 1):
        if law > 0:
            ramp = laws.swap_ramp[law - 1]
            done = 0
            old_taps = now_taps
            old_state = now_state
            now_taps = laws.taps[laws.taps_from[law] : laws.taps_from[law + 1]]
            now_state = states[laws.states_from[law] : laws.states_from[law + 1]]
            old_recursive = now_recursive
            now_recursive = _slice(
                laws.recursive, 2 * laws.states_from[law], 2 * laws.states_from[law + 1]
            )
            _warm_up(now_recursive, now_state, history, head, length)
        end = ticks
        if law < len(laws.swap_at) and laws.swap_at[law] < ticks:
            end = laws.swap_at[law]
        for k in range(start, end):
            if read is not None:
                nudged[k, 0], nudged[k, 1], nudged[k, 2] = nudge(
                    x, float(read[k]), motion.resolution, motion.period
                )
            if nudged is not None:
                x += float(nudged[k, 0])
                v += float(nudged[k, 1])
            measured = quantise(x, motion.resolution)
            if nudged is not None:
                measured += float(nudged[k, 2])
            head, newest, touches = respond(
                measured,
                contact.kind,
                contact.surface,
                contact.normal,
                contact.raw,
                history,
                head,
                length,
            )
            if k == 0 and newest != 0.0:
                # The scene begins in contact: at rest, as in the coupling, and the force rises by
                # its easing.
                for m in range(len(history)):
                    history[m] = newest
                if law == 0:
                    _settle(now_recursive, now_state, newest)
                else:
                    _warm_up(now_recursive, now_state, history, head, length)
                    if law == 1:
                        _settle(old_recursive, old_state, newest)
                    else:
                        _warm_up(old_recursive, old_state, history, head, length)
                easing = max(contact.ease, 1)
            force = evaluate(now_taps, now_recursive, now_state, history, head)
            if own is not None:
                force = force + own_force(own, history, head)
            if done < ramp:
                force = cross_fade(
                    evaluate(old_taps, old_recursive, old_state, history, head),
                    force,
                    done,
                    ramp,
                )
                done += 1
            force = one_sided(
                force,
                contact.normal,
                force * contact.normal,
                touches,
                contact.raw,
                contact.clamp,
            )
            if easing > 0:
                force = limit(force, 0.0, contact.peak, math.inf)
                if ease_done == 0:
                    ease_offset = 0.0 - force
                force = eased(force, 0.0, ease_offset, ease_done, easing)
                ease_done += 1
                if ease_done >= easing:
                    easing = 0
            if guard is not None:
                if k > 0:
                    step = measured - before
                    energy = observe(energy, acting, step)
                before = measured
            records.positions[k] = x
            _note(records.velocities, k, v)
            _note(records.measureds, k, measured)
            _note(records.deflections, k, newest)
            load = _load_at(motion.loads, motion.load, k)
            if arrivals is None:
                pending = applied
                if guard is not None:
                    energy, force = _guarded(
                        guard, energy, force, step, pending, guard.late
                    )
                _note(records.asked, k, force)
                applied = limit_within_tick(
                    force, applied, contact.peak, contact.slew, 0.0
                )
                if guard is not None:
                    acting = through(
                        guard.line,
                        applied if guard.late == 0.0 else pending,
                        guard.part,
                    )
                # A ring of the last i + 2 commands; of the pending ones, tick k−i−1's acts first,
                # then tick k−i's.
                commands[slot] = applied
                older = slot + 1 if slot + 1 < waiting else 0
                newer = older + 1 if older + 1 < waiting else 0
                slot = older
                u = saturate(commands[older], motion.motor) + load
                x, v = _move_early(
                    x,
                    v,
                    u,
                    motion.early,
                    motion.early_map,
                    motion.mass,
                    motion.damping,
                    motion.grip,
                    motion.friction,
                )
                x, v = _stopped(x, v, motion.ends)
                u = (
                    saturate(applied if waiting == 2 else commands[newer], motion.motor)
                    + load
                )
                x, v = move(
                    x,
                    v,
                    u,
                    motion.late,
                    motion.late_map,
                    motion.mass,
                    motion.damping,
                    motion.grip,
                    motion.friction,
                )
                x, v = _stopped(x, v, motion.ends)
            else:
                arrivals.asked[k] = force
                late = 0.0 if guard is None else guard.late
                if late > 0.0:
                    handed = following
                since = 0.0
                mean = 0.0
                slewed = 0.0
                answered = False
                pending = handed
                while came < len(arrivals.when) and arrivals.when[came] < k + 1:
                    offset = max(arrivals.when[came] - k, 0.0)
                    answers = arrivals.answers[came]
                    if 0 <= answers <= k:
                        answered = answered or answers == k
                        force = arrivals.asked[answers]
                        if guard is not None:
                            energy, force = _guarded(
                                guard,
                                energy,
                                force,
                                step,
                                handed,
                                late if late > 0.0 else offset,
                            )
                        last = applied
                        applied = limit_within_tick(
                            force, last, contact.peak, contact.slew, slewed
                        )
                        slewed += abs(applied - last)
                    else:
                        applied = arrivals.given[came]
                    arrivals.acts[came] = applied
                    following = applied
                    if late == 0.0:
                        mean += (offset - since) * handed
                        since = offset
                        handed = applied
                    came += 1
                if guard is not None:
                    if not answered:
                        energy = forget(energy, applied, guard.stiffness)
                    acting = through(
                        guard.line,
                        pending if late > 0.0 else mean + (1.0 - since) * handed,
                        guard.part,
                    )
                now = 0.0
                while gone < came and arrivals.when[gone] + arrivals.effect < k + 1:
                    until = max(arrivals.when[gone] + arrivals.effect - k, now)
                    x, v = _move_part(
                        x, v, saturate(moving, motion.motor) + load, until - now, motion
                    )
                    moving = arrivals.acts[gone]
                    now = until
                    gone += 1
                x, v = _move_part(
                    x, v, saturate(moving, motion.motor) + load, 1.0 - now, motion
                )
            _note(records.forces, k, applied)
        start = end
    return x, v


# the compiled loop, for other compiled functions that play many scenes
play_compiled: Any = compiled()(play)
