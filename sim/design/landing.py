"""Impact stability as a constraint of the search: laws that also settle when dropped.

The loop in contact is linear. Impact is not: contact comes and goes, and no pole radius covers the
conventions of history and clamping (THEORY.md §4). The boundary of the settling region is ragged,
so a law must settle with a margin: from half to twice the height, and with masses 3 % outside the
range. The search is differential evolution in boxes that shrink around the best law so far, with
every candidate dropped.
"""

import itertools
from dataclasses import dataclass, replace
from typing import Any

import msgspec
import numpy as np

from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.stability.flexible import FlexiblePlant
from nodes.stability.landing_proof import CONVENTION, prove_landing
from nodes.stability.plant import Plant
from sim.arrays import Array
from sim.design.demand import CONVENTIONS, Demand, cases_of, corners, filtered
from sim.design.evolution import evolve
from sim.design.fall import Falls, falls, settled
from sim.design.linear_family import LinearFamily
from sim.device.model import DeviceModel
from sim.experiments.drop import drop_scene
from sim.experiments.settling import Criterion, settles
from sim.play.one_axis_inputs import Scene

# how far the masses of the drops lie outside the demanded range, relative
MARGIN = 0.03
# heights from which laws must settle [m]; the first is that of `sim.experiments.drop`
HEIGHTS = (0.01, 0.005, 0.02)
# half-widths of the boxes, in forces that move the lightest device by the deflection within one
# tick
_BOXES = (1.5, 0.3, 0.03)


def dropped(
    demand: Demand, mass: float, raw: bool, clamp: bool, height: float
) -> Scene:
    """Return the drop of a device of a demand, with least damping and longest delay."""
    device = DeviceModel(mass=mass, damping=demand.damping, delay=demand.delay[1])
    return drop_scene(device, demand.period, raw, clamp, height)


def drops(law: CompiledLaw, demand: Demand) -> dict[str, bool]:
    """Drop the lightest, middle and heaviest device under every contact convention.

    Return whether each drop settled, by name.
    """
    given = {}
    for mass in np.unique(np.geomspace(*demand.mass, 3)).tolist():
        for raw, clamp in CONVENTIONS:
            name = (
                f"{'position' if raw else 'penetration'} {'clamped' if clamp else 'free'}"
                f" {mass:.3g} kg"
            )
            if demand.beyond:
                given[name] = all(
                    settled(law, falls(demand, [mass], [(raw, clamp)], HEIGHTS[:1]))
                )
            else:
                given[name] = settles(
                    dropped(demand, mass, raw, clamp, HEIGHTS[0]), [law], Criterion()
                )[0]
    return given


@dataclass(frozen=True)
class ProvenLanding:
    """Whether every drop settles, proven at all corners of a demand (THEORY.md §19)."""

    proven: bool
    # devices and delays checked: all of them, or up to the first without a proof
    cases: int
    margin: float  # smallest Re{M (1 + G)} over them
    convention: str  # contact convention of the proof
    why: str  # where and why the proof fails; empty with a proof

    def text(self) -> str:
        """Return the verdict as a sentence."""
        if self.proven:
            return (
                f"every drop settles: proven for {self.cases} devices and delays of these ranges"
                f" ({self.convention})"
            )
        return f"every drop settles: no proof ({self.convention}): {self.why}"


def prove_over(law: CompiledLaw, demand: Demand) -> ProvenLanding:
    """Prove that every drop settles, from any height, at the corners of a demand.

    The corners are five masses and the ends of delay, damping, hand, joint and lag.
    """
    margin = np.inf
    cases = 0
    for corner, delay in itertools.product(corners(demand), sorted(set(demand.delay))):
        plant: Plant | FlexiblePlant = replace(corner, delay=delay)
        if corner.rigid and corner.lag == 0.0:
            plant = Plant(
                demand.period, corner.mass, corner.damping, delay, corner.stiffness
            )
        found = prove_landing(law, plant, demand.period)
        cases = cases + 1
        margin = min(margin, found.margin)
        if not found.proven:
            where = f"{corner.mass:.3g} kg, {delay:.3g} ticks, hand {corner.stiffness:.3g} N/m"
            return ProvenLanding(
                False, cases, margin, CONVENTION, f"{found.why} ({where})"
            )
    return ProvenLanding(True, cases, margin, CONVENTION, "")


