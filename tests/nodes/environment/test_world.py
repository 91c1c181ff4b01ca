"""A world of one body: its integrators, their passivity, and the loop against theory."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import expm

from messages.topics import DEVICE_STATE, FORCE, PROXY
from nodes.coupling.judgement import Judgement
from nodes.coupling.law_book import LawBook
from nodes.coupling.parameters import CouplingParameters
from nodes.environment.world.dynamics import INTEGRATORS, BodyMotion, Stepped, lag_of
from nodes.environment.world.node import FeltWorld, WorldParameters, check_world
from nodes.launcher import launch_file, scenario_files
from nodes.laws import CompiledLaw
from nodes.laws.parse import compile_law, parse_law
from nodes.parameters.store import ParameterError, convert
from nodes.recording.reader import Recording
from nodes.stability.closed_loop import pole_radius
from nodes.stability.k_max import with_spring, without_spring
from nodes.stability.plant import Plant
from nodes.stability.worst_world import worst_world
from sim.device.filters import filtered
from sim.play.player import play
from tests.support.launching import launch_json

PERIOD = 0.002
EPS = np.finfo(float).eps


def bilinear(polynomial: list[float], *fraction: list[float]) -> NDArray[np.float64]:
    """Put s = (2/T)(1 − w)/(1 + w) into one side of a fraction, times (1 + w) to its degree."""
    degree = max(map(len, fraction)) - 1
    found = np.zeros(degree + 1)
    for power, weight in enumerate(reversed(polynomial)):
        term = np.array([weight * (2.0 / PERIOD) ** power])
        for factor in [[1.0, -1.0]] * power + [[1.0, 1.0]] * (degree - power):
            term = np.convolve(term, factor)
        found += term
    return found


def moved(
    integrator: str,
    body: tuple[float, float, float],
    forces: np.ndarray,
    steps: int = 1,
) -> np.ndarray:
    """Return positions of a body under forces of the device, same tick included [m]."""
    motion: BodyMotion = INTEGRATORS[integrator](body, PERIOD, steps, (0.0, 0.0))
    found = []
    for force in forces.tolist():
        found.append(motion.free() - motion.compliance * force)
        if isinstance(motion, Stepped):
            motion.hand_over(force, 0.0)
        motion.close(force)
    return np.array(found)


@pytest.mark.parametrize(
    "body",
    [
        (0.01, 0.3, 400.0),
        (0.2, 0.0, 0.0),
        (0.0, 2.0, 500.0),
        (0.0, 3.0, 0.0),
        (0.05, 0.0, 900.0),
    ],
)
def test_implicit_and_trapezoidal_are_the_rules_of_these_names(
    body: tuple[float, float, float],
) -> None:
    """Against the admittance with both rules put in for s, as a recursive filter."""
    mass, damping, stiffness = body
    forces = np.random.default_rng(1).normal(size=400)
    # Velocity over force, s/(m s² + c s + k); then y = T u/(1 − w) of the bilinear u.
    top, below = [1.0, 0.0], [mass, damping, stiffness]
    while below[-1] == 0.0 and len(below) > 1 and top[-1] == 0.0:
        top, below = top[:-1], below[:-1]
    below = np.trim_zeros(np.array(below), "f").tolist()
    numerator, denominator = (bilinear(each, top, below) for each in (top, below))
    speed = filtered(numerator, denominator, -forces)
    found = moved("lossless", body, forces)
    size = np.abs(found).max()
    # 400 ticks of rounding
    assert found == pytest.approx(PERIOD * np.cumsum(speed), abs=1e-9 * size)
    # Backward Euler: s = (1 − w)/T in m s² + c s + k.
    d = np.array([1.0, -1.0]) / PERIOD
    rule = (
        mass * np.convolve(d, d)
        + damping * np.append(d, 0.0)
        + stiffness * np.array([1.0, 0.0, 0.0])
    )
    assert moved("implicit", body, forces) == pytest.approx(
        filtered([1.0], rule, -forces), abs=1e-9 * size
    )


@pytest.mark.parametrize("part", [0.0, 0.3, 1.0, 1.6])
def test_an_exact_body_is_the_matrix_exponential_of_the_force_that_is_held(
    part: float,
) -> None:
    """Forces `part` of a tick late, against scipy's expm over the pieces between."""
    mass, damping, stiffness = 0.03, 0.4, 700.0
    motion = INTEGRATORS["exact"]((mass, damping, stiffness), PERIOD, 1, (0.0, 0.0))
    assert isinstance(motion, Stepped)
    forces = np.random.default_rng(2).normal(size=60)
    state, whole, late = np.zeros(2), int(part), part - int(part)
    held = np.concatenate([np.zeros(whole + 1), forces])
    for k, force in enumerate(forces.tolist()):
        assert motion.free() == pytest.approx(state[0], rel=1e-9, abs=1e-15)
        motion.hand_over(force, part)
        motion.close(force)
        for value, duration in ((held[k], late), (held[k + 1], 1.0 - late)):
            matrix = np.array(
                [
                    [0.0, 1.0, 0.0],
                    [-stiffness / mass, -damping / mass, -value / mass],
                    [0.0, 0.0, 0.0],
                ]
            )
            state = (expm(matrix * duration * PERIOD) @ np.append(state, 1.0))[:2]


