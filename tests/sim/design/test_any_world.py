"""Designs for any hand and world: published limits, and random hands and worlds by poles."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.cli.main import main
from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.laws.presets import preset_names
from nodes.stability.plant import Plant, held_plant
from sim.design.any_world import keeps, stiffest_for_any_world, zeros_inside
from sim.design.any_world_families import (
    felt_stiffness,
    fractional_gain,
    stiffest_linear,
    stiffest_members,
    stiffest_one_pole,
    stiffest_pd,
    stiffest_pd_alpha,
    stiffest_taps,
    stiffness,
)
from sim.design.surroundings import Surroundings, behind_poles, over
from tests.support.launching import typed_in

T = 0.002
DELAYS = {
    "any_hand_d0": 0.0,
    "any_hand_d1": 1.0,
    "any_hand_d1_5": 1.5,
    "any_hand_d2": 2.0,
}


def any_hand(delay: float) -> Surroundings:
    return Surroundings(T, 1.0, (delay, delay), 1e4)


def device(delay: float) -> Surroundings:
    return Surroundings(T, 1.0, (delay, delay), 1e4, (0.1, 0.1))


def closed_radius(
    law: CompiledLaw, plant: Plant, world: tuple[float, float, float]
) -> float:
    """Return the pole radius of device, law and a mass-damper-spring world in the same tick.

    1 + H (P_d + Y) = 0 with Y = 1/(m s² + b s + k), s = (1 − w)/T: multiplied out, independently of
    the code.
    """
    held, (mass, damper, spring) = held_plant(plant), world
    below, above = (
        np.array(held.denominator),
        np.append(np.zeros(held.whole + 1), held.numerator),
    )
    s = np.array([1.0, -1.0]) / T
    yielding = (
        mass * np.convolve(s, s)
        + damper * np.append(s, 0.0)
        + spring * np.array([1.0, 0.0, 0.0])
    )
    top, bottom = np.array(law.taps), np.array([1.0])
    for b0, b1, a1, a2 in law.sections:
        own = np.array([1.0, a1, a2])
        top = np.polyadd(
            np.convolve(top, own)[::-1], np.convolve([b0, b1], bottom)[::-1]
        )[::-1]
        bottom = np.convolve(bottom, own)
    parts = [
        np.convolve(np.convolve(bottom, below), yielding),
        np.convolve(np.convolve(top, above), yielding),
        np.convolve(top, below),
    ]
    size = max(map(len, parts))
    # ascending powers of w
    total = sum(np.pad(part, (0, size - len(part))) for part in parts)
    return float(np.abs(np.roots(np.trim_zeros(np.asarray(total), "b"))).max())


def test_figures_at_one_tick_are_the_known_ones() -> None:
    """PD, PDα, the paper's optimum, five taps, one pole: from an independent programme in 1/H."""
    surroundings = any_hand(1.0)
    optimum = {"kind": "paper_optimum"}
    assert stiffness(stiffest_pd(surroundings)) == pytest.approx(384.9, abs=0.05)
    assert stiffness(
        stiffest_linear("paper_optimum", optimum, surroundings)
    ) == pytest.approx(445.7, abs=0.05)
    taps = stiffest_taps(surroundings, 5)
    assert stiffness(taps) == pytest.approx(469.4, abs=0.05)
    assert taps.design is not None
    # flat: the stiffness says little of it
    assert taps.design.h_nyquist_n_per_m == pytest.approx(1862.7, rel=2e-3)
    assert taps.design.bound_n_per_m == pytest.approx(469.43, abs=0.01)
    assert surroundings.limit == 500.0


def test_one_pole_is_the_stiffest_and_pays_in_noise() -> None:
    """K/(1 + ρ w): |H(−1)| ≤ 1e4 leaves 487.8 N/m (1/(1/500 + 1/20 000))."""
    poles = np.linspace(-0.91, -0.89, 21).tolist()
    found = [
        design
        for pole in poles
        if (
            design := stiffest_for_any_world(
                any_hand(1.0), np.eye(1), bottom=behind_poles(pole)
            )
        )
    ]
    best = max(found, key=lambda one: one.h1_n_per_m)
    assert best.h1_n_per_m == pytest.approx(487.8, abs=0.3)
    assert best.h_nyquist_n_per_m > 9000.0


