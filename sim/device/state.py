"""State and tick rules of the virtual device: one axis in one struct.

The rules only call the functions of `sim.device.model`, so the one-process scene, which calls them
in the same order, gives the same bits. They are plain functions: interpreted as they are, and
compiled by sim/device/kernel.py into the two calls of a compiled driver.
"""

import math
from array import array
from typing import Annotated, Final, TypeAlias

from nodes.compiled.layout import address_of, state_of, struct
from nodes.compiled.memory import monotonic, pairs_at, shared_real, shared_whole
from nodes.compiled.rules import rule
from sim.device.friction import move
from sim.device.hand import path_position
from sim.device.model import (
    Coefficients,
    DeviceModel,
    coefficients,
    end_stop,
    ends_of,
    move_towards,
    quantise,
    saturate,
    split_delay,
)

PENDING: Final = 2048  # capacity for forces in flight; a delay is at most 1000 ticks
# Capacity for forces in flight in lockstep: 1000 ticks of delay, one of ``next_tick``, and spare.
_IN_FLIGHT: Final = 1004


Map: TypeAlias = Annotated[list[float], 6]


@struct
class AxisState:
    """A virtual device along one axis."""

    # Parameters, from `DeviceModel`
    mass: float  # [kg]
    damping: float  # [N s/m]
    grip: float  # stiffness of its hand [N/m]; 0 for none
    friction: float  # [N]
    resolution: float  # encoder step [m]; 0 for none
    motor: float  # largest force [N]; inf without a limit
    low: float  # ends of its workspace [m]
    high: float
    weight: float  # gravity's force [N]
    period: float  # sampling period T [s]
    carried: float  # mass of the hand [kg]
    masses: int  # address of mass by position, pairs [m, kg]
    masses_count: int  # 0 for one mass everywhere
    axis: int  # axis of the scene
    lockstep: int  # 1 if each force advances the device by a whole tick

    # Motion
    x: float  # true position [m]
    v: float  # true velocity [m/s]
    ticks: int  # ticks done
    tick: int  # tick up to which real time has passed; -1 before the first sample

    # The hand
    path: int  # address of its path, pairs [s, m]
    corners: int  # 0 without a hand
    has_repeat: int
    repeat: float  # time after which the path repeats [s]
    pull: float  # its present target [m]
    led: int  # 1: `pull` is set from outside; 0: the path applies

    # Pointer of a page that may drag the hand (nodes/driver/pointer.py)
    pointer: int  # address of the shared memory; 0 for none
    wanted: float  # position wanted for the hand [m]
    wanted_at: float  # time of that request [s]
    silence: float  # time after which it expires [s]
    farthest: float  # largest movement of the hand per tick [m]
    away: float  # position of the hand while off its path [m]
    is_away: int

    # Lockstep: durations for which the older and the newer force act in a tick [s], and their maps
    early: float
    late: float
    early_map: Map
    late_map: Map
    commands: Annotated[list[float], _IN_FLIGHT]  # ring buffer of forces in flight [N]
    commands_count: int
    slot: int  # index of the next force

    # force from outside besides the motor's, the weight's and the hand's [N]
    push: float

    # Real time
    delay: float  # delay of the device [ticks]
    hold: float  # time without a force after which it releases [s]
    acting: float  # force acting [N]
    commanded: float  # time since when it acts [ticks]
    # Ring buffer of forces in flight: time of arrival [ticks] and force [N].
    pending: Annotated[list[float], 2 * PENDING]
    pending_first: int
    pending_count: int

    # For the clock
    clock_gettime: int
    time: int


@rule
def measured(d: AxisState) -> float:
    """Return the encoder reading [m]."""
    return quantise(d.x, d.resolution)


@rule
def point(d: AxisState, tick: int) -> float:
    """Return the position of the hand's path at a tick [m]; 0 without a hand."""
    if d.corners == 0:
        return 0.0
    time = tick * d.period
    if d.has_repeat != 0:
        time = time % d.repeat
    return path_position(pairs_at(d.path, d.corners), time)


@rule
def target(d: AxisState, seq: int) -> float:
    """Return the hand's target for a tick [m]: on its path, or dragged at a limited speed."""
    if d.led != 0:
        return float(d.pull)
    rest = point(d, seq)
    if d.pointer == 0:
        return rest
    # Protocol of nodes/driver/pointer.py: during a write, keep the value before, at most one page
    # frame old.
    after = shared_whole(d.pointer)
    value = shared_real(d.pointer + 8 + 8 * d.axis)
    when = shared_real(d.pointer + 32)
    if shared_whole(d.pointer + 40) == after:
        d.wanted, d.wanted_at = value, when
    is_held = monotonic(d) - d.wanted_at < d.silence
    d.pull = rest
    if is_held or d.is_away != 0:
        d.pull = move_towards(
            d.wanted if is_held else rest,
            d.away if d.is_away != 0 else rest,
            d.farthest,
        )
        # The hand is no longer away once it is back on its path.
        d.is_away = 1 if is_held or d.pull != rest else 0
        d.away = d.pull
    return float(d.pull)


@rule
def _pulled(d: AxisState, force: float) -> float:
    """Return the sum of the saturated motor force, gravity and the hand's spring [N]."""
    load = d.weight
    if d.corners > 0:
        is_led = d.pointer != 0 or d.led != 0
        load += d.grip * (d.pull if is_led else point(d, d.ticks))
    return float(saturate(force, d.motor) + (load + d.push))


@rule
def mass_here(d: AxisState) -> float:
    """Return the mass that moves at the present position [kg]."""
    return float(d.carried + path_position(pairs_at(d.masses, d.masses_count), d.x))