@pytest.mark.parametrize(
    ("integrator", "steps"),
    [
        ("implicit", 1),
        ("lossless", 1),
        ("semi_implicit", 1),
        ("semi_implicit", 4),
        ("exact", 1),
    ],
)
def test_the_lag_that_is_named_is_the_one_of_a_free_mass(
    integrator: str, steps: int
) -> None:
    """A pushed trapezoidal mass is at T² (k + ½)/m; others lag by the named ticks."""
    mass = 0.05
    way = -moved(integrator, (mass, 0.0, 0.0), np.array([1.0] + 9 * [0.0]), steps)
    lag = np.arange(5, 10) + 0.5 - way[5:] * mass / PERIOD**2
    assert lag == pytest.approx(lag_of(integrator, steps), abs=1e-9)


bodies = st.tuples(
    st.floats(0.0, 1.0), st.floats(0.0, 10.0), st.floats(0.0, 1e4)
).filter(lambda b: max(b) > 1e-3)


@settings(max_examples=60, deadline=None)
@given(
    bodies,
    st.sampled_from(["implicit", "lossless"]),
    st.integers(0, 2**32 - 1),
    st.booleans(),
)
def test_a_body_that_answers_in_the_same_tick_never_gives_out_energy(
    body: tuple[float, float, float], integrator: str, seed: int, resonant: bool
) -> None:
    """From rest: Σ F[k] (y[k−1] − y[k]) ≥ 0 at every tick, up to rounding."""
    rng = np.random.default_rng(seed)
    forces = rng.normal(size=200)
    if resonant:
        # Pushed against its own motion, as far as it is known before the tick: what draws most from
        # it.
        forces = np.sin(rng.uniform(0.0, math.pi) * np.arange(200)) * np.sign(
            rng.normal()
        )
    y = moved(integrator, body, forces)
    works = forces * -np.diff(y, prepend=0.0)
    assert np.all(
        np.cumsum(works) >= -200 * EPS * (np.cumsum(np.abs(forces)) * np.abs(y).max())
    )


@pytest.mark.parametrize("integrator", ["semi_implicit", "exact"])
def test_a_stepped_body_gives_out_energy_that_it_never_got(integrator: str) -> None:
    """Pushed and pulled back: the movement follows the second force, unpaid before."""
    y = moved(integrator, (0.05, 0.0, 0.0), np.array([1.0, -1.0]))
    assert float(np.sum(np.array([1.0, -1.0]) * -np.diff(y, prepend=0.0))) < -1e-6


