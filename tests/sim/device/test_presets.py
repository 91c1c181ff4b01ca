"""Presets of real devices: one word, every value with its source, what nobody published left to the scenario."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest

from nodes.launcher import launch_file
from nodes.parameters.store import ParameterError, convert
from sim.device.driver import SimDriverParameters
from sim.device.model import DeviceModel
from sim.device.presets import MEMORY, PRESETS, preset
from tests.support.launching import haptic, launch_json

SCENE = {"mass": 0.1, "damping": 0.7, "friction": 0.03, "delay": 0.4, "resolution": 1e-6}


@pytest.mark.parametrize("name", PRESETS)
def test_known_values_take_the_place_of_the_scenarios(name: str) -> None:
    parameters: SimDriverParameters = convert({"preset": name, "device": SCENE}, SimDriverParameters, "driver")
    for field, value in (SCENE | preset(name)).items():
        assert getattr(parameters.device, field) == value
    # Nobody published a damping or a delay.
    assert (parameters.device.damping, parameters.device.delay) == (0.7, 0.4)
    # What param dump writes is read back as the same.
    assert convert(msgspec.to_builtins(parameters), SimDriverParameters, "driver") == parameters


@pytest.mark.parametrize("name", PRESETS)
def test_every_value_has_a_source_and_a_place(name: str) -> None:
    one = PRESETS[name]
    assert set(one.model) <= set(DeviceModel.__struct_fields__)
    for fact in (*one.model.values(), *one.limits.values()):
        assert fact.value > 0.0
        assert fact.source
        assert fact.remembered == (fact.source == MEMORY)


@pytest.mark.parametrize("name", ["", "none"])
def test_no_preset_changes_nothing(name: str) -> None:
    parameters: SimDriverParameters = convert({"preset": name, "device": SCENE}, SimDriverParameters, "driver")
    assert parameters.device == convert(SCENE, DeviceModel, "device")


def test_an_unknown_one_is_refused_with_those_there_are() -> None:
    launch = launch_file.read("identify", {"device": "tuch_x"})
    with pytest.raises(ParameterError, match=r"tuch_x.*touch_x"):
        convert(launch.nodes["driver"].parameters, SimDriverParameters, "driver")


def test_one_word_at_the_launch(tmp_path: Path) -> None:
    words = ("identify", "device:=touch_x", "pace:=lockstep", "duration:=5")
    recording = launch_json(tmp_path, *words)["recording"]
    done = haptic(tmp_path, "study", "identify", recording, "--json")
    told = json.loads(done.stdout.splitlines()[-1])
    assert told["mass_kg"]["value"] == pytest.approx(0.035, rel=0.01)
    assert told["friction_n"]["value"] == pytest.approx(0.06, rel=0.05)
    listed = json.loads(haptic(tmp_path, "device", "presets", "--json").stdout.splitlines()[-1])["presets"]
    assert {one["name"] for one in listed} == set(PRESETS)
