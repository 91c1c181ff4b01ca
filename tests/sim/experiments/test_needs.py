"""Every shipped scenario models exactly enough, and the study notices otherwise."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from nodes.cli.main import main
from nodes.launcher import launch_file, scenario_files
from nodes.launcher.launch_spec import Model
from nodes.launcher.wiring import chains_of
from nodes.parameters.store import ParameterError
from sim.experiments.needs import Needs, Outcome, measured_outcome, movement, needs
from sim.experiments.term_scene import term_scene, with_parameters
from sim.experiments.terms import TERMS, NeedTerm
from sim.studies.needs import ChainNeeds, _text
from tests.support import slowly
from tests.support.launches import every_launch


def judge(name: str, **arguments: Any) -> Needs:
    return needs(launch_file.read(name, arguments), rounds=1)


def verdicts(found: Needs) -> dict[str, str]:
    return {finding.term: finding.verdict for finding in found.findings}


def changed(tmp_path: Path, name: str, edit: Any) -> str:
    data = yaml.safe_load(scenario_files.find(name).read_text())
    edit(data)
    path = tmp_path / "changed.yaml"
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return str(path)


LAUNCHES = every_launch()


def kinds(name: str) -> list[str]:
    return [spec.kind for spec in LAUNCHES[name].nodes.values()]


CHAINS = [(name, chain) for name in LAUNCHES for chain in chains_of(LAUNCHES[name])]
APART = [(name, chain) for name, chain in CHAINS if name == "hands_apart"]
"""A network between two hands lives in real time."""

SPATIAL = [
    name for name, chain in CHAINS if not chain and len(LAUNCHES[name].run.axes) > 1
]
PLAYED = [
    (name, chain)
    for name, chain in CHAINS
    if name not in SPATIAL and (name, chain) not in APART
]


def test_what_one_process_cannot_play_is_refused_by_name(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["study", "needs", "hands_apart"]) == 2
    assert "which one process does not play" in capsys.readouterr().err


@pytest.mark.parametrize("scenario", slowly(SPATIAL, but=["sphere_feel"]))
def test_scenes_in_three_axes_model_enough_and_no_more(scenario: str) -> None:
    if "mujoco" in kinds(scenario):
        pytest.importorskip("mujoco")
    # The way on, over the shape and to where the hand stays.
    found = needs(launch_file.read(scenario, {"duration": 1.5}), rounds=0)
    assert (found.superfluous, found.missing) == ((), ())
    judged = verdicts(found)
    assert judged["hand"] == "needed"
    # What a scene in three axes is made of is what it needs.
    own = [
        judged[term]
        for term in (
            "shape",
            "triangles",
            "surface_friction",
            "tool_radius",
            "bodies",
            "field",
        )
        if term in judged
    ]
    assert "needed" in own
    assert set(own) <= {"needed", "left out"}


def test_a_curved_surface_that_is_hardly_curved_needs_a_plane(tmp_path: Path) -> None:
    """A sphere of 1 km deviates by 0.2 µm over 2 cm."""

    def edit(data: dict[str, Any]) -> None:
        surface = {
            "kind": "sphere",
            "radius": 1000.0,
            "position": [0.0, 0.0, -1000.0],
            "tool_radius": 0.001,
        }
        data["nodes"]["environment"]["parameters"]["surface"] = surface
        hand = {
            "path": [[0.02, 0.0], [0.3, 0.02]],
            "stiffness": 150.0,
            "damping": 2.0,
            "mass": 0.05,
        }
        data["nodes"]["driver"]["parameters"]["device"]["hand"] = hand
        data["run"]["duration"] = 0.3

    found = needs(
        launch_file.read(changed(tmp_path, "sphere_feel", edit), {}), rounds=0
    )
    shape = next(f for f in found.findings if f.term == "shape")
    assert shape.verdict == "superfluous"
    assert shape.switched == "off: the plane that touches it"


def test_needs_in_three_axes_by_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(
            [
                "study",
                "needs",
                "rough_plane",
                "duration:=0.8",
                "--rounds",
                "0",
                "--json",
            ]
        )
        == 0
    )
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert {finding["term"]: finding["verdict"] for finding in answer["terms"]}[
        "surface_friction"
    ] == "needed"
    assert answer["rest"] is None
    assert (
        main(["study", "needs", "sphere_feel", "duration:=0.1", "--rounds", "0"]) == 2
    )
    assert "touches nothing" in capsys.readouterr().err


QUICK = [
    ("floor_drop", ""),
    ("hands_coupled", ""),
    ("two_hands", "right"),
    ("world_edge", ""),
]


@pytest.mark.parametrize("where", slowly(PLAYED, but=QUICK), ids="/".join)
def test_shipped_scenarios_model_enough_and_no_more(where: tuple[str, str]) -> None:
    scenario, chain = where
    found = needs(launch_file.read(scenario, {}), chain, rounds=0)
    assert found.superfluous == ()
    assert found.missing == ()
    declared = [
        finding for finding in found.findings if finding.switched.startswith("off")
    ]
    assert declared
    assert all(
        finding.verdict in ("needed", "protects", "sought") for finding in declared
    )
    # The encoder of ``identify`` is there to be identified: the run itself does not feel it.
    sought = [finding.term for finding in declared if finding.verdict == "sought"]
    assert sought == (["resolution"] if scenario == "identify" else [])


def test_each_chain_of_a_launch_is_judged_by_what_its_own_file_is_for() -> None:
    launch = launch_file.read("two_hands", {})
    assert launch.models["right"] == launch_file.read("wall_press", {}).model
    found, alone = (
        needs(launch, "left", rounds=0),
        needs(launch_file.read("floor_drop", {}), rounds=0),
    )
    assert found == alone


def test_a_term_without_effect_is_named_superfluous(tmp_path: Path) -> None:
    def edit(data: dict[str, Any]) -> None:
        data["nodes"]["driver"]["parameters"]["device"]["peak_force"] = 100.0

    assert judge(changed(tmp_path, "floor_drop", edit)).superfluous == ("peak_force",)


def test_a_term_that_is_not_there_is_named_missing(tmp_path: Path) -> None:
    def edit(data: dict[str, Any]) -> None:
        data["model"].pop("leaves_out")

    found = judge(changed(tmp_path, "floor_drop", edit))
    assert "friction" in found.missing
    assert "gravity" not in found.missing
    # At 7.9 N the motor is not reached by the default drop (4.2 N), so its limit is not needed.
    assert verdicts(found)["peak_force"] == "not needed"


def test_delay_is_brought_by_the_loop_and_moves_k_max() -> None:
    finding = next(f for f in judge("floor_drop").findings if f.term == "delay")
    assert finding.verdict == "brought by the loop"
    assert finding.most == "k_max"
    # Heavy device: K_max ~ 1/(½ + d); 250 µs are d = 1/8 at 500 Hz, so K_max falls to 4/5.
    assert finding.changes["k_max"] == pytest.approx(0.2, abs=0.01)


@pytest.mark.slow
def test_long_memory_that_nothing_depends_on_is_superfluous(tmp_path: Path) -> None:
    def edit(data: dict[str, Any]) -> None:
        coupling = data["nodes"]["coupling"]["parameters"]
        coupling["laws"] = {
            "pd": {
                "kind": "pd_alpha",
                "stiffness": 1000.0,
                "damping": 3.0,
                "order": 1.2,
                "taps": length,
                "gains": "paper",
                "derivative": "gl_leak_corrected",
            }
        }

    length = 400
    assert (
        verdicts(judge(changed(tmp_path, "floor_drop", edit)))["memory"]
        == "superfluous"
    )
    length = 4
    assert verdicts(judge(changed(tmp_path, "floor_drop", edit)))["memory"] == "needed"


def test_costs_are_told_for_every_term() -> None:
    found = needs(launch_file.read("floor_drop", {}), rounds=3)
    assert found.tick_us is not None
    assert found.tick_us > 0.0
    # What is smaller than the spread of its rounds is not known.
    assert all(
        f.cost_us is None or abs(f.cost_us) > (f.cost_spread_us or 0.0)
        for f in found.findings
    )
    assert all(f.cost_us is None for f in found.findings if f.switched == "other")


SCENES = ("floor_guarded", "identify", "mesh_pebble", "world_feel", "reach", "moving")
"""Of these each term is in one, or can be."""


def moving(data: dict[str, Any]) -> None:
    """Put a soft sphere that moves through a viscous ball into the way of the hand."""
    way = {"path": [[0.0, 0.0, 0.0, 0.0], [2.0, 0.0, 0.0, -0.01]], "speed": 0.1}
    soft = {"stiffness": 0.5, "damping": 0.8}
    data["nodes"]["environment"]["parameters"]["surface"] = {
        "kind": "union",
        "shapes": [
            {"kind": "sphere", "radius": 0.05, "motion": way, **soft},
            {
                "kind": "viscosity",
                "time": 0.02,
                "within": {"kind": "sphere", "radius": 0.09},
            },
        ],
    }


@pytest.mark.parametrize("term", TERMS, ids=lambda term: str(term.name))
def test_switches_do_what_they_say(term: NeedTerm, tmp_path: Path) -> None:
    tried = 0
    for name in SCENES:
        file = changed(tmp_path, "sphere_feel", moving) if name == "moving" else name
        scene = term_scene(launch_file.read(file, {}))
        if name == "identify":
            laws = {"long": {"kind": "fir", "taps": [100.0, -1.0, 1.0, 2.0, -2.0]}}
            scene = with_parameters(scene, "coupling", {"law": "long", "laws": laws})
        with_it = scene if term.declared(scene) else None
        if with_it is None and term.typical is not None:
            typical = term.typical(scene)
            with_it = typical if term.declared(typical) else None
        if with_it is None:
            continue
        tried += 1
        without = term.without(with_it)
        if term.name == "triangles":
            counts = [len(one.shapes[0].mesh.corners) for one in (with_it, without)]  # type: ignore[union-attr]
            assert 2 * counts[1] <= counts[0]
        else:
            assert not term.declared(without)
    assert tried


def test_outcome_of_a_known_motion() -> None:
    ticks, period = 1000, 0.002
    position = np.where(np.arange(ticks) < 300, 0.02, 0.0)[:, None]
    position[-1] = 1e-4
    found = measured_outcome(position, 3.0 * np.sign(position - 0.01), period)
    # 20 mm until tick 300; the last sample is within 1 % of the travel.
    assert found.settling_s == pytest.approx(300 * period)
    assert found.travel_m == pytest.approx(0.02)
    assert found.limit_cycle_m == pytest.approx(1e-4)
    assert found.peak_force_n == 3.0
    assert found.rest_force_n == pytest.approx(-3.0)
    assert found.h1_max_n_per_m is None


def test_movement_ignores_swings_too_small_to_feel_and_sees_divergence() -> None:
    still = Outcome(1.0, 2.0, 1.0, 0.01, 1e-12, 1000.0)
    assert (
        movement(still, replace(still, limit_cycle_m=9e-7), 0.002)["limit_cycle"] == 0.0
    )
    assert movement(still, replace(still, limit_cycle_m=5e-6), 0.002)[
        "limit_cycle"
    ] == pytest.approx(1.0, abs=1e-5)
    assert (
        movement(still, replace(still, peak_force_n=math.inf), 0.002)["peak_force"]
        == math.inf
    )
    assert (
        movement(still, replace(still, h1_max_n_per_m=None), 0.002)["k_max"] == math.inf
    )
    assert movement(still, replace(still, h1_max_n_per_m=980.0), 0.002)[
        "k_max"
    ] == pytest.approx(0.02)


@pytest.mark.slow
def test_command_answers_and_judges(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    assert main(["study", "needs", "floor_drop", "--rounds", "1", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert answer["superfluous"] == answer["missing"] == []
    assert {
        "term",
        "switched",
        "verdict",
        "moved",
        "most",
        "changes",
        "cost_us",
    } <= set(answer["terms"][0])

    def edit(data: dict[str, Any]) -> None:
        data["nodes"]["driver"]["parameters"]["device"]["peak_force"] = 100.0

    assert (
        main(["study", "needs", changed(tmp_path, "floor_drop", edit), "--rounds", "1"])
        == 1
    )
    assert "superfluous: peak_force" in capsys.readouterr().out
    assert main(["study", "needs", "no_such_scene"]) == 2


def test_unknown_terms_are_refused(tmp_path: Path) -> None:
    def edit(data: dict[str, Any]) -> None:
        data["model"]["leaves_out"] = ["air"]

    with pytest.raises(ParameterError, match=r"model\.leaves_out"):
        launch_file.read(changed(tmp_path, "floor_drop", edit), {})


def test_model_counts_only_what_the_scene_is_for() -> None:
    launch = launch_file.read("floor_drop", {})
    found = needs(launch, model=Model(outcome=["rest_force"]), rounds=1)
    judged = verdicts(found)
    assert judged["gravity"] == "needed"
    # How it settles does not count here, so damping has nothing to move.
    assert judged["damping"] == "superfluous"


def test_what_is_left_out_although_it_matters_is_said() -> None:
    """`missing: nothing` was shown although friction changes settling by 21 %."""
    launch = launch_file.read("floor_drop", {})
    found = needs(launch, rounds=0)
    assert found.missing == ()
    assert "friction" in [finding.term for finding in found.left_out]
    lines = _text(
        ChainNeeds(launch.scenario, launch.model, False, found, None)
    ).splitlines()
    assert any(
        line.startswith(
            "left out on purpose although it matters: friction (settling by 21 %)"
        )
        for line in lines
    )
    assert any(
        line.startswith("a hand notices 7 to 13 % of force (7 %: Pang, Tan & Durlach")
        for line in lines
    )
    # By a tolerance that lets it move by so much it is not said to matter.
    loose = needs(launch, rounds=0, tolerance=lambda _: 0.5)
    assert "friction" not in [finding.term for finding in loose.left_out]
    assert verdicts(loose)["gravity"] == "needed"


def test_regions_stay_where_shapes_are_replaced(tmp_path: Path) -> None:
    """The same shapes in place of themselves change no bit, and no region is lost with them."""
    launch = launch_file.read(
        changed(tmp_path, "sphere_feel", moving), {"duration": 0.4}
    )
    scene = term_scene(launch)
    whole = scene.play().force
    assert np.array_equal(scene._replace(solids=scene.own).play().force, whole)
    assert not np.array_equal(scene._replace(has_regions=False).play().force, whole)
