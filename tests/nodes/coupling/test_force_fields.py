"""Force fields by formula: closed forms, the judgement against simulation, errors."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from messages.types import Proxy
from nodes.coupling.field_judgement import resistance_of
from nodes.coupling.force_fields import ForceField, begin_field
from nodes.coupling.judgement import Judgement, StartAnyway
from nodes.coupling.law_book import LawBook
from nodes.coupling.parameters import CouplingParameters
from nodes.coupling.renderer import ActiveLaw, Renderer
from nodes.launcher import launch_file
from nodes.laws import CompiledLaw
from nodes.parameters.store import ParameterError, convert
from nodes.stability.field_loop import field_matrix, judge_in_field
from nodes.stability.plant import Plant, held_step
from sim.play.player import play
from tests.support import ROOT
from tests.support.touched import T

PD = CompiledLaw((1000.0 + 3.0 / T, -3.0 / T))
NUMBER = st.floats(-20.0, 20.0)
TRIPLE = st.tuples(NUMBER, NUMBER, NUMBER)
B = 13.0
EPS = float(np.finfo(float).eps)


def made(data: dict[str, Any]) -> ForceField:
    found: ForceField = convert(data, ForceField, "field")
    return found


def renderer(field: dict[str, Any], law: CompiledLaw = PD) -> Renderer:
    found = Renderer([0, 1, 2], 64)
    active = ActiveLaw("one", "", law, found.histories)
    found.law = found.fallback = active
    begin_field(found.state, made(field), T)
    return found


def proxy(seq: int, at: Any, rebased: int = -1) -> Proxy:
    return Proxy(
        seq=seq, stamp=0.0, position=tuple(at), proxy=tuple(at), rebased=rebased
    )


FORMULAS: list[tuple[dict[str, Any], Any, Any]] = [
    ({"kind": "none", "gain": B}, np.zeros((3, 3)), np.zeros(3)),
    ({"kind": "viscous", "gain": B}, -B * np.eye(3), np.zeros(3)),
    (
        {"kind": "viscous", "gains": [1.0, 2.0, -3.0]},
        -np.diag([1.0, 2, -3]),
        np.zeros(3),
    ),
    # Shadmehr and Mussa-Ivaldi 1994: B [[0, 1], [-1, 0]] in the plane
    (
        {"kind": "curl", "gain": B},
        np.array([[0.0, B, 0.0], [-B, 0.0, 0.0], [0.0, 0.0, 0.0]]),
        np.zeros(3),
    ),
    (
        {"kind": "curl", "gain": B, "plane": "zx"},
        np.array([[0.0, 0.0, -B], [0.0, 0.0, 0.0], [B, 0.0, 0.0]]),
        np.zeros(3),
    ),
    ({"kind": "constant", "force": [1.0, 2.0, 3.0]}, np.zeros((3, 3)), [1.0, 2.0, 3.0]),
    (
        # the field of their figures
        {"kind": "linear", "matrix": [[-10.1, -11.2, 0], [-11.2, 11.1, 0], [0, 0, 0]]},
        np.array([[-10.1, -11.2, 0.0], [-11.2, 11.1, 0.0], [0.0, 0.0, 0.0]]),
        np.zeros(3),
    ),
]


@given(
    kind=st.sampled_from(FORMULAS),
    velocity=TRIPLE,
    at=TRIPLE,
    missing=st.integers(0, 3),
)
def test_the_force_is_the_formula_of_the_velocity(
    kind: Any, velocity: Any, at: Any, missing: int
) -> None:
    """Also over missing ticks, and if a tick is rendered twice."""
    field, matrix, force = kind
    found = renderer(field)
    velocity, at = np.array(velocity), np.array(at)
    first = found.render(proxy(0, at))
    assert first == pytest.approx(force)  # no velocity is known yet
    second = proxy(1 + missing, at + velocity * T * (1 + missing))
    if missing:
        found.bridge(second, missing)
    got = found.render(second)
    # the difference of two positions of 20 m, over T
    rounding = 8.0 * EPS * np.abs(matrix).sum() * (np.abs(at).max() + 1.0) / T
    assert got == pytest.approx(matrix @ velocity + force, abs=rounding + 1e-12)
    assert found.fall_back(second) == got


def test_a_jump_of_the_position_is_no_velocity() -> None:
    found = renderer({"kind": "viscous", "gain": B})
    for seq in range(3):
        place = proxy(seq, [0.001 * seq, 0.0, 0.0])
        found.follow(place, seq - 1)
        found.state.ease_ramp = 0
        before = found.render(place)
    jumped = proxy(3, [0.5, 0.0, 0.0], rebased=3)
    found.follow(jumped, 2)
    found.state.ease_ramp = 0
    assert found.render(jumped) == before == pytest.approx((-B * 0.001 / T, 0.0, 0.0))
    assert found.render(proxy(4, [0.502, 0, 0]))[0] == pytest.approx(-B * 0.002 / T)


def grows(
    law: CompiledLaw,
    plant: Plant,
    resistance: NDArray[np.float64],
    weight: NDArray[np.float64],
) -> float:
    """Return the growth per tick of a loop of several axes, simulated.

    `weight`: I where the law acts on all axes, 0 in free motion, n nᵀ on a surface.
    """
    n, ticks, far = len(resistance), 2000, len(law.taps) + 1
    whole, (a11, a12, a21, a22), new, old = held_step(plant)
    x, v, sizes = np.zeros(n), np.random.default_rng(1).normal(size=n), []
    past = [np.zeros(n)] * far
    forces = [np.zeros(n)] * (whole + 2)
    sections = [[np.zeros(n), np.zeros(n)] for _ in law.sections]
    for tick in range(ticks):
        past = [x, *past[:-1]]
        force = sum(h * weight @ p for h, p in zip(law.taps, past, strict=False))
        for (b0, b1, a1, a2), y in zip(law.sections, sections, strict=True):
            out = weight @ (b0 * past[0] + b1 * past[1]) - a1 * y[0] - a2 * y[1]
            y[:] = [out, y[0]]
            force = force + out
        forces = [
            -force - resistance @ (past[0] - past[1]) / plant.period,
            *forces[:-1],
        ]
        recent, older = forces[whole], forces[whole + 1]
        if not plant.anchored:  # a place that no spring holds does not matter
            loose = x - weight @ x
            past = [one - loose for one in past]
            x = x - loose
        x, v = (
            a11 * x + a12 * v + new[0] * recent + old[0] * older,
            a21 * x + a22 * v + new[1] * recent + old[1] * older,
        )
        size = np.linalg.norm([*(x - past[0]), *(v * plant.period)])
        sizes.append(np.log(size))
        if tick % 50 == 49:  # linear: scaled, so that nothing overflows or vanishes
            x, v, *rest = (one / size for one in (x, v, *past, *forces))
            past, forces = rest[:far], rest[far:]
            sections = [[y / size for y in pair] for pair in sections]
    scaled = np.cumsum(sizes[49::50])
    return float(np.exp((scaled[-1] - scaled[19]) / (50 * (len(scaled) - 20))))


@pytest.mark.parametrize("seed", range(5))
def test_the_pole_radius_is_the_growth_of_a_simulation(seed: int) -> None:
    """Random fields, laws, delays and normals; free, held and on a surface."""
    draw = np.random.default_rng(seed)
    n = int(draw.integers(1, 4))
    plant = Plant(
        T, draw.uniform(0.05, 1.0), draw.uniform(0.1, 5.0), draw.choice([0.0, 0.4, 1.3]),
        draw.choice([0.0, 200.0]),
    )  # fmt: skip
    size = draw.uniform(0.2, 1.0) * plant.mass / T
    resistance = draw.uniform(-0.3, 1.0, (n, n)) * size
    pole = draw.uniform(0.1, 0.8)
    sections = ((draw.uniform(0, 200.0), 0.0, -pole, 0.0),) if seed % 3 == 0 else ()
    law = CompiledLaw(PD.taps, sections)
    normal = np.linalg.qr(draw.normal(size=(n, n)))[0]
    for touched, weight in (
        ((False,) * n, np.zeros((n, n))),
        ((True,) * n, np.eye(n)),
        ((True, *(False,) * (n - 1)), np.outer(normal[:, 0], normal[:, 0])),
    ):
        along = normal.T @ resistance @ normal
        step = field_matrix(law, plant, touched, along)
        radius = np.abs(np.linalg.eigvals(step)).max()
        # Growth over n ticks of the largest pole: a few beats of a pair, 1/(n ticks).
        assert grows(law, plant, resistance, weight) == pytest.approx(radius, rel=3e-3)


@pytest.mark.parametrize("axes", [2, 3])
def test_a_shear_is_judged_on_the_surface_where_it_drives_most(axes: int) -> None:
    """F = a (e₂·v) e₁ drives along the diagonal with a/2: neutral at a = 2b, however turned."""
    draw = np.random.default_rng(5)
    plant = Plant(T, 0.3, 2.0)
    for _ in range(4):
        turned = np.linalg.qr(draw.normal(size=(axes, axes)))[0]
        neutral = 2.0 * plant.damping * np.outer(turned[0], turned[1])
        for share, stable in ((0.999, True), (1.001, False)):
            found = judge_in_field(PD, plant, -share * neutral)
            assert found is not None
            assert found.stable is stable


def test_on_one_axis_and_alone_it_is_the_loop_with_a_damper_of_the_field() -> None:
    from nodes.coupling.felt_law import added
    from nodes.stability.judge import judge

    damper = CompiledLaw((B / T, -B / T))
    for plant in (Plant(T, 0.1, 1.0, 0.3), Plant(T, 0.1, 1.0, 1.0, 300.0)):
        one = judge(added(PD, damper), plant)
        step = field_matrix(PD, plant, (True,), np.array([[B]]))
        assert one is not None
        # equal polynomials; eigenvalues of small, simple poles
        assert np.abs(np.linalg.eigvals(step)).max() == pytest.approx(
            one.pole_radius, rel=1e-9
        )


def judged(field: dict[str, Any], **more: Any) -> tuple[Judgement, CouplingParameters]:
    parameters: CouplingParameters = convert(
        {
            "law": "pd",
            "laws": {"pd": {"kind": "pd", "stiffness": 1000.0, "damping": 3.0}},
            "plant": {"mass": 0.1, "damping": 1.0, **more},
            "field": field,
        },
        CouplingParameters,
        "coupling",
    )
    book = LawBook("coupling", T)
    return Judgement("coupling", T, book, axes=("x", "y")), parameters


def edge(kind: str, plant: Plant) -> float:
    """Return the largest gain of a field at which all motions decay [N s/m]."""
    unit = resistance_of(made({"kind": kind, "gain": 1.0}), ("x", "y"))
    low, high = 0.0, 1e4
    for _ in range(40):
        middle = 0.5 * (low + high)
        found = judge_in_field(PD, plant, middle * unit)
        assert found is not None
        low, high = (middle, high) if found.stable else (low, middle)
    return low


@pytest.mark.parametrize("kind", ["curl", "viscous"])
def test_at_the_edge_a_played_device_settles_below_and_grows_above(kind: str) -> None:
    """The nodes themselves, in one process, on both sides of the predicted edge."""
    plant = Plant(1e-3, 0.3, 2.0)
    at = edge(kind, plant)
    assert edge("curl", plant) < 0.1 * edge("viscous", plant)

    def speed(gain: float) -> NDArray[np.float64]:
        device = {"mass": 0.3, "damping": 2.0, "velocity": 1e-3, "hand": None}
        launch = launch_file.read(
            "reach",
            {"field": kind, "gain": gain, "driver.device": device, "duration": 1.0},
        )
        return np.asarray(np.linalg.norm(play(launch).velocity, axis=1))

    assert speed(0.98 * at)[100:].max() < 1e-3
    assert speed(1.02 * at).max() > 1.2e-3


def test_an_unstable_field_is_refused_with_the_part_that_is_accepted() -> None:
    judgement, parameters = judged({"kind": "curl", "gain": 40.0})
    with pytest.raises(
        ParameterError, match=r"coupling\.field, in free motion"
    ) as error:
        judgement.at_start(parameters, 0.0)
    share = float(str(error.value).partition("is stable: ")[2].split()[0])
    for factor, refused in ((1.0, False), (1.05, True)):
        field = {"kind": "curl", "gain": 40.0 * share * factor}
        judgement, parameters = judged(field)
        verdict = judgement.verdict(
            parameters, LawBook("coupling", T).compile(parameters, "pd"), 0.0
        )
        assert verdict is not None
        assert verdict.stable is not refused
    (warning,) = judged({"kind": "curl", "gain": 40.0})[0].at_start(
        judged({"kind": "curl", "gain": 40.0})[1], 0.0, StartAnyway.VIRTUAL
    )
    assert "started anyway" in warning


def test_what_is_not_judged_says_so() -> None:
    moving = judged({"kind": "curl", "gain": 1.0}, tool_mass=0.1, tool_lag=0.5)
    assert moving[0].unjudged(moving[1]) == (
        "coupling.field beside a body that moves, or a second device"
    )
    constant = judged({"kind": "constant", "force": [1, 0, 0]}, tool_mass=0.1)
    assert constant[0].unjudged(constant[1]) == ""
    assert judged({"kind": "none"})[0].of_field(judged({"kind": "none"})[1], 0.0) == []
    judgement, parameters = judged({"kind": "viscous", "gain": 2.0})
    (text,) = judgement.of_field(parameters, 0.0)
    assert (
        "F = (x: -2 vx, y: -2 vy); the law is felt with K 1000 N/m, B 5 N s/m" in text
    )
    assert "worst pole radius 0.9" in text


def played(field: dict[str, Any], **more: Any) -> Any:
    launch = launch_file.read("reach", {"coupling.field": field, **more})
    return play(launch)


def test_a_hand_of_constant_speed_is_pushed_aside_by_the_curl() -> None:
    """Across, y = −B v/k; along x the hand's spring carries (b + c) v."""
    hand = {
        "mass": 1.0,
        "damping": 15.0,
        "stiffness": 300.0,
        "path": [[0.0, 0.0], [3.0, 0.15]],
    }
    trace = played(
        {"kind": "curl", "gain": B}, **{"driver.device.hand": hand, "duration": 3.0}
    )
    v, drag = 0.05, 2.0 + 15.0
    across = trace.position[2900:, 1]
    # e^(−17·2.9/(2·2)) of the transient is left, 4e-6 of its 0.05 m/s·13/300
    assert across == pytest.approx(np.full(100, -B * v / 300.0), rel=4e-4)
    lag = v * trace.time[2900:] - trace.position[2900:, 0]
    # sampled and held: half a tick of the path
    assert lag == pytest.approx(np.full(100, drag * v / 300.0), abs=v * 1e-3)


