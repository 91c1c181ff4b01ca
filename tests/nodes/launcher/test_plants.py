"""The plant of a coupling is its launch's device: filled in, compared, named if unknown.

The oracles are the masses of the launch file added by hand, and the law of the scaled device from
THEORY's own units.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest

from nodes.base.node_kinds import load
from nodes.coupling.contradictions import contradictions
from nodes.coupling.node import Coupling
from nodes.coupling.parameters import PlantParameters
from nodes.launcher import launch_file
from nodes.launcher.wiring import wire
from nodes.parameters.store import ParameterError, convert
from nodes.stability.plant import Plant
from sim.device.driver import PEAK, SLEW, SimDriverParameters
from tests.support.setups import setup_of

PD = {"kind": "pd", "stiffness": 500.0, "damping": 2.0}
DEVICE = {
    "mass": 0.05,
    "damping": 1.0,
    "delay": 0.5,
    "hand": {"mass": 0.1, "stiffness": 200.0, "damping": 2.0, "path": [[0, 0]]},
}
WHOLE = {"mass": 0.15, "damping": 3.0, "stiffness": 200.0, "device_delay": 0.5}
TOOL = """<mujoco><worldbody><body name="tool">
<joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
<joint type="slide" axis="0 0 1"/><geom type="sphere" size="0.006" mass="0.005"/>
</body></worldbody></mujoco>"""


def written(
    folder: Path,
    coupling: dict[str, Any] | None = None,
    device: dict[str, Any] | None = None,
    **nodes: Any,
) -> str:
    """Write a user's launch file: a device, a wall and a law."""
    content = {
        "summary": "s",
        "run": {"axes": ["x"]},
        "nodes": {
            "driver": {
                "kind": "sim_driver",
                "parameters": {"device": device or DEVICE},
            },
            "environment": {
                "kind": "environment",
                "parameters": {
                    "surface": {"kind": "plane", "axis": "x", "position": 0.02}
                },
            },
            "coupling": {
                "kind": "coupling",
                "parameters": {"law": "pd", "laws": {"pd": PD}, **(coupling or {})},
            },
            **nodes,
        },
    }
    if "mujoco" in json.dumps(nodes):
        del content["run"]
    path = folder / "own.yaml"
    path.write_text(json.dumps(content), encoding="utf-8")
    return str(path)


def plant_of(path: str, **arguments: Any) -> dict[str, Any]:
    found: dict[str, Any] = (
        launch_file.read(path, arguments).nodes["coupling"].parameters["plant"]
    )
    return found


def test_a_launch_file_names_its_device_once(tmp_path: Path) -> None:
    assert plant_of(written(tmp_path)) == WHOLE
    # What the file says goes before: here a loop whose delay is known, and a worse device.
    assert plant_of(written(tmp_path, {"plant": {"delay": 1.0, "damping": 0.0}})) == {
        **WHOLE,
        "delay": 1.0,
        "damping": 0.0,
    }
    # An arm that is heavier further out, and an axis that is another device: the worst of each
    # value.
    arm = {
        **DEVICE,
        "mass_by_position": [[0.0, 0.05], [0.1, 0.3]],
        "axes": {"x": {"damping": 0.5}},
    }
    assert plant_of(written(tmp_path, device=arm)) == {
        **WHOLE,
        "heaviest": 0.4,
        "damping": 2.5,
    }
    assert plant_of(written(tmp_path), device="touch_x")["mass"] == pytest.approx(
        0.035 + 0.1, rel=1e-11
    )
    late = {**DEVICE, "delay": 100.0 + 1e-9}
    with pytest.raises(
        ParameterError,
        match=r"plant\.device_delay: the device answers 100 ticks late, limit 100; .* to null",
    ):
        launch_file.read(written(tmp_path, device=late), {})
    launch = launch_file.read(written(tmp_path, {"plant": None}, device=late), {})
    assert launch.nodes["coupling"].parameters["plant"] is None


def test_what_an_including_file_changes_is_what_is_judged(tmp_path: Path) -> None:
    inner = written(tmp_path)
    outer = tmp_path / "outer.yaml"
    included = {
        "launch": inner,
        "namespace": "a",
        "parameters": {"driver": {"device": {"mass": 0.2}}},
    }
    outer.write_text(
        json.dumps({"summary": "s", "include": [included]}), encoding="utf-8"
    )
    launch = launch_file.read(str(outer), {})
    assert launch.nodes["a/coupling"].parameters["plant"] == {**WHOLE, "mass": 0.3}
    assert wire(launch, "r", tmp_path, {})["a/coupling"].plant["mass"] == 0.3


