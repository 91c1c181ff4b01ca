"""From an identified device to its law: design for what it may be, predict what it will do, and tell both.

The design keeps a pole radius over the whole interval of mass, widened by a factor for what identification cannot know (another
hand, another pose), and over the whole range of delay that was seen. The prediction is made for the device as identified.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.closed_loop import pole_radius
from nodes.stability.every_delay import every_delay
from nodes.stability.plant import Plant
from nodes.stability.rest import rest
from sim.design.demand import CONVENTIONS, Demand
from sim.design.families import Tuned, best_pd, designed, latest_delay
from sim.design.landing import drops
from sim.device.model import DeviceModel
from sim.identify.identified import Identified
from sim.tune.knock import Edge, factors, predicted_edge

__all__ = [
    "Wanted",
    "demand",
    "design",
    "edge_error",
    "knock_size",
    "linear_edge",
    "model",
    "predict",
]


@dataclass(frozen=True)
class Wanted:
    """What a tuning asks for.

    Attributes
    ----------
    taps : int
        Length of the law.
    spread : float
        Factor by which the mass may be off in either direction.
    radius : float
        Largest pole radius.
    nyquist : float
        Largest |H(−1)| [N/m].
    land : bool
        Whether every drop must settle too.
    effort : int
        Multiplies the search.
    """

    taps: int = 4
    spread: float = 1.25
    radius: float = 0.99
    nyquist: float = 1e4
    land: bool = False
    effort: int = 1


def demand(found: Identified, wanted: Wanted) -> Demand:
    """Ask for a law that suits everything that a device may be.

    Parameters
    ----------
    found : Identified
        The device.
    wanted : Wanted
        Margins.

    Returns
    -------
    Demand
        Mass interval widened, least damping, range of delay, range of a hand's stiffness.

    Raises
    ------
    ValueError
        When mass, damping or delay could not be told; the text says why.
    """
    _, lightest, heaviest = found.mass.known()
    _, damping, _ = found.damping.known()
    found.delay.known()
    _, softest, stiffest = found.stiffness.known()
    return Demand(
        mass=(lightest / wanted.spread, heaviest * wanted.spread),
        damping=damping,
        delay=found.delay_range,
        period=found.period,
        radius=wanted.radius,
        nyquist=wanted.nyquist,
        stiffness=(softest, stiffest),
        lands=CONVENTIONS if wanted.land else (),
    )


def design(found: Identified, wanted: Wanted) -> tuple[Tuned, Tuned, Demand]:
    """Design taps, and tune PD in the same way to compare.

    Parameters
    ----------
    found : Identified
        The device.
    wanted : Wanted
        Margins and length.

    Returns
    -------
    tuple of Tuned, Tuned and Demand
        The designed law, PD, and what both keep; the better of the two comes first should the search find no better taps.

    Raises
    ------
    ValueError
        When the device is not known well enough.
    """
    asked = demand(found, wanted)
    law, pd = designed(asked, wanted.taps, wanted.effort), best_pd(asked)
    if pd.found is not None and (law.found is None or pd.found.h1_n_per_m > law.found.h1_n_per_m):
        law = pd
    return law, pd, asked


def model(found: Identified) -> DeviceModel:
    """Put the identified device into a model that has the whole delay of the loop.

    Parameters
    ----------
    found : Identified
        The device.

    Returns
    -------
    DeviceModel
        Free, or with the hand's stiffness about its present place.
    """
    from sim.device.model import Hand

    mass, _, _ = found.mass.known()
    damping, _, _ = found.damping.known()
    delay, _, _ = found.delay.known()
    hand = None
    if found.held and found.stiffness.value:
        hand = Hand(stiffness=found.stiffness.value, path=[(0.0, 0.0)])
    return DeviceModel(
        mass=mass,
        damping=damping,
        friction=found.friction.value or None,
        resolution=found.encoder.value,
        delay=delay,
        hand=hand,
    )


def knock_size(taps: tuple[float, ...], edge: float, found: Identified, peak: float | None) -> float:
    """Choose a knock that the encoder sees well and the driver does not limit.

    Parameters
    ----------
    taps : tuple of float
        The law [N/m].
    edge : float
        Largest factor that is tried.
    found : Identified
        The device.
    peak : float or None
        Largest force of the driver [N].

    Returns
    -------
    float
        At most 1 mm, at least eight encoder steps [m].
    """
    strongest = 0.5 * (peak or 6.0) / (edge * max(map(abs, taps)))
    return max(min(1e-3, strongest), 8.0 * (found.encoder.value or 1e-6))


def linear_edge(law: CompiledLaw, found: Identified) -> float:
    """Find the factor of all taps at which a pole of the identified loop reaches the unit circle.

    Parameters
    ----------
    law : CompiledLaw
        Taps.
    found : Identified
        The device.

    Returns
    -------
    float
        Above 1, at most 100.
    """
    mass, damping, delay = found.mass.known()[0], found.damping.known()[0], found.delay.known()[0]

    def radius(factor: float) -> float:
        scaled = CompiledLaw(tuple(factor * tap for tap in law.taps))
        return pole_radius(scaled, Plant(found.period, mass, damping, delay, found.stiffness.value or 0.0))

    low, high = 1.0, 1.0
    while high < 100.0 and radius(high) < 1.0:
        low, high = high, high * 1.1
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if radius(middle) < 1.0 else (low, middle)
    return low


def predict(
    law: Tuned, asked: Demand, found: Identified, peak: float | None, slew: float | None
) -> tuple[dict[str, Any], Edge, float, list[float]]:
    """Tell what the law will do on the identified device.

    Parameters
    ----------
    law : Tuned
        With taps.
    asked : Demand
        What it was designed for.
    found : Identified
        The device.
    peak, slew : float or None
        Limits of the driver.

    Returns
    -------
    tuple
        Figures; the edge found by knocking on the model; the knock [m]; the factors to be tried for real.

    Raises
    ------
    ValueError
        When there is no law.
    """
    if law.found is None:
        raise ValueError("no law keeps the demand: allow a larger radius, less spread or more taps")
    compiled = law.found.law
    taps = compiled.taps
    linear = linear_edge(compiled, found)
    tried = factors(max(1.0, 0.8 * linear), 1.25 * linear)
    knock = knock_size(taps, linear, found, peak)
    knocked = predicted_edge(compiled, model(found), found.period, knock, tried, peak, slew)
    # Far below the edge every third step will do.
    near = 0.93 * (knocked.factor or tried[-1])
    tried = [factor for n, factor in enumerate(tried) if n % 3 == 0 or factor > near]
    dropped = drops(law.found.law, asked)
    figures: dict[str, Any] = {
        "h1_n_per_m": law.found.h1_n_per_m,
        "h_nyquist_n_per_m": law.found.h_nyquist_n_per_m,
        "pole_radius": law.found.radius,
        "edge_linear_factor": linear,
        "edge_linear_h1_n_per_m": linear * law.found.h1_n_per_m,
        "edge_factor": knocked.factor,
        "edge_h1_n_per_m": None if knocked.factor is None else knocked.factor * law.found.h1_n_per_m,
        "knock_m": knock,
        "stable_up_to_delay_ticks": latest_delay(law, asked),
        "drops_settled": sum(dropped.values()),
        "drops": len(dropped),
        **_every_delay(compiled, asked),
        **_at_rest(compiled, found),
    }
    return figures, knocked, knock, tried


def _every_delay(law: CompiledLaw, asked: Demand) -> dict[str, Any]:
    """Certify lightest and heaviest device for every sequence of delays, where the range is within a tick."""
    low, high = asked.delay
    if high > low + 1.0:
        return {
            "every_delay_stable": None,
            "every_delay_why": f"delays of {low:.3g} to {high:.3g} ticks: over a tick apart",
        }
    told = [
        every_delay(law, Plant(asked.period, mass, asked.damping, stiffness=grip), (low, high)).stable
        for mass in asked.mass
        for grip in sorted(set(asked.stiffness))
    ]
    return {"every_delay_stable": False if False in told else None if None in told else True}


def _at_rest(law: CompiledLaw, found: Identified) -> dict[str, Any]:
    if found.encoder.value is None or found.friction.value is None:
        return {"limit_cycle_free": None}
    plant = Plant(found.period, found.mass.known()[0], found.damping.known()[0], found.delay.known()[0])
    told = rest(law, plant, found.encoder.value)
    return {
        "friction_n": found.friction.value,
        "friction_for_rest_bound_n": told.friction_bound_n,
        "friction_for_rest_estimated_n": told.friction_estimated_n,
        "limit_cycle_free": told.free(found.friction.known()[1]),
        "buzz_hz": told.buzz_hz,
    }


def edge_error(predicted: float | None, measured: float | None) -> float | None:
    """Compare the two edges.

    Parameters
    ----------
    predicted, measured : float or None
        Factors.

    Returns
    -------
    float or None
        Measured over predicted, minus one.
    """
    if predicted is None or measured is None or not math.isfinite(predicted * measured):
        return None
    return float(np.float64(measured) / predicted - 1.0)
