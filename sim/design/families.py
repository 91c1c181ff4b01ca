"""Laws designed for the actual device and loop, compared with tuned conventional laws.

The comparison is at equal demand: same range of mass, same delay, same pole radius, same bound on
H(−1), same search. PD, PDα and the paper's optimum are narrower families than free taps of the same
length.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.laws.presets import PRESETS
from nodes.parameters.yaml_io import write_yaml
from nodes.stability.flexible import FlexiblePlant, flexible_radius
from nodes.stability.k_max import tolerance
from nodes.stability.plant import Plant
from sim.arrays import Array
from sim.design.demand import Demand, Robust, corners
from sim.design.robust import stiffest
from sim.stability.every_delay import Certificate, every_delay

# orders at which PDα is tuned before the best is refined
ORDERS = tuple(round(0.1 * i, 1) for i in range(1, 40, 2))
REFINED = 0.0125  # spacing of the orders at which refining stops


# Cutoffs of the filtered velocity tried first, relative to the loop's rate: above 0.8 it equals
# plain PD.
CUTOFFS = (0.05, 0.1, 0.2, 0.4, 0.8)


@dataclass(frozen=True)
class Tuned:
    """The stiffest member of a family at one demand."""

    # ``pd``, ``pd_filtered``, ``pd_alpha``, ``paper_optimum`` or ``designed``
    family: str
    # description for `nodes.laws.parse.parse_law`; None if no member meets the demand
    law: dict[str, Any] | None
    found: Robust | None  # its figures


def designed(demand: Demand, taps: int, effort: int = 1) -> Tuned:
    """Design free taps: a law of kind ``fir`` for one sampling period."""
    # A shorter law padded with zeros is a longer one: more taps are never worse.
    found: Robust | None = None
    for length in range(min(taps, 2), taps + 1):
        shorter: list[Array] = [] if found is None else [np.append(found.taps, 0.0)]
        found = stiffest(demand, np.eye(length), effort=effort, known=shorter)
    return Tuned(
        "designed", None if found is None else fir(found.taps, demand.period), found
    )


def fir(taps: Array, period: float) -> dict[str, Any]:
    """Return taps h_0 ... h_n [N/m] as a law description."""
    return {"kind": "fir", "taps": [float(tap) for tap in taps], "period": period}


def best_pd(demand: Demand) -> Tuned:
    """Tune stiffness and damping of PD."""
    return best_linear("pd", {"kind": "pd"}, demand)


def best_pd_filtered(demand: Demand) -> Tuned:
    """Tune PD with a filtered velocity at `CUTOFFS`, then refine the best cutoff [Hz]."""

    def at(cutoff: float, wanted: Demand) -> Tuned:
        return best_linear(
            "pd_filtered", {"kind": "pd_filtered", "cutoff": cutoff}, wanted
        )

    best = _stiffest_of(at, [share / demand.period for share in CUTOFFS], demand)
    for step in (1.3, 1.1):
        if best.law is not None:
            cutoff = float(best.law["cutoff"])
            best = _stiffest_of(at, (cutoff / step, cutoff * step), demand, best)
    return best


def best_pd_alpha(
    demand: Demand, taps: int, orders: tuple[float, ...] | None = None
) -> Tuned:
    """Tune stiffness and damping of PDα at every order and refine the best.

    orders: by default `ORDERS`.
    """

    def at(order: float, wanted: Demand) -> Tuned:
        return best_linear(
            "pd_alpha",
            {"kind": "pd_alpha", "order": order, "taps": taps, "gains": "paper"},
            wanted,
        )

    best = _stiffest_of(at, ORDERS if orders is None else orders, demand)
    step = 0.1
    while step >= REFINED and best.law is not None:
        order = float(best.law["order"])
        best = _stiffest_of(
            at, [x for x in (order - step, order + step) if 0.0 < x < 4.0], demand, best
        )
        step *= 0.5
    return best


def best_paper_optimum(demand: Demand) -> Tuned:
    """Tune stiffness and damping of the paper's optimum; its gains and orders are fixed."""
    return best_linear(
        "paper_optimum", {**PRESETS["paper_optimum"], "kind": "paper_optimum"}, demand
    )


def compare(demand: Demand, taps: int) -> Iterator[Tuned]:
    """Tune PD, filtered PD, PDα, the paper's optimum and a designed law to one demand."""
    yield best_pd(demand)
    yield best_pd_filtered(demand)
    yield best_pd_alpha(demand, taps)
    yield best_paper_optimum(demand)
    yield designed(demand, taps)


def _stiffness(tuned: Tuned) -> float:
    return 0.0 if tuned.found is None else tuned.found.h1_n_per_m


