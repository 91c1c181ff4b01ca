"""Parameters of nodes given to a launch: placed, refused and judged as those of its file."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import haptic
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nodes.launcher import launch_file
from nodes.launcher.launch_spec import NodeSpec
from nodes.launcher.node_parameters import with_parameters
from nodes.parameters.store import ParameterError
from tests.support.launching import typed_in

GRAVITY = 9.81


def parameters(node: str, **given: Any) -> Any:
    launch = launch_file.read(
        "floor_drop", {name.replace("__", "."): given[name] for name in given}
    )
    return launch.nodes[node].parameters


def test_a_parameter_replaces_that_of_the_file_and_leaves_the_rest() -> None:
    before = parameters("driver")
    after = parameters("driver", driver__device__mass=0.2)
    assert after["device"] == {**before["device"], "mass": 0.2}
    assert after["safety"] == before["safety"]


def test_the_plant_that_laws_are_judged_on_follows_the_device() -> None:
    assert parameters("coupling", driver__device__mass=0.2)["plant"]["mass"] == 0.2
    # of an argument and a parameter for the same place, the parameter
    assert (
        parameters("coupling", mass=0.3, driver__device__mass=0.2)["plant"]["mass"]
        == 0.2
    )


def test_the_file_s_check_refuses_a_plant_that_contradicts_the_device(
    tmp_path: Path,
) -> None:
    # Twice the mass looks more stable than the device is.
    words = ("launch", "floor_drop", "coupling.plant.mass:=0.2")
    told = typed_in(tmp_path, *words, code=2).stderr
    assert re.search(
        r"floor_drop\.yaml:\d+: coupling\.plant\.mass: 0\.2 kg, but .* 0\.1 kg", told
    )


@pytest.mark.parametrize(
    ("name", "value", "text"),
    [
        ("drver.device.mass", 1, r"no node 'drver'; .*did you mean driver\?"),
        (
            "driver.device.maas",
            1,
            r"driver\.device\.maas: no such .*did you mean mass\?",
        ),
        (
            "driver.device.mass",
            -1,
            r"driver\.device\.mass: expected a number above 0, got -1",
        ),
        (
            "driver.device.mass.x",
            1,
            r"driver\.device\.mass is 0\.1, which has no names below",
        ),
        ("driver.safety.workspace[7]", 1, r"has 3 entries; give it as a whole"),
        ("driver.device[0]", 1, r"driver\.device is no list here"),
        ("driver.", 1, r"is not a parameter's name"),
        ("driver.device..mass", 1, r"is not a parameter's name"),
        (
            "coupling.laws.pd.stiffness",
            -1,
            r"coupling\.laws\.pd\.stiffness: .*above 0, got -1",
        ),
        (
            "environment.surface",
            {"kind": "sphere"},
            r"environment\.surface\.radius: is missing",
        ),
    ],
)
def test_what_does_not_fit_is_refused_by_place(
    name: str, value: Any, text: str
) -> None:
    with pytest.raises(ParameterError, match=text) as raised:
        haptic.play("floor_drop", params={name: value})
    if "no node" not in text:  # a node that is not there has no line
        assert re.match(r"floor_drop\.yaml:\d+: ", str(raised.value))
        assert f"(given as {name}=" in str(raised.value)


names = st.text("abc", min_size=1, max_size=3)
trees = st.recursive(
    st.integers(), lambda inner: st.dictionaries(names, inner, max_size=3)
)


@given(
    st.dictionaries(names, trees, max_size=3), st.lists(names, min_size=1, max_size=4)
)
def test_only_the_place_that_is_given_changes(
    tree: dict[str, Any], steps: list[str]
) -> None:
    spec = NodeSpec(kind="any", parameters=tree)
    place = "node." + ".".join(steps)
    branch: Any = tree
    for step in steps[:-1]:
        branch = branch.get(step, {}) if isinstance(branch, dict) else branch
    if not isinstance(branch, dict):  # a number is on the way
        with pytest.raises(ParameterError, match="which has no names below"):
            with_parameters({"node": spec}, {place: "new"}, "file")
        return
    changed = with_parameters({"node": spec}, {place: "new"}, "file")["node"].parameters

    def flat(branch: Any, path: tuple[str, ...] = ()) -> dict[tuple[str, ...], Any]:
        if not isinstance(branch, dict):
            return {path: branch}
        return {
            inner: value
            for key, below in branch.items()
            for inner, value in flat(below, (*path, key)).items()
        }

    wanted = {
        path: value
        for path, value in flat(tree).items()
        if path[: len(steps)] != (*steps,)
    }
    assert flat(changed) == {**wanted, tuple(steps): "new"}
    assert spec.parameters == tree  # the file's own is left alone


def test_a_law_of_a_preset_s_name_takes_parameters() -> None:
    nodes = {
        "c": NodeSpec(kind="coupling", parameters={"laws": {"best": "paper_optimum"}})
    }
    found = with_parameters(nodes, {"c.laws.best.stiffness": 800.0}, "file")[
        "c"
    ].parameters
    assert found["laws"]["best"] == {"kind": "paper_optimum", "stiffness": 800.0}


def test_python_gives_parameters_flat_or_nested_and_leaves_nodes_out() -> None:
    flat = haptic.play("floor_drop", params={"driver.device.mass": np.float64(0.2)})
    nested = haptic.play(
        "floor_drop", params={"driver": {"device": {"mass": 0.2}}}, without=["logger"]
    )
    assert np.array_equal(flat.position_m, nested.position_m)
    # It rests where gravity and the spring balance, on H(1) = K of a PD: 1000 N/m by default.
    assert flat.position_m[-1] == pytest.approx(-0.2 * GRAVITY / 1000, rel=1e-3)
    with pytest.raises(ParameterError, match="no node 'nobody'"):
        haptic.play("floor_drop", without=["nobody"])


def test_gain_is_the_damping_of_a_launch_s_laws() -> None:
    by_gain = launch_file.read("floor_drop", {"gain": 4.0})
    assert by_gain.nodes == launch_file.read("floor_drop", {"damping": 4.0}).nodes
    with pytest.raises(ParameterError, match="no argument 'gain'"):
        launch_file.read("floor_drop", {"gain": 4.0, "damping": 3.0})


def test_a_table_of_a_play_has_the_names_of_its_recording() -> None:
    played = haptic.play("floor_drop", duration=0.1)
    columns = played.columns()
    assert np.array_equal(columns["position_z"], played.measured_m)
    assert np.array_equal(columns["force_z"], played.force_n)
    both = haptic.play("sphere_feel", duration=0.1)
    assert np.array_equal(both.columns()["proxy_y"], both.proxy_m[:, 1])
