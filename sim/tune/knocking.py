"""Find the stability edge of a held device by step tests, on a model or on the device.

The law on trial sees a step in the deflection (`nodes.laws.knock`). The motion left at the end of
the window decides; a motion that still decays is watched for longer. The predicted and the measured
edge use the same steps and the same verdict, including friction, encoder and driver limits.

The steps begin far below the law and go up through it: large where the model predicts no danger, 2
% near the law's edge. If a large step does not come to rest, those below it are tried from the last
one that did; if the first does not, the steps go down.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

from nodes.laws import CompiledLaw
from nodes.laws.knock import Knock
from sim.arrays import Array
from sim.device.model import DeviceModel
from sim.play.nonideal import NonidealDevice, pushed

WINDOW = 400  # ticks a knock is watched
LONGEST_WINDOW = 4 * WINDOW  # ticks a slowly decaying knock is watched
STEP = 1.02  # ratio of two stiffnesses near the edge
STRIDE = 10  # number of steps in one large step, 22 %
# where the climb begins if the model allows: a quarter of the law [steps]
LOWEST = -7 * STRIDE
# lowest factor tried: a fiftieth of the law [steps]
DEEPEST = -20 * STRIDE
NEAR = 4  # steps below the predicted edge at which the small steps begin
BEYOND = 12  # steps above the predicted edge at which the climb is given up: 27 %
LEFT = 0.5  # largest motion left, peak to peak in the last third of the window [share of the knock]
# a motion decays if the last third of the longest window is below this share of the third before it
DYING = 0.9
GROWING = 1.05  # a motion grows if it exceeds this share; it is watched no longer
# positions within an encoder step at which a knock on a model begins; near the edge the position
# decides, and the worst counts
STARTS = (0.0, 0.25, 0.5, 0.75)
FAR = 3.0  # deflection that ends the trial [knocks]


@dataclass(frozen=True)
class KnockVerdict:
    """Result of one knock."""

    factor: float  # factor on all taps
    left: float  # motion in the last third of the window, peak to peak [share of the knock]
    # whether that is small enough, or still decays after the longest window
    rests: bool
    why: str = ""  # reason if the trial ended early; else empty
    # ``stop`` or ``fault`` of the driver, ``energy`` exceeded; else empty
    ended_by: str = ""


@dataclass
class KnockedEdge:
    """Steps towards the edge."""

    steps: list[KnockVerdict] = field(default_factory=list)  # sorted by stiffness
    ended: str = ""  # why the climb ended
    # whether the climb reached its own end, neither refused nor interrupted
    complete: bool = False

    @property
    def factor(self) -> float | None:
        """Return the smallest factor that did not come to rest; None if all did."""
        return next((step.factor for step in self.steps if not step.rests), None)

    @property
    def rested(self) -> float | None:
        """Return the largest factor up to which every one came to rest; None if none did."""
        below = [
            step.factor
            for step in self.steps
            if self.factor is None or step.factor < self.factor
        ]
        return max(below, default=None)

    def add(self, verdict: KnockVerdict) -> None:
        """Insert a verdict, sorted by factor."""
        self.steps = sorted([*self.steps, verdict], key=lambda step: step.factor)


@dataclass(frozen=True)
class Plan:
    """Which steps are tried; step n means the factor `STEP` to the power of n."""

    first: int  # where the climb begins
    near: int  # every step from here on is tried
    last: int  # where it ends at the latest


def factor_of(step: int) -> float:
    """Return the factor of a step."""
    return STEP**step


def judge(position: Array, knock: float, factor: float) -> KnockVerdict | None:
    """Judge the positions since a knock [m]; None if there are too few."""
    with np.errstate(invalid="ignore", over="ignore"):
        away = np.abs(knock - (position - position[:1])) / abs(knock)
        if position.size and not bool(np.all(away <= FAR)):
            return KnockVerdict(
                factor,
                float(np.max(np.nan_to_num(away, nan=np.inf))),
                False,
                f"moved more than {FAR:g} knocks away",
            )
        for ticks in (WINDOW, 2 * WINDOW, LONGEST_WINDOW):
            if position.size < ticks:
                return None
            third = ticks // 3
            middle, last = (
                float(np.ptp(part))
                for part in (
                    position[third : 2 * third],
                    position[ticks - third : ticks],
                )
            )
            left = last / abs(knock)
            if left < LEFT or last > GROWING * middle:
                return KnockVerdict(factor, left, left < LEFT)
    return KnockVerdict(factor, left, last < DYING * middle)


def climb(
    plan: Plan, knock: Callable[[int], KnockVerdict], steps: KnockedEdge | None = None
) -> KnockedEdge:
    """Raise the factor in steps until one does not come to rest, and locate the edge.

    The edge lies between two neighbouring steps. `steps` collects the verdicts.
    """
    edge = KnockedEdge() if steps is None else steps

    def rests(step: int) -> bool:
        edge.add(knock(step))
        return edge.steps[
            [one.factor for one in edge.steps].index(factor_of(step))
        ].rests

    here = plan.first
    while not rests(here):
        # Down in large steps until one rests, then up again in small ones.
        here -= STRIDE
        if here < DEEPEST:
            least = f"{factor_of(here + STRIDE):.2g}"
            edge.ended = f"nothing came to rest, down to {least} times the law"
            edge.complete = True
            return edge
    known = edge.factor
    top = plan.last if known is None else round(math.log(known) / math.log(STEP)) - 1
    while here < top:
        large = known is None and here + STRIDE <= plan.near
        step = here + (STRIDE if large else 1)
        if here < 0 < step:
            # The law itself is always tried.
            step = 0
        if not rests(step):
            if not large:
                break
            # The edge is within this large step: continue from the last that rested, by small
            # steps.
            known = factor_of(step)
            top = step - 1
            continue
        here = step
    edge.ended = _ended("device", edge.factor)
    edge.complete = True
    return edge


def _ended(who: str, found: float | None) -> str:
    return (
        "every factor came to rest"
        if found is None
        else f"the {who} does not come to rest at {found:.3f} times the law"
    )


def scaled(law: CompiledLaw, factor: float) -> CompiledLaw:
    """Multiply the taps of a law."""
    return CompiledLaw(tuple(factor * tap for tap in law.taps))


def knocked(
    law: CompiledLaw,
    model: DeviceModel | NonidealDevice,
    period: float,
    knock: float,
    peak: float | None,
    slew: float | None,
    starts: Sequence[float] = STARTS,
) -> Callable[[int], KnockVerdict]:
    """Return a function that knocks on a model, from several places in an encoder step.

    The history begins at zero, as that of `nodes.laws.knock`: the law feels the whole step.
    """
    device = model if isinstance(model, NonidealDevice) else NonidealDevice(model)
    strongest, change = (math.inf if limit is None else limit for limit in (peak, slew))
    step = device.rigid.resolution or 0.0
    places = [(knock, math.inf, strongest, start * step) for start in starts]

    def once(number: int) -> KnockVerdict:
        factor = factor_of(number)
        told = (period, np.zeros(LONGEST_WINDOW), np.array(scaled(law, factor).taps))
        return worst(
            judge(pushed(device, *told, place, 0, change)[0], knock, factor)
            for place in (places if step else places[:1])
        )

    return once


def worst(verdicts: Iterable[KnockVerdict | None]) -> KnockVerdict:
    """Return the first knock that does not come to rest, or else the last one."""
    last: KnockVerdict | None = None
    for last in verdicts:
        if last is not None and not last.rests:
            break
    assert last is not None  # noqa: S101  # the longest window decides
    return last


def planned(
    knock: Callable[[int], KnockVerdict], linear: float
) -> tuple[Plan, KnockedEdge]:
    """Knock on a model at every step around the edge of its poles, and plan the climb.

    Raise ValueError if the law does not come to rest on the model.
    """
    top = math.floor(math.log(linear) / math.log(STEP)) + BEYOND
    edge = KnockedEdge()
    for step in range(LOWEST, top + 1):
        edge.add(knock(step))
        # Far below a law, little damping may take longer than any window: the climb begins where
        # the model rests.
        if not edge.steps[-1].rests:
            if step >= 0:
                break
            edge.steps = []
    if not edge.steps:
        raise ValueError("the law does not come to rest on the identified model")
    found = edge.factor
    edge.ended = _ended("model", found)
    first = round(math.log(edge.steps[0].factor) / math.log(STEP))
    last = top if found is None else round(math.log(found) / math.log(STEP)) + BEYOND
    return Plan(
        min(first, 0), (top if found is None else last - BEYOND) - NEAR, last
    ), edge


def law_of(
    taps: list[float], factor: float, knock: float, load: float
) -> dict[str, object]:
    """Return the parameters of a law on trial for the coupling."""
    limits = {"step": knock, "ticks": LONGEST_WINDOW, "far": FAR, "load": load}
    return {"kind": Knock.kind, "taps": [factor * tap for tap in taps], **limits}