def best_linear(family: str, shape: dict[str, Any], demand: Demand) -> Tuned:
    """Tune K and B of a law that is linear in both."""
    spring, pole = _numerator(
        parse_law({**shape, "stiffness": 1.0, "damping": 0.0}).compile(demand.period)
    )
    both, _ = _numerator(
        parse_law({**shape, "stiffness": 1.0, "damping": 1.0}).compile(demand.period)
    )
    found = stiffest(demand, np.array([spring, both - spring]), free=False, pole=pole)
    if found is None or not found.parameters[0] > 0.0:
        return Tuned(family, None, None)
    stiffness, damping = found.parameters.tolist()
    return Tuned(family, {**shape, "stiffness": stiffness, "damping": damping}, found)


def _stiffest_of(
    at: Callable[[float, Demand], Tuned],
    values: Sequence[float],
    demand: Demand,
    best: Tuned | None = None,
) -> Tuned:
    """Tune at each value and return the stiffest.

    If drops must settle, a value is skipped when its linear bound is not above the best so far.
    """
    if not demand.lands:
        found = [at(value, demand) for value in values]
        return max(found if best is None else [best, *found], key=_stiffness)
    linear = replace(demand, lands=())
    bounds = sorted(
        ((_stiffness(at(value, linear)), value) for value in values), reverse=True
    )
    for bound, value in bounds:
        if best is None or bound > _stiffness(best):
            # 2 % below the best, so that the search still explores where drops settle.
            tuned = at(
                value, replace(demand, above=0.98 * _stiffness(best) if best else 0.0)
            )
            best = tuned if best is None else max(best, tuned, key=_stiffness)
    if best is None:
        raise ValueError("no value was given")
    return best


def _numerator(law: CompiledLaw) -> tuple[Array, float]:
    """Return the taps of a law, or its two numerator taps over 1 − pole·w."""
    if not law.sections:
        return np.array(law.taps), 0.0
    ((b0, b1, a1, _),) = law.sections
    return np.array([law.taps[0] + b0, law.taps[0] * a1 + b1]), -a1


def latest_delay(law: CompiledLaw, demand: Demand) -> float | None:
    """Find the largest delay [ticks] at which a law is stable over a demand.

    Checked at five masses, the ends of damping and hand, every joint and lag. Return None without a
    limit and 0 for a law unstable at the longest demanded delay.
    """
    masses = np.unique(np.geomspace(*demand.mass, 5)).tolist()
    edges: list[float | None] = []
    for mass, damping, hand in itertools.product(
        masses, sorted(set(demand.dampings)), sorted(set(demand.stiffness))
    ):
        if demand.beyond:
            edges += [
                _latest(law, demand, (mass, damping), (hand, *beyond))
                for beyond in demand.beyond
            ]
        else:
            limit = tolerance(
                law, Plant(demand.period, mass, damping, demand.delay[1], hand)
            )
            edges.append(0.0 if limit is None else limit.delay_max_ticks)
    return min((edge for edge in edges if edge is not None), default=None)


def _latest(
    law: CompiledLaw,
    demand: Demand,
    body: tuple[float, float],
    beyond: tuple[float, ...],
) -> float | None:
    """Return the delay at which a pole leaves the unit circle, up to 20 ticks beyond.

    Searched in quarters of a tick, then bisected; None if there is none.
    """

    def stable(delay: float) -> bool:
        return (
            flexible_radius(law, demand.period, FlexiblePlant(*body, delay, *beyond))
            < 1.0
        )

    if not stable(demand.delay[1]):
        return 0.0

    low = high = demand.delay[1]
    while stable(high):
        low = high
        high = high + 0.25
        if high > demand.delay[1] + 20.0:
            return None
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return low


def certificate(law: CompiledLaw, demand: Demand) -> Certificate:
    """Certify a law for every sequence of the demanded delays (THEORY.md §10)."""
    if demand.delay[1] > demand.delay[0] + 1.0:
        return Certificate.TOO_WIDE
    worst = Certificate.CERTIFIED
    for plant in corners(demand):
        found = every_delay(law, plant, demand.delay, period=demand.period).stable
        if found is Certificate.UNSTABLE:
            return found
        worst = worst if found else Certificate.UNDECIDED
    return worst


def certified(tune: Callable[[Demand], Tuned], demand: Demand) -> Tuned:
    """Reduce the pole radius until every sequence of delays is certified, ten times at most.

    Each time the radius is 10 % further from 1.
    """
    margin = 1.0 - demand.radius
    if demand.delay[1] > demand.delay[0] + 1.0:
        raise ValueError(
            f"delay {demand.delay[0]:g}..{demand.delay[1]:g} ticks: a certificate takes at most one"
            " tick"
        )
    for _ in range(10):
        tuned = tune(replace(demand, radius=1.0 - margin))
        if tuned.found is None or certificate(tuned.found.law, demand):
            return tuned
        margin = max(1.1 * margin, 1e-3)
    return Tuned(tuned.family, None, None)


def to_yaml(
    law: dict[str, Any],
    name: str = "designed",
    node: str = "coupling",
    comment: str = "",
) -> str:
    """Return a law as YAML for ``haptic param load``, which defines and activates it."""
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    return head + write_yaml({node: {"law": name, "laws": {name: law}}})
