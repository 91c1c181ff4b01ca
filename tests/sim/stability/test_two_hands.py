"""Two devices, any two hands: the two-port condition against published limits and poles."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.laws.pd import PD
from sim.stability.two_hands import TwoHands, damping_share, k_max_two_hands
from tests.support.two_port import loop_radius

T = 0.002


def pd(stiffness: float, damping: float = 0.0) -> CompiledLaw:
    return PD(stiffness=stiffness, damping=damping).compile(T)


def middle(first: int, second: int, gain: float = 0.0) -> float | None:
    return k_max_two_hands(
        lambda k: TwoHands.in_the_middle(pd(k, gain), first, second), T, (1.0, 1.0)
    )


def law_each(there: int, back: int, gain: float = 0.0) -> float | None:
    def at(stiffness: float) -> TwoHands:
        law = pd(stiffness, gain)
        return TwoHands.law_each((law, law), there, back)

    return k_max_two_hands(at, T, (1.0, 1.0))


def quadratic(first: int, second: int) -> float:
    """Return the limit of a spring in the middle, from the condition at θ → 0.

    κ((1 + 2 d₁) + (1 + 2 d₂))/2 + κ² (d₁ − d₂)²/4 = 1 with κ = K T/b, of s_i → κ(½ + d_i).
    """
    linear, square = (
        0.5 * ((1 + 2 * first) + (1 + 2 * second)),
        0.25 * (first - second) ** 2,
    )
    if square == 0.0:
        return 1.0 / (T * linear)
    return (math.sqrt(linear * linear + 4.0 * square) - linear) / (2.0 * square * T)


@pytest.mark.parametrize(("first", "second"), [(0, 0), (0, 1), (1, 1), (0, 2), (3, 5)])
def test_a_spring_in_the_middle_bears_what_its_slow_end_bears(
    first: int, second: int
) -> None:
    # The condition is met first at θ → 0; the lowest frequency looked at is 1e-4, and rounding
    # there costs 1e-8.
    assert middle(first, second) == pytest.approx(quadratic(first, second), rel=1e-6)


@pytest.mark.parametrize(("there", "back"), [(0, 0), (1, 1), (0, 3), (5, 2)])
def test_a_spring_each_bears_more_than_one_in_the_middle_with_half_of_the_way_at_either_end(
    there: int, back: int
) -> None:
    # b/(T(1 + (a + c)/2)): of the matrix at θ → 0 for a symmetric damping.
    assert law_each(there, back) == pytest.approx(
        1.0 / (T * (1.0 + 0.5 * (there + back))), rel=1e-6
    )


def test_two_different_springs_are_passive_for_no_hands() -> None:
    coupling = TwoHands.law_each((pd(100.0), pd(100.1)), 1, 1)
    assert damping_share(coupling, T, (1.0, 1.0)) == math.inf


def _random_couplings(rng: np.random.Generator) -> TwoHands:
    kind = rng.integers(3)
    stiffness, gain = float(10 ** rng.uniform(1.0, 3.0)), float(rng.uniform(0.0, 0.4))
    law = [
        pd(stiffness, gain),
        parse_law(
            {
                "kind": "pd_alpha",
                "stiffness": stiffness,
                "damping": gain,
                "order": 0.6,
                "taps": 4,
                "gains": "paper",
            }
        ).compile(T),
        parse_law(
            {"kind": "fir", "taps": [stiffness, -0.2 * stiffness, -0.1 * stiffness]}
        ).compile(T),
    ][int(kind)]
    if rng.random() < 0.5:
        return TwoHands.in_the_middle(law, _delay(rng, 4), _delay(rng, 4))
    return TwoHands.law_each(
        (law, law), _delay(rng, 6), _delay(rng, 6), (_delay(rng, 2), _delay(rng, 2))
    )


def _delay(rng: np.random.Generator, most: int) -> float:
    return (
        float(rng.integers(most))
        if rng.random() < 0.5
        else float(rng.uniform(0.0, most))
    )


@pytest.mark.parametrize(
    "cases",
    [
        15,
        pytest.param(
            60,
            marks=pytest.mark.thorough("test_no_hands_make_what_is_passive_unstable"),
        ),
        pytest.param(1000, marks=pytest.mark.slow),
    ],
)
def test_no_hands_make_what_is_passive_unstable(cases: int) -> None:
    rng = np.random.default_rng(20261127)
    tried = 0
    while tried < cases:
        coupling = _random_couplings(rng)
        damping = (float(rng.uniform(0.3, 3.0)), float(rng.uniform(0.3, 3.0)))
        share = damping_share(coupling, T, damping)
        if not math.isfinite(share) or share <= 0.0:
            continue
        # At 0.99 of the damping: as tight as the claim is.
        for _ in range(30):
            damping = (damping[0] * share / 0.99, damping[1] * share / 0.99)
            share = damping_share(coupling, T, damping)
        # with fractions of a tick the share is not in proportion to 1/b
        if abs(share - 0.99) > 1e-6:
            continue
        tried += 1
        hands = tuple(
            (
                float(10 ** rng.uniform(-2.0, 0.5)),
                b + float(rng.choice([0.0, 1.0])),
                float(10 ** rng.uniform(-1.0, 4.0)),
            )
            for b in damping
        )
        # Without a spring anywhere both drift together: a pole at 1, which rounding moves by the
        # root of epsilon.
        assert loop_radius(coupling, hands) < 1.0 + 1e-8, (coupling, hands)


def test_beyond_the_edge_there_are_hands_that_swing() -> None:
    # Two heavy hands: the slow end, where the condition is met first.
    law = pd(1.05 * 166.666)
    coupling = TwoHands.in_the_middle(law, 1, 1)
    assert damping_share(coupling, T, (1.0, 1.0)) > 1.0
    assert loop_radius(coupling, ((30.0, 1.0, 1e-3), (30.0, 1.0, 1e-3))) > 1.0
    below = TwoHands.in_the_middle(pd(0.95 * 166.666), 1, 1)
    assert loop_radius(below, ((30.0, 1.0, 1e-3), (30.0, 1.0, 1e-3))) < 1.0
