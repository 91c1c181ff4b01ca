"""From an identified device to its law: the stiffest that keeps a pole radius over all that the device may be, and lands.

The design keeps a pole radius over the whole interval of mass, widened by a factor for what identification cannot know (another
hand, another pose), and over the whole range of delay that was seen. Unless told otherwise, every drop on a floor settles too.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from sim.design.demand import CONVENTIONS, Demand
from sim.design.families import Tuned, best_pd, designed
from sim.device.model import DeviceModel, Hand
from sim.identify.identified import Identified
from sim.scene.richer import RicherModel


@dataclass(frozen=True)
class Wanted:
    """What a tuning asks for."""

    taps: int = 4  # length of the law
    spread: float = 1.25  # factor by which the mass may be off in either direction
    radius: float = 0.99  # largest pole radius
    nyquist: float = 1e4  # largest |H(−1)| [N/m]
    land: bool = True  # whether every drop must settle too
    effort: int = 1  # multiplies the search
    # By how much the device is lighter and heavier in other poses than in the one that it was identified in [kg], shape (2,).
    poses: tuple[float, float] = (0.0, 0.0)


def demand(found: Identified, wanted: Wanted) -> Demand:
    """Ask for a law that suits everything that a device may be.

    Returns: mass interval widened, least damping, range of delay, range of a hand's stiffness. Raises ValueError when mass,
    damping or delay could not be told; the text says why.
    """
    _, lightest, heaviest = found.mass.known()
    _, damping, _ = found.damping.known()
    found.delay.known()
    _, softest, stiffest = found.stiffness.known()
    lighter, heavier = wanted.poses
    # What is left of a hand's and a device's mass is a tenth at least.
    lightest, heaviest = max(lightest - lighter, 0.1 * lightest), heaviest + heavier
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
    """List the ends of the intervals of lag and joint, the frequency 5 % wider: a pose moves it."""
    if not {"actuator lag", "flexible mode"} & set(found.terms):
        return ()
    _, early, late = found.lag.known() if found.lag.value else (0.0, 0.0, 0.0)
    shares, frequencies, loss = (0.0, 0.0), (math.inf, math.inf), 0.0
    if found.frequency.value is not None:
        _, *ends = found.share.known()
        _, low, high = found.frequency.known()
        shares, frequencies, loss = (ends[0], ends[1]), (low / 1.05, high * 1.05), found.loss.known()[1]
    return tuple(
        (lag, share, frequency, loss)
        for lag in sorted({early, late})
        for share in sorted(set(shares))
        for frequency in sorted(set(frequencies))
    )


def to_record(asked: Demand) -> dict[str, Any]:
    """Write a demand down, for a step that is run alone."""
    return asdict(asked)


def from_record(record: dict[str, Any]) -> Demand:
    """Read a demand back: the inverse of `to_record`."""
    beyond = tuple((float(a), float(b), float(c), float(d)) for a, b, c, d in record.get("beyond", ()))
    pairs = {name: (float(record[name][0]), float(record[name][1])) for name in ("mass", "delay", "stiffness")}
    lands = tuple((bool(raw), bool(clamp)) for raw, clamp in record["lands"])
    return Demand(**{**record, **pairs, "lands": lands, "beyond": beyond})


def design(found: Identified, wanted: Wanted) -> tuple[Tuned, Tuned, Demand]:
    """Design taps, and tune PD in the same way to compare.

    Returns: the designed law, PD, and what both keep; the better of the two comes first should the search find no better taps.
    Raises ValueError when the device is not known well enough.
    """
    asked = demand(found, wanted)
    law, pd = designed(asked, wanted.taps, wanted.effort), best_pd(asked)
    if pd.found is not None and (law.found is None or pd.found.h1_n_per_m > law.found.h1_n_per_m):
        law = pd
    return law, pd, asked


def model(found: Identified) -> DeviceModel | RicherModel:
    """Put the identified device into a model that has the whole delay of the loop.

    Returns: free, or with the hand's stiffness about its present place; the richer one where the data asked for a joint, a lag
    or quadratic damping.
    """
    mass, _, _ = found.mass.known()
    damping, _, _ = found.damping.known()
    delay, _, _ = found.delay.known()
    hand = None
    if found.held and found.stiffness.value:
        hand = Hand(stiffness=found.stiffness.value, path=[(0.0, 0.0)])
    rigid = DeviceModel(
        mass=mass,
        damping=damping,
        friction=found.friction.value or None,
        resolution=found.encoder.value,
        delay=delay,
        hand=hand,
    )
    whole = found.plant()
    quadratic = found.quadratic.value or 0.0
    if whole.rigid and whole.lag == quadratic == 0.0:
        return rigid
    joint = {} if whole.rigid else {"share": whole.share, "frequency": whole.frequency, "loss": whole.loss}
    return RicherModel(rigid, "identified", quadratic=quadratic, lag=whole.lag, **joint)
