"""Edges of all laws, and laws scaled to another H(1)."""

from __future__ import annotations

from functools import partial
from typing import Any

import msgspec
import numpy as np
import pytest

from messages.errors import AT_MOST, OTHER, Remedy
from nodes.coupling.judgement import Judgement
from nodes.coupling.law_book import LawBook
from nodes.coupling.parameters import CouplingParameters
from nodes.laws.parse import parse_law
from nodes.parameters.store import ParameterError, convert
from nodes.stability.bracketed_roots import roots_between
from nodes.stability.closed_loop import pole_radius
from nodes.stability.plant import Plant
from nodes.view.law_edges import (
    edges_of_laws,
    in_hardness,
    rests_of_laws,
    with_hardness,
)
from nodes.view.steady_delay import PERIOD, SPAN, SteadyDelay

T = 0.002
SECTION = {"b0": 90.0, "b1": -60.0, "a1": -0.4, "a2": 0.1}
LAWS: dict[str, dict[str, Any]] = {
    "pd": {"kind": "pd", "stiffness": 1000.0, "damping": 3.0},
    "fir": {"kind": "fir", "taps": [3000.0, -1500.0]},
    "recursive": {"kind": "fir", "taps": [2500.0, -1500.0], "recursive": [SECTION]},
    "push": {"kind": "excitation"},
}
DEVICES = [Plant(T, mass, 1.0, 0.4, 150.0) for mass in (0.1, 0.3)]


def radius(described: dict[str, Any], stiffness: float) -> float:
    """Return the largest pole radius of a law at a stiffness, over the devices."""
    if "stiffness" in described:
        law = parse_law({**described, "stiffness": stiffness})
    else:
        law = parse_law(with_hardness(described, stiffness, T))
    return max(pole_radius(law.compile(T), device) for device in DEVICES)


@pytest.mark.parametrize("name", ["pd", "fir", "recursive"])
def test_below_its_edge_a_law_is_stable_and_above_it_is_not(name: str) -> None:
    edge = edges_of_laws(LAWS, DEVICES)[name]
    assert edge is not None
    # A bisection of 30 halvings of a bracket of a tenth ends within 1e-10 of the edge.
    assert radius(LAWS[name], edge * (1.0 - 1e-6)) < 1.0
    assert radius(LAWS[name], edge * (1.0 + 1e-6)) > 1.0


def test_a_law_is_scaled_as_a_whole_and_only_where_it_has_no_stiffness() -> None:
    scaled = with_hardness(LAWS["recursive"], 4000.0, T)
    law, old = (parse_law(each).compile(T) for each in (scaled, LAWS["recursive"]))
    assert law.h1 == pytest.approx(4000.0, rel=1e-12)
    z = np.exp(1j * np.array([0.1, 1.0, 3.0]))
    ratio = law.response(z) / old.response(z)
    assert ratio == pytest.approx(np.full(3, 4000.0 / old.h1), rel=1e-12)
    rests = rests_of_laws(LAWS, T)
    assert rests["fir"] == 1500.0
    assert (rests["pd"], rests["push"]) == (None, None)
    with pytest.raises(ParameterError, match="of kind pd is not scaled"):
        with_hardness(LAWS["pd"], 4000.0, T)
    for wrong in (0.0, -1.0, float("nan"), float("inf")):
        with pytest.raises(ParameterError, match="expected a stiffness above 0"):
            with_hardness(LAWS["fir"], wrong, T)
    assert edges_of_laws(LAWS, DEVICES)["push"] is None


@pytest.mark.parametrize("name", ["one", "fir"])
def test_a_refusal_of_an_h1_tells_the_largest_one_that_is_accepted(name: str) -> None:
    """The coupling tells taps; the law there is accepted, and the dial asks for 40 000 N/m."""
    taps = {"one": [100.0], "fir": [2000.0, -1000.0]}[name]
    device = {"mass": 0.1, "damping": 1.0, "stiffness": 150.0, "delay": 0.4}
    law = {"kind": "fir", "taps": taps}

    def parameters(described: dict[str, Any]) -> CouplingParameters:
        given = {"laws": {name: described}, "law": name, "plant": device}
        found: CouplingParameters = convert(given, CouplingParameters, "coupling")
        return found

    scaled = with_hardness(law, 4e4, T)
    now, wanted = parameters(law), parameters(scaled)
    judgement = Judgement("coupling", T, LawBook("coupling", T))
    with pytest.raises(ParameterError) as refusal:
        judgement.of_change(
            now, wanted, name, parse_law(scaled).compile(T), 0.4, force=False
        )
    told = in_hardness(refusal.value.remedies, scaled, 4e4)
    assert not any("taps" in one.text for one in told)
    (most,) = [one.values["hardness"] for one in told if one.kind == AT_MOST]
    edge = edges_of_laws({name: law}, [Plant(T, 0.1, 1.0, 0.4, 150.0)])[name]
    assert edge is not None
    # Rounded down to a few digits.
    assert 0.989 * edge < most < edge
    other = (Remedy(OTHER, "no value is accepted"),)
    assert in_hardness(other, scaled, 4e4) == other


def test_the_edge_of_a_scaled_law_does_not_depend_on_how_soft_it_is_now() -> None:
    """To 2**-30 of the bracket and the rounding of a scale, far below the edge too."""
    whole = edges_of_laws({"fir": LAWS["fir"]}, DEVICES)["fir"]
    soft = {"kind": "fir", "taps": [1e-6 * tap for tap in LAWS["fir"]["taps"]]}
    assert edges_of_laws({"fir": soft}, DEVICES)["fir"] == pytest.approx(
        whole, rel=1e-8
    )


def _product(roots: Any, x: Any) -> Any:
    return np.prod(x[:, None] - roots, axis=1)


def test_bracketed_roots_are_those_of_the_polynomial() -> None:
    """Between neighbours of random roots; a bracket that ends at a root has it."""
    rng = np.random.default_rng(4)
    for _ in range(50):
        roots = np.sort(rng.uniform(-5.0, 5.0, 6))
        ends = np.concatenate([[-6.0], 0.5 * (roots[1:] + roots[:-1]), [6.0]])
        found = roots_between(partial(_product, roots), ends[:-1], ends[1:])
        # Rounding of the product: some eps over the distance to the other roots.
        gap = np.diff(roots).min()
        assert found == pytest.approx(roots, abs=1e-14 / gap)
    ends = np.array([0.0, 1.0, 2.0])
    assert roots_between(lambda x: x - 1.0, ends[:-1], ends[1:]).tolist() == [1.0, 1.0]


def test_the_delay_of_a_map_is_the_median_of_ten_seconds() -> None:
    steady = SteadyDelay()
    assert steady.median(0.7) == 0.7
    for k in range(round(SPAN / PERIOD)):
        # One of three samples is late.
        steady.add(k * PERIOD * 1.001, 1.5 if k % 3 == 0 else 0.2)
    assert steady.median(0.0) == 0.2
    steady.add(SPAN - 0.5 * PERIOD, 9.0)  # too soon after the last one
    for k in range(round(SPAN / PERIOD)):
        steady.add(SPAN + k * PERIOD * 1.001, 0.3)
    assert steady.median(0.0) == 0.3
    assert msgspec.to_builtins(len(steady._samples)) <= round(SPAN / PERIOD) + 1
