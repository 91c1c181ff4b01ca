"""Presets of real devices: one word, sourced values, unpublished ones from the scenario."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from messages.topics import event
from nodes.launcher import launch_file, scenario_files
from nodes.launcher.launch_spec import Launch
from nodes.parameters.store import ParameterError, convert
from nodes.recording.reader import Recording
from sim.device.driver import SimDriverParameters
from sim.device.hand import Hand
from sim.device.model import DeviceModel
from sim.device.real_devices import HANDS, MEMORY, PRESETS, preset
from sim.studies.device_options import hand
from tests.support.launching import haptic

SCENE = {
    "mass": 0.1,
    "damping": 0.7,
    "friction": 0.03,
    "delay": 0.4,
    "resolution": 1e-6,
}


@pytest.mark.parametrize("name", PRESETS)
def test_known_values_take_the_place_of_the_scenarios(name: str) -> None:
    parameters: SimDriverParameters = convert(
        {"preset": name, "device": SCENE}, SimDriverParameters, "driver"
    )
    for field, value in (SCENE | preset(name)).items():
        assert getattr(parameters.device, field) == value
    # Nobody published a damping or a delay.
    assert (parameters.device.damping, parameters.device.delay) == (0.7, 0.4)
    # What param dump writes is read back as the same.
    assert (
        convert(msgspec.to_builtins(parameters), SimDriverParameters, "driver")
        == parameters
    )


@pytest.mark.parametrize("name", PRESETS)
def test_every_value_has_a_source_and_a_place(name: str) -> None:
    one = PRESETS[name]
    assert set(one.model) <= set(DeviceModel.__struct_fields__)
    for fact in (*one.model.values(), *one.limits.values()):
        assert fact.value > 0.0
        assert fact.source
        assert fact.remembered == (fact.source == MEMORY)


@pytest.mark.parametrize("name", HANDS)
def test_a_hand_has_sources_and_can_hold_a_device_and_bound_a_design(name: str) -> None:
    known = HANDS[name].model
    values = {field: fact.value for field, fact in known.items()}
    assert (
        convert(values | {"path": [(0.0, 0.0)]}, Hand, "hand").stiffness
        == values["stiffness"]
    )
    assert all(
        fact.source and fact.remembered == ("remembered" in fact.source)
        for fact in known.values()
    )
    assert hand(name) == (0.0, values["stiffness"])


@pytest.mark.parametrize("name", ["", "none"])
def test_no_preset_changes_nothing(name: str) -> None:
    parameters: SimDriverParameters = convert(
        {"preset": name, "device": SCENE}, SimDriverParameters, "driver"
    )
    assert parameters.device == convert(SCENE, DeviceModel, "device")


def test_an_unknown_one_is_refused_with_those_there_are() -> None:
    with pytest.raises(ParameterError, match=r"driver: preset is 'tuch_x'.*touch_x"):
        launch_file.read("identify", {"device": "tuch_x"})


@pytest.mark.parametrize("scenario", scenario_files.scenarios())
def test_every_scenario_takes_one_and_judges_laws_by_it(scenario: str) -> None:
    assert "device" in scenario_files.read_arguments(scenario_files.find(scenario))[1]
    before, launch = (
        launch_file.read(scenario, {}),
        launch_file.read(scenario, {"device": "touch_x"}),
    )
    for name in (
        name for name, spec in launch.nodes.items() if spec.kind == "sim_driver"
    ):
        assert_stands_in(name, before, launch)
    assert launch.arguments["device"] == "touch_x"


def assert_stands_in(driver: str, before: Launch, launch: Launch) -> None:
    """Assert that the driver has the device, and its coupling the plant."""
    device, described = (
        convert(one.nodes[driver].parameters, SimDriverParameters, driver).device
        for one in (launch, before)
    )
    assert (device.mass, device.damping, device.hand) == (
        0.035,
        described.damping,
        described.hand,
    )
    # Its own limit, or the scene's stricter one.
    limit = before.nodes[driver].parameters["safety"]["peak_force"]
    assert convert(
        launch.nodes[driver].parameters, SimDriverParameters, driver
    ).safety.peak_force == min(limit, 7.9)
    plant = launch.nodes[driver.replace("driver", "coupling")].parameters["plant"]
    # Twelve digits: masses are added as a person adds them.
    assert plant["mass"] == pytest.approx(device.moving_mass, rel=1e-11)
    assert plant.get("damping", 0.0) == pytest.approx(device.moving_damping, rel=1e-11)


def test_a_launch_without_a_virtual_device_takes_none(tmp_path: Path) -> None:
    path = tmp_path / "bare.yaml"
    path.write_text("summary: s\nnodes: {logger: {kind: logger}}\n")
    with pytest.raises(ParameterError, match="no argument 'device'"):
        launch_file.read(str(path), {"device": "touch_x"})


@pytest.mark.slow
def test_one_word_and_a_scenario_is_started_and_identified(tmp_path: Path) -> None:
    words = (
        "device",
        "identify",
        "identify",
        "device:=touch_x",
        "pace:=lockstep",
        "--duration",
        "5",
        "--json",
    )
    done = haptic(tmp_path, *words)
    told = json.loads(done.stdout.splitlines()[-1])
    events = Recording(tmp_path / told["recording"]).messages(event("driver"))
    said = " ".join(one.reason for one in events)
    assert "mass 0.035 (remembered, not checked)" in said
    assert "resolution 2.3e-05 (3D Systems, data sheet" in said
    assert told["stopped"] == "done"
    assert told["mass_kg"]["value"] == pytest.approx(0.035, rel=0.01)
    assert told["friction_n"]["value"] == pytest.approx(0.06, rel=0.05)
    listed = json.loads(
        haptic(tmp_path, "device", "presets", "--json").stdout.splitlines()[-1]
    )["presets"]
    assert {one["name"] for one in listed} == set(PRESETS | HANDS)
