"""Factors of a law on a shape, regions of viscosity and attraction, their judgement."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from messages.types import Proxy
from nodes.base.setup import Effect
from nodes.coupling.felt_law import factored, felt_laws, trailing
from nodes.coupling.judgement import Judgement
from nodes.coupling.law_book import LawBook
from nodes.coupling.parameters import CouplingParameters
from nodes.coupling.renderer import ActiveLaw, Renderer
from nodes.environment.shapes.convex import gap
from nodes.environment.shapes.tables import ROW, ROWS
from nodes.environment.surfaces import parse_surface, surface_effects
from nodes.laws import CompiledLaw
from nodes.parameters.store import ParameterError, convert
from tests.support.touched import T, Touched

FINITE = st.floats(-5.0, 5.0)
BOX = {"kind": "box", "position": [0.0, 0.0, -0.05], "size": [0.1, 0.1, 0.1]}


def renderer(law: CompiledLaw) -> Renderer:
    made = Renderer([0], 64)
    active = ActiveLaw("one", "", law, made.histories)
    made.law = made.fallback = active
    return made


# taps, and one section with its poles inside the unit circle
LAWS = st.builds(
    lambda taps, b0, b1, r, c: CompiledLaw(
        tuple(taps), ((b0, b1, -2.0 * r * c, r * r),)
    ),
    st.lists(FINITE, min_size=1, max_size=6),
    FINITE,
    FINITE,
    st.floats(0.05, 0.95),
    st.floats(-1.0, 1.0),
)


@given(
    LAWS,
    st.floats(0.0, 1.0),
    st.floats(0.0, 1.0),
    st.lists(FINITE, min_size=1, max_size=20),
)
def test_the_law_that_is_judged_is_the_one_that_renders(
    law: CompiledLaw, stiffness: float, damping: float, path: list[float]
) -> None:
    """`factored` over a path, and the coupling with these factors in its proxies."""
    felt, same = renderer(law), renderer(factored(law, stiffness, damping))
    for seq, value in enumerate(path):
        place: dict[str, Any] = {
            "seq": seq,
            "stamp": 0.0,
            "position": (-value, 0.0, 0.0),
            "contact": True,
        }
        one = felt.render(
            Proxy(proxy=(0.0, 0.0, 0.0), stiffness=stiffness, damping=damping, **place)
        )
        two = same.render(Proxy(proxy=(0.0, 0.0, 0.0), **place))
        # H(1) of a section near z = 1 is large; all sums have below 100 terms.
        size = 1.0 + sum(map(abs, law.taps)) + abs(law.h1) + max(map(abs, two))
        assert one == pytest.approx(
            two, abs=100 * size * 5.0 * np.finfo(float).eps * 100
        )


@given(LAWS, st.floats(1e-4, 0.05))
def test_a_law_behind_a_trailing_proxy_has_the_product_of_both_responses(
    law: CompiledLaw, lag: float
) -> None:
    made = trailing(law, lag, T)
    rho = lag / (lag + T)
    q = np.exp(-1j * np.linspace(0.0, np.pi, 40))
    whole = law.response(1.0 / q) * rho * (1.0 - q) / (1.0 - rho * q)
    # Equal poles are moved apart by 1e-6; dividing by powers of ρ loses at most half of the digits.
    size = np.abs(law.response(1.0 / q)).max() + sum(map(abs, law.taps))
    assert made.response(1.0 / q) == pytest.approx(whole, abs=2e-4 * size)
    assert made.h1 == pytest.approx(0.0, abs=1e-6 * (1.0 + size))


def test_a_viscous_region_renders_the_damping_that_is_told() -> None:
    """At a steady speed the proxy trails by `time` times the speed; outside it does not."""
    felt = Touched(
        {
            "kind": "viscosity",
            "within": {"kind": "sphere", "radius": 0.05},
            "time": 0.01,
        }
    )
    speed, before = 0.1, felt.at((-0.06, 0.0, 0.0))
    assert not before[1]
    for k in range(1, 1200):
        x = -0.06 + speed * T * k
        deflection, is_felt = felt.at((x, 0.0, 0.0))
        if abs(x) < 0.04 and x > 0.0:
            # after 40 ms inside, four times the time: 1 − exp(−4·…)
            assert deflection == pytest.approx([-0.01 * speed, 0.0, 0.0], rel=1e-3)
            assert felt.met[3:7].tolist() == [0.0] * 4
        if x > 0.0501:
            assert not is_felt
    # No step is larger than its share of the way: it grows and fades within the band.
    (effect,) = surface_effects(
        {
            "kind": "viscosity",
            "within": {"kind": "sphere", "radius": 0.05},
            "time": 0.01,
        },
        "s",
    )
    assert effect == Effect(name="s", lag=0.01)


@example(2.6e-15, 0.0, 1.0)  # a pull below the least step
@given(st.floats(0.0, 0.02), st.floats(0.0, 2.0 * math.pi), st.floats(0.1, 1.0))
def test_a_line_attracts_as_a_spring_as_far_as_half_its_reach(
    away: float, angle: float, strength: float
) -> None:
    line = {
        "kind": "magnetic_line",
        "start": [-1, 0, 0],
        "end": [1, 0, 0],
        "reach": 0.01,
    }
    felt = Touched({**line, "stiffness": strength})
    place = (0.3, away * math.cos(angle), away * math.sin(angle))
    deflection, is_felt = felt.at(place)
    size = strength * max(min(away, 0.01 - away), 0.0)
    # A step below 1e-14 m counts as none.
    assert np.linalg.norm(deflection) == pytest.approx(size, abs=2e-14)
    assert is_felt or size < 2e-14
    if size > 1e-12:
        towards = [0.0, -math.cos(angle), -math.sin(angle)]
        assert deflection == pytest.approx(np.array(towards) * size, abs=1e-12)
    # Felt from all sides: nothing is clamped.
    assert felt.met[3:7].tolist() == [0.0] * 4 or not is_felt


def test_a_line_in_a_solid_pulls_the_device_to_its_surface_and_not_in() -> None:
    felt = Touched(
        {
            "kind": "union",
            "tool_radius": 0.0,
            "shapes": [
                BOX,
                {
                    "kind": "magnetic_line",
                    "start": [-1, 0, -0.002],
                    "end": [1, 0, -0.002],
                    "reach": 0.02,
                },
            ],
        }
    )
    deflection, is_felt = felt.at((0.0, 0.0, 0.003))
    assert is_felt
    assert felt.met[3:6].tolist() == [0.0, 0.0, 0.0]
    # The proxy rests on the top, 0.1 nm above it.
    assert deflection == pytest.approx([0.0, 0.0, -0.003], abs=2e-10)
    deflection, _ = felt.at((0.0, 0.0, -0.001))
    assert felt.met[3:6].tolist() == [0.0, 0.0, 1.0]
    assert felt.met[6] == pytest.approx(-0.001, abs=2e-10)


def test_factors_are_those_of_the_contacts_and_do_not_jump() -> None:
    """Slid from a hard to a soft tile at a rate of 1 in 50 ms; touched anew, at once."""
    felt = Touched(
        {
            "kind": "union",
            "shapes": [
                {**BOX, "position": [-0.05, 0, -0.05]},
                {**BOX, "position": [0.05, 0, -0.05], "stiffness": 0.2, "damping": 0.6},
            ],
        }
    )
    found = []
    for k in range(200):
        felt.at((-0.01 + 1e-4 * k, 0.0, 0.001 if k == 0 else -0.001))
        found.append((felt.met[9], felt.met[10]))
    assert found[50] == (1.0, 1.0)
    assert found[-1] == pytest.approx((0.2, 0.6), abs=1e-12)
    steps = np.abs(np.diff(found, axis=0))
    assert steps.max() == pytest.approx(T / 0.05, rel=1e-9)
    felt.at((0.01, 0.0, 0.01))
    felt.at((-0.01, 0.0, 0.01))
    felt.at((-0.01, 0.0, -0.001))
    assert (felt.met[9], felt.met[10]) == (1.0, 1.0)


PLANT = {"mass": 0.05, "damping": 0.05, "delay": 1.0}


def judged(
    law: dict[str, Any], effects: list[Effect]
) -> tuple[Judgement, CouplingParameters]:
    parameters = convert(
        {"law": "one", "laws": {"one": law}, "plant": PLANT, "stability": "refuse"},
        CouplingParameters,
        "coupling",
    )
    return Judgement("coupling", T, LawBook("coupling", T), effects), parameters


def test_a_law_is_judged_as_it_is_felt() -> None:
    """With a tick of delay a spring needs the law's damping: a factor of it alone is refused."""
    law = {"kind": "pd", "stiffness": 800.0, "damping": 3.0}
    for effect in (
        Effect(name="s[0]", stiffness=0.3, damping=0.3),
        Effect(name="s[1]", stiffness=0.3),
        Effect(name="s[2]", lag=0.002),
    ):
        judgement, parameters = judged(law, [effect])
        assert judgement.at_start(parameters, 1.0) == []
        (text,) = judgement.of_effects(parameters)
        assert text.startswith(f"{effect.name}: the law is felt with K ")
    assert (
        "K 240 N/m, B 0.9 N s/m"
        in judged(law, [Effect(name="a", stiffness=0.3, damping=0.3)])[0].of_effects(
            parameters
        )[0]
    )
    assert "K 0 N/m, B 1.6 N s/m" in text
    judgement, parameters = judged(
        law, [Effect(name="s[3]", stiffness=1.0, damping=0.05)]
    )
    with pytest.raises(
        ParameterError, match=r"pole radius 1\.0.*as it is felt at s\[3\].*law itself"
    ):
        judgement.at_start(parameters, 1.0)


