"""Inputs and outputs of the loop of one axis: device, contact, laws, guard, records."""

from typing import Any, NamedTuple, TypeAlias

from sim.device.model import Coefficients

# a list of numbers in the interpreted loop, an array in the compiled one
Values: TypeAlias = Any


class Motion(NamedTuple):
    """The device for the loop: `DeviceModel`, prepared for one period and delay.

    A tick is split where a force arrives: `early` seconds with the previous force, `late` seconds
    with the newest. A field is None if the scene has no such term; the compiled version then omits
    it. `early_map` is unused if `early` is 0.
    """

    position: float
    velocity: float
    mass: float
    damping: float
    grip: float
    early: float
    early_map: Coefficients | None
    late: float
    late_map: Coefficients
    resolution: float | None
    friction: float | None
    motor: float | None
    ends: tuple[float, float] | None
    load: float
    loads: Values | None
    waiting: int
    period: float


class Contact(NamedTuple):
    """The touched surface, its conventions, and the driver's limits on the force."""

    kind: int
    surface: float
    normal: float
    raw: bool
    clamp: bool
    peak: float | None
    slew: float | None
    ease: int = 0


class LawTables(NamedTuple):
    """All laws of a run, one after the other, and the ticks of the swaps."""

    taps: Values
    taps_from: Values
    recursive: Values | None
    states_from: Values
    swap_at: Values
    swap_ramp: Values


class Guard(NamedTuple):
    """The passivity guard of nodes/driver/passivity.py."""

    damping: float
    stiffness: float | None
    late: float
    line: Values
    part: float
    allowance: float = 0.0


class Arrivals(NamedTuple):
    """Arrival of forces at the driver in real time, in order.

    The n-th force arrives at `when` [ticks] and answers tick `answers`; −1 means the driver's own
    force, `given` [N]. It acts `effect` ticks later; a tick without an answer repeats the previous
    force. The loop writes `asked`, the law's force of each tick [N], and `acts`, the n-th force
    after guard and limits [N].
    """

    when: Values
    answers: Values
    given: Values
    effect: float
    asked: Values
    acts: Values


class Records(NamedTuple):
    """Arrays written each tick; None for those not recorded."""

    positions: Values
    velocities: Values | None
    measureds: Values | None
    deflections: Values | None
    forces: Values | None
    asked: Values | None = None