@rule
def _move(d: AxisState, u: float, duration: float, step: Coefficients) -> None:
    mass = d.mass
    if d.masses_count > 0:
        mass = mass_here(d)
        step = coefficients(mass, d.damping, d.grip, duration)
    x, v = move(d.x, d.v, u, duration, step, mass, d.damping, d.grip, d.friction)
    d.x, d.v = end_stop(x, v, d.low, d.high)
    if d.masses_count > 0:
        # m(x) x'' + m'(x) v²/2 = u: a change of mass conserves the kinetic energy.
        d.v *= math.sqrt(mass / mass_here(d))


@rule
def device_tick(d: AxisState, force: float) -> None:
    """Advance by one whole tick with the model's delay (lockstep)."""
    waiting = d.commands_count
    # Ring buffer: the oldest force in flight acts first, then the next one.
    d.commands[d.slot] = force
    older = d.slot + 1 if d.slot + 1 < waiting else 0
    newer = older + 1 if older + 1 < waiting else 0
    d.slot = older
    if d.early > 0.0:
        m = d.early_map
        _move(
            d,
            _pulled(d, d.commands[older]),
            d.early,
            (m[0], m[1], m[2], m[3], m[4], m[5]),
        )
    m = d.late_map
    _move(
        d, _pulled(d, d.commands[newer]), d.late, (m[0], m[1], m[2], m[3], m[4], m[5])
    )
    d.ticks += 1


@rule
def device_part(d: AxisState, force: float, duration: float) -> None:
    """Advance by part of a tick under one force."""
    if duration > 0.0:
        # With a position-dependent mass, _move recomputes the coefficients.
        _move(
            d,
            _pulled(d, force),
            duration,
            coefficients(d.mass, d.damping, d.grip, duration),
        )


@rule
def pass_tick(d: AxisState) -> None:
    """Advance by one tick of real time; forces act when they arrive, plus the model's delay."""
    start = float(d.tick)
    now = 0.0
    if (start - d.commanded) * d.period >= d.hold:
        d.acting = 0.0
    while d.pending_count > 0 and d.pending[2 * d.pending_first] < start + 1.0:
        when = d.pending[2 * d.pending_first]
        force = d.pending[2 * d.pending_first + 1]
        d.pending_first = (d.pending_first + 1) % PENDING
        d.pending_count -= 1
        d.commanded = when
        offset = max(when - start, now)
        device_part(d, d.acting, (offset - now) * d.period)
        d.acting, now = force, offset
    device_part(d, d.acting, (1.0 - now) * d.period)
    d.ticks += 1
    d.tick += 1


@rule
def read_axis(d: AxisState, seq: int) -> float:
    """Advance to a tick, update the hand's target, and return the encoder reading [m]."""
    if d.lockstep == 0:
        if d.tick < 0:
            # Respawned or started late: the device starts here and did not move before.
            d.tick = d.ticks = seq
        while d.tick < seq:
            pass_tick(d)
    if d.corners > 0:
        d.pull = target(d, seq)
    return measured(d)


@rule
def write_axis(d: AxisState, force: float, seq: int, offset: float) -> bool:
    """Hand over a force; return False if there is no room for it."""
    if d.lockstep != 0:
        # The model includes ``next_tick``, so the whole tick passes here.
        device_tick(d, force)
        return True
    if d.pending_count >= PENDING:
        return False
    if not math.isfinite(force):
        # As on a real device, NaN is no force.
        force = 0.0
    last = (d.pending_first + d.pending_count) % PENDING
    d.pending[2 * last] = seq + offset + d.delay
    d.pending[2 * last + 1] = force
    d.pending_count += 1
    return True


class VirtualDevice:
    """A virtual device of one axis; in lockstep each force advances it by a whole tick."""

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
        self.state = state_of(AxisState, compiled)
        d = self.state
        d.mass, d.damping, d.grip = model.moving_mass, model.moving_damping, model.grip
        d.friction = model.friction or 0.0
        d.resolution = model.resolution or 0.0
        d.motor = math.inf if model.peak_force is None else model.peak_force
        self._masses = array(
            "d", [number for corner in model.mass_by_position for number in corner]
        )
        d.masses, d.masses_count = (
            self._masses.buffer_info()[0],
            len(model.mass_by_position),
        )
        d.carried = 0.0 if model.hand is None else model.hand.mass
        d.low, d.high = ends_of(workspace, model.resolution)
        d.weight = 0.0 if model.gravity is None else 0.0 - model.mass * model.gravity
        d.period = period
        d.lockstep = lockstep
        d.hold = hold
        d.delay = model.delay
        d.axis = axis
        d.x = model.position
        d.v = model.velocity
        d.tick = -1
        corners = (
            []
            if model.hand is None
            else [number for corner in model.hand.corners for number in corner]
        )
        self._path = array("d", corners)
        d.path, d.corners = self._path.buffer_info()[0], len(corners) // 2
        if model.hand is not None and model.hand.repeat is not None:
            d.has_repeat = 1
            d.repeat = model.hand.repeat
        whole, part = split_delay(model.delay + (1.0 if next_tick else 0.0))
        # Before tick 0 the forces are zero.
        d.commands_count = whole + 2
        d.early = part * period
        d.late = period - d.early
        d.early_map[:] = coefficients(d.mass, d.damping, d.grip, d.early)
        d.late_map[:] = coefficients(d.mass, d.damping, d.grip, d.late)
        d.wanted_at = -math.inf

    @property
    def address(self) -> int:
        """Address of the state for compiled code."""
        return address_of(self.state)
