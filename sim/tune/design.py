"""Design the stiffest law for an identified device.

The law keeps a pole radius over the whole mass interval, widened by a factor for what
identification cannot cover (another hand, another pose), and over the whole range of delay in the
recording. By default it must also settle after every drop on a floor. `predict` computes its
behaviour on the identified device: the stability edge by poles and by knocks, drops, delays and
limit cycles.
"""

import math
from dataclasses import dataclass, replace

from nodes.laws import CompiledLaw
from nodes.stability.closed_loop import pole_radius
from nodes.stability.flexible import FlexiblePlant, flexible_radius
from nodes.stability.plant import Plant
from sim.design.demand import CONVENTIONS, Demand
from sim.design.families import Tuned, best_pd, certificate, designed, latest_delay
from sim.design.hands import STYLUS, judge_grasps
from sim.design.landing import drops
from sim.device.hand import Hand
from sim.device.model import DeviceModel
from sim.identify.altered import worst_altered
from sim.identify.identified import Identified
from sim.play.nonideal import NonidealDevice
from sim.stability.rest import rest
from sim.tune.knocking import knocked, planned, scaled
from sim.tune.record import PlannedKnocks, PredictedStep


@dataclass(frozen=True)
class Wanted:
    """Options of a tuning."""

    taps: int = 4  # number of taps
    spread: float = 1.25  # factor by which the mass may be wrong in either direction
    radius: float = 0.99  # largest pole radius
    nyquist: float = 1e4  # largest |H(−1)| [N/m]
    land: bool = True  # every drop must also settle
    # mass difference of other poses from the identified one, lighter and heavier [kg], shape (2,)
    poses: tuple[float, float] = (0.0, 0.0)


def demand(found: Identified, wanted: Wanted) -> Demand:
    """Return the design demand for an identified device: its intervals, the mass widened.

    Raise ValueError if a needed quantity was not identified.
    """
    (_, lightest, heaviest) = found.mass.known()
    (_, damping, _) = found.damping.known()
    found.delay.known()
    _, softest, stiffest = found.stiffness.known()
    lighter, heavier = wanted.poses
    # The remaining mass is at least a tenth of the identified one.
    lightest = max(lightest - lighter, 0.1 * lightest)
    heaviest = heaviest + heavier
    return Demand(
        mass=(lightest / wanted.spread, heaviest * wanted.spread),
        damping=damping,
        delay=found.delay_range,
        period=found.period,
        radius=wanted.radius,
        nyquist=wanted.nyquist,
        stiffness=(softest, stiffest),
        lands=CONVENTIONS if wanted.land else (),
        beyond=_beyond(found),
    )


def _beyond(found: Identified) -> tuple[tuple[float, float, float, float], ...]:
    """Return the ends of the intervals of lag and joint.

    The frequency interval is 5 % wider because it changes with the pose.
    """
    if not {"actuator lag", "flexible mode"} & set(found.terms):
        return ()
    _, early, late = found.lag.known() if found.lag.value else (0.0, 0.0, 0.0)
    shares = (0.0, 0.0)
    frequencies = (math.inf, math.inf)
    loss = 0.0
    if found.frequency.value is not None:
        _, *ends = found.share.known()
        _, low, high = found.frequency.known()
        shares = (ends[0], ends[1])
        frequencies = (low / 1.05, high * 1.05)
        loss = found.loss.known()[1]
    return tuple(
        (lag, share, frequency, loss)
        for lag in sorted({early, late})
        for share in sorted(set(shares))
        for frequency in sorted(set(frequencies))
    )


def design(found: Identified, wanted: Wanted) -> tuple[Tuned, Tuned, Demand]:
    """Design taps, and tune PD for the same demand; return the stiffer, PD, and the demand."""
    asked = demand(found, wanted)
    law = designed(asked, wanted.taps)
    pd = best_pd(asked)
    if pd.found is not None and (
        law.found is None or pd.found.h1_n_per_m > law.found.h1_n_per_m
    ):
        law = pd
    return law, pd, asked


