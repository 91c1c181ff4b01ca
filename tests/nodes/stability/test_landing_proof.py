"""Proofs of landing: a multiplier written by hand, both sides of the limit, refusals."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from nodes.cli.main import main
from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.stability.cosine_sums import Laurent, one_less_cosine, positive, values
from nodes.stability.flexible import FlexiblePlant
from nodes.stability.landing_proof import prove_landing
from nodes.stability.plant import Plant

T = 0.002
THETA = np.linspace(1e-4, np.pi, 20001)


def pd(stiffness: float, damping: float = 3.0) -> CompiledLaw:
    return parse_law(
        {"kind": "pd", "stiffness": stiffness, "damping": damping}
    ).compile(T)


def tsypkin(stiffness: float, delay: int) -> float:
    """Return the minimum of Re{(1 − w)(1 + G)} for PD, B 3, 0.1 kg, 1 N s/m (THEORY.md §3)."""
    m, b, z = 0.1, 1.0, np.exp(1j * THETA)
    e = math.exp(-b * T / m)
    q = (1.0 - e) * m / b
    device = ((T - q) * z + q - e * T) / (b * (z - 1.0) * (z - e))
    loop = z**-delay * (stiffness + 3.0 * (1.0 - 1.0 / z) / T) * device
    return float(((1.0 - 1.0 / z) * (1.0 + loop)).real.min())


@pytest.mark.parametrize(("delay", "edge"), [(0, 3225.21), (1, 1251.992)])
def test_edge_of_pd_is_that_of_the_multiplier_one_less_w(
    delay: int, edge: float
) -> None:
    """PD, B 3: 85 % and 99.96 % of K_max (3781.87, 1252.48 N/m); no multiplier is better."""
    plant = Plant(T, 0.1, 1.0, float(delay))
    for factor in (0.999, 1.001):
        found = prove_landing(pd(factor * edge), plant)
        assert (
            found.proven is (tsypkin(factor * edge, delay) > 0.0) is (factor < 1.0)
        ), found


@pytest.mark.parametrize(
    ("name", "delays"), [("designed_d0", (0.0, 0.5)), ("designed_d1", (1.0,))]
)
def test_designed_presets_are_proven_as_shipped(
    name: str, delays: tuple[float, ...]
) -> None:
    law = parse_law(name).compile(T)
    for mass in (0.05, 0.2):
        for delay in delays:
            assert prove_landing(law, Plant(T, mass, 1.0, delay)).proven


def test_margin_is_that_of_the_multiplier_at_every_frequency() -> None:
    """The returned multiplier fulfils the condition, computed independently."""
    law, plant = parse_law("designed_d1").compile(T), Plant(T, 0.1, 1.0, 1.0)
    found = prove_landing(law, plant)
    taps = np.array(found.multiplier)
    powers = [i for i in range(-8, 9) if i]
    assert taps.min() >= 0.0
    assert taps.sum() <= 1.0
    z = np.exp(1j * THETA)
    e = math.exp(-T / 0.1)
    q = (1.0 - e) * 0.1
    device = ((T - q) * z + q - e * T) / ((z - 1.0) * (z - e))
    multiplier = 1.0 - np.array([z ** -float(i) for i in powers]).T @ taps
    condition = (multiplier * (1.0 + law.response(z) / z * device)).real
    # The least over 20 001 points and over the finer grid of the search: both within the grid's own
    # curvature.
    assert condition.min() == pytest.approx(found.margin, rel=1e-3)


def test_sections_and_a_joint_have_proofs_too() -> None:
    filtered = parse_law(
        {"kind": "pd_filtered", "stiffness": 500.0, "damping": 2.0, "cutoff": 60.0}
    ).compile(T)
    assert filtered.sections
    assert prove_landing(filtered, Plant(T, 0.1, 1.0, 1.0)).proven
    joint = FlexiblePlant(0.1, 1.0, 1.0, share=0.2, frequency=60.0, loss=0.1)
    assert prove_landing(pd(200.0, 1.0), joint, T).proven
    rigid = FlexiblePlant(0.1, 1.0, 1.0)
    margins = [
        prove_landing(pd(800.0), one, T).margin
        for one in (rigid, Plant(T, 0.1, 1.0, 1.0))
    ]
    # one device by a matrix exponential, and by its series
    assert margins[0] == pytest.approx(margins[1], rel=1e-6)


def test_a_hand_that_holds_the_device_has_a_proof() -> None:
    assert prove_landing(pd(800.0), Plant(T, 0.1, 1.0, 1.0, 200.0)).proven


@pytest.mark.parametrize(
    ("law", "plant", "why"),
    [
        (pd(1260.0), Plant(T, 0.1, 1.0, 1.0), "unstable in contact"),
        (pd(3500.0), Plant(T, 0.1, 1.0), "no multiplier"),
        (pd(100.0), Plant(T, 0.1, 1.0).with_tool(0.2, 1.0), "two bodies"),
        (pd(100.0), Plant(T, 0.1, 0.0), "no damping"),
        (CompiledLaw((1.0, -2.0)), Plant(T, 0.1, 1.0), "pulls into the wall"),
        (
            CompiledLaw((100.0,), evaluate=lambda ring, head: ring[head]),
            Plant(T, 0.1, 1.0),
            "code of its own",
        ),
    ],
)
def test_without_a_proof_it_says_why(law: CompiledLaw, plant: Plant, why: str) -> None:
    found = prove_landing(law, plant)
    assert not found.proven
    assert why in found.why
    assert "no proof" in found.text()


def test_a_flexible_device_needs_its_period() -> None:
    with pytest.raises(ValueError, match="period"):
        prove_landing(pd(100.0), FlexiblePlant(0.1, 1.0))


@given(st.floats(-3.0, 3.0), st.floats(1e-8, 1e-3), st.integers(1, 2))
@settings(max_examples=60, deadline=None)
def test_a_sum_just_above_zero_is_proven_and_one_just_below_is_not(
    at: float, gap: float, power: int
) -> None:
    """((1 − cos(θ − a))(1 − cos(θ + a)))^p touches 0 between any grid's points."""
    touching = np.array([1.0])
    for _ in range(power):
        touching = np.convolve(touching, [0.5, -math.cos(at), 0.5])
    square = np.convolve(touching, touching)
    middle = len(square) // 2
    cosines = square[middle:] * np.where(np.arange(middle + 1), 2.0, 1.0)
    lifted, lowered = cosines.copy(), cosines.copy()
    lifted[0] += gap
    lowered[0] -= gap
    assert positive(lifted) is True
    assert positive(lowered) is False