def simulated(
    launch: Any, ticks: int, world: tuple[np.ndarray, np.ndarray], law: Any, late: int
) -> np.ndarray:
    """Return positions of a pushed device on an implicit world y = −(top/below)(w) F."""
    device = launch.nodes["driver"].parameters["device"]
    mass, damping = float(device["mass"]), float(device["damping"])
    tick = expm(
        PERIOD
        * np.array(
            [[0.0, 1.0, 0.0], [0.0, -damping / mass, 1.0 / mass], [0.0, 0.0, 0.0]]
        )
    )
    top, below = world[0] / world[1][0], world[1] / world[1][0]
    state, found = np.array([0.0, float(device["velocity"])]), []
    x, y, f = np.zeros(ticks + 8), np.zeros(ticks + 8), np.zeros(ticks + 8)
    sections = np.zeros((len(law.sections), 2))
    for k in range(8, ticks + 8):
        found.append(state[0])
        free = sum(-top[i] * f[k - i] for i in range(1, len(top))) - sum(
            below[i] * y[k - i] for i in range(1, len(below))
        )
        past = sum(law.taps[i] * x[k - i] for i in range(1, len(law.taps)))
        gain = law.taps[0]
        for (b0, b1, a1, a2), (y1, y2) in zip(law.sections, sections, strict=True):
            past += b1 * x[k - 1] - a1 * y1 - a2 * y2
            gain += b0
        # F = gain (y − p) + past, y = free − top₀ F.
        f[k] = (gain * (free - state[0]) + past) / (1.0 + gain * top[0])
        y[k] = free - top[0] * f[k]
        x[k] = y[k] - state[0]
        for i, (b0, b1, a1, a2) in enumerate(law.sections):
            sections[i] = (
                b0 * x[k] + b1 * x[k - 1] - a1 * sections[i, 0] - a2 * sections[i, 1],
                sections[i, 0],
            )
        state = tick[:2, :2] @ state + tick[:2, 2] * f[k - late]
    return np.array(found)


@pytest.mark.parametrize("integrator", ["implicit", "lossless"])
@pytest.mark.parametrize("law", ["pd", "filtered", "multi_term"])
@pytest.mark.parametrize("apply", ["on_arrival", "next_tick"])
def test_the_loop_solves_for_the_force_of_the_same_tick(
    integrator: str, law: str, apply: str
) -> None:
    """Taps and sections, with and without delay, against solving force and world together."""
    words = {
        "integrator": integrator,
        "body_mass": 0.004,
        "body_stiffness": 2000.0,
        "body_damping": 0.2,
        "law": law,
    }
    launch = launch_file.read(
        "world_edge", {**words, "stiffness": 600.0, "damping": 0.5, "apply": apply}
    )
    kind: dict[str, dict[str, Any]] = {
        "pd": {"kind": "pd"},
        "filtered": {"kind": "pd_filtered", "cutoff": 80.0},
        "multi_term": {"kind": "paper_optimum"},
    }
    compiled = compile_law(
        parse_law({**kind[law], "stiffness": 600.0, "damping": 0.5}), PERIOD
    )
    assert (law == "filtered") == bool(compiled.sections)
    d = np.array([1.0, -1.0])
    if integrator == "implicit":
        world = (
            np.array([1.0]),
            0.004 / PERIOD**2 * np.convolve(d, d)
            + 0.2 / PERIOD * np.append(d, 0.0)
            + [2000.0, 0.0, 0.0],
        )
    else:
        s, g = np.array([1.0, 1.0]), 0.5 * PERIOD
        parts = (
            0.004 / g * np.convolve(d, d),
            0.2 * np.convolve(d, s),
            2000.0 * g * np.convolve(s, s),
        )
        # u = (1 − w)(1 + w)/(…) F and y = T u/(1 − w).
        world = PERIOD * np.append(s, 0.0), np.sum(parts, axis=0)
    found = play(launch, ticks=300).position[:, 0]
    expected = simulated(launch, 300, world, compiled, int(apply == "next_tick"))
    # 300 ticks of rounding
    assert found == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def growth(launch: Any, ticks: int) -> float:
    """Return the growth of a swing per tick, from its peaks in the second and last quarter."""
    swing = np.abs(play(launch, ticks=ticks).position[:, 0]).reshape(4, -1).max(axis=1)
    return float((swing[3] / swing[1]) ** (2.0 / ticks))