def test_the_tool_of_a_scene_is_weighed_before_the_start(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    (tmp_path / "tool.xml").write_text(TOOL, encoding="utf-8")
    world = {"kind": "mujoco", "parameters": {"scene": str(tmp_path / "tool.xml")}}
    path = written(tmp_path, environment=world)
    # MuJoCo's usual step, contacts and no springs: its weight is a promise too.
    assert plant_of(path) == {**WHOLE, "tool_mass": 0.005, "tool_step": 0.002}
    with pytest.raises(
        ParameterError,
        match=r"coupling\.plant\.tool_mass: 0\.05 kg, but the tool of the scene weighs 0\.005 kg",
    ):
        wire(
            launch_file.read(
                written(tmp_path, {"plant": {"tool_mass": 0.05}}, environment=world), {}
            ),
            "r",
            tmp_path,
            {},
        )
    # A scene that is saved again is weighed again.
    (tmp_path / "tool.xml").write_text(
        TOOL.replace('mass="0.005"', 'mass="0.0075"'), encoding="utf-8"
    )
    assert plant_of(written(tmp_path, environment=world))["tool_mass"] == 0.0075


@pytest.mark.parametrize(
    ("plant", "field", "text"),
    [
        ({"mass": 15.0}, "mass", "15 kg, but the device has 0.15 kg"),
        ({"mass": 0.15 * 1.011}, "mass", "0.15165 kg, but the device has 0.15 kg"),
        ({"damping": 3.1}, "damping", "3.1 N s/m, but the device has 3 N s/m"),
        ({"stiffness": 0.0}, "stiffness", "0 N/m, but the device has 200 N/m"),
        (
            {"device_delay": 0.0},
            "device_delay",
            "0 ticks, but the device has 0.5 ticks",
        ),
        (
            {"mass": 0.1, "heaviest": 0.14},
            "heaviest",
            "0.14 kg, but the device has 0.15 kg",
        ),
    ],
)
def test_a_plant_that_flatters_the_device_is_refused(
    plant: dict[str, float], field: str, text: str, tmp_path: Path
) -> None:
    def start(more: dict[str, Any]) -> None:
        wire(launch_file.read(written(tmp_path, more), {}), "r", tmp_path, {})

    with pytest.raises(ParameterError) as raised:
        start({"plant": plant})
    assert f"coupling.plant.{field}: {text}" in str(raised.value)
    assert f"Leave coupling.plant.{field} out" in str(raised.value)
    for policy in ("warn", "off"):
        start({"plant": plant, "stability": policy})
    # The same numbers a little to the worse side are a device that a user may ask for.
    start(
        {
            "plant": {
                "mass": 0.15 * 0.99,
                "damping": 2.9,
                "stiffness": 201.0,
                "device_delay": 0.6,
            }
        }
    )


def test_a_device_drawn_larger_is_lighter_to_the_law() -> None:
    plant = PlantParameters(mass=0.2, damping=1.0, stiffness=50.0, scale=2.0)
    # x = s x_d and m x_d'' = s F, so m/s² x'' = F: the loop of K on m/s² is that of s² K on m.
    assert plant.at(0.002, 0.25) == Plant(0.002, 0.05, 0.25, 0.25, 12.5)
    assert msgspec.structs.replace(plant, scale=1.0).at(0.002, 0.25) == Plant(
        0.002, 0.2, 1.0, 0.25, 50.0
    )
    assert contradictions(plant, {"scale": 2.0}) == {}
    assert contradictions(plant, {"scale": 4.0}) == {"scale": "4"}


def test_the_scale_of_a_real_device_reaches_the_judge(tmp_path: Path) -> None:
    driver = {
        "kind": "force_dimension_driver",
        "parameters": {"mapping": {"scale": 10.0}},
    }
    assert plant_of(written(tmp_path, {"plant": {"mass": 0.2}}, driver=driver)) == {
        "mass": 0.2,
        "scale": 10.0,
    }
    # 500 N/m on 0.2 kg are stable, 50 000 N/m as the device feels it are not.
    with pytest.raises(ParameterError, match=r"mass 0\.002 kg.* the loop is unstable"):
        wire(
            launch_file.read(
                written(tmp_path, {"plant": {"mass": 0.2}}, driver=driver), {}
            ),
            "r",
            tmp_path,
            {},
        )


def test_what_nobody_judges_is_named(tmp_path: Path) -> None:
    def why(coupling: dict[str, Any], **nodes: Any) -> str:
        setup = wire(
            launch_file.read(written(tmp_path, coupling, **nodes), {}),
            "r",
            tmp_path,
            {},
        )["coupling"]
        return load(setup.factory).unjudged(setup)

    assert why({}) == ""
    assert why({"stability": "warn"}) == ""
    assert why({"stability": "off"}) == "coupling.stability is off"
    assert (
        why({}, driver={"kind": "force_dimension_driver"})
        == "coupling.plant, the device, is not declared"
    )
    knock = {
        "law": "excitation",
        "laws": {
            "excitation": {"kind": "excitation", "amplitude": 0.1, "duration": 1.0}
        },
    }
    assert (
        why(knock) == "coupling.laws.excitation has code of its own, which has no poles"
    )


def test_a_virtual_device_has_limits_unless_it_is_to_have_none() -> None:
    def safety(**given: Any) -> Any:
        return convert(
            {"device": DEVICE, "safety": given}, SimDriverParameters, "driver"
        ).safety

    usual = safety()
    assert (usual.peak_force, usual.slew) == (PEAK, SLEW)
    far = {**DEVICE, "position": 0.5, "hand": {**DEVICE["hand"], "path": [[0.0, -0.3]]}}  # type: ignore[dict-item]
    # Each place that the file names, and 0.2 m beyond.
    reach = convert({"device": far}, SimDriverParameters, "driver").safety.workspace
    assert reach == ((-0.5, 0.7),) * 3
    assert safety(peak_force=3.0, slew=100.0).peak_force == 3.0
    none = safety(without=["peak_force", "slew", "workspace"])
    assert (none.peak_force, none.slew, none.workspace) == (None, None, None)


def coupling(**more: Any) -> Coupling:
    laws = {"pd": PD, "aside": {**PD, "stiffness": 600.0}}
    parameters = {
        "law": "pd",
        "laws": laws,
        "plant": {"mass": 0.1, "damping": 1.0},
        **more,
    }
    node = Coupling(
        setup_of(
            name="coupling",
            kind="coupling",
            parameters=parameters,
            plant={"mass": 0.1, "damping": 1.0},
        )
    )
    node.configure()
    return node


def test_a_law_that_does_not_render_is_judged_when_it_is_set() -> None:
    node = coupling()
    with pytest.raises(
        ParameterError,
        match=r"coupling\.laws\.aside: pole radius .* the largest coupling\.laws\.aside\.stiffness",
    ):
        node.prepare(node.store.changed({"laws.aside.stiffness": 80_000.0}))
    receipt = node.prepare(node.store.changed({"laws.aside.stiffness": 700.0}))(0)
    assert receipt["stability"]["law"] == "aside"
    assert receipt["stability"]["stable"]
    assert 0.0 < receipt["stability"]["was_pole_radius"] < 1.0
    assert (
        node.prepare_forced(node.store.changed({"laws.aside.stiffness": 80_000.0}))(1)[
            "stability"
        ]["stable"]
        is False
    )


def test_a_plant_that_flatters_the_device_is_refused_while_it_runs() -> None:
    node = coupling()
    with pytest.raises(
        ParameterError,
        match=r"coupling\.plant\.mass: 10 kg, but the device has 0\.1 kg",
    ):
        node.prepare(node.store.changed({"plant.mass": 10.0}))
    node.prepare_forced(node.store.changed({"plant.mass": 10.0}))
    # A page moves a virtual device's own delay, which it tells the judge first.
    node.prepare(node.store.changed({"plant.device_delay": 1.0}))(0)


def test_what_was_before_is_judged_on_the_plant_of_before() -> None:
    def told(change: dict[str, Any]) -> dict[str, Any]:
        node = coupling()
        found: dict[str, Any] = node.prepare_forced(node.store.changed(change))(0)[
            "stability"
        ]
        return found

    # Of a change of the law alone the plant of before is that of now.
    rendered = told({"laws.pd.stiffness": 700.0})["was_pole_radius"]
    heavier = told({"plant.mass": 0.4})
    assert heavier["was_pole_radius"] == rendered != heavier["pole_radius"]
    aside = told({"laws.aside.stiffness": 700.0})["was_pole_radius"]
    both = told({"laws.aside.stiffness": 700.0, "plant.mass": 0.4})
    assert both["was_pole_radius"] == {"aside": aside, "pd": rendered}[both["law"]]
