"""The virtual device from tick to tick: the state of one axis in one struct, and the rules that move it.

They add no arithmetic of their own to the functions of `sim.device.model`, so the scene in one
process, which calls those in the same order, gives the same bits. The rules are plain functions:
the interpreter calls them as they stand, and sim/device/kernel.py compiles them into the two calls
that a compiled driver makes of a device.
"""

import math
from array import array
from typing import Annotated, Final, TypeAlias

from nodes.compiled.layout import address_of, state_of, struct
from nodes.compiled.memory import monotonic, pairs_at, shared_real, shared_whole
from nodes.compiled.rules import rule
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
# room for the forces under way in lockstep: a delay of 1000 ticks, one of ``next_tick``, and two
_LONGEST: Final = 1004


Map: TypeAlias = Annotated[list[float], 6]


@struct
class AxisState:
    """A virtual device along one axis."""

    # What it is: of `DeviceModel`
    mass: float  # [kg]
    damping: float  # [N s/m]
    grip: float  # stiffness of its hand [N/m]; 0 for none
    friction: float  # [N]
    resolution: float  # encoder step [m]; 0 for none
    motor: float  # largest force [N]; infinite for a motor without limit
    low: float  # ends of its workspace [m]
    high: float
    weight: float  # gravity's force [N]
    period: float  # sampling period T [s]
    carried: float  # mass of the hand [kg]
    masses: int  # address of mass by position, pairs [m, kg]
    masses_count: int  # 0 for one mass everywhere
    axis: int  # of the scene
    lockstep: int  # 1 where a whole tick passes with each force

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
    pull: float  # where it pulls to [m]

    # The page that may drag it (nodes/driver/pointer.py)
    pointer: int  # address of what it writes; 0 for none
    wanted: float  # where it wants the hand [m]
    wanted_at: float  # when it said so [s]
    silence: float  # after how long that expires [s]
    farthest: float  # longest way of the hand in a tick [m]
    away: float  # where the hand is while it is not on its path [m]
    is_away: int

    # Lockstep: for how long of a tick the older and the newer force acts [s], and the maps of both
    early: float
    late: float
    early_map: Map
    late_map: Map
    commands: Annotated[list[float], _LONGEST]  # ring of forces under way [N]
    commands_count: int
    slot: int  # where the newest goes

    # Real time
    delay: float  # of the device [ticks]
    hold: float  # time without a force after which it lets go [s]
    acting: float  # force that acts [N]
    commanded: float  # since when [ticks]
    # ring of forces on their way: when [ticks], and how large [N]
    pending: Annotated[list[float], 2 * PENDING]
    pending_first: int
    pending_count: int

    # For the clock
    clock_gettime: int
    time: int


@rule
def measured(d: AxisState) -> float:
    """Read the encoder [m]."""
    return quantise(d.x, d.resolution)


@rule
def point(d: AxisState, tick: int) -> float:
    """Where the path of its hand is at a tick [m]; 0 without a hand."""
    if d.corners == 0:
        return 0.0
    time = tick * d.period
    if d.has_repeat != 0:
        time = time % d.repeat
    return path_position(pairs_at(d.path, d.corners), time)


@rule
def target(d: AxisState, seq: int) -> float:
    """Move the target of the hand by one tick [m]: along its path, unless a page drags it, at a limited speed."""
    rest = point(d, seq)
    if d.pointer == 0:
        return rest
    # As nodes/driver/pointer.py writes it; while it is being written, the value before is at most a
    # frame of the page old.
    after = shared_whole(d.pointer)
    value, when = shared_real(d.pointer + 8 + 8 * d.axis), shared_real(d.pointer + 32)
    if shared_whole(d.pointer + 40) == after:
        d.wanted, d.wanted_at = value, when
    is_held = monotonic(d) - d.wanted_at < d.silence
    d.pull = rest
    if is_held or d.is_away != 0:
        d.pull = move_towards(
            d.wanted if is_held else rest, d.away if d.is_away != 0 else rest, d.farthest
        )
        # Back on its path the hand is its own again.
        d.is_away = 1 if is_held or d.pull != rest else 0
        d.away = d.pull
    return float(d.pull)


@rule
def _pulled(d: AxisState, force: float) -> float:
    """Add to what the motor gives of a force what pulls besides [N]."""
    load = d.weight
    if d.corners > 0:
        load += d.grip * (d.pull if d.pointer != 0 else point(d, d.ticks))
    return float(saturate(force, d.motor) + load)


@rule
def mass_here(d: AxisState) -> float:
    """Mass that moves where the device is [kg]."""
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
        # m(x) x'' + m'(x) v²/2 = u: what the mass does by itself keeps the energy of the motion.
        d.v *= math.sqrt(mass / mass_here(d))


@rule
def device_tick(d: AxisState, force: float) -> None:
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


@rule
def device_part(d: AxisState, force: float, duration: float) -> None:
    """Hold one force for part of a tick."""
    if duration > 0.0:
        # Where the mass depends on the position this is of no use, and does no harm.
        _move(d, _pulled(d, force), duration, coefficients(d.mass, d.damping, d.grip, duration))


@rule
def pass_tick(d: AxisState) -> None:
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


@rule
def read_axis(d: AxisState, seq: int) -> float:
    """Let the time up to a tick pass, then read the encoder [m]; the hand's target is that of the tick that begins."""
    if d.lockstep == 0:
        if d.tick < 0:
            # Respawned, or started late: the device is put there now, it was not falling all the
            # time.
            d.tick = d.ticks = seq
        while d.tick < seq:
            pass_tick(d)
    if d.corners > 0:
        d.pull = target(d, seq)
    return measured(d)


@rule
def write_axis(d: AxisState, force: float, seq: int, offset: float) -> bool:
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
        self._masses = array(
            "d", [number for corner in model.mass_by_position for number in corner]
        )
        d.masses, d.masses_count = self._masses.buffer_info()[0], len(model.mass_by_position)
        d.carried = 0.0 if model.hand is None else model.hand.mass
        d.low, d.high = ends_of(workspace, model.resolution)
        d.weight = 0.0 if model.gravity is None else 0.0 - model.mass * model.gravity
        d.period, d.lockstep, d.hold, d.delay, d.axis = period, lockstep, hold, model.delay, axis
        d.x, d.v, d.tick = model.position, model.velocity, -1
        corners = (
            []
            if model.hand is None
            else [number for corner in model.hand.path for number in corner]
        )
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
        return address_of(self.state)