def test_the_worst_world_of_pd_swings_above_the_edge_and_rests_below() -> None:
    """PD, B 3 N s/m, 0.1 kg, T 2 ms: 3781.87 N/m on a wall, 2244.22 on any passive world.

    The worst one is a spring by the trapezoidal rule: at the limit Re{D/H + D P} touches 0 at 16
    Hz, where its Im is that of 1844 N/m.
    """
    worst = {"body_stiffness": 1843.766, "integrator": "lossless"}
    for part, swings in ((0.995, False), (1.005, True)):
        found = growth(
            launch_file.read("world_edge", {"stiffness": part * 2244.217, **worst}),
            4000,
        )
        # 0.5 % from the edge the pole is 8e-5 from the circle; a swing that is read off peaks is
        # known to 1e-5.
        assert found == pytest.approx(1.0 + (8e-5 if swings else -8e-5), abs=1.5e-5)
    # A wall holds that stiffness, by far; so does a static spring above 1.6 times the edge, and not
    # at 3400 N/m.
    assert (
        growth(
            launch_file.read(
                "world_edge", {"stiffness": 3400.0, "body_stiffness": 1e9}
            ),
            4000,
        )
        < 0.9999
    )
    assert (
        growth(
            launch_file.read(
                "world_edge", {"stiffness": 3400.0, "body_stiffness": 5400.0}
            ),
            4000,
        )
        > 1.0001
    )