def test_the_drivers_limit_holds_and_the_force_comes_by_the_ease() -> None:
    trace = played({"kind": "constant", "force": [100.0, 0.0, 0.0]}, duration=0.5)
    # safety.peak_force of the scenario, which the ramp does not quite reach
    assert 25.0 < trace.force[:, 0].max() <= 30.0
    weak = played({"kind": "constant", "force": [6.0, 0.0, 0.0]}, duration=0.3)
    # eased over 0.15 s by the coupling, and beside it by the driver's ramp
    assert np.diff(weak.force[:, 0]).max() <= 2.0 * 6.0 / 150 * (1.0 + 1e-9)
    assert weak.force[-1, 0] == 6.0


@pytest.mark.parametrize(
    ("field", "error"),
    [
        ({"kind": "crul", "gain": 1.0}, "field.kind: expected one of .* mean curl"),
        ({"gain": 1.0}, "field.kind: missing; one of none"),
        ({"kind": "curl"}, "field.gain: is missing"),
        ({"kind": "curl", "gain": 1e7}, "field.gain: expected .* at most 1000000"),
        ({"kind": "viscous"}, "gain or gains: neither is given"),
        ({"kind": "viscous", "gain": 1.0, "gains": [1, 1, 1]}, "both are given"),
        ({"kind": "constant", "force": [1.0, 2.0]}, "a list of length 3"),
    ],
)
def test_errors_name_the_parameter(field: dict[str, Any], error: str) -> None:
    with pytest.raises(ParameterError, match=error):
        made(field)


def test_an_axis_that_is_not_computed_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"acts along z, but run\.axes"):
        played({"kind": "constant", "force": [0.0, 0.0, 1.0]})
    assert msgspec.to_builtins(made({"kind": "none"})) == {"kind": "none", "gain": 0.0}


def test_the_edges_of_the_page_are_those_that_are_computed() -> None:
    text = (ROOT / "nodes" / "environment" / "README.md").read_text(encoding="utf-8")
    words = "0.3 kg and 2 N s/m at 1 kHz {:.1f} N s/m, and {:.1f} with a tick of delay"
    edges = (edge("curl", Plant(1e-3, 0.3, 2.0, delay)) for delay in (0.0, 1.0))
    assert words.format(*edges) in " ".join(text.split())
