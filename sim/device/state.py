"""The virtual device from tick to tick: the state of one axis in one struct, and the rules that move it.

They add no arithmetic of their own to the functions of `sim.device.model`, so the scene in one process, which calls those in
the same order, gives the same bits. The rules are plain functions: the interpreter calls them as they stand, and
sim/device/kernel.py compiles them into the two calls that a compiled driver makes of a device.
"""

import ctypes
import math
from array import array
from ctypes import Structure, c_double, c_int64
from typing import Any, Final

from nodes.compiled.layout import state_of
from nodes.compiled.memory import monotonic, pairs_at, shared_real, shared_whole
from sim.device.friction import move
from sim.device.model import (
    Coefficients,
    DeviceModel,
    coefficients,
    end_stop,
    ends_of,
    move_towards,
    path_position,
    quantise,
    saturate,
    split_delay,
)

PENDING: Final = 2048  # room for forces on their way to the device; a delay is at most 1000 ticks
_LONGEST: Final = 1004  # room for the forces under way in lockstep: a delay of 1000 ticks, one of ``next_tick``, and two


class AxisState(Structure):
    """A virtual device along one axis."""

    _fields_ = [
        # what it is: nodes of `DeviceModel`; infinity for a motor without limit
        *(
            (name, c_double)
            for name in (
                *("mass", "damping", "grip", "friction", "resolution", "motor", "low", "high", "weight", "period", "carried"),
                # true position and velocity
                *("x", "v"),
                # the hand: after how long its path repeats, and where it pulls to when it is dragged
                *("repeat", "pull"),
                # the page that may drag it: what it wrote last and when, when that expires, longest way of a tick, where it is
                *("wanted", "wanted_at", "silence", "farthest", "away"),
                # lockstep: for how long of a tick the older and the newer force acts
                *("early", "late"),
                # real time: delay and deadline [ticks, s], the force that acts, and since when [ticks]
                *("delay", "hold", "acting", "commanded"),
            )
        ),
        *(
            (name, c_int64)
            for name in (
                *("axis", "lockstep", "path", "corners", "has_repeat", "pointer", "is_away", "masses", "masses_count"),
                # ticks done; tick up to which real time has passed, -1 before the first sample
                *("ticks", "tick"),
                *("commands_count", "slot", "pending_first", "pending_count"),
                # for the clock
                *("clock_gettime", "time"),
            )
        ),
        ("early_map", c_double * 6),
        ("late_map", c_double * 6),
        ("commands", c_double * _LONGEST),
        ("pending", c_double * (2 * PENDING)),
    ]


def measured(d: Any) -> float:
    """Read the encoder [m]."""
    return quantise(d.x, d.resolution)


def point(d: Any, tick: int) -> float:
    """Where the path of its hand is at a tick [m]; 0 without a hand."""
    if d.corners == 0:
        return 0.0
    time = tick * d.period
    if d.has_repeat != 0:
        time = time % d.repeat
    return path_position(pairs_at(d.path, d.corners), time)


def target(d: Any, seq: int) -> float:
    """Move the target of the hand by one tick [m]: along its path, unless a page drags it, at a limited speed."""
    rest = point(d, seq)
    if d.pointer == 0:
        return rest
    # As nodes/driver/pointer.py writes it; while it is being written, the value before is at most a frame of the page old.
    after = shared_whole(d.pointer)
    value, when = shared_real(d.pointer + 8 + 8 * d.axis), shared_real(d.pointer + 32)
    if shared_whole(d.pointer + 40) == after:
        d.wanted, d.wanted_at = value, when
    is_held = monotonic(d) - d.wanted_at < d.silence
    d.pull = rest
    if is_held or d.is_away != 0:
        d.pull = move_towards(d.wanted if is_held else rest, d.away if d.is_away != 0 else rest, d.farthest)
        # Back on its path the hand is its own again.
        d.is_away = 1 if is_held or d.pull != rest else 0
        d.away = d.pull
    return float(d.pull)


def _pulled(d: Any, force: float) -> float:
    """Add to what the motor gives of a force what pulls besides [N]."""
    load = d.weight
    if d.corners > 0:
        load += d.grip * (d.pull if d.pointer != 0 else point(d, d.ticks))
    return float(saturate(force, d.motor) + load)


def mass_here(d: Any) -> float:
    """Mass that moves where the device is [kg]."""
    return float(d.carried + path_position(pairs_at(d.masses, d.masses_count), d.x))


def _move(d: Any, u: float, duration: float, step: Coefficients) -> None:
    mass = d.mass
    if d.masses_count > 0:
        mass = mass_here(d)
        step = coefficients(mass, d.damping, d.grip, duration)
    x, v = move(d.x, d.v, u, duration, step, mass, d.damping, d.grip, d.friction)
    d.x, d.v = end_stop(x, v, d.low, d.high)
    if d.masses_count > 0:
        # m(x) x'' + m'(x) v²/2 = u: what the mass does by itself keeps the energy of the motion.
        d.v *= math.sqrt(mass / mass_here(d))