@pytest.mark.parametrize(
    ("delay", "any_world", "any_hand_too"),
    [(0.0, 1.16, 1.0), (1.0, 1.085, 1.10), (2.0, 1.015, 1.16)],
)
@pytest.mark.slow
def test_what_a_fractional_term_buys(
    delay: float, any_world: float, any_hand_too: float
) -> None:
    for surroundings, bought in (
        (device(delay), any_world),
        (any_hand(delay), any_hand_too),
    ):
        gain = fractional_gain(
            [stiffest_pd(surroundings), stiffest_pd_alpha(surroundings, 4)]
        )
        assert gain == pytest.approx(bought, abs=0.006)


@pytest.mark.parametrize("delay", [0.0, 1.0, 2.0])
def test_closed_limit_is_reached_at_whole_delays_and_not_exceeded(delay: float) -> None:
    """H = (2b/T)/(1 + w + … + w^d) with poles moved inside by 1 %: d %/2 below, and proven."""
    order = int(delay)
    poles = np.exp(2j * np.pi * np.arange(1, order + 1) / (order + 1)) * 0.99
    below = np.atleast_1d(np.real(np.poly(poles)))
    limit = any_hand(delay).limit
    loud = Surroundings(T, 1.0, (delay, delay), 1e9)
    sections = ((1.0, 0.0, *np.append(below[1:], [0.0, 0.0])[:2].tolist()),)
    scale = limit * below.sum()
    for factor, kept in ((0.985, True), (1.001, False)):
        law = CompiledLaw(
            (0.0,),
            tuple((factor * scale * b0, b1, a1, a2) for b0, b1, a1, a2 in sections),
        )
        assert law.h1 == pytest.approx(factor * limit)
        assert keeps(loud, law) is kept


@pytest.mark.parametrize("name", DELAYS)
def test_preset_is_proven_as_shipped_and_little_below_the_design(name: str) -> None:
    surroundings, law = any_hand(DELAYS[name]), parse_law(name).compile(T)
    assert name in preset_names()
    assert keeps(surroundings, law)
    bigger = CompiledLaw(tuple(1.002 * tap for tap in law.taps))
    assert not keeps(surroundings, bigger)
    assert law.h1 > stiffness(stiffest_pd(surroundings)) * (
        1.2 if DELAYS[name] else 0.999
    )


@given(
    st.sampled_from(sorted(DELAYS)),
    st.floats(-3.0, 2.0),
    st.floats(-1.0, 5.0),
    st.tuples(st.floats(-5.0, 1.0), st.floats(-3.0, 2.0), st.floats(-1.0, 6.0)),
)
@settings(max_examples=150, deadline=None)
def test_no_hand_and_no_world_make_a_preset_unstable(
    name: str, mass: float, hand: float, world: tuple[float, float, float]
) -> None:
    """Mass, hand and world over decades; a pole at z = 1 (no support) is no swing."""
    law, plant = (
        parse_law(name).compile(T),
        Plant(T, 10.0**mass, 1.0, DELAYS[name], 10.0**hand),
    )
    m, b, k = (10.0**one for one in world)
    # A double root near z = 1 is found to the square root of the machine's epsilon.
    assert closed_radius(law, plant, (m, b, k)) < 1.0 + 1e-7


def test_beyond_the_edge_a_world_swings() -> None:
    """PD, B 3, stable at a wall to 3782 N/m, is unstable at 3400 with a 5.4 kN/m spring."""
    law = parse_law({"kind": "pd", "stiffness": 3400.0, "damping": 3.0}).compile(T)
    plant = Plant(T, 0.1, 1.0)
    assert closed_radius(law, plant, (0.0, 0.0, 5400.0)) > 1.0
    assert closed_radius(law, plant, (0.0, 0.0, 1e9)) < 1.0
    assert not keeps(device(0.0), law)


