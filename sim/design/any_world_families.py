"""Families of laws for an unknown world: PD, PDα, the optimum, free taps, poles."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.laws.presets import PRESETS
from nodes.stability.landing_proof import law_polynomials
from sim.arrays import Array
from sim.design.any_world import stiffest_for_any_world
from sim.design.surroundings import Surroundings, WorldDesign, behind_poles

# orders at which PDα is tuned before the best is refined
ORDERS = tuple(round(0.2 * i, 1) for i in range(1, 13))
MOST_POLE = 0.995  # largest radius of a pole
# poles of the section tried before the best is refined
POLES = (-0.95, -0.9, -0.8, -0.6, -0.3, 0.3, 0.6)
# with a known device a slow pole adds static stiffness (THEORY.md §20)
SLOW_POLES = (0.9, 0.97)
# frequency at which a hand moves; there the stiffness is given as well [Hz]
FELT_AT = 10.0


@dataclass(frozen=True)
class Member:
    """The stiffest member of a family."""

    # ``pd``, ``pd_alpha``, ``paper_optimum``, ``taps``, ``one_pole``, ``taps_over_pole`` or
    # ``two_poles``
    family: str
    # description for `nodes.laws.parse.parse_law`; None if none is stable for every world
    law: dict[str, Any] | None
    design: WorldDesign | None  # its figures


def stiffest_members(
    surroundings: Surroundings, taps: int, sections: bool = False
) -> Iterator[Member]:
    """Yield the stiffest member of each family, PD first.

    taps: number of taps of a family with a choice.
    sections: also search taps over a pole and two poles, up to a minute each.
    """
    yield stiffest_pd(surroundings)
    yield stiffest_pd_alpha(surroundings, taps)
    yield stiffest_linear(
        "paper_optimum",
        {**PRESETS["paper_optimum"], "kind": "paper_optimum"},
        surroundings,
    )
    yield stiffest_taps(surroundings, taps)
    yield stiffest_one_pole(surroundings)
    if sections:
        yield stiffest_over_pole(surroundings, taps)
        yield stiffest_two_poles(surroundings)


def stiffest_pd(surroundings: Surroundings) -> Member:
    """Tune stiffness and damping of PD."""
    return stiffest_linear("pd", {"kind": "pd"}, surroundings)


def stiffest_pd_alpha(surroundings: Surroundings, taps: int) -> Member:
    """Tune stiffness, damping and order of PDα with `taps` taps."""

    def at(order: float) -> Member:
        return stiffest_linear(
            "pd_alpha",
            {"kind": "pd_alpha", "order": order, "taps": taps, "gains": "paper"},
            surroundings,
        )

    return _refined(at, ORDERS, 0.1, (0.05, 3.9))


def stiffest_taps(surroundings: Surroundings, taps: int) -> Member:
    """Design up to `taps` free taps; fewer if they are as stiff."""
    best: Member | None = None
    for length in range(1 if surroundings.mass is None else min(2, taps), taps + 1):
        design = stiffest_for_any_world(surroundings, np.eye(length))
        member = Member(
            "taps",
            None if design is None else _fir(design, surroundings.period),
            design,
        )
        # The shorter law is preferred if more taps gain less than a thousandth.
        if best is None or stiffness(member) > 1.001 * stiffness(best):
            best = member
    if best is None:
        raise ValueError(f"taps = {taps}: expected at least 1")
    return best


def stiffest_one_pole(surroundings: Surroundings) -> Member:
    """Design two taps over one pole, anywhere inside the unit circle."""

    def at(pole: float) -> Member:
        return _behind("one_pole", surroundings, 2, behind_poles(pole))

    return _refined(at, _poles(surroundings), 0.05, (-MOST_POLE, MOST_POLE))


def stiffest_over_pole(surroundings: Surroundings, taps: int) -> Member:
    """Design `taps` taps over one pole, anywhere inside the unit circle."""

    def at(pole: float) -> Member:
        return _behind("taps_over_pole", surroundings, taps, behind_poles(pole))

    return _refined(at, _poles(surroundings), 0.05, (-MOST_POLE, MOST_POLE))


def _poles(surroundings: Surroundings) -> tuple[float, ...]:
    return POLES if surroundings.mass is None else POLES + SLOW_POLES


def stiffest_two_poles(surroundings: Surroundings, taps: int = 3) -> Member:
    """Design taps over a second-order section with poles anywhere inside the unit circle.

    The coefficients a1, a2 of 1 + a1·w + a2·w² lie in a triangle: |a2| < 1, |a1| < 1 + a2. They are
    searched with steps that are halved.
    """

    def at(a1: float, a2: float) -> Member:
        if not (abs(a2) < MOST_POLE**2 and abs(a1) < MOST_POLE * (1.0 + a2)):
            return Member("two_poles", None, None)
        return _behind("two_poles", surroundings, taps, np.array([1.0, a1, a2]))

    tried = {
        (share * (1.0 + a2), a2): at(share * (1.0 + a2), a2)
        for a2 in (-0.5, 0.0, 0.5, 0.9)
        for share in (-0.6, 0.0, 0.5, 0.9)
    }
    step = 0.2
    while step > 0.01:
        a1, a2 = max(tried, key=lambda one: stiffness(tried[one]))
        around = [(a1 + step, a2), (a1 - step, a2), (a1, a2 + step), (a1, a2 - step)]
        tried |= {one: at(*one) for one in around if one not in tried}
        if max(tried, key=lambda one: stiffness(tried[one])) == (a1, a2):
            step *= 0.5
    return max(tried.values(), key=stiffness)


def _behind(
    family: str, surroundings: Surroundings, taps: int, bottom: Array
) -> Member:
    basis = np.eye(taps)
    if surroundings.mass is not None:
        # All but the first have no static gain: what they must be does not depend on a slow pole.
        basis[1:] -= np.eye(taps)[:-1]
    design = stiffest_for_any_world(surroundings, basis, bottom=bottom)
    return Member(
        family, None if design is None else _fir(design, surroundings.period), design
    )


def stiffest_linear(
    family: str, shape: dict[str, Any], surroundings: Surroundings
) -> Member:
    """Tune stiffness and damping of a law of taps that is linear in both."""
    spring, both = (
        np.array(
            parse_law({**shape, "stiffness": 1.0, "damping": gain})
            .compile(surroundings.period)
            .taps
        )
        for gain in (0.0, 1.0)
    )
    spring = np.pad(spring, (0, len(both) - len(spring)))
    design = stiffest_for_any_world(
        surroundings, np.array([spring, both - spring]), free=False
    )
    if design is None or not design.parameters[0] > 0.0:
        return Member(family, None, None)
    stiffness_, damping = design.parameters.tolist()
    return Member(
        family, {**shape, "stiffness": stiffness_, "damping": damping}, design
    )


def stiffness(member: Member) -> float:
    """Return H(1) of a member, 0 if there is none [N/m]."""
    return 0.0 if member.design is None else member.design.h1_n_per_m


def _refined(
    at: Callable[[float], Member],
    values: tuple[float, ...],
    step: float,
    ends: tuple[float, float],
) -> Member:
    """Return the best of some values, refined by smaller and smaller steps."""
    tried = {value: at(value) for value in values}
    best = max(tried, key=lambda value: stiffness(tried[value]))
    while step > 0.004 * (ends[1] - ends[0]) / 4.0:
        for value in (best - step, best + step):
            if ends[0] < value < ends[1]:
                tried[value] = at(value)
        best = max(tried, key=lambda value: stiffness(tried[value]))
        step *= 0.5
    return tried[best]


def _fir(design: WorldDesign, period: float) -> dict[str, Any]:
    law = design.law
    described: dict[str, Any] = {
        "kind": "fir",
        "taps": list(law.taps),
        "period": period,
    }
    return described | (
        {
            "recursive": [
                dict(zip(("b0", "b1", "a1", "a2"), part, strict=True))
                for part in law.sections
            ]
        }
        if law.sections
        else {}
    )


def fractional_gain(members: list[Member]) -> float | None:
    """Return the ratio of H(1) of PDα to PD; None if one of them has no stiffness."""
    found = {member.family: stiffness(member) for member in members}
    return (
        found["pd_alpha"] / found["pd"]
        if min(found["pd_alpha"], found["pd"]) > 0.0
        else None
    )


def felt_stiffness(
    law: CompiledLaw, period: float, frequency: float = FELT_AT
) -> float:
    """Return the stiffness that a motion of this frequency [Hz] meets, Re H [N/m]."""
    top, bottom = law_polynomials(law)
    theta = np.array([2.0 * math.pi * frequency * period])
    return float((top.at(theta) / bottom.at(theta)).real[0])


def margin_figures(design: WorldDesign, period: float) -> dict[str, Any]:
    """Return the figures of a design for JSON; `period`: T [s]."""
    bound = design.bound_n_per_m
    return {
        "taps_n_per_m": list(design.law.taps),
        "sections": [list(section) for section in design.law.sections],
        "h1_n_per_m": design.h1_n_per_m,
        "h_nyquist_n_per_m": design.h_nyquist_n_per_m,
        "stiffness_10_hz_n_per_m": felt_stiffness(design.law, period),
        "limit_n_per_m": design.limit_n_per_m,
        "bound_n_per_m": bound if bound is not None and math.isfinite(bound) else None,
        "proven": design.proven,
    }
