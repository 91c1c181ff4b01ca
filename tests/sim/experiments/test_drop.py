"""K_max by simulation against the exact pole radius, and the verdict on single runs."""

from __future__ import annotations

import cmath
import dataclasses
import itertools
import json
import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from nodes.cli.main import main
from nodes.laws import CompiledLaw, Law
from nodes.laws.multi_term import MultiTerm, Term
from nodes.laws.parse import parse_law
from nodes.laws.pd import PD
from nodes.laws.pd_alpha import PDAlpha
from nodes.stability.closed_loop import closed_loop, pole_radius
from nodes.stability.k_max import k_max, with_spring, without_spring
from nodes.stability.plant import Plant
from sim.device.hand import Hand
from sim.device.model import DeviceModel
from sim.experiments.drop import drop_scene, free_scene, press_scene
from sim.experiments.k_max_simulated import simulated_k_max, swing_frequency
from sim.experiments.settling import Criterion, settles

PERIOD = 0.002


def optimum(damping: float) -> MultiTerm:
    """Return the paper's optimum, A = [1.69, 1.32], α = [1.50, 3.47] (THEORY.md §2)."""
    terms = (Term(gain=1.69, order=1.50), Term(gain=1.32, order=3.47))
    return MultiTerm(stiffness=1.0, damping=damping, terms=terms, taps=4, gains="paper")


def pd_alpha(damping: float) -> PDAlpha:
    return PDAlpha(stiffness=1.0, damping=damping, order=1.5, taps=8, gains="paper")


def largest_pole_angle(law: CompiledLaw, model: DeviceModel) -> float:
    roots = np.roots(
        closed_loop(law, Plant(PERIOD, model.mass, model.damping, model.delay))
    ).tolist()
    return abs(cmath.phase(max(roots, key=abs)))


GRID = [
    (law, mass, damping, gain, delay)
    for law, mass, damping, gain, delay in itertools.product(
        (lambda B: PD(stiffness=1.0, damping=B), optimum, pd_alpha),
        (0.05, 0.2),
        (0.5, 2.0),
        (0.5, 2.0),
        (0.0, 1.0),
    )
]


@pytest.mark.parametrize(("law", "mass", "damping", "gain", "delay"), GRID)
def test_free_swing_ends_where_the_pole_radius_says(
    law: object, mass: float, damping: float, gain: float, delay: float
) -> None:
    assert callable(law)
    model = DeviceModel(mass=mass, damping=damping, delay=delay)
    derivative = without_spring(law(gain), PERIOD)
    criterion = Criterion(ticks=12000)
    found = simulated_k_max(
        lambda K: with_spring(derivative, K), free_scene(model, PERIOD), criterion
    )
    exact = k_max(derivative, Plant(PERIOD, mass, damping, delay))
    assert found.k_max_n_per_m is not None
    assert exact.k_max_n_per_m is not None
    assert found.k_max_n_per_m < exact.k_max_n_per_m
    # At the simulated limit the swing of 2·10 mm has decayed to 0.1 mm when the last quarter
    # begins: ρ^(9000) = 1/200 times the share of that mode in the start, which is between 1/4 and 4
    # for these laws.
    at_limit = with_spring(derivative, found.k_max_n_per_m)
    decay = 9000.0 * math.log(
        pole_radius(at_limit, Plant(PERIOD, mass, damping, delay))
    )
    assert decay == pytest.approx(math.log(1.0 / 200.0), abs=math.log(4.0))
    # And it swings with the angle of that pole; 20 crossings of a decaying sine are read to a part
    # in a thousand.
    assert found.frequency_hz is not None
    angle = largest_pole_angle(at_limit, model)
    assert found.frequency_hz == pytest.approx(
        angle / (2.0 * math.pi * PERIOD), rel=2e-3
    )


@pytest.mark.parametrize("delay", [0.0, 1.0, 0.4])
@pytest.mark.parametrize("law", [PD(stiffness=1.0, damping=2.0), optimum(2.0)])
def test_just_inside_and_just_outside(law: Law, delay: float) -> None:
    model = DeviceModel(mass=0.1, damping=1.0, delay=delay)
    derivative = without_spring(law, PERIOD)
    exact = k_max(derivative, Plant(PERIOD, 0.1, 1.0, delay)).k_max_n_per_m
    assert exact is not None
    inside, outside = (
        with_spring(derivative, exact * share) for share in (0.999, 1.001)
    )
    # A part in a thousand of K moves ln ρ by some 1e-5 here: 10⁶ ticks tell e^{−10} from e^{+10}.
    assert settles(
        free_scene(model, PERIOD), [inside, outside], Criterion(1_000_000)
    ) == [True, False]
    assert (
        pole_radius(inside, Plant(PERIOD, 0.1, 1.0, delay))
        < 1.0
        < pole_radius(outside, Plant(PERIOD, 0.1, 1.0, delay))
    )