@pytest.mark.parametrize(
    ("law", "delay", "edge"),
    [
        ({"kind": "pd", "damping": 0.0}, 0.0, 1003.342),
        ({"kind": "pd", "damping": 3.0}, 0.0, 2244.217),
        ({"kind": "pd", "damping": 1.0}, 0.5, 914.523),
        ({"kind": "pd", "damping": 3.0}, 1.0, 960.354),
        ({"kind": "pd", "damping": 0.2}, 2.0, 214.781),
        (
            {
                "kind": "pd_alpha",
                "order": 0.5,
                "taps": 4,
                "damping": 0.5,
                "gains": "paper",
            },
            1.0,
            431.010,
        ),
    ],
)
def test_known_device_edges(law: dict[str, object], delay: float, edge: float) -> None:
    """K_max of a known device and any world, derived independently, with first-order worlds."""
    for factor, kept in ((0.9999, True), (1.0001, False)):
        assert (
            keeps(
                device(delay), parse_law({**law, "stiffness": factor * edge}).compile(T)
            )
            is kept
        )


@pytest.mark.parametrize(
    ("law", "delay", "edge"),
    [
        ({"kind": "pd", "damping": 0.0}, 0.5, 400.0),
        ({"kind": "pd", "damping": 0.2}, 0.0, 800.0),
        ({"kind": "pd", "damping": 0.2}, 0.5, 545.708),
        ({"kind": "pd", "damping": 0.2}, 2.0, 214.614),
        (
            {
                "kind": "pd_alpha",
                "order": 0.5,
                "taps": 4,
                "damping": 0.5,
                "gains": "paper",
            },
            1.0,
            157.544,
        ),
    ],
)
def test_any_hand_edges(law: dict[str, object], delay: float, edge: float) -> None:
    for factor, kept in ((0.9999, True), (1.0001, False)):
        assert (
            keeps(
                any_hand(delay),
                parse_law({**law, "stiffness": factor * edge}).compile(T),
            )
            is kept
        )


def test_a_range_of_delay_is_kept_all_through() -> None:
    wide = Surroundings(T, 1.0, (0.5, 1.5), 1e4)
    design = stiffest_for_any_world(wide, np.eye(3))
    assert design is not None
    assert design.proven
    for delay in np.linspace(0.5, 1.5, 11).tolist():
        assert keeps(any_hand(delay), design.law)


def test_known_device_is_stiffer_than_any_hand_and_kept_over_its_masses() -> None:
    surroundings = Surroundings(T, 1.0, (1.0, 1.0), 1e4, (0.05, 0.2))
    design = stiffest_for_any_world(surroundings, np.eye(2))
    assert design is not None
    assert design.proven
    assert design.h1_n_per_m > 2.0 * any_hand(1.0).limit
    assert abs(design.h_nyquist_n_per_m) <= 1e4


@given(
    st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=4),
    st.floats(-0.95, 0.95).filter(lambda pole: abs(pole) > 0.05),
)
@settings(max_examples=50, deadline=None)
def test_taps_over_a_pole_are_that_quotient(taps: list[float], pole: float) -> None:
    law, theta = over(np.array(taps), behind_poles(pole)), np.linspace(0.1, 3.0, 7)
    w = np.exp(-1j * theta)
    expected = sum(tap * w**m for m, tap in enumerate(taps)) / (1.0 - pole * w)
    # Division by the pole magnifies rounding by 1/|pole| a tap.
    assert law.response(1.0 / w) == pytest.approx(
        expected, rel=1e-7, abs=1e-12 * 1e3 / abs(pole) ** len(taps)
    )


@given(
    st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=5),
    st.floats(0.3, 0.95),
    st.floats(0.0, 3.1),
)
@settings(max_examples=50, deadline=None)
def test_taps_over_a_pair_of_poles_are_that_quotient(
    taps: list[float], radius: float, angle: float
) -> None:
    pole = radius * np.exp(1j * angle)
    bottom = behind_poles(pole, np.conj(pole))
    law, theta = over(np.array(taps), bottom), np.linspace(0.1, 3.0, 7)
    w = np.exp(-1j * theta)
    expected = sum(tap * w**m for m, tap in enumerate(taps)) / (
        (1.0 - pole * w) * (1.0 - np.conj(pole) * w)
    )
    assert law.response(1.0 / w) == pytest.approx(
        expected, rel=1e-7, abs=1e-9 / radius**10
    )
    assert law.stable_sections()