def test_regions_that_overlap_are_judged_together() -> None:
    """Two lines that cross pull with twice the law; a law beyond half of its bound is refused."""
    line = {"kind": "magnetic_line", "reach": 0.01}
    lines = [
        {**line, "start": [-1, 0, 0], "end": [1, 0, 0]},
        {**line, "start": [0, -1, 0], "end": [0, 1, 0]},
        {**line, "start": [-1, 0, 0.5], "end": [1, 0, 0.5]},
    ]
    within = {"kind": "sphere", "position": [0.5, 0, 0], "radius": 0.1}
    ball = {"kind": "viscosity", "within": within, "time": 0.01}
    surface = {"kind": "union", "shapes": [*lines, ball]}
    effects = surface_effects(surface, "s")
    assert effects[4:] == [
        Effect(
            name="s.shapes[0] with s.shapes[1]", stiffness=2.0, damping=2.0, line=True
        ),
        Effect(name="s.shapes[0] with s.shapes[3]", lag=0.01, line=True),
    ]
    # It is what a device feels: above the crossing, both pull it down.
    felt = Touched(surface)
    deflection, _ = felt.at((0.0, 0.0, 0.003))
    assert deflection == pytest.approx([0.0, 0.0, -0.006], abs=1e-12)
    law = {"kind": "pd", "stiffness": 1500.0, "damping": 20.0}
    judgement, parameters = judged(law, effects[:4])
    assert judgement.at_start(parameters, 1.0) == []
    judgement, parameters = judged(law, effects)
    assert "K 3000 N/m" in judgement.of_effects(parameters)[4]
    assert "B 35 N s/m" in judgement.of_effects(parameters)[5]
    with pytest.raises(ParameterError, match=r"s.shapes\[0\] with s.shapes\[1\]"):
        judgement.at_start(parameters, 1.0)


