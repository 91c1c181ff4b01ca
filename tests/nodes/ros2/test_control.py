"""Parameters and laws of a chain as a ROS 2 graph sees and changes them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

import nodes.ros2.chain_control as chain_control
from messages.errors import FORCE, RefusedError, Remedy
from nodes.launcher import launch_file
from nodes.launcher.runs import RunInfo
from nodes.ros2.chain_control import ChainControl, ros_values
from nodes.ros2.graph import Trigger
from tests.support.setups import setup_of

FACTORIES = {
    "driver": "sim.device.driver:SimDriver",
    "environment": "nodes.environment.node:Environment",
    "coupling": "nodes.coupling.node:Coupling",
}


class Shown:
    """A graph that keeps what it is shown and offered."""

    def __init__(self) -> None:
        self.values: dict[str, Any] = {}
        self.texts: dict[str, str] = {}
        self.requests: dict[str, Trigger] = {}
        self.times = 0

    def serve(self, change: object) -> bool:
        """Serve."""
        del change
        return True

    def show(self, values: Mapping[str, Any], about: Callable[[str], str]) -> None:
        """Store parameters and their descriptions."""
        self.values, self.times = dict(values), self.times + 1
        self.texts = {name: about(name) for name in values}

    def offer(self, requests: Mapping[str, Trigger]) -> None:
        """Store services."""
        self.requests = dict(requests)


def trees() -> dict[str, Any]:
    """Return the parameters of a chain as its nodes would dump them."""
    launch = launch_file.read("touch_wall", {"stiffness": 800})
    found = {name: launch.nodes[name].parameters for name in FACTORIES}
    return msgspec.json.decode(msgspec.json.encode(found))  # type: ignore[no-any-return]


def control(graph: Shown, dump: Any, refusal: str = "") -> ChainControl:
    setups = {
        name: setup_of(name=name, factory=place) for name, place in FACTORIES.items()
    }
    run = RunInfo(run="r", scenario="s", launcher=1, nodes=setups)
    return ChainControl(graph, run, {name: name for name in setups}, dump, refusal)  # type: ignore[arg-type]


def test_what_a_node_has_is_shown_until_it_is_different() -> None:
    graph, now = Shown(), trees()
    now["coupling"]["laws"]["pd"]["stiffness"] = 800
    made = control(graph, lambda node: now[node])
    assert made.refresh()
    stiffness = graph.values["coupling.laws.pd.stiffness"]
    # Written as a whole number; ROS would take a type of its own for it.
    assert (stiffness, type(stiffness)) == (800.0, float)
    text = graph.texts["coupling.laws.pd.stiffness"]
    assert text == "K [N/m]; above 0; number"
    assert not made.refresh()
    assert graph.times == 1
    now["coupling"] = {**now["coupling"], "law": "pd_alpha"}
    assert made.refresh()
    assert graph.values["coupling.law"] == "pd_alpha"
    made.offer_laws()
    assert {"law/pd", "law/pd_alpha"} <= graph.requests.keys()


def test_a_node_that_does_not_answer_keeps_what_it_had() -> None:
    graph, now, silent = Shown(), trees(), list[str]()

    def dump(node: str) -> Any:
        if node in silent:
            raise RefusedError(f"{node} does not answer")
        return now[node]

    made = control(graph, dump)
    made.refresh()
    before = dict(graph.values)
    silent.append("coupling")
    assert not made.refresh()
    now["driver"] = {**now["driver"], "preset": "none of them"}
    assert made.refresh()
    assert graph.values == before | {"driver.preset": "none of them"}


def test_the_graph_changes_one_node_at_once_in_the_names_of_the_project(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked: list[Any] = []

    def ask(run: RunInfo, node: str, op: str, **args: Any) -> Any:
        asked.append((node, op, args))
        if args.get("law") == "quark":
            refusal = RefusedError("coupling.law: unstable")
            raise refusal.with_remedies(Remedy(FORCE, "to study it, use --force"))
        return {"seq": 7, "force_step_n": 0.25}

    monkeypatch.setattr(chain_control, "ask", ask)
    now = trees()
    now["coupling"]["laws"] |= {"quark": {"kind": "pd"}, "a__b": {}, "µ": {}}
    graph = Shown()
    made = control(graph, now.__getitem__)
    made.refresh()
    both = {"coupling.laws.pd.stiffness": 700, "coupling.laws.pd.damping": 2.0}
    assert made.change(both) == ""
    paths = {"laws.pd.stiffness": 700, "laws.pd.damping": 2.0}
    assert asked == [("coupling", "param.set", {"values": paths})]
    refused = made.change({"driver.device.mass": 0.2, "coupling.law": "pd"})
    assert "coupling and driver cannot be set at once" in refused
    assert "cannot be removed" in made.change({"coupling.law": None})
    assert len(asked) == 1
    made.offer_laws()
    # Names that ROS does not have are not offered.
    assert not {"law/a__b", "law/µ"} & graph.requests.keys()
    assert graph.requests["law/pd"]() == (True, "pd from tick 7 on, force step 0.25 N")
    done, why = graph.requests["law/quark"]()
    assert (done, why) == (
        False,
        "coupling.law: unstable; to study it anyway, use haptic param set --force",
    )


def test_without_control_it_reads_and_changes_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(chain_control, "ask", lambda *_, **__: pytest.fail("asked"))
    graph = Shown()
    made = control(graph, trees().__getitem__, refusal="ros2: the graph may only read")
    made.refresh()
    made.offer_laws()
    assert graph.values["coupling.law"] == "pd"
    assert made.change({"coupling.law": "pd_alpha"}) == "ros2: the graph may only read"
    assert graph.requests["law/pd"]() == (False, "ros2: the graph may only read")


PLAIN = (
    st.none() | st.booleans() | st.integers(-(1 << 70), 1 << 70) | st.text(max_size=3)
)
VALUE = st.recursive(
    PLAIN | st.floats(allow_nan=False),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=6,
)


@given(st.dictionaries(st.sampled_from("abc"), VALUE))
def test_every_value_that_is_shown_has_one_ros_type(tree: dict[str, Any]) -> None:
    shown = ros_values({"node": tree})
    for name, value in shown.items():
        given_value = tree[name.removeprefix("node.")]
        items = value if isinstance(value, list) else [value]
        (kind,) = {type(item) for item in items}
        assert kind in (bool, int, float, str)
        assert kind is not int or all(-(1 << 63) <= item < 1 << 63 for item in items)
        # A whole number beyond 64 bits is a double, good to 2^-53.
        given_items = given_value if isinstance(value, list) else [given_value]
        for item, whole in zip(items, given_items, strict=True):
            assert item == (
                whole
                if kind in (str, bool)
                else pytest.approx(whole, rel=2**-52, abs=0.0)
            )
    for name, value in tree.items():
        is_plain = isinstance(value, (bool, int, float, str))
        assert (f"node.{name}" in shown) or not is_plain
