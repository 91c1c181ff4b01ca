"""Laws designed for the device and the loop one really has, and what they gain over the best-tuned known ones.

The comparison is at equal demand: same range of mass, same delay, same pole radius, same bound on H(−1), same search. PD,
every PDα and the paper's optimum are then just narrower families than free taps of the same length.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.laws.presets import PRESETS
from nodes.parameters.yaml_io import write_yaml
from nodes.stability.every_delay import every_delay
from nodes.stability.k_max import Plant, tolerance
from sim.design.robust import Demand, Robust, stiffest
from sim.device.model import DeviceModel

__all__ = [
    "ORDERS",
    "REFINED",
    "Tuned",
    "Vector",
    "best_paper_optimum",
    "best_pd",
    "best_pd_alpha",
    "certificate",
    "certified",
    "compare",
    "designed",
    "drops",
    "fir",
    "landing",
    "latest_delay",
    "to_yaml",
]

Vector = NDArray[np.float64]

ORDERS = tuple(round(0.1 * i, 1) for i in range(1, 40, 2))
"""Orders at which PDα is tuned before the best is refined."""

REFINED = 0.0125
"""Spacing of the orders at which refining stops."""


@dataclass(frozen=True)
class Tuned:
    """The stiffest member of a family at one demand.

    Attributes
    ----------
    family : str
        ``pd``, ``pd_alpha``, ``paper_optimum`` or ``designed``.
    law : dict or None
        Its description, as `nodes.laws.parse.parse_law` reads it; None when no member keeps the demand.
    found : Robust or None
        Its figures.
    """

    family: str
    law: dict[str, Any] | None
    found: Robust | None


def designed(demand: Demand, taps: int, effort: int = 1) -> Tuned:
    """Design the taps themselves.

    Parameters
    ----------
    demand : Demand
        What to keep.
    taps : int
        n + 1.
    effort : int
        Multiplies the global search.

    Returns
    -------
    Tuned
        With a law of kind ``fir``, tied to its sampling period.
    """
    # A shorter law with zeros behind it is a longer one: more taps are never worse.
    found: Robust | None = None
    for length in range(min(taps, 2), taps + 1):
        shorter: list[Vector] = [] if found is None else [np.append(found.taps, 0.0)]
        found = stiffest(demand, np.eye(length), effort=effort, known=shorter)
    law = None if found is None else fir(found.taps, demand.period)
    return Tuned("designed", law, found)


def fir(taps: Vector, period: float) -> dict[str, Any]:
    """Describe raw taps as a law.

    Parameters
    ----------
    taps : ndarray, shape (n + 1,)
        h_0 ... h_n [N/m].
    period : float
        Sampling period that they were made for [s].

    Returns
    -------
    dict
        A law of kind ``fir``.
    """
    return {"kind": "fir", "taps": [float(tap) for tap in taps], "period": period}


def best_pd(demand: Demand) -> Tuned:
    """Tune stiffness and damping of PD.

    Parameters
    ----------
    demand : Demand
        What to keep.

    Returns
    -------
    Tuned
        The stiffest.
    """
    return _best("pd", {"kind": "pd"}, demand)


def best_pd_alpha(demand: Demand, taps: int, orders: tuple[float, ...] | None = None) -> Tuned:
    """Tune stiffness and damping of PDα at every order, then refine the best order.

    Parameters
    ----------
    demand : Demand
        What to keep.
    taps : int
        n + 1 of the derivative.
    orders : tuple of float or None
        Orders to begin with; None for `ORDERS`.

    Returns
    -------
    Tuned
        The stiffest of all orders.
    """

    def at(order: float) -> Tuned:
        shape = {"kind": "pd_alpha", "order": order, "taps": taps, "gains": "paper"}
        return _best("pd_alpha", shape, demand)

    best = max((at(order) for order in (ORDERS if orders is None else orders)), key=_stiffness)
    step = 0.1
    while step >= REFINED and best.law is not None:
        order = float(best.law["order"])
        beside = [at(other) for other in (order - step, order + step) if 0.0 < other < 4.0]
        best = max([best, *beside], key=_stiffness)
        step *= 0.5
    return best


def best_paper_optimum(demand: Demand) -> Tuned:
    """Tune stiffness and damping of the paper's optimum; its gains and orders stay.

    Parameters
    ----------
    demand : Demand
        What to keep.

    Returns
    -------
    Tuned
        The stiffest.
    """
    return _best("paper_optimum", {**PRESETS["paper_optimum"], "kind": "paper_optimum"}, demand)


def compare(demand: Demand, taps: int, say: Callable[[str], None], land: bool = False) -> Iterator[Tuned]:
    """Tune every family to the same demand.

    Parameters
    ----------
    demand : Demand
        What all of them must keep.
    taps : int
        n + 1 of PDα and of the designed law.
    say : callable
        Told what is being tuned, for a progress line.
    land : bool
        Whether all of them must also settle when dropped, see `landing`.

    Yields
    ------
    Tuned
        PD, PDα, the paper's optimum, and the designed law.
    """
    families: dict[str, Callable[[Demand], Tuned]] = {
        "PD": best_pd,
        f"PDα, {len(ORDERS)} orders": lambda wanted: best_pd_alpha(wanted, taps),
        "the paper's optimum": best_paper_optimum,
        f"{taps} free taps": lambda wanted: designed(wanted, taps),
    }
    for name, tune in families.items():
        say(name)
        yield landing(tune, demand) if land else tune(demand)


def _stiffness(tuned: Tuned) -> float:
    return 0.0 if tuned.found is None else tuned.found.h1_n_per_m


def _best(family: str, shape: dict[str, Any], demand: Demand) -> Tuned:
    """Tune K and B of a law that is linear in both: its taps at (K, B) = (1, 0) and what one B adds."""
    spring = np.array(parse_law({**shape, "stiffness": 1.0, "damping": 0.0}).compile(demand.period).taps)
    both = np.array(parse_law({**shape, "stiffness": 1.0, "damping": 1.0}).compile(demand.period).taps)
    found = stiffest(demand, np.array([spring, both - spring]), free=False)
    if found is None or not found.parameters[0] > 0.0:
        return Tuned(family, None, None)
    law = {**shape, "stiffness": float(found.parameters[0]), "damping": float(found.parameters[1])}
    return Tuned(family, law, found)


def latest_delay(tuned: Tuned, demand: Demand) -> float | None:
    """Find the delay up to which a law stays stable at every mass of the range: what the demand did not ask for.

    Parameters
    ----------
    tuned : Tuned
        The law.
    demand : Demand
        What it was tuned to.

    Returns
    -------
    float or None
        Delay [ticks], at five masses of the range; None when there is no law or no limit.
    """
    if tuned.found is None:
        return None
    compiled = CompiledLaw(tuple(tuned.found.taps.tolist()))
    known = []
    for mass in np.geomspace(*demand.mass, 5).tolist():
        device = Plant(mass, demand.damping, demand.delay[1], demand.stiffness[0])
        limits = tolerance(compiled, demand.period, device)
        if limits is not None and limits.delay_max_ticks is not None:
            known.append(limits.delay_max_ticks)
    return min(known) if known else None


def drops(taps: Vector, demand: Demand) -> dict[str, bool]:
    """Drop the lightest, the middle and the heaviest device of a demand on a floor, under every contact convention.

    The demand is about the loop in contact, which is linear. Landing is not: contact comes and goes, the history outside it
    and the clamping of forces into the floor are conventions (THEORY.md §4), and no pole radius covers them.

    Parameters
    ----------
    taps : ndarray, shape (n + 1,)
        The law [N/m].
    demand : Demand
        What it was designed for; the longest delay is used.

    Returns
    -------
    dict of str to bool
        Whether the run settled, by convention and mass, e.g. ``penetration clamped 0.05 kg``.
    """
    from sim.experiments.drop import Criterion, drop_scene, settles

    law = CompiledLaw(tuple(taps.tolist()))
    told = {}
    for mass in np.unique(np.geomspace(*demand.mass, 3)).tolist():
        for raw in (False, True):
            for clamp in (True, False):
                model = DeviceModel(mass=mass, damping=demand.damping, delay=demand.delay[1])
                scene = drop_scene(model, demand.period, raw, clamp)
                name = f"{'position' if raw else 'penetration'} {'clamped' if clamp else 'free'} {mass:.3g} kg"
                told[name] = settles(scene, [law], Criterion())[0]
    return told


def landing(tune: Callable[[Demand], Tuned], demand: Demand) -> Tuned:
    """Tune for lighter devices than demanded until every drop of the demanded ones settles.

    Landing punishes what a lighter device punishes: too much force per tick. The law still keeps the demand, whose masses
    are a part of those it is tuned for.

    Parameters
    ----------
    tune : callable
        From a demand to a law, e.g. `best_pd`.
    demand : Demand
        What to keep.

    Returns
    -------
    Tuned
        The first that settles, in steps of 10 % of the lightest mass; without a law when none does down to a quarter.
    """
    lightest = demand.mass[0]
    while lightest > 0.25 * demand.mass[0]:
        tuned = tune(replace(demand, mass=(lightest, demand.mass[1])))
        if tuned.found is None or all(drops(tuned.found.taps, demand).values()):
            return tuned
        lightest *= 0.9
    return Tuned(tuned.family, None, None)


def certificate(taps: Vector, demand: Demand) -> bool | str | None:
    """Certify a law for every sequence of the demanded delays, at five masses, both ends of hand and damping (THEORY.md §10).

    Parameters
    ----------
    taps : ndarray, shape (n + 1,)
        The law [N/m].
    demand : Demand
        With the range of delay.

    Returns
    -------
    bool, str or None
        True with a certificate everywhere; False where a sequence grows; None where it is not decided; ``too wide`` for
        a range above a tick.
    """
    if demand.delay[1] > demand.delay[0] + 1.0:
        return "too wide"
    law = CompiledLaw(tuple(taps.tolist()))
    worst: bool | None = True
    for mass in np.unique(np.geomspace(*demand.mass, 5)).tolist():
        for damping in sorted(set(demand.dampings)):
            for hand in sorted(set(demand.stiffness)):
                found = every_delay(law, demand.period, mass, damping, demand.delay, hand).stable
                if found is False:
                    return False
                worst = worst if found else None
    return worst


def certified(tune: Callable[[Demand], Tuned], demand: Demand) -> Tuned:
    """Tune to smaller pole radii until every sequence of the demanded delays is certified.

    Parameters
    ----------
    tune : callable
        From a demand to a law.
    demand : Demand
        What to keep.

    Returns
    -------
    Tuned
        The first with a certificate: at the demanded radius, then 10 % further from 1 each; without a law after ten.

    Raises
    ------
    ValueError
        When the range of delay is wider than a tick.
    """
    margin = 1.0 - demand.radius
    if demand.delay[1] > demand.delay[0] + 1.0:
        raise ValueError(f"delay {demand.delay[0]:g}..{demand.delay[1]:g} ticks: a certificate takes at most one tick")
    for _ in range(10):
        tuned = tune(replace(demand, radius=1.0 - margin))
        if tuned.found is None or certificate(tuned.found.taps, demand) is True:
            return tuned
        margin = max(1.1 * margin, 1e-3)
    return Tuned(tuned.family, None, None)


def to_yaml(law: dict[str, Any], name: str = "designed", node: str = "coupling", comment: str = "") -> str:
    """Write a law so that ``haptic param load`` takes it at once: defined under its name, and switched to.

    Parameters
    ----------
    law : dict
        Its description.
    name : str
        Name that it gets.
    node : str
        Name of the coupling node.
    comment : str
        Lines to put above.

    Returns
    -------
    str
        YAML.
    """
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    return head + write_yaml({node: {"law": name, "laws": {name: law}}})