@given(st.integers(0, 2**31))
def test_no_place_has_more_than_the_regions_that_are_judged_together(seed: int) -> None:
    """Sampled places of random regions against the sums of `surface_effects`."""
    random = np.random.default_rng(seed)
    shapes: list[dict[str, Any]] = []
    for _ in range(int(random.integers(2, 9))):
        a, b = random.uniform(-0.05, 0.05, (2, 3)).tolist()
        turn, size = (
            random.uniform(-3.0, 3.0, 3).tolist(),
            random.uniform(0.01, 0.06, 3).tolist(),
        )
        within: dict[str, Any] = [
            {"kind": "sphere", "position": a, "radius": size[0]},
            {"kind": "box", "position": a, "size": size, "rotation": turn},
            {"kind": "capsule", "start": a, "end": b, "radius": size[0]},
            {"kind": "cylinder", "start": a, "end": b, "radius": size[0]},
            {"kind": "oriented_plane", "position": a, "normal": b},
        ][random.integers(5)]
        shapes.append({"kind": "viscosity", "within": within, "time": 0.01})
    surface = {"kind": "union", "tool_radius": 0.0, "shapes": shapes}
    parsed = parse_surface(surface, "s")
    numbers = parsed.numbers(T)
    assert numbers is not None
    most = max(one.lag for one in parsed.effects("s"))
    for place in random.uniform(-0.08, 0.08, (20, 3)).tolist():
        acting = sum(
            gap(numbers.table, ROWS + ROW * n, *place)[0] < -1e-9
            for n in range(len(shapes))
        )
        assert 0.01 * acting <= most + 1e-12


@given(st.floats(0.05, 1.0), st.floats(0.05, 1.0))
def test_factors_of_a_plain_law_without_delay_stay_within_its_bound(
    a: float, b: float
) -> None:
    """Colgate and Schenkel: b > K T/2 + |B| holds for every part of a law that satisfies it."""
    from nodes.stability.judge import judge
    from nodes.stability.plant import Plant

    stiffness, damping = 800.0, 0.4
    law = CompiledLaw((stiffness + damping / T, -damping / T))
    plant = Plant(T, 0.1, 1.05 * (0.5 * stiffness * T + damping), 0.0)
    for effect in (
        Effect(name="", stiffness=a, damping=b),
        Effect(name="", stiffness=a, damping=a, lag=0.02 * b),
    ):
        for felt in felt_laws(law, effect, T):
            verdict = judge(felt, plant, effect.lag > 0.0)
            assert verdict is not None
            assert verdict.stable


@pytest.mark.parametrize(
    ("surface", "why"),
    [
        ({**BOX, "stiffness": 1.2}, "stiffness"),
        ({**BOX, "damping": -0.1}, "damping"),
        ({"kind": "viscosity", "within": {"kind": "free"}, "time": 1.0}, "within.kind"),
        (
            {"kind": "viscosity", "within": {**BOX, "friction": {}}, "time": 1.0},
            "within.friction",
        ),
        (
            {"kind": "magnetic_line", "start": [0, 0, 0], "end": [1, 0, 0], "reach": 0},
            "reach",
        ),
        (
            {"kind": "union", "shapes": [{"kind": "union", "shapes": [BOX]}]},
            "no shape that can be",
        ),
    ],
)
def test_what_cannot_be_felt_is_refused(surface: dict[str, Any], why: str) -> None:
    with pytest.raises(ParameterError, match=why):
        parse_surface(surface, "surface").check("surface")
