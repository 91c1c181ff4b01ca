"""The virtual device in a kernel: sim/device/state.py in lockstep, sim/device/driver.py in real time, on the same functions."""

from __future__ import annotations

from typing import Any

from nodes.tick.kernels.hop import monotonic
from nodes.tick.kernels.machine import compilable, reals_at, shared_real, shared_whole
from nodes.tick.kernels.sources import kernel
from sim.device.friction import halt_time, move, slide
from sim.device.model import advance, coefficients, decay_mean, end_stop, move_towards, quantise, saturate
from sim.device.tick.layout import PENDING

for _function in (
    move_towards,
    decay_mean,
    coefficients,
    advance,
    halt_time,
    slide,
    move,
    end_stop,
    quantise,
    saturate,
):
    kernel(_function)
_PENDING = PENDING


@compilable
def measured(s: Any) -> float:
    """Read the encoder [m]."""
    return float(quantise(s.x, s.resolution) if s.has_resolution != 0 else quantise(s.x, None))


@compilable
def _path(s: Any, tick: int) -> float:
    return float(reals_at(s.targets, s.targets_count)[min(tick - s.targets_from, s.targets_count - 1)])


@compilable
def move_hand(s: Any, seq: int) -> float:
    """Move the target of the hand by one tick [m] (`TimedDevice._move_hand`)."""
    rest = _path(s, seq)
    if s.pointer == 0:
        return rest
    after = shared_whole(s.pointer)
    value, when = shared_real(s.pointer + 8 + 8 * s.device_axis), shared_real(s.pointer + 32)
    if shared_whole(s.pointer + 40) == after:
        s.wanted, s.wanted_at = value, when
    is_held = monotonic(s) - s.wanted_at < s.silence
    s.pull = rest
    if is_held or s.is_away != 0:
        s.pull = move_towards(s.wanted if is_held else rest, s.away if s.is_away != 0 else rest, s.farthest)
        s.is_away = is_held or s.pull != rest
        s.away = s.pull
    return float(s.pull)


@compilable
def _pulled(s: Any, force: float) -> float:
    """Add to what the motor gives of a force what pulls besides [N] (`VirtualDevice.load`)."""
    load = s.weight
    if s.targets_count > 0:
        load += s.grip * (_path(s, s.device_ticks) if s.pointer == 0 else s.pull)
    return float((saturate(force, s.motor) if s.has_motor != 0 else saturate(force, None)) + load)


@compilable
def _move(s: Any, u: float, duration: float, step: Any) -> None:
    if s.has_friction != 0:
        s.x, s.v = move(s.x, s.v, u, duration, step, s.mass, s.damping, s.grip, s.friction)
    else:
        s.x, s.v = move(s.x, s.v, u, duration, step, s.mass, s.damping, s.grip, None)
    s.x, s.v = end_stop(s.x, s.v, s.low, s.high)


@compilable
def lockstep_tick(s: Any, force: float) -> None:
    """Go through one whole tick with the model's own delay (`VirtualDevice.tick`)."""
    waiting = s.commands_count
    commands = reals_at(s.commands, waiting)
    # A ring: of the commands still under way, the oldest acts first, then the one after it.
    commands[s.slot] = force
    older = s.slot + 1 if s.slot + 1 < waiting else 0
    newer = older + 1 if older + 1 < waiting else 0
    s.slot = older
    if s.early > 0.0:
        m = s.early_map
        _move(s, _pulled(s, commands[older]), s.early, (m[0], m[1], m[2], m[3], m[4], m[5]))
    m = s.late_map
    _move(s, _pulled(s, commands[newer]), s.late, (m[0], m[1], m[2], m[3], m[4], m[5]))
    s.device_ticks += 1


@compilable
def _pass_time(s: Any, force: float, duration: float) -> None:
    if duration > 0.0:
        _move(s, _pulled(s, force), duration, coefficients(s.mass, s.damping, s.grip, duration))


@compilable
def pass_tick(s: Any) -> None:
    """Let one tick of real time pass (`TimedDevice._pass_tick`)."""
    start, now = float(s.device_tick), 0.0
    if (start - s.commanded) * s.period >= s.device_hold:
        s.device_acting = 0.0
    pending = reals_at(s.pending, 2 * _PENDING)
    while s.pending_count > 0 and pending[2 * s.pending_first] < start + 1.0:
        when, force = pending[2 * s.pending_first], pending[2 * s.pending_first + 1]
        s.pending_first = (s.pending_first + 1) % _PENDING
        s.pending_count -= 1
        s.commanded = when
        offset = max(when - start, now)
        _pass_time(s, s.device_acting, (offset - now) * s.period)
        s.device_acting, now = force, offset
    _pass_time(s, s.device_acting, (1.0 - now) * s.period)
    s.device_ticks += 1
    s.device_tick += 1


@compilable
def write_force(s: Any, force: float, seq: int, offset: float) -> None:
    """Hand over a force in real time (`TimedDevice.write_force`)."""
    pending = reals_at(s.pending, 2 * _PENDING)
    last = (s.pending_first + s.pending_count) % _PENDING
    pending[2 * last] = seq + offset + s.device_delay
    pending[2 * last + 1] = force
    s.pending_count += 1
