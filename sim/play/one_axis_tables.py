"""What the loop of one axis is given as numbers: device, contact, laws, guard, arrivals, and where it writes."""

from typing import Any, NamedTuple, TypeAlias

from sim.device.model import Coefficients

# a list of numbers when the loop is interpreted, an array when it is compiled
Values: TypeAlias = Any


class Motion(NamedTuple):
    """The device as the loop moves it: `DeviceModel`, ready for one period and delay.

    A tick is split where a force arrives: `early` seconds with the one before, `late` seconds with
    the newest. A field is None where the scene has no such term; another version is compiled
    without it. Where `early` is 0, `early_map` is not read.
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
    """What is touched, by which conventions, and the driver's limits on the force."""

    kind: int
    surface: float
    normal: float
    raw: bool
    clamp: bool
    peak: float | None
    slew: float | None
    ease: int = 0


class LawTables(NamedTuple):
    """All laws of a run, one after the other, and the ticks at which they follow."""

    taps: Values
    taps_from: Values
    recursive: Values | None
    states_from: Values
    swap_at: Values
    swap_ramp: Values


class Guard(NamedTuple):
    """The passivity guard: nodes/driver/passivity.py."""

    damping: float
    stiffness: float | None
    late: float
    line: Values
    part: float
    allowance: float = 0.0


class Arrivals(NamedTuple):
    """When the driver gets its forces in real time, in the order in which it gets them.

    The n-th comes at `when` [ticks] and is the force for tick `answers`; where that is −1 it is the
    driver's own, `given` [N]. It acts `effect` ticks later, and ticks without an answer hold the
    force before. `asked` and `acts` are notes of the loop: the law's force of each tick, and the
    n-th force after guard and limits [N].
    """

    when: Values
    answers: Values
    given: Values
    effect: float
    asked: Values
    acts: Values


class Records(NamedTuple):
    """What is written down each tick; None for what is not."""

    positions: Values
    velocities: Values | None
    measureds: Values | None
    deflections: Values | None
    forces: Values | None
    asked: Values | None = None