def _margin(demand: Demand) -> list[float]:
    low, high = demand.mass
    return list(np.geomspace(low / (1.0 + MARGIN), high * (1.0 + MARGIN), 3).tolist())


def landings(demand: Demand) -> list[Scene]:
    """Return every drop in which a law must settle.

    Masses are up to 3 % beyond the range, conventions are those of the demand, with three heights.
    """
    cases = itertools.product(_margin(demand), demand.lands, HEIGHTS)
    return [
        dropped(demand, mass, *convention, height) for mass, convention, height in cases
    ]


def best_pd_windowed(demand: Demand, resolution: float) -> dict[str, Any] | None:
    """Tune PD with a windowed velocity by its drops, all of `landings`, all conventions.

    This law has no poles to judge it by. Return its parameters, or None if none settles.
    """
    scenes = [
        replace(
            scene, device=msgspec.structs.replace(scene.device, resolution=resolution)
        )
        for scene in landings(replace(demand, lands=CONVENTIONS))
    ]
    best: dict[str, Any] | None = None
    unit = demand.mass[0] / demand.period**2
    stiffnesses = np.geomspace(2e-3, 0.8, 20) * unit
    gains = np.geomspace(0.01, 0.8, 8) * unit * demand.period
    for spread in (1.2, 1.05, 1.0):
        tried = [
            {
                "kind": "pd_windowed",
                "stiffness": k,
                "damping": b,
                "resolution": resolution,
            }
            for k, b in itertools.product(stiffnesses.tolist(), gains.tolist())
            if k + 2.0 * b / demand.period <= demand.nyquist
        ]
        lands = (
            _settled([parse_law(law).compile(demand.period) for law in tried], scenes)
            == 1.0
        )
        best = max(
            (law for law, good in zip(tried, lands, strict=True) if good),
            key=_stiffness,
            default=best,
        )
        if best is None:
            break
        stiffnesses = best["stiffness"] * np.geomspace(1.0, spread, 8)
        gains = best["damping"] * np.geomspace(1.0 / spread, spread, 5)
    return best


def _stiffness(law: dict[str, Any]) -> float:
    return float(law["stiffness"])


def _settled(laws: list[CompiledLaw], scenes: list[Scene]) -> Array:
    """Return the share of drops before the first in which a law fails; 1 if all settle."""
    share = np.ones(len(laws))
    going = list(range(len(laws)))
    for i, scene in enumerate(scenes):
        if not going:
            break
        good = settles(scene, [laws[j] for j in going], Criterion())
        for j in [j for j, fell_well in zip(going, good, strict=True) if not fell_well]:
            share[j] = i / len(scenes)
            going.remove(j)
    return share


def landed(family: LinearFamily, starts: list[Array]) -> Array | None:
    """Search a family for the stiffest law that meets a demand and settles, or None.

    Each search starts at one of `starts` or, last, without a start.
    """
    demand, pole = family.demand, family.fine.pole
    drops = falls(demand, _margin(demand), demand.lands, HEIGHTS)
    best, most = None, 0.0
    for start in [*starts, None]:
        for one in [start, _shrunk(family, drops, start)]:
            if one is None or one.sum() == 0.0 or family.stiffness(one) <= most:
                continue
            laws = filtered(one @ family.basis, pole)
            if family.keeps(one) and all(settled(laws, drops)):
                best, most = one, family.stiffness(one)
    return best


def _shrunk(family: LinearFamily, drops: Falls, start: Array | None) -> Array | None:
    """Search in boxes that shrink around the best law; without a start the first is wide."""
    demand, pole = family.demand, family.fine.pole
    parameters = len(family.basis)
    criterion = Criterion()
    # With a filter, taps give 1/(1 − pole) times the stiffness.
    least = demand.above * (1.0 - pole) / (demand.mass[0] / demand.period**2)
    loop = family.loop(cases_of(demand, 15, 3))
    given = family.evolving(loop, demand.radius - 1e-7)
    lands = (least, drops, pole, criterion.ticks, criterion.tolerance)
    here = start
    score = 0.0
    size = 12 * parameters
    generations = (10 + 15 * parameters) * family.effort
    for span in _BOXES if start is None else _BOXES[1:]:
        middle = np.zeros(parameters) if here is None else here
        box = family.box(middle, span)
        here, score = evolve(
            *given, box, middle, size, generations, family.seed, *lands
        )
    return here if score < 0.0 else None
