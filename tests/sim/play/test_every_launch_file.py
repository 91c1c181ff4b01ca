"""Every player of a launch file gives the same bits: processes, one process, replay.

This contract holds the project together: what a study computes in one process, or a replay, is what
the loop renders. It covers every installed launch file. Equality is exact, not within a tolerance,
because all call the same functions on the same floats in the same order.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import yaml

from messages.topics import DEVICE_STATE, FORCE, PROXY
from nodes.compiled.choose_tick import choose
from nodes.launcher import launch_file, scenario_files
from nodes.launcher.launch_spec import Launch, NodeSpec, unusual
from nodes.launcher.wiring import chains_of
from nodes.parameters.store import ParameterError
from nodes.recording.reader import Recording
from sim.cli.bench.loop import KERNELS
from sim.identify.counterfactual import replay
from sim.identify.recorded_scene import rebuild
from sim.play.player import How, play, play_launch
from sim.play.trace import ChainTrace
from tests.support import slowly
from tests.support.launching import launch_json

SECONDS = 1.2
"""Of each launch, but of those that say why not."""

LONGER = {"floor_swap": 4.3, "puck_push": 1.6, "stack_boxes": 1.6, "knob_turn": 1.6}
"""Until the last swap is over, and until something is pushed."""

APART = {"hands_apart": "hears a partner over a network in real time"}
"""What one process does not play, and why it says so."""

LISTENS = {"ros2"}
"""Kinds that need what is not installed, and only listen unless somebody pushes."""

VARIANTS: tuple[tuple[str, dict[str, Any]], ...] = (
    ("floor_drop", {"apply": "next_tick", "law": "multi_term"}),
    ("floor_drop", {"law": "pd_alpha", "rate": 1000.0}),
    ("floor_buzz", {"apply": "next_tick", "law": "pd_alpha"}),
    ("wall_press", {"delay": 1.3, "law": "multi_term"}),
    ("wall_press", {"delay": 0.4, "apply": "next_tick"}),
    ("hands_coupled", {"apply": "next_tick", "law": "multi_term"}),
    ("rough_plane", {"friction": 0.4}),
    ("knob_turn", {"apply": "next_tick"}),
    ("floor_drop", {"law": "designed_d0"}),
    ("reach", {"field": "viscous", "gain": 40.0, "apply": "next_tick"}),
    # Unstable: the driver's limits of force and slew act.
    ("floor_drop", {"stiffness": 1e6, "damping": 0.0, "law": "pd"}),
    ("floor_drop", {"law": "designed_d1", "apply": "next_tick"}),
    # So unstable that the driver stops.
    ("floor_buzz", {"stiffness": 1e5, "law": "pd"}),
    ("floor_guarded", {"apply": "next_tick", "latency": 0.6}),
    ("identify", {"apply": "next_tick", "delay": 1.3}),
    # The device falls to the end of its workspace.
    ("floor_drop", {"stiffness": 2.0}),
)
"""Beyond the files: every law, quantiser, friction, delay and rule of apply."""

EVERY = [
    (name, dict[str, Any]()) for name in scenario_files.scenarios() if name not in APART
]
CASES = [*EVERY, *VARIANTS]
# Launched in every run, with the plain tick; the rest is launched on request.
QUICK: list[tuple[str, dict[str, Any]]] = [
    ("floor_drop", {}),
    ("floor_guarded", {}),
    ("hands_coupled", {}),
    ("two_hands", {}),
]
# Launched in every run, with the compiled one.
OFTEN = [*EVERY, *VARIANTS[:6]]
ALIKE = ("two_loggers", "ros2_wall")
"""Compiled they run the code of floor_drop and touch_wall."""


def case_id(case: tuple[str, dict[str, Any]]) -> str:
    return " ".join([case[0], *(f"{name}:={value}" for name, value in case[1].items())])


def in_lockstep(name: str, given: Mapping[str, Any]) -> Launch:
    """Read a launch file in lockstep for a duration, with or without such arguments."""
    launch = launch_file.read(
        name,
        {**given, "run.pace": "lockstep"}
        if "pace" not in arguments(name)
        else {**given, "pace": "lockstep"},
    )
    nodes = {
        node: spec for node, spec in launch.nodes.items() if spec.kind not in LISTENS
    }
    run = msgspec.structs.replace(launch.run, duration=LONGER.get(name, SECONDS))
    return msgspec.structs.replace(launch, run=run, nodes=nodes)


@cache
def arguments(name: str) -> frozenset[str]:
    return frozenset(scenario_files.read_arguments(scenario_files.find(name))[1])


def written(launch: Launch, folder: Path) -> Path:
    """Write a launch out, without arguments, so that processes start exactly that."""
    nodes = {name: unusual(spec) for name, spec in launch.nodes.items()}
    run = {**unusual(launch.run), "axes": []}
    if not launch.axes:
        run["axes"] = list(launch.run.axes)
    path = folder / f"{launch.scenario}.yaml"
    path.write_text(
        yaml.safe_dump({"summary": "A copy.", "run": run, "nodes": nodes}),
        encoding="utf-8",
    )
    return path


def bits(values: Any) -> Any:
    return np.ascontiguousarray(values, dtype=np.float64).view(np.int64)


def rows(trace: ChainTrace) -> dict[str, Any]:
    names = (
        "position",
        "velocity",
        "measured",
        "deflection",
        "proxy",
        "normal",
        "force",
        "final",
    )
    found = {name: bits(getattr(trace, name)) for name in names}
    return {**found, "contact": trace.contact, "law": np.array(trace.law)}


def needs_mujoco(launch: Launch) -> None:
    if (
        "mujoco" in {spec.kind for spec in launch.nodes.values()}
        and find_spec("mujoco") is None
    ):
        pytest.skip("the extra is not installed: pip install 'haptic-nodes[mujoco]'")


@pytest.mark.parametrize("case", CASES, ids=case_id)
def test_however_one_process_plays_it_all_columns_have_the_same_bits(
    case: tuple[str, dict[str, Any]],
) -> None:
    """By the nodes, by the loop of one axis where it is chosen, and by that interpreted."""
    launch = in_lockstep(*case)
    needs_mujoco(launch)
    ways: tuple[How, ...] = ("fastest", "interpreted", "nodes")
    for chain in chains_of(launch):
        several = len(launch.axes.get(chain) or launch.run.axes) > 1
        first, *others = (
            rows(play(launch, chain, how=how))
            for how in (ways[:1] if several else ways)
        )
        assert np.abs(first["force"]).max() > 0 or case[0] == "free_space"
        for other in others:
            for name, values in first.items():
                assert np.array_equal(values, other[name]), name


@pytest.mark.parametrize("name", APART)
def test_what_one_process_does_not_play_is_refused_by_the_node_that_it_is_about(
    name: str,
) -> None:
    launch = launch_file.read(name, {})
    with pytest.raises(ParameterError, match=APART[name]) as refused:
        play_launch(launch)
    assert str(refused.value).startswith("left/environment: ")


@pytest.mark.parametrize(
    ("node", "spec", "told"),
    [
        (
            "driver",
            NodeSpec(kind="touch_driver"),
            "driver: touch_driver drives a real device",
        ),
        ("environment", None, "0 nodes publish /environment/proxy"),
        ("coupling", None, "0 nodes publish /coupling/force"),
    ],
)
def test_a_chain_that_is_none_is_refused_by_name(
    node: str, spec: NodeSpec | None, told: str
) -> None:
    launch = launch_file.read("floor_drop", {})
    nodes = {**launch.nodes, **({} if spec is None else {node: spec})}
    if spec is None:
        del nodes[node]
    with pytest.raises(ParameterError, match=told):
        play(msgspec.structs.replace(launch, nodes=nodes))


def test_two_chains_are_played_by_name() -> None:
    launch = launch_file.read("two_hands", {})
    with pytest.raises(
        ParameterError, match="2 chains \\(left, right\\); name one of them"
    ):
        play(launch)
    both = play_launch(launch, ticks=200)
    assert list(both) == ["left", "right"]
    assert [trace.axes for trace in both.values()] == [(2,), (0,)]


@pytest.fixture(scope="module")
def compiled_before() -> None:
    """Compile the ticks before the clock of a launch runs."""
    told: list[str] = []
    kernels = (*KERNELS, "nodes.environment.shapes.kernel")
    assert choose("compiled", kernels, told.append) == "compiled", told


@pytest.mark.process
@pytest.mark.smoke("floor_guarded", "floor_swap", "mesh_pebble", "two_hands")
@pytest.mark.usefixtures("compiled_before")
@pytest.mark.parametrize(
    "case",
    slowly([case for case in CASES if case[0] not in ALIKE], but=OFTEN),
    ids=case_id,
)
def test_processes_with_the_compiled_tick_give_the_bits_of_one_process(
    case: tuple[str, dict[str, Any]], tmp_path: Path
) -> None:
    assert_launched(in_lockstep(*case), "compiled", tmp_path)


@pytest.mark.process
@pytest.mark.smoke("hands_coupled")
@pytest.mark.parametrize("case", slowly(CASES, but=QUICK), ids=case_id)
def test_processes_with_the_plain_tick_and_a_replay_give_the_bits_of_one_process(
    case: tuple[str, dict[str, Any]], tmp_path: Path
) -> None:
    launch = in_lockstep(*case)
    recordings = assert_launched(launch, "plain", tmp_path)
    kinds = {spec.kind for spec in launch.nodes.values()}
    if len(recordings) > 1 or not kinds <= {
        "sim_driver",
        "environment",
        "coupling",
        "logger",
    }:
        return
    trace = play(launch)
    if len(trace.axes) == 1:
        same = replay(rebuild(recordings[0]))
        for name, values in (("measured", same.measured), ("force", same.force)):
            assert np.array_equal(
                bits(values[: trace.ticks]), bits(getattr(trace.along(), name))
            ), name


def assert_launched(launch: Launch, tick: str, folder: Path) -> list[Path]:
    """Launch in lockstep, compare each chain with one process, return the recordings."""
    needs_mujoco(launch)
    figures = launch_json(folder, str(written(launch, folder)), "--tick", tick)
    paths = [
        folder / path for path in figures.get("recordings") or [figures["recording"]]
    ]
    # Each logger of two_loggers has the whole loop; each chain of a launch its own logger, which
    # names topics as if the chain were alone.
    for chain, path in zip(chains_of(launch), paths, strict=False):
        trace, recording = play(launch, chain), Recording(path)
        states, proxies, forces = (
            recording.messages(topic) for topic in (DEVICE_STATE, PROXY, FORCE)
        )
        # One state a tick, and a last one that tells where the device came to rest.
        assert [state.seq for state in states] == list(range(trace.ticks + 1))
        for name, values in (
            ("measured", [state.position for state in states[:-1]]),
            ("force", [state.force for state in states[1:]]),
            ("proxy", [proxy.proxy for proxy in proxies[:-1]]),
            ("normal", [proxy.normal for proxy in proxies[:-1]]),
        ):
            assert np.array_equal(bits(values), bits(getattr(trace, name))), (
                chain,
                name,
            )
        assert [proxy.contact for proxy in proxies[:-1]] == trace.contact.tolist()
        assert tuple(force.law for force in forces[:-1]) == trace.law
    return paths