@pytest.mark.slow
def test_what_sections_buy_beyond_taps() -> None:
    """Up to 7 %: the limit is 2b/(T(1 + d)), and free taps come near it."""
    for delay, least, most in (
        (0.0, 1.0, 1.0001),
        (1.0, 1.03, 1.06),
        (1.5, 1.03, 1.05),
        (2.0, 1.06, 1.075),
    ):
        members = {
            member.family: member
            for member in stiffest_members(any_hand(delay), 6, sections=True)
        }
        limit = 2.0 * 1.0 / (T * (1.0 + delay))
        for member in members.values():
            assert stiffness(member) <= limit * (1.0 + 1e-9)
            assert member.design is not None
            assert member.design.proven
        # More taps or poles are never worse, as far as the search of the poles is right.
        assert stiffness(members["taps_over_pole"]) > 0.999 * stiffness(
            members["one_pole"]
        )
        assert stiffness(members["two_poles"]) > 0.99 * stiffness(members["one_pole"])
        best = max(stiffness(members[name]) for name in ("taps_over_pole", "two_poles"))
        assert least <= best / stiffness(members["taps"]) * (1.0 + 1e-6) <= most
        if delay == 1.5:
            assert stiffness(members["two_poles"]) == pytest.approx(limit, rel=1e-5)


@given(st.floats(50.0, 5e3), st.floats(-0.9, 5.0), st.floats(-0.95, 0.95))
@settings(max_examples=50, deadline=None)
def test_compliance_is_a_mean_of_the_real_part(
    static: float, zero: float, pole: float
) -> None:
    """1/H(1) = (T/2π) ∫ Re{V/H}/(1 − cos θ) dθ, for 1/H of one zero and one pole."""
    # The midpoint rule errs by pole^2048 for a periodic function.
    theta = (np.arange(2048) + 0.5) * np.pi / 2048
    w = np.exp(-1j * theta)
    inverse = (1.0 + zero * w) / (1.0 - pole * w) * (1.0 - pole) / (1.0 + zero) / static
    mean = float(np.mean(((1.0 - w) / T * inverse).real / (1.0 - np.cos(theta))))
    assert T * mean == pytest.approx(1.0 / static, rel=1e-9)


def test_a_slow_pole_adds_static_stiffness_to_a_known_device_without_bound() -> None:
    """24 kN/m where a wall allows PD 1252: proven for any world, and no random world swings."""
    rng = np.random.default_rng(4)
    fast = np.array([800.0 + 3.0 / T, -3.0 / T])
    for boost, kept in ((30.0, True), (1000.0, False)):
        pole = 0.9999
        law = over(
            np.convolve(fast, [1.0, -1.0 + boost * (1.0 - pole)]), behind_poles(pole)
        )
        assert law.h1 == pytest.approx(boost * 800.0, rel=1e-9)
        assert keeps(device(1.0), law, 1) is kept
        if kept:
            for _ in range(300):
                mass, damper, spring = (
                    float(10.0 ** rng.uniform(*e)) for e in ((-4, 1), (-3, 2), (0, 5))
                )
                world = mass, damper, spring
                assert closed_radius(law, Plant(T, 0.1, 1.0, 1.0), world) < 1.0
    # At 10 Hz the pole is not felt.
    slow = over(np.convolve(fast, [1.0, -0.997]), behind_poles(0.9999))
    plain = CompiledLaw(tuple(fast.tolist()))
    assert felt_stiffness(slow, T) == pytest.approx(felt_stiffness(plain, T), rel=0.02)
    assert not keeps(any_hand(1.0), slow)


@pytest.mark.slow
def test_what_sections_buy_a_known_device() -> None:
    """Static stiffness, and nothing at 10 Hz that free taps do not have."""
    members = {
        one.family: one for one in stiffest_members(device(1.0), 4, sections=True)
    }
    taps, slow = members["taps"].design, members["taps_over_pole"].design
    assert taps is not None
    assert slow is not None
    assert slow.proven
    assert slow.h1_n_per_m > 5.0 * taps.h1_n_per_m
    felt = [
        felt_stiffness(one.design.law, T)
        for name, one in members.items()
        if name in ("one_pole", "taps_over_pole", "two_poles")
        and one.design is not None
    ]
    assert max(felt) < 1.02 * felt_stiffness(taps.law, T)


