"""Parts of a law: what stiffness and damping multiply, so that taps follow a slider.

A worker computes the coefficients from these parts with the bits of the law's own `compile`; what
needs the C library (powers, realisations of derivatives) is computed here.
"""

from __future__ import annotations

import math
from typing import Any

from nodes.laws import CompiledLaw, Law
from nodes.laws.derivatives import realise
from nodes.laws.fields import Gains, alternating_sum, term_gain
from nodes.laws.multi_term import MultiTerm
from nodes.laws.pd import PD
from nodes.laws.pd_alpha import PDAlpha
from nodes.laws.pd_filtered import PDFiltered
from sim.static_page.image import law_of


def parts_of(
    law: Law, period: float, ticks: int, axes: int, where: str
) -> dict[str, Any]:
    """Return the parts of a law by name; `free` names the parameters that a page may change.

    Raises
    ------
    NotInBrowserError
        If the law has code of its own that is not emitted.
    """
    both = ["stiffness", "damping"]
    if isinstance(law, PD):
        return {"form": "pd", "free": both}
    if isinstance(law, PDFiltered):
        pole = math.exp(-2.0 * math.pi * law.cutoff * period)
        return {"form": "filtered", "pole": pole, "rest": 1.0 - pole, "free": both}
    if isinstance(law, PDAlpha):
        unit = realise(law.derivative, law.order, law.taps, period)
        return {
            "form": "terms",
            "terms": [_weight(law.order, law.gains, period, law.taps) | _unit(unit)],
            "free": both,
        }
    if isinstance(law, MultiTerm):
        terms = [
            {"gain": _term_gain(term.gain, term.order, law, period)}
            | _unit(realise(law.derivative, term.order, law.taps, period))
            for term in law.terms
        ]
        return {"form": "terms", "terms": terms, "free": both}
    compiled = law.compile(period)
    numbers = law_of(compiled, ticks, axes, where)
    return {"form": "fixed", "rest": compiled.h1, "free": [], **numbers}


def _term_gain(gain: float, order: float, law: MultiTerm, period: float) -> float:
    return term_gain(gain, order, law.gains, period, law.taps)


def _weight(order: float, gains: Gains, period: float, taps: int) -> dict[str, float]:
    """Return the factors of `term_gain`, in the order in which it applies them."""
    if gains == "physical":
        return {"gain": 1.0}
    power: float = (0.5 * period) ** (order - 1.0)
    if gains == "unlimited":
        return {"power": power}
    return {"power": power, "two": 2.0**order, "sum": alternating_sum(order, taps)}


def _unit(law: CompiledLaw) -> dict[str, Any]:
    return {
        "taps": list(law.taps),
        "sections": [number for section in law.sections for number in section],
    }