@pytest.mark.parametrize(
    ("raw", "clamp"), [(False, True), (False, False), (True, True), (True, False)]
)
def test_drop_reads_most_of_the_linear_limit(raw: bool, clamp: bool) -> None:
    model = DeviceModel(mass=0.1, damping=1.0)
    for law in (PD(stiffness=1.0, damping=2.0), optimum(2.0)):
        derivative = without_spring(law, PERIOD)
        exact = k_max(derivative, Plant(PERIOD, 0.1, 1.0)).k_max_n_per_m
        scene = drop_scene(model, PERIOD, raw, clamp)
        found = simulated_k_max(lambda K, d=derivative: with_spring(d, K), scene)  # type: ignore[misc]
        assert exact is not None
        assert found.k_max_n_per_m is not None
        # THEORY.md §4: the drop test reads 70–99 % of the linear limit.
        assert 0.7 < found.k_max_n_per_m / exact < 0.99


def test_press_is_judged_with_the_hand_in_the_loop() -> None:
    model = DeviceModel(mass=0.045, damping=0.5)
    hand = Hand(mass=0.08, damping=2.0, stiffness=250.0, path=[(0.0, -0.01)])
    derivative = without_spring(PD(stiffness=1.0, damping=2.0), PERIOD)
    alone = simulated_k_max(
        lambda K: with_spring(derivative, K), press_scene(model, PERIOD, False, True)
    )
    held = simulated_k_max(
        lambda K: with_spring(derivative, K),
        press_scene(model, PERIOD, False, True, hand),
    )
    exact = k_max(derivative, Plant(PERIOD, 0.125, 2.5, 0.0, 250.0)).k_max_n_per_m
    assert exact is not None
    assert held.k_max_n_per_m is not None
    assert alone.k_max_n_per_m is not None
    assert 0.7 < held.k_max_n_per_m / exact < 0.99
    # More mass and damping in the hand: the same law bears more.
    assert held.k_max_n_per_m > 1.5 * alone.k_max_n_per_m


def test_bracket_is_as_narrow_as_asked() -> None:
    derivative = without_spring(PD(stiffness=1.0, damping=2.0), PERIOD)
    scene = drop_scene(DeviceModel(mass=0.1, damping=1.0), PERIOD, False, True)
    criterion = Criterion(2500)
    found = simulated_k_max(
        lambda K: with_spring(derivative, K), scene, criterion, precision=1e-6
    )
    assert found.k_max_n_per_m is not None
    assert found.unsettled_n_per_m is not None
    assert (
        0.0
        < found.unsettled_n_per_m - found.k_max_n_per_m
        <= 1e-6 * found.k_max_n_per_m
    )
    edge = [
        with_spring(derivative, K)
        for K in (found.k_max_n_per_m, found.unsettled_n_per_m)
    ]
    assert settles(scene, edge, criterion) == [True, False]


def test_divergence_that_ends_in_saturation_is_no_rest() -> None:
    # Far beyond its limit a motor of 7.9 N keeps the device bouncing by millimetres: bounded, but
    # never at rest.
    wild = PD(stiffness=20000.0, damping=2.0).compile(PERIOD)
    scene = drop_scene(
        DeviceModel(mass=0.1, damping=1.0, peak_force=7.9), PERIOD, False, True
    )
    assert settles(scene, [wild], Criterion()) == [False]
    # Held for so short a time that it hardly moves at all, it is the force at its limit, or the air
    # under it, that tells.
    brief = Criterion(8, tolerance=1.0)
    pressed = drop_scene(
        DeviceModel(mass=0.1, damping=1.0, peak_force=7.9),
        PERIOD,
        False,
        True,
        height=1e-9,
    )
    assert settles(pressed, [wild], brief) == [False]
    soft = PD(stiffness=2000.0, damping=2.0).compile(PERIOD)
    assert settles(pressed, [soft], brief) == [True]
    assert settles(dataclasses.replace(pressed, peak=0.2), [soft], brief) == [False]


def test_overflow_is_no_rest() -> None:
    scene = free_scene(DeviceModel(mass=0.1), PERIOD)
    assert settles(
        scene, [CompiledLaw((1e9, -1e9)), CompiledLaw((1e300, 1e300))], Criterion()
    ) == [False, False]


def test_no_stiffness_at_all_is_no_rest() -> None:
    # H(1) = 0 and H(1) < 0: a damper alone lets the mass sink, whatever it looks like over a short
    # time.
    scene = drop_scene(DeviceModel(mass=0.1, damping=1.0), PERIOD, False, True)
    assert settles(
        scene, [CompiledLaw((500.0, -500.0)), CompiledLaw((500.0, -510.0))], Criterion()
    ) == [False, False]