def device_tick(d: Any, force: float) -> None:
    """Go through one whole tick with the model's own delay: lockstep, where the force is known before the tick passes."""
    waiting = d.commands_count
    # A ring: of the forces still under way, the oldest acts first, then the one after it.
    d.commands[d.slot] = force
    older = d.slot + 1 if d.slot + 1 < waiting else 0
    newer = older + 1 if older + 1 < waiting else 0
    d.slot = older
    if d.early > 0.0:
        m = d.early_map
        _move(d, _pulled(d, d.commands[older]), d.early, (m[0], m[1], m[2], m[3], m[4], m[5]))
    m = d.late_map
    _move(d, _pulled(d, d.commands[newer]), d.late, (m[0], m[1], m[2], m[3], m[4], m[5]))
    d.ticks += 1


def device_part(d: Any, force: float, duration: float) -> None:
    """Hold one force for part of a tick."""
    if duration > 0.0:
        # Where the mass depends on the position this is of no use, and does no harm.
        _move(d, _pulled(d, force), duration, coefficients(d.mass, d.damping, d.grip, duration))


def pass_tick(d: Any) -> None:
    """Let one tick of real time pass: forces take effect when they arrive, plus the model's own delay."""
    start, now = float(d.tick), 0.0
    if (start - d.commanded) * d.period >= d.hold:
        d.acting = 0.0
    while d.pending_count > 0 and d.pending[2 * d.pending_first] < start + 1.0:
        when, force = d.pending[2 * d.pending_first], d.pending[2 * d.pending_first + 1]
        d.pending_first = (d.pending_first + 1) % PENDING
        d.pending_count -= 1
        d.commanded = when
        offset = max(when - start, now)
        device_part(d, d.acting, (offset - now) * d.period)
        d.acting, now = force, offset
    device_part(d, d.acting, (1.0 - now) * d.period)
    d.ticks += 1
    d.tick += 1


def read_axis(d: Any, seq: int) -> float:
    """Let the time up to a tick pass, then read the encoder [m]; the hand's target is that of the tick that begins."""
    if d.lockstep == 0:
        if d.tick < 0:
            # Respawned, or started late: the device is put there now, it was not falling all the time.
            d.tick = d.ticks = seq
        while d.tick < seq:
            pass_tick(d)
    if d.corners > 0:
        d.pull = target(d, seq)
    return measured(d)


def write_axis(d: Any, force: float, seq: int, offset: float) -> bool:
    """Hand over a force; whether there is room for it."""
    if d.lockstep != 0:
        # The model itself knows about ``next_tick``: the whole tick passes here.
        device_tick(d, force)
        return True
    if d.pending_count >= PENDING:
        return False
    if not math.isfinite(force):
        # As a real one: what is no number is no force.
        force = 0.0
    last = (d.pending_first + d.pending_count) % PENDING
    d.pending[2 * last] = seq + offset + d.delay
    d.pending[2 * last + 1] = force
    d.pending_count += 1
    return True


class VirtualDevice:
    """A virtual device of one axis; in lockstep a whole tick passes with each force."""

    def __init__(
        self,
        model: DeviceModel,
        period: float,
        next_tick: bool = False,
        workspace: tuple[float, float] = (-math.inf, math.inf),
        lockstep: bool = True,
        hold: float = math.inf,
        axis: int = 0,
        compiled: bool = False,
    ) -> None:
        self.state = state_of(AxisState, compiled)  # all of it
        d = self.state
        d.mass, d.damping, d.grip = model.moving_mass, model.moving_damping, model.grip
        d.friction, d.resolution = model.friction or 0.0, model.resolution or 0.0
        d.motor = math.inf if model.peak_force is None else model.peak_force
        self._masses = array("d", [number for corner in model.mass_by_position for number in corner])
        d.masses, d.masses_count = self._masses.buffer_info()[0], len(model.mass_by_position)
        d.carried = 0.0 if model.hand is None else model.hand.mass
        d.low, d.high = ends_of(workspace, model.resolution)
        d.weight = 0.0 if model.gravity is None else 0.0 - model.mass * model.gravity
        d.period, d.lockstep, d.hold, d.delay, d.axis = period, lockstep, hold, model.delay, axis
        d.x, d.v, d.tick = model.position, model.velocity, -1
        corners = [] if model.hand is None else [number for corner in model.hand.path for number in corner]
        self._path = array("d", corners)
        d.path, d.corners = self._path.buffer_info()[0], len(corners) // 2
        if model.hand is not None and model.hand.repeat is not None:
            d.has_repeat, d.repeat = 1, model.hand.repeat
        whole, part = split_delay(model.delay + (1.0 if next_tick else 0.0))
        # Before tick 0 nothing was commanded.
        d.commands_count = whole + 2
        d.early = part * period
        d.late = period - d.early
        d.early_map[:] = coefficients(d.mass, d.damping, d.grip, d.early)
        d.late_map[:] = coefficients(d.mass, d.damping, d.grip, d.late)
        d.wanted_at = -math.inf

    @property
    def address(self) -> int:
        """Where compiled code finds it."""
        return ctypes.addressof(self.state)