@pytest.mark.parametrize("delay", [0.25, 0.5, 0.9, 1.1, 1.5, 1.75])
def test_a_section_reaches_the_limit_at_a_fraction_of_a_tick(delay: float) -> None:
    """(2b/T)/(1 + w + … + φ w^(i+1)), less 1e-6 of itself: proven, and 1e-6 more is not."""
    whole, fraction = int(delay), delay % 1.0
    bottom = np.array([*[1.0] * (whole + 1), fraction])
    damping = 0.7
    surroundings = Surroundings(T, damping, (delay, delay), 1e9)
    for share, kept in ((1.0 - 1e-6, True), (1.0 + 1e-6, False)):
        law = over(np.array([share * 2.0 * damping / T]), bottom)
        assert law.h1 == pytest.approx(share * surroundings.limit, rel=1e-12)
        assert keeps(surroundings, law) is kept
    # Its gain is bounded, unlike that of the same law at a whole delay.
    gain = np.abs(law.response(np.exp(1j * np.linspace(0.0, np.pi, 2001))))
    assert gain.max() < 11.0 * 2.0 * damping / T
    if delay == 1.5:
        assert gain.max() == pytest.approx(math.sqrt(8.0) * 2.0 * damping / T, rel=1e-4)


def test_a_zero_outside_is_seen() -> None:
    assert zeros_inside(CompiledLaw((2.0, -1.0)))
    assert not zeros_inside(CompiledLaw((1.0, -2.0)))


def test_without_damping_nothing_is_stable_for_any_world() -> None:
    with pytest.raises(ValueError, match="damping"):
        Surroundings(T, 0.0, (0.0, 0.0), 1e4)


@pytest.mark.slow
def test_command_designs_compares_and_writes_a_law(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    words = [
        "study",
        "design",
        "--for",
        "any_hand",
        "--taps",
        "4",
        "--json",
        "--out",
        str(tmp_path),
    ]
    assert main([*words, "--delay", "1"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["closed_limit_n_per_m"] == 500.0
    assert told["fractional_gain"] == pytest.approx(1.10, abs=0.006)
    assert max(law["h1_n_per_m"] for law in told["laws"]) < 500.0
    assert Path(told["yaml"]).is_file()
    assert all(law["proven"] for law in told["laws"])
    assert main([*words, "--radius", "0.9"]) == 2
    assert "--radius: no effect here" in capsys.readouterr().err
    assert main([*words, "--compare", "--delays", "0", "2"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert [case["closed_limit_n_per_m"] for case in told["cases"]] == pytest.approx(
        [1000.0, 1000.0 / 3.0]
    )
    assert Path(told["plot"]).is_file()


@pytest.mark.slow
def test_stiffest_one_pole_is_a_law_that_can_be_loaded() -> None:
    member = stiffest_one_pole(any_hand(1.0))
    assert member.law is not None
    assert member.design is not None
    assert parse_law(member.law).compile(T).h1 == pytest.approx(
        member.design.h1_n_per_m, rel=1e-12
    )


def test_the_study_asks_for_any_hand(tmp_path: Path) -> None:
    """Options without effect beside --for are refused by name."""
    done = typed_in(
        tmp_path,
        "study",
        "design",
        "--for",
        "any_hand",
        "--delay",
        "1",
        "--taps",
        "2",
        "--json",
    )
    # The closed limit 2 b/(T (1 + d)) of 1 N s/m at 500 Hz, one tick late.
    assert json.loads(done.stdout.splitlines()[-1])[
        "closed_limit_n_per_m"
    ] == pytest.approx(500.0)
    refused = typed_in(
        tmp_path, "study", "design", "--for", "any_hand", "--every-delay", code=2
    )
    assert "--every-delay: no effect here" in refused.stderr
