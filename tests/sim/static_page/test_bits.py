"""A page's worker gives the bits of `haptic.play`: in node, and in Chromium if slow.

All scenarios that one process plays, all kinds of law and all realisations of a derivative run in
one process of node. Equality is exact, because the emitted rules are the rules of the nodes.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from nodes.coupling.law_book import LawBook
from nodes.coupling.parameters import CouplingParameters
from nodes.launcher import launch_file, scenario_files
from nodes.launcher.launch_spec import Launch, NodeSpec
from nodes.laws import law_kinds
from nodes.parameters.store import ParameterError, convert
from sim.play.chain import Instead
from sim.play.given import Given
from sim.play.one_axis import PlannedSwap
from sim.play.player import play
from sim.static_page.image import image_of
from tests.support.browser import chromium, needs_browser
from tests.support.in_node import PLAYED, ROWS, Case, Swap, play_in_node, program
from tests.support.realisations import KINDS, LENGTH

TICKS = 400

REFUSED = {
    "hands_apart": "2 chains",
    "hands_coupled": "drives two devices",
    "two_hands": "2 chains",
    "world_edge": "code or bodies of its own",
    "world_feel": "code or bodies of its own",
}
"""What a page in the browser does not play, and why it says so."""

MUJOCO = ("knob_turn", "puck_push", "stack_boxes")
"""Refused as well; reading them imports MuJoCo, which starts a process."""

LAWS: dict[str, dict[str, Any]] = {
    "excitation": {"amplitude": 0.7, "duration": 0.6, "load": 0.4},
    "fir": {
        "taps": [2200.0, -900.0, -300.0],
        "recursive": [{"b0": 30.0, "b1": -10.0, "a1": -1.2, "a2": 0.4}],
    },
    "fractional_sls": {
        "stiffness": 800.0,
        "damping": 3.0,
        "order": 0.6,
        "relaxation": 0.02,
        "taps": 20,
    },
    "multi_term": {
        "stiffness": 900.0,
        "damping": 3.0,
        "terms": [{"order": 0.4, "gain": 2.0}, {"order": 1.1, "gain": 0.6}],
        "taps": 4,
        "gains": "paper",
    },
    "pd": {"stiffness": 1200.0, "damping": 3.0},
    "pd_alpha": {
        "stiffness": 1200.0,
        "damping": 3.0,
        "order": 1.2,
        "taps": 12,
        "gains": "paper",
    },
    "pd_filtered": {"stiffness": 1200.0, "damping": 3.0, "cutoff": 60.0},
    "pd_windowed": {"stiffness": 1200.0, "damping": 3.0, "resolution": 1e-5},
}

VARIANTS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("floor_drop", {"law": "multi_term", "stiffness": 3700.0}),
    ("floor_drop", {"law": "designed_d1", "apply": "next_tick"}),
    ("floor_drop", {"stiffness": 9000.0}),  # the force saturates, and the driver stops
    ("floor_drop", {"stiffness": 2.0}),  # falls to the end of its workspace
    ("floor_guarded", {"apply": "next_tick", "latency": 0.6}),
    ("identify", {"apply": "next_tick", "delay": 1.3}),
    ("wall_press", {"delay": 1.7, "stiffness": 4000.0}),
    ("wall_press", {"delay": 0.4, "apply": "next_tick", "law": "multi_term"}),
    ("touch_wall", {"stiffness": 12000.0}),
)

SURFACES: dict[str, dict[str, Any]] = {
    "a softer shape": {"stiffness": 0.3, "damping": 0.6},
    "a shape that moves": {
        "motion": {"path": [[0.0, 0.0, 0.0, 0.0], [0.4, 0.0, 0.0, 0.02]], "repeat": 0.5}
    },
}

STILL: list[float] = [0.0, 0.0, 0.0, 0.0]

BALL: dict[str, Any] = {
    "kind": "sphere",
    "position": [0.05, 0.01, -0.03],
    "radius": 0.035,
}

UNIONS: dict[str, list[dict[str, Any]]] = {
    "a factor for each shape": [
        {"kind": "box", "position": [0.02, 0.0, -0.02], "size": [0.02, 0.04, 0.045]}
        | {"stiffness": 0.3, "damping": 0.6},
        {"kind": "capsule", "start": [0.04, -0.02, -0.01], "end": [0.06, 0.02, -0.01]}
        | {"radius": 0.012, "stiffness": 0.7},
        {"kind": "cylinder", "start": [0.08, -0.02, -0.01], "end": [0.08, 0.02, -0.01]}
        | {"radius": 0.014, "friction": {"static": 0.3}},
    ],
    "regions": [
        {**BALL, "friction": {"static": 0.4, "dynamic": 0.2}},
        {"kind": "viscosity", "within": {**BALL, "radius": 0.05}, "time": 0.01},
        {"kind": "viscosity", "time": 0.02, "band": 0.004}
        | {"within": {"kind": "box", "size": [0.05, 0.05, 0.05]}},
    ],
    "magnetic lines": [
        {
            "kind": "magnetic_line",
            "start": [0.0, 0.004, 0.01],
            "end": [0.1, 0.004, 0.01],
        }
        | {"reach": 0.03, "stiffness": 0.5},
        {"kind": "magnetic_line", "start": [0.03, 0.0, 0.01], "end": [0.03, 0.0, 0.01]}
        | {"reach": 0.02},
        {**BALL, "radius": 0.03},
    ],
    "shapes that move, one limited by its power": [
        {**BALL, "friction": {"static": 0.4}}
        | {"motion": {"path": [STILL, [0.4, 0.0, 0.0, 0.02]], "repeat": 0.5}},
        {"kind": "box", "position": [0.01, 0.02, 0.0], "size": [0.1, 0.02, 0.06]}
        | {"motion": {"path": [STILL, [0.3, 0.0, -0.02, 0.0]], "power": 0.001}},
        {"kind": "viscosity", "within": {**BALL, "radius": 0.05}, "time": 0.01},
    ],
}
"""Scenes of several shapes and regions, all met on the path of sphere_feel."""

SWAPS: tuple[Swap, ...] = tuple(
    Swap(
        250 + 3 * n,
        ("pd_alpha", "multi_term", "pd", "recursive")[n % 4],
        (40, 90, 1, 60)[n % 4],
    )
    for n in range(24)
)
"""More laws fade out at once than a coupling stores, some of them with recursive sections."""

NAMES = sorted(
    [
        *(
            name
            for name in scenario_files.scenarios()
            if name not in (*REFUSED, *MUJOCO)
        ),
        *(f"{name} {given}" for name, given in VARIANTS),
        *(f"law {kind}" for kind in LAWS),
        *(f"derivative {kind}" for kind in KINDS),
        *SURFACES,
        *UNIONS,
        *("ramp and heat", "swaps", "swaps on a softer shape"),
        *("dragged 1000.0", "dragged 15000.0"),
    ]
)
"""Names of all cases, which are read where they are played, not where tests are collected."""


def read(name: str, given: Mapping[str, Any] | None = None) -> Launch:
    return launch_file.read(name, dict(given or {}))


def changed(launch: Launch, node: str, **parameters: Any) -> Launch:
    """Return a launch with other parameters of a node."""
    spec = launch.nodes[node]
    spec = NodeSpec(kind=spec.kind, parameters={**spec.parameters, **parameters})
    return msgspec.structs.replace(launch, nodes={**launch.nodes, node: spec})


def with_law(law: Mapping[str, Any]) -> Launch:
    return changed(
        read("wall_press"),
        "coupling",
        law="mine",
        laws={"mine": dict(law)},
        stability="off",
    )


def with_driver(name: str, given: Mapping[str, Any], **safety: Any) -> Launch:
    launch = read(name, given)
    before = launch.nodes["driver"].parameters["safety"]
    return changed(launch, "driver", safety={**before, **safety})


@cache
def cases() -> dict[str, Case]:
    launches = {name: read(name) for name in PLAYED}
    launches |= {f"{name} {given}": read(name, given) for name, given in VARIANTS}
    launches |= {
        f"law {kind}": with_law({"kind": kind, **law}) for kind, law in LAWS.items()
    }
    launches |= {
        f"derivative {kind}": with_law(
            {
                **LAWS["pd_alpha"],
                "kind": "pd_alpha",
                "derivative": kind,
                "taps": min(LENGTH[kind], 20),
            }
        )
        for kind in KINDS
    }
    launches["ramp and heat"] = with_driver(
        "wall_press", {}, ramp=0.2, continuous_force=1.0, thermal_time=0.3
    )
    for name, more in SURFACES.items():
        launch = read("sphere_feel", {"friction": 0.4})
        surface = {**launch.nodes["environment"].parameters["surface"], **more}
        launches[name] = changed(launch, "environment", surface=surface)
    for name, shapes in UNIONS.items():
        surface = {"kind": "union", "shapes": shapes}
        launches[name] = changed(read("sphere_feel"), "environment", surface=surface)
    found = {name: Case(launch, TICKS) for name, launch in launches.items()}
    recursive = {"kind": "fir", **LAWS["fir"]}
    laws = read("touch_wall").nodes["coupling"].parameters["laws"]
    launch = changed(
        read("touch_wall"), "coupling", laws={**laws, "recursive": recursive}
    )
    found["swaps"] = Case(launch, TICKS, swaps=SWAPS)
    # What rests of a mixed law is scaled as the rest of it.
    launch = changed(
        launches["a softer shape"], "coupling", laws={**laws, "recursive": recursive}
    )
    found["swaps on a softer shape"] = Case(launch, TICKS, swaps=SWAPS)
    rng = np.random.default_rng(5)
    target = np.zeros((TICKS, 3))
    corners = np.arange(0, TICKS + 50, 50)
    wanted = rng.uniform(0.0, 0.05, len(corners))
    target[:, 0] = np.interp(np.arange(TICKS), corners, wanted)
    for stiffness in (1000.0, 15000.0):
        launch = read("touch_wall", {"stiffness": stiffness, "duration": 1.0})
        found[f"dragged {stiffness}"] = Case(launch, TICKS, target)
    return found


def expected(case: Case) -> Any:
    given = None if case.target is None else Given(target=case.target)
    instead = None
    if case.swaps:
        parameters = convert(
            case.launch.nodes["coupling"].parameters, CouplingParameters, "coupling"
        )
        book = LawBook("coupling", case.launch.run.period)
        instead = Instead(
            book.compile(parameters, parameters.law),
            [
                PlannedSwap(swap.tick, book.compile(parameters, swap.law), swap.ramp)
                for swap in case.swaps
            ],
        )
    trace = play(case.launch, None, case.ticks, instead, given, how="nodes")
    return np.array([getattr(trace, row) for row in ROWS])


@pytest.fixture(scope="module")
def played(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    assert sorted(cases()) == NAMES
    rows = play_in_node(list(cases().values()), tmp_path_factory.mktemp("node"))
    return dict(zip(cases(), rows, strict=True))


@pytest.mark.process
@pytest.mark.smoke
@pytest.mark.parametrize("name", NAMES)
def test_every_row_of_every_tick_has_the_bits_of_one_process(
    played: dict[str, Any], name: str
) -> None:
    """Position, velocity, reading, deflection and force along all axes."""
    rows, want = np.ascontiguousarray(played[name]), expected(cases()[name])
    assert np.abs(want[ROWS.index("force")]).max() > 0.0 or name == "free_space"
    differs = rows.view(np.int64) != want.view(np.int64)
    first = {
        row: int(np.argmax(one.any(axis=1)))
        for row, one in zip(ROWS, differs, strict=True)
    }
    assert not differs.any(), (
        f"first tick that differs: {first}, of {differs.sum(axis=(1, 2))}"
    )


def test_every_scenario_is_played_or_refused() -> None:
    assert {*PLAYED, *REFUSED, *MUJOCO} == set(scenario_files.scenarios())


def test_all_kinds_of_law_are_played_but_one_whose_code_has_a_memory_of_its_own() -> (
    None
):
    assert set(LAWS) | {"knock"} == set(law_kinds())
    knock = {
        "kind": "knock",
        "stiffness": 1000.0,
        "damping": 3.0,
        "step": 1e-3,
        "taps": [900.0],
    }
    with pytest.raises(
        ParameterError, match=r"coupling\.laws\.mine: Trial is code of its own"
    ):
        image_of(with_law(knock), TICKS)


@pytest.mark.parametrize("name", sorted(REFUSED))
def test_what_the_worker_cannot_play_is_refused_with_the_node_and_the_reason(
    name: str,
) -> None:
    with pytest.raises(ParameterError, match=REFUSED[name]):
        image_of(read(name), TICKS)


def test_moving_bodies_are_refused() -> None:
    launch = read("touch_wall")
    nodes = {**launch.nodes, "environment": NodeSpec(kind="mujoco", parameters={})}
    with pytest.raises(
        ParameterError, match="environment: mujoco has code or bodies of its own"
    ):
        image_of(msgspec.structs.replace(launch, nodes=nodes), TICKS)


@pytest.mark.process
@pytest.mark.smoke
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("return proxy - position", "return (proxy - position) * (1 + 2 ** -52)"),
        (
            "force +(taps[m]*history[head + m])",
            "(taps[m] * history[head + m]) + force * (1 + 2 ** -52)",
        ),
        (
            "((coefs[0]*x)+(coefs[1]*v))+(coefs[4]*u)",
            "(coefs[0] * x) + ((coefs[1] * v) + (coefs[4] * u))",
        ),
    ],
)
def test_the_comparison_notices_a_changed_rule(
    tmp_path: Path, old: str, new: str
) -> None:
    case = cases()["touch_wall"]
    script = program([case])
    assert old in script
    (rows,) = play_in_node([case], tmp_path, script.replace(old, new))
    assert (
        np.ascontiguousarray(rows).view(np.int64) != expected(case).view(np.int64)
    ).any()


@pytest.mark.slow
@pytest.mark.process
@needs_browser
def test_chromium_gives_the_same_bits_as_node_from_a_file(
    played: dict[str, Any], tmp_path: Path
) -> None:
    path = tmp_path / "bits.html"
    script = program(list(cases().values()))
    path.write_text(f"<meta charset=utf-8><script>{script}</script>", encoding="utf-8")
    with chromium() as browser:
        page = browser.new_page()
        page.goto(f"file://{path}")
        got = page.evaluate(
            "() => results.map(([rows]) => Array.from(new Uint32Array(rows.buffer)))"
        )
    for (name, case), numbers in zip(cases().items(), got, strict=True):
        rows = (
            np.array(numbers, dtype=np.uint32).view(np.int64).reshape(case.ticks, 5, 3)
        )
        same = np.ascontiguousarray(played[name].transpose(1, 0, 2)).view(np.int64)
        assert (rows == same).all(), name