def model(found: Identified) -> DeviceModel | NonidealDevice:
    """Return a model of the identified device with the whole delay of the loop.

    It is a `NonidealDevice` if identification found a lag, a joint or quadratic friction.
    """
    mass, damping, delay = (
        one.known()[0] for one in (found.mass, found.damping, found.delay)
    )
    hand = None
    if found.held and found.stiffness.value:
        hand = Hand(stiffness=found.stiffness.value, path=[(0.0, 0.0)])
    friction = found.friction.value or None
    resolution = found.encoder.value
    rigid = DeviceModel(
        mass=mass,
        damping=damping,
        delay=delay,
        hand=hand,
        friction=friction,
        resolution=resolution,
    )
    whole = found.plant()
    quadratic = found.quadratic.value or 0.0
    if whole.rigid and whole.lag == quadratic == 0.0:
        return rigid
    joint = (
        {}
        if whole.rigid
        else {"share": whole.share, "frequency": whole.frequency, "loss": whole.loss}
    )
    return NonidealDevice(
        rigid, "identified", quadratic=quadratic, lag=whole.lag, **joint
    )


def plant_of(found: Identified) -> Plant:
    """Return the plant of the identified device with the whole delay of the loop."""
    values = (found.mass.known()[0], found.damping.known()[0], found.delay.known()[0])
    return Plant(found.period, *values, found.stiffness.value or 0.0)


def knock_size(
    taps: tuple[float, ...], edge: float, found: Identified, peak: float | None
) -> float:
    """Return a knock the driver does not limit [m]: at most 1 mm, at least 8 encoder steps."""
    strongest = 0.8 * (peak or 4.0) / (edge * max(map(abs, taps)))
    return max(min(1e-3, strongest), 8.0 * (found.encoder.value or 1e-6))


def linear_edge(
    law: CompiledLaw, plant: Plant | FlexiblePlant, period: float | None = None
) -> float:
    """Find the factor on all taps (1 to 100) at which a pole reaches the unit circle.

    Return 1 for an unstable law.
    """

    def radius(factor: float) -> float:
        if isinstance(plant, Plant):
            return pole_radius(scaled(law, factor), plant)
        return flexible_radius(scaled(law, factor), period or math.nan, plant)

    low, high = 1.0, 1.0
    while high < 100.0 and radius(high) < 1.0:
        low = high
        high = high * 1.1
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if radius(middle) < 1.0 else (low, middle)
    return low


def predict(
    law: CompiledLaw,
    asked: Demand,
    found: Identified,
    peak: float | None,
    slew: float | None,
) -> tuple[PredictedStep, PlannedKnocks]:
    """Predict a law on the identified device; also return the plan of the steps on the device."""
    plant = plant_of(found)
    whole = found.plant()
    rigid = whole.rigid and whole.lag == 0.0
    linear = linear_edge(law, plant) if rigid else linear_edge(law, whole, found.period)
    knock = knock_size(law.taps, linear, found, peak)
    plan, edge = planned(
        knocked(law, model(found), found.period, knock, peak, slew), linear
    )
    dropped = drops(law, asked)
    radius, cause = worst_altered(law, found.period, found.altered) or (None, None)
    figures = PredictedStep(
        h1_n_per_m=law.h1,
        h_nyquist_n_per_m=law.h_nyquist,
        pole_radius=pole_radius(law, plant)
        if rigid
        else flexible_radius(law, found.period, whole),
        edge_linear_factor=linear,
        edge_factor=edge.factor,
        knock_m=knock,
        stable_up_to_delay_ticks=latest_delay(law, asked),
        drops_settled=sum(dropped.values()),
        drops=len(dropped),
        grasp=judge_grasps(law, asked, STYLUS, 20_000),
        remainder_pole_radius=radius,
        remainder_worst=cause,
        every_delay=certificate(law, asked),
        limit_cycle_free=None,
    )
    return _at_rest(figures, law, found, plant), PlannedKnocks(
        tuple(edge.steps), edge.ended, plan
    )


def remainder_refusal(law: CompiledLaw, found: Identified) -> str | None:
    """Return why the residual forbids to try a law: it may be unstable; else None."""
    worst = worst_altered(law, found.period, found.altered)
    if worst is None or worst[0] < 1.0:
        return None
    return (
        f"the law has a pole radius of {worst[0]:.4f} (limit: < 1) on a device with {worst[1]},"
        " which the recording leaves open"
    )


def _at_rest(
    figures: PredictedStep, law: CompiledLaw, found: Identified, plant: Plant
) -> PredictedStep:
    """Add the friction and what it is enough for; nothing if encoder or friction is unknown."""
    if found.encoder.value is None or found.friction.value is None:
        return figures
    answer = rest(law, plant, found.encoder.value)
    friction = found.friction.value
    return replace(
        figures,
        friction_n=friction,
        friction_for_rest_bound_n=answer.friction_bound_n,
        friction_for_rest_estimated_n=answer.friction_estimated_n,
        limit_cycle_free=answer.free(friction),
        buzz_hz=answer.buzz_hz,
    )
