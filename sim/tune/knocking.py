"""Knock on a held device and see whether it comes to rest: how the edge of stability is approached, on a model and for real.

The law on trial feels a step of the deflection from nothing (`nodes.laws.knock`). What is left of
the motion at the end of the window decides; what is left but goes on dying is watched for longer.
The predicted and the measured edge are found by the same steps and the same verdict, friction,
encoder and limits of the driver included.

The steps begin far below the law and go up through it: large where the model sees no danger, of 2 %
near the law's edge. When a large step does not come to rest, those below it are tried from the last
that did; when the first does not, they go down.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field

import msgspec
import numpy as np

from nodes.laws import CompiledLaw
from nodes.laws.knock import Knock
from sim.arrays import Array
from sim.device.model import DeviceModel
from sim.play.nonideal import NonidealDevice, pushed
from sim.play.one_axis import Scene, SceneSurface, run

WINDOW = 400  # ticks that a knock is watched
LONGEST = 4 * WINDOW  # ticks that a knock is watched whose motion dies slowly
STEP = 1.02  # factor between two stiffnesses near the edge
STRIDE = 10  # so many of those steps are one large step, 22 %
# where the climb begins where the model allows it: a quarter of the law [steps]
LOWEST = -7 * STRIDE
# a law that does not rest at a fiftieth of itself is not tried any lower [steps]
DEEPEST = -20 * STRIDE
NEAR = 4  # so many steps below the predicted edge the small steps begin
BEYOND = 12  # so many steps above the predicted edge it is given up: 27 %
LEFT = 0.5  # part of the knock that may be left, peak to peak, in the last third of the window
# a motion dies when the last third of the longest window has so much of the third before it
DYING = 0.9
GROWING = 1.05  # one that has more than this of it grows, and is watched no longer
# Where in an encoder step a knock on a model begins: near the edge that decides, and the worst of
# them counts.
STARTS = (0.0, 0.25, 0.5, 0.75)
FAR = 3.0  # a deflection of so many knocks ends the trial


@dataclass(frozen=True)
class KnockVerdict:
    """What came of one knock."""

    factor: float  # all taps were multiplied by it
    left: float  # motion in the last third of the window, as a part of the knock, peak to peak
    rests: bool  # whether that is little enough, or still dying after the longest window
    why: str = ""  # what ended the trial before its time; empty when nothing did
    # ``stop`` or ``fault`` of the driver, ``energy`` given out; empty when nothing of these
    ended_by: str = ""


@dataclass
class KnockedEdge:
    """The steps towards the edge."""

    steps: list[KnockVerdict] = field(default_factory=list)  # in the order of the stiffness
    ended: str = ""  # why no more were tried
    # whether the climb came to its own end: nothing refused or interrupted it
    complete: bool = False

    @property
    def factor(self) -> float | None:
        """Smallest factor that does not come to rest; None when all did."""
        return next((step.factor for step in self.steps if not step.rests), None)

    @property
    def rested(self) -> float | None:
        """Largest factor up to which every one came to rest; None when none did."""
        below = [
            step.factor for step in self.steps if self.factor is None or step.factor < self.factor
        ]
        return max(below, default=None)

    def add(self, verdict: KnockVerdict) -> None:
        """Take a verdict in, in the order of the stiffness."""
        self.steps = sorted([*self.steps, verdict], key=lambda step: step.factor)


@dataclass(frozen=True)
class Plan:
    """Which steps are tried: n stands for the factor `STEP` to the power of n."""

    first: int  # where the climb begins
    near: int  # from here on every step is tried
    last: int  # where it ends at the latest


def factor_of(step: int) -> float:
    """Tell the factor of a step."""
    return STEP**step


def judge(position: Array, knock: float, factor: float) -> KnockVerdict | None:
    """Judge the positions since a knock [m]; None when they are too few to tell."""
    with np.errstate(invalid="ignore", over="ignore"):
        away = np.abs(knock - (position - position[:1])) / abs(knock)
        if position.size and not bool(np.all(away <= FAR)):
            return KnockVerdict(
                factor,
                float(np.max(np.nan_to_num(away, nan=np.inf))),
                False,
                f"went {FAR:g} knocks far",
            )
        for ticks in (WINDOW, 2 * WINDOW, LONGEST):
            if position.size < ticks:
                return None
            third = ticks // 3
            middle, last = (
                float(np.ptp(part))
                for part in (position[third : 2 * third], position[ticks - third : ticks])
            )
            left = last / abs(knock)
            if left < LEFT or last > GROWING * middle:
                return KnockVerdict(factor, left, left < LEFT)
    return KnockVerdict(factor, left, last < DYING * middle)


def climb(
    plan: Plan, knock: Callable[[int], KnockVerdict], steps: KnockedEdge | None = None
) -> KnockedEdge:
    """Go up in steps until one does not come to rest, and find between which two that is; `steps` takes what is known."""
    edge = KnockedEdge() if steps is None else steps

    def rests(step: int) -> bool:
        edge.add(knock(step))
        return edge.steps[[one.factor for one in edge.steps].index(factor_of(step))].rests

    here = plan.first
    while not rests(here):
        # Down in large steps until one rests, then up again in small ones.
        here -= STRIDE
        if here < DEEPEST:
            edge.ended = (
                f"nothing came to rest, down to {factor_of(here + STRIDE):.2g} times the law"
            )
            edge.complete = True
            return edge
    known = edge.factor
    top = plan.last if known is None else round(math.log(known) / math.log(STEP)) - 1
    while here < top:
        large = known is None and here + STRIDE <= plan.near
        step = here + (STRIDE if large else 1)
        if here < 0 < step:
            # The law itself is never passed over.
            step = 0
        if not rests(step):
            if not large:
                break
            # Somewhere in this large step: again from the last that rested, by small ones.
            known, top = factor_of(step), step - 1
            continue
        here = step
    edge.ended, edge.complete = _ended("device", edge.factor), True
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
    """Make knocks on a model, each from several places in an encoder step."""
    if isinstance(model, NonidealDevice):
        richer = model
        strongest, change = (math.inf if limit is None else limit for limit in (peak, slew))

        def on_richer(step: int) -> KnockVerdict:
            factor = factor_of(step)
            told = (period, np.zeros(LONGEST), np.array(scaled(law, factor).taps))
            places = [
                (knock, math.inf, strongest, start * (richer.rigid.resolution or 0.0))
                for start in starts
            ]
            return worst(
                judge(pushed(richer, *told, place, 0, change)[0], knock, factor) for place in places
            )

        return on_richer

    def begun(start: float) -> Scene:
        place = start * (model.resolution or 0.0) - knock
        device = msgspec.structs.replace(model, position=place, velocity=0.0, gravity=None)
        return Scene(
            device=device,
            surface=SceneSurface("anchor"),
            period=period,
            raw=False,
            clamp=False,
            peak=peak,
            slew=slew,
        )

    scenes = [begun(start) for start in (starts if model.resolution else starts[:1])]

    def once(step: int) -> KnockVerdict:
        factor = factor_of(step)
        tried = scaled(law, factor)
        return worst(judge(run(scene, tried, LONGEST).measured, knock, factor) for scene in scenes)

    return once


def worst(verdicts: Iterable[KnockVerdict | None]) -> KnockVerdict:
    """Take the first knock that does not come to rest, or the last one that does."""
    last: KnockVerdict | None = None
    for last in verdicts:
        if last is not None and not last.rests:
            break
    assert last is not None  # noqa: S101  # the longest window decides
    return last


def planned(knock: Callable[[int], KnockVerdict], linear: float) -> tuple[Plan, KnockedEdge]:
    """Knock on a model at every step about the edge that its poles have, and plan the climb on the device by it."""
    top = math.floor(math.log(linear) / math.log(STEP)) + BEYOND
    edge = KnockedEdge()
    for step in range(LOWEST, top + 1):
        edge.add(knock(step))
        # Far below a law a light damper may take longer than any window: the climb begins where the
        # model rests.
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
    return Plan(min(first, 0), (top if found is None else last - BEYOND) - NEAR, last), edge


def law_of(taps: list[float], factor: float, knock: float, load: float) -> dict[str, object]:
    """Describe a law on trial, as a coupling takes it."""
    limits = {"step": knock, "ticks": LONGEST, "far": FAR, "load": load}
    return {"kind": Knock.kind, "taps": [factor * tap for tap in taps], **limits}