@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=7), st.integers(-4, 3))
@settings(max_examples=60, deadline=None)
def test_cosine_sums_are_the_real_parts(coefficients: list[float], low: int) -> None:
    polynomial = Laurent(np.array(coefficients), low)
    theta: NDArray[Any] = np.linspace(0.1, np.pi, 17)
    at, w = polynomial.at(theta), np.exp(-1j * theta)
    # so many terms of at most 1, each rounded once or twice
    size = 1e-13 * len(coefficients)
    assert np.abs(values(polynomial.real(), theta) - at.real).max() < size
    assert (
        np.abs(
            values(polynomial.real_over_one_less_w(), theta) - (at / (1.0 - w)).real
        ).max()
        < 100.0 * size
    )
    assert np.abs(polynomial.conjugate.at(theta) - at.conj()).max() < size


@pytest.mark.parametrize("multiple", [1, 2, 5])
def test_one_less_cosine_is_the_quotient(multiple: int) -> None:
    theta = np.linspace(0.3, np.pi, 9)
    quotient = (1.0 - np.cos(multiple * theta)) / (1.0 - np.cos(theta))
    assert values(one_less_cosine(multiple), theta) == pytest.approx(
        quotient, rel=1e-12
    )


@pytest.mark.parametrize(
    ("words", "proven", "said"),
    [
        (
            ["pd", "--stiffness", "800", "--gain", "3"],
            True,
            "every drop settles: proven",
        ),
        (
            ["pd", "--stiffness", "3500", "--gain", "3"],
            False,
            "every drop settles: no proof",
        ),
        (
            ["--launch", "floor_drop", "designed_d0"],
            True,
            "this launch has penetration history, force clamped, which no proof",
        ),
        (
            ["--launch", "floor_drop", "designed_d0", "--heaviest", "0.3"],
            True,
            "every drop settles: proven",
        ),
    ],
)
def test_law_show_says_whether_there_is_a_proof(
    words: list[str], proven: bool, said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["law", "show", *words]) == 0
    assert said in capsys.readouterr().out
    assert main(["law", "show", *words, "--json"]) == 0
    assert (
        json.loads(capsys.readouterr().out.splitlines()[-1])["landing_proof"]["proven"]
        is proven
    )