def test_ends_of_the_search() -> None:
    scene = free_scene(DeviceModel(mass=0.1, damping=1.0), PERIOD)
    derivative = without_spring(PD(stiffness=1.0, damping=2.0), PERIOD)
    none = simulated_k_max(lambda K: CompiledLaw((-K,)), scene)
    assert none.k_max_n_per_m is None
    every = simulated_k_max(
        lambda K: with_spring(derivative, K), scene, low=100.0, high=300.0
    )
    assert every.k_max_n_per_m == math.inf


def test_a_law_with_code_of_its_own_is_judged_by_the_same_rule() -> None:
    scene = drop_scene(DeviceModel(mass=0.1, damping=1.0), PERIOD, False, True)

    def nothing(ring: Sequence[float], head: int) -> float:
        return 0.0 * ring[head]

    # The same law compiled and interpreted: inside its limit and beyond.
    for stiffness in (600.0, 6000.0):
        law = PD(stiffness=stiffness, damping=3.0).compile(PERIOD)
        own = dataclasses.replace(law, evaluate=nothing)
        first, second = settles(scene, [law, own], Criterion(1500))
        assert first == second == (stiffness < 1000.0)


def test_frequency_of_a_sine() -> None:
    time = np.arange(1000) * PERIOD
    # Linear interpolation between 12 samples of a period misses by up to (ωT)²/8 of its phase; the
    # median averages it out.
    wave = 0.003 + 0.001 * np.sin(2.0 * math.pi * 41.7 * time)
    assert swing_frequency(wave, PERIOD, 0.003) == pytest.approx(41.7, rel=1e-3)
    assert swing_frequency(wave, PERIOD, 0.01) is None
    assert swing_frequency(np.full(1000, 0.003), PERIOD, 0.003) is None


@pytest.mark.parametrize(
    ("fields", "text"),
    [({"ticks": 4}, "ticks is 4"), ({"tolerance": 0.0}, r"tolerance is 0\.0")],
)
def test_wrong_criteria_are_refused(fields: dict[str, float], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Criterion(**fields)  # type: ignore[arg-type]


def test_study_presses_with_the_grip_it_is_given(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = (
        "study kmax --law pd --gain 3 --mass 0.1 --damping 1 --method simulation --scene press"
        " --json"
    )
    found = []
    for hand in (100.0, 4000.0):
        assert main([*words.split(), "--hand", str(hand)]) == 0
        found.append(
            json.loads(capsys.readouterr().out.splitlines()[-1])["k_max_n_per_m"]
        )
        exact = k_max(
            without_spring(PD(stiffness=1.0, damping=3.0), PERIOD),
            Plant(PERIOD, 0.1, 1.0, 0.0, hand),
        )
        assert exact.k_max_n_per_m is not None
        assert 0.7 < found[-1] / exact.k_max_n_per_m < 0.99
    # The hand's own spring is in the loop too: what it takes is not left for the wall.
    assert found[1] < found[0]
    # Where none is given one presses all the same, and is named.
    assert main(words.split()) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["k_max_n_per_m"] == found[0]
    assert "hand 100 N/m" in told["loop"]


def test_the_pages_simulated_limits_name_their_horizon() -> None:
    page = (Path(__file__).parents[3] / "sim" / "README.md").read_text(encoding="utf-8")
    rows = re.findall(
        r"^\| (?:`(\w+)` at 23 µm, )?(free swing|drop) in simulation, (\d+) s \| (\d+) \|"
        r" (\d+) \|$",
        page,
        re.M,
    )
    assert len(rows) == 4
    for kind, scene, horizon, *limits in rows:
        resolution = {"resolution": 2.3e-5} if kind else {}
        law = parse_law(
            {"kind": kind or "pd", "stiffness": 1.0, "damping": 3.0, **resolution}
        )
        derivative = without_spring(law, PERIOD)
        for delay, limit in zip((0.0, 1.0), map(float, limits), strict=True):
            model = DeviceModel(mass=0.1, damping=1.0, delay=delay)
            played = (
                drop_scene(model, PERIOD, False, True)
                if scene == "drop"
                else free_scene(model, PERIOD)
            )
            criterion = Criterion(ticks=round(float(horizon) / PERIOD))
            found = simulated_k_max(
                lambda K, d=derivative: with_spring(d, K),  # type: ignore[misc]
                played,
                criterion,
            )
            # The page rounds to whole N/m.
            assert found.k_max_n_per_m == pytest.approx(limit, abs=0.6)