@pytest.mark.process
@pytest.mark.parametrize(
    ("words", "tick"),
    [
        (("integrator:=lossless", "law:=filtered", "apply:=next_tick"), "compiled"),
        pytest.param(
            ("integrator:=implicit", "law:=multi_term"), "plain", marks=pytest.mark.slow
        ),
        pytest.param(
            ("integrator:=semi_implicit", "steps:=3"),
            "compiled",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            ("integrator:=exact", "law:=pd_alpha", "apply:=next_tick"),
            "compiled",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_a_launch_gives_the_bits_of_one_process(
    words: tuple[str, ...], tick: str, tmp_path: Path
) -> None:
    figures = launch_json(
        tmp_path,
        "world_feel",
        "pace:=lockstep",
        "duration:=1.2",
        *words,
        "--tick",
        tick,
    )
    assert figures["tick_by_node"]["coupling"] == tick
    recording = Recording(tmp_path / figures["recording"])
    states, proxies, forces = (
        recording.messages(topic) for topic in (DEVICE_STATE, PROXY, FORCE)
    )
    alone = play(
        launch_file.read(
            "world_feel", scenario_files.parse_assignments(["pace:=lockstep", *words])
        ),
        ticks=figures["ticks"],
    )
    assert np.array_equal(alone.measured, [state.position for state in states[:-1]])
    assert np.array_equal(alone.proxy, [proxy.proxy for proxy in proxies[:-1]])
    assert np.array_equal(alone.force, [force.force for force in forces[:-1]])
    assert np.abs(alone.force).max() > 0.1
    assert (proxies[5].compliance > 0.0) == (
        "integrator:=lossless" in words or "integrator:=implicit" in words
    )


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({}, "environment: a force of 0 N moves this body by 1 m"),
        ({"mass": 1e-12}, "expected at least 0.001 N; raise environment.mass"),
        (
            {"stiffness": 100.0, "integrator": "exact"},
            r"environment.mass: 0 kg, expected at least 1e-06 kg for integrator exact",
        ),
        (
            {"mass": 0.001, "stiffness": 1e4, "integrator": "semi_implicit"},
            "environment.steps: 1 .* expected at least 4",
        ),
    ],
)
def test_a_body_that_cannot_be_moved_is_refused(
    fields: dict[str, Any], told: str
) -> None:
    with pytest.raises(ParameterError, match=told):
        check_world(WorldParameters(**fields), PERIOD, "environment")


def test_the_sub_steps_that_a_refusal_asks_for_are_enough_and_one_less_is_not() -> None:
    """A pushed body stays bounded with 4 sub-steps, and grows with 3."""
    body: dict[str, Any] = {
        "mass": 0.001,
        "stiffness": 1e4,
        "integrator": "semi_implicit",
    }
    check_world(WorldParameters(**body, steps=4), PERIOD, "environment")
    push = np.array([1.0] + 20 * [0.0])
    far = [
        np.abs(moved("semi_implicit", (0.001, 0.0, 1e4), push, steps)).max()
        for steps in (4, 3)
    ]
    assert far[0] < 1e-3
    assert far[1] > 1e3 * far[0]


def test_other_parameters_leave_the_body_where_it_is_and_ticks_that_were_lost_are_made_up_for() -> (
    None
):
    zero = (0.0, 0.0, 0.0)
    for integrator in INTEGRATORS:
        fields: dict[str, Any] = {
            "mass": 0.1,
            "stiffness": 50.0,
            "damping": 1.0,
            "integrator": integrator,
        }
        world = FeltWorld(WorldParameters(**fields), PERIOD, ["x"])
        world.follow(0, (0.01, 0.02, 0.0), zero, -1, 0.0)
        for tick in range(1, 50):
            at = world.follow(tick, zero, (2.0, 0.0, 0.0), tick - 1, 0.0)
        assert at.proxy[1:] == zero[1:]  # no motion along axes that are not computed
        before, speed = world._motions[0].state()
        world.set(WorldParameters(**{**fields, "stiffness": 100.0}))
        assert world._motions[0].state() == pytest.approx((before, speed), rel=1e-12)
        # 20 ticks at once, and one by one: the same force was on the device meanwhile.
        other = FeltWorld(WorldParameters(**fields), PERIOD, ["x"])
        other.follow(0, (0.01, 0.02, 0.0), zero, -1, 0.0)
        other.follow(29, zero, (2.0, 0.0, 0.0), 0, 0.0)
        at_once = other.follow(49, zero, (2.0, 0.0, 0.0), 48, 0.0)
        assert at_once.proxy[0] == pytest.approx(at.proxy[0], rel=1e-9)
        # After a second without a state it goes on for a tenth of it.
        gone = FeltWorld(
            WorldParameters(**{**fields, "stiffness": 0.0, "damping": 1e-9}),
            PERIOD,
            ["x"],
        )
        gone.follow(0, zero, zero, -1, 0.0)
        gone.follow(1, zero, (1.0, 0.0, 0.0), 0, 0.0)
        start = gone.follow(2, zero, zero, 1, 0.0).proxy[0]
        after = gone.follow(502, zero, zero, 1, 0.0).proxy[0]
        assert after - start == pytest.approx(-0.1 * PERIOD / 0.1, rel=1e-6)


def test_a_launch_is_judged_on_the_body_that_it_couples_to() -> None:
    """20 g on 170 N/m, PD with B 0 and 300 N/m: it swings; a wall allows 1003 N/m."""
    words = {
        "body_mass": 0.02,
        "body_stiffness": 170.0,
        "integrator": "exact",
        "stiffness": 300.0,
        "damping": 0.0,
    }
    launch = launch_file.read("world_edge", words)
    coupling = convert(
        launch.nodes["coupling"].parameters, CouplingParameters, "coupling"
    )
    assert coupling.plant is not None
    radius = pole_radius(CompiledLaw((300.0,)), coupling.plant.at(PERIOD, 0.0))
    assert radius > 1.01
    # Of the swing that the launch plays, once it is nothing but that: a window of 200 ticks ends
    # within 5 % of a peak.
    swing = np.abs(play(launch, ticks=800).position[:, 0])
    peaks = swing[400:600].max(), swing[600:].max()
    assert (peaks[1] / peaks[0]) ** (1.0 / 200.0) == pytest.approx(radius, abs=3e-4)
    judgement = Judgement("coupling", PERIOD, LawBook("coupling", PERIOD))
    assert (
        "a stepped tool without damping to the ground"
        in judgement.of_moving_world(coupling, 0.0)[0]
    )
    # A body that answers in the same tick is one of all of them; on a wall the same law is stable.
    launch = launch_file.read("world_edge", {"stiffness": 2244.0})
    coupling = convert(
        launch.nodes["coupling"].parameters, CouplingParameters, "coupling"
    )
    assert coupling.plant is not None
    assert coupling.plant.at(PERIOD, 0.0).partner is None
    assert judgement.of_moving_world(coupling, 0.0)[0].startswith(
        "coupling.laws.pd: certified with any passive world"
    )
    launch = launch_file.read("world_edge", {"stiffness": 2245.0})
    coupling = convert(
        launch.nodes["coupling"].parameters, CouplingParameters, "coupling"
    )
    assert judgement.of_moving_world(coupling, 0.0)[0].startswith(
        "coupling.laws.pd: not certified with any passive world"
    )


LAWS: dict[str, dict[str, Any]] = {
    "pd": {"kind": "pd", "stiffness": 1.0, "damping": 3.0},
    "pd_alpha": {
        "kind": "pd_alpha",
        "stiffness": 1.0,
        "damping": 0.5,
        "order": 0.5,
        "taps": 3,
        "gains": "paper",
    },
    "multi_term": {"kind": "paper_optimum", "stiffness": 1.0, "damping": 1.0},
    "designed": {"kind": "designed_d0"},
}


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("apply", ["on_arrival", "next_tick"])
def test_real_launches_swing_one_percent_above_the_edge_and_rest_one_percent_below(
    law: str, apply: str, tmp_path: Path
) -> None:
    """The worst body for worlds answering in the same tick, on real nodes."""
    derivative = without_spring(parse_law(LAWS[law]), PERIOD)
    worst = worst_world(
        derivative, Plant(PERIOD, 0.1, 1.0, float(apply == "next_tick"))
    )
    assert worst is not None
    assert worst.stiffness_n_per_m is not None
    body = (
        f"body_stiffness:={worst.stiffness_n_per_m!r}",
        "integrator:=lossless",
        f"apply:={apply}",
    )
    found = []
    for part in (0.99, 1.01):
        stiffness = part * worst.k_max_n_per_m
        words = [
            f"law:={law}",
            f"stiffness:={stiffness!r}",
            f"damping:={LAWS[law].get('damping', 1.0)!r}",
        ]
        if law == "designed":
            taps = list(with_spring(derivative, stiffness).taps)
            path = tmp_path / "designed.yaml"
            laws = {"designed": {"kind": "fir", "taps": taps, "period": PERIOD}}
            path.write_text(json.dumps({"coupling": {"laws": laws}}), encoding="utf-8")
            words += ["--params", str(path)]
        figures = launch_json(
            tmp_path, "world_edge", "pace:=lockstep", "duration:=12", *body, *words
        )
        states = Recording(tmp_path / figures["recording"]).messages(DEVICE_STATE)[
            1:6001
        ]
        swing = (
            np.abs([state.position[0] for state in states]).reshape(4, -1).max(axis=1)
        )
        found.append(float((swing[3] / swing[1]) ** (1.0 / 3000)))
        if law == "pd_alpha":
            assert compile_law(
                parse_law({**LAWS[law], "stiffness": stiffness}), PERIOD
            ) == with_spring(derivative, stiffness)
    # One percent is 1e-5 to 2e-4 of the pole: read off peaks it is known to 1e-6 over so many
    # ticks.
    assert found[0] < 1.0 - 5e-6
    assert found[1] > 1.0 + 5e-6
