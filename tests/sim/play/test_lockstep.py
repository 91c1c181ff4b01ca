"""Whoever plays a scene plays the same: four processes, plain or compiled, one process, compiled or interpreted, a replay.

This test holds the project together: what a study computes in one process is what the loop renders.
Equality is exact, not within a tolerance, because all call the same functions on the same floats in
the same order.
"""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import numpy as np
import pytest

from messages.topics import DEVICE_STATE, FORCE, PROXY
from nodes.cli.main import main
from nodes.compiled.choose_tick import choose
from nodes.launcher import launch_file
from nodes.recording.accounts import accounts
from nodes.recording.reader import Recording
from sim.cli.bench.loop import KERNELS
from sim.identify.counterfactual import replay
from sim.identify.recorded_scene import rebuild
from sim.play.launched import from_launch
from tests.support.launching import haptic, launch_json, running, wait_for

SHORT = "duration:=1.2"
VARIANTS = (
    ("floor_drop", "apply:=next_tick", "law:=multi_term"),
    ("floor_drop", "law:=pd_alpha", "rate:=1000"),
    ("floor_buzz", "apply:=next_tick", "law:=pd_alpha"),
    ("wall_press", "delay:=1.3", "law:=multi_term"),
    ("wall_press", "delay:=0.4", "apply:=next_tick"),
    ("floor_drop", "law:=designed_d0"),
    # Unstable: the driver's limits of force and slew act.
    ("floor_drop", "stiffness:=1e6", "damping:=0", "law:=pd"),
    ("floor_drop", "law:=designed_d1", "apply:=next_tick"),
    # So unstable that the driver stops.
    ("floor_buzz", "stiffness:=1e5", "law:=pd"),
    ("floor_guarded", "apply:=next_tick", "latency:=0.6"),
    ("identify", "apply:=next_tick", "delay:=1.3"),
    # The device falls to the end of its workspace.
    ("floor_drop", "stiffness:=2"),
)
"""Beyond each scenario as it stands: every law, quantiser and friction, whole and fractional delay, both rules of apply."""

LAUNCHES = {name: launch_file.read(name, {}) for name in launch_file.scenarios()}
PLAYED = [
    name
    for name, one in LAUNCHES.items()
    if len(one.run.axes) == 1
    and "coupling" in one.nodes
    and "ros2" not in one.nodes
    and one.nodes["driver"].kind == "sim_driver"
    and one.nodes["environment"].kind != "world"
]
"""One process plays one axis of one chain; scenes of three axes are compared in test_touch_launched, bodies to feel in
tests/nodes/environment/test_world.py. The chain on a ROS 2
graph is touch_wall's own; two devices on one law live in real time."""

WORDS = [(name,) for name in PLAYED] + list(VARIANTS)
ALIKE = {
    ("two_loggers",),
    ("floor_drop", "law:=designed_d0"),
    ("floor_drop", "law:=designed_d1", "apply:=next_tick"),
    ("floor_drop", "law:=pd_alpha", "rate:=1000"),
}
"""Of these the plain tick alone: compiled they run the code of floor_drop and its multi_term, beside two loggers and with taps
of other values; pd_alpha is compiled in floor_buzz, another rate in floor_drop_fast."""

QUICK = {("floor_drop",), ("touch_wall",), ("floor_guarded",)}
"""Of these the plain tick is tried in every run."""

OFTEN = {*((name,) for name in PLAYED), *VARIANTS[:5]}
"""Of these the compiled one."""


@pytest.fixture(scope="module", autouse=True)
def compiled_before() -> None:
    """Compile the ticks before the clock of a launch runs."""
    told: list[str] = []
    assert choose("compiled", KERNELS, told.append) == "compiled", told


def bits(values: list[float]) -> list[int]:
    return [int(v) for v in np.array(values).view(np.int64)]


@pytest.mark.process
@pytest.mark.smoke(
    "floor_guarded-compiled",
    "floor_swap-compiled",
    "wall_press delay:=1.3 law:=multi_term-compiled",
)
@pytest.mark.parametrize(
    ("words", "tick"),
    [
        pytest.param(
            words,
            tick,
            id=f"{' '.join(words)}-{tick}",
            marks=[pytest.mark.slow] * (words not in (QUICK if tick == "plain" else OFTEN)),
        )
        for words in WORDS
        for tick in ("plain", "compiled")
        if tick == "plain" or words not in ALIKE
    ],
)
def test_every_player_gives_the_same_bits(
    words: tuple[str, ...], tick: str, tmp_path: Path
) -> None:
    _, arguments = launch_file.read_arguments(launch_file.find(words[0]))
    duration = [] if words[0] == "floor_swap" or "duration" not in arguments else [SHORT]
    assert_same_bits(tmp_path, words[0], *words[1:], *duration, tick=tick)


def assert_same_bits(
    tmp_path: Path,
    scenario: str,
    *assignments: str,
    laid_over: tuple[Path, ...] = (),
    tick: str = "auto",
) -> None:
    given = launch_file.parse_assignments([*assignments, "pace:=lockstep"])
    played = from_launch(launch_file.read(scenario, given, laid_over))
    trace = played.play()

    options = [word for path in laid_over for word in ("--params", str(path))]
    figures = launch_json(
        tmp_path, scenario, *assignments, "pace:=lockstep", "--tick", tick, *options
    )
    assert tick in ("auto", figures["tick"])

    recording = Recording(tmp_path / figures["recording"])
    states = recording.messages(DEVICE_STATE)
    ticks = played.ticks
    assert figures["ticks"] == ticks
    # One state a tick, and a last one that tells where the device came to rest.
    assert [state.seq for state in states] == list(range(ticks + 1))
    axis = played.axis
    assert bits([state.position[axis] for state in states[:ticks]]) == bits(list(trace.measured))
    assert bits([state.force[axis] for state in states[1:]]) == bits(list(trace.force))
    forces = recording.messages(FORCE)
    assert [force.seq for force in forces] == list(range(ticks + 1))
    if tick == "compiled":
        # A recording is the same whatever its tick was: its replay, and the interpreted loop, need
        # one of them.
        return
    interpreted = played.play(interpreted=True)
    same = replay(rebuild(recording.path))
    for name, values in (("measured", trace.measured), ("force", trace.force)):
        assert bits(list(getattr(interpreted, name))) == bits(list(values))
        assert bits(list(getattr(same, name)[:ticks])) == bits(list(values))


@pytest.mark.process
@pytest.mark.parametrize("tick", ["plain", "compiled"])
def test_a_device_that_comes_to_the_end_of_its_workspace_stops_there(
    tick: str, tmp_path: Path
) -> None:
    """With friction and an encoder, on the outermost count inside; a soft floor lets it down so far."""
    narrow = tmp_path / "narrow.yaml"
    narrow.write_text(
        "driver: {safety: {workspace: [[-1, 1], [-1, 1], [-0.0009, 0.1]]}}", encoding="utf-8"
    )
    words = ("floor_buzz", "stiffness:=50", "law:=pd", "apply:=next_tick", SHORT)
    assert_same_bits(tmp_path, *words, laid_over=(narrow,), tick=tick)
    trace = from_launch(
        launch_file.read(words[0], launch_file.parse_assignments([*words[1:]]), (narrow,))
    ).play()
    # 39.1 counts of 2.3e-5 m; without the stop it would rest 20 mm deep.
    assert trace.measured.min() == -39 * 2.3e-5
    assert np.count_nonzero(trace.measured == -39 * 2.3e-5) > 100


@pytest.mark.process
@pytest.mark.parametrize("tick", ["plain", "compiled"])
def test_a_driver_that_limits_and_never_stops_does_the_same_everywhere(
    tick: str, tmp_path: Path
) -> None:
    """Where a driver may stop, one process plays its very rules; here it is the fast loop that limits slew and peak."""
    hard = tmp_path / "hard.yaml"
    hard.write_text(
        "{driver: {safety: {slew: 500.0, stop_after: null}}, coupling: {stability: warn}}",
        encoding="utf-8",
    )
    words = ("floor_drop", "stiffness:=1e5", "damping:=0", SHORT)
    assert_same_bits(tmp_path, *words, laid_over=(hard,), tick=tick)
    force = (
        from_launch(
            launch_file.read(words[0], launch_file.parse_assignments([*words[1:]]), (hard,))
        )
        .play()
        .force
    )
    # 500 N/s are 1 N a tick; the peak is that of the scenario.
    changes = np.abs(np.diff(force, prepend=0.0))
    assert np.count_nonzero(changes == 1.0) > 10
    assert changes.max() <= 1.0 + 40.0 * np.finfo(float).eps


@pytest.mark.slow
def test_designs_that_were_just_made_are_rendered_bit_for_bit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """What ``haptic study design`` writes starts any scenario with a coupling: here both of its files, one over the other."""
    words = ("--mass", "0.1", "--taps", "3", "--delay", "1", "--out", str(tmp_path), "--json")
    assert main(["study", "design", *words]) == 0
    made = json.loads(capsys.readouterr().out)
    files = tuple(Path(made[which]["yaml"]) for which in ("passive", "designed"))
    launch = launch_file.read("floor_drop", {}, files)
    laws = launch.nodes["coupling"].parameters["laws"]
    assert launch.nodes["coupling"].parameters["law"] == "designed"
    assert laws["designed"]["taps"] == made["designed"]["taps_n_per_m"]
    assert {"pd", "pd_alpha", "multi_term", "passive"} < set(laws)
    assert_same_bits(tmp_path, "floor_drop", "apply:=next_tick", SHORT, laid_over=files)


@pytest.mark.process
def test_files_of_parameters_are_checked_before_anything_starts(tmp_path: Path) -> None:
    for text, told in (
        ("coupling: {law: spring}", "coupling.law: no law is named 'spring'"),
        (
            "couplng: {law: pd}",
            "has no node 'couplng'; available: driver, environment, coupling, logger",
        ),
        ("coupling: pd", "given.yaml.coupling: expected a mapping of parameters, got 'pd'"),
        ("[1, 2]", "given.yaml: expected a mapping from node to parameters"),
        ("driver: {device: {mass: -1.0}}", "driver.device.mass"),
    ):
        (tmp_path / "given.yaml").write_text(text, encoding="utf-8")
        assert (
            told
            in haptic(tmp_path, "launch", "floor_drop", "--params", "given.yaml", code=2).stderr
        )
    assert (
        "elsewhere.yaml"
        in haptic(tmp_path, "launch", "floor_drop", "--params", "elsewhere.yaml", code=2).stderr
    )


@pytest.mark.process
def test_lockstep_twice_gives_the_same_recording(tmp_path: Path) -> None:
    found = []
    for part in ("one", "two"):
        folder = tmp_path / part
        folder.mkdir()
        figures = launch_json(folder, "floor_buzz", SHORT, "pace:=lockstep")
        states = Recording(folder / figures["recording"]).messages(DEVICE_STATE)
        found.append(
            [
                (state.seq, state.stamp, state.position, state.force, state.energy)
                for state in states
            ]
        )
    assert found[0] == found[1]


@pytest.mark.process
@pytest.mark.smoke("coupling")
@pytest.mark.parametrize("node", ["environment", "coupling"])
def test_a_question_asked_again_is_recorded_once(node: str, tmp_path: Path) -> None:
    """A machine under load stalls a node for longer than the driver waits; it asks again, and both questions are answered."""
    with running(tmp_path, "two_loggers", "duration:=0", "pace:=lockstep") as launch:
        stalled = launch.call(node, "status")["pid"]
        os.kill(stalled, signal.SIGSTOP)
        try:
            wait_for(lambda: "publishing it again" in launch.errors, "the driver asks again")
            asked = launch.call("driver", "progress")["tick"]
        finally:
            os.kill(stalled, signal.SIGCONT)
        # Both answers are there: the one that was waited for, and the one that nobody waits for any
        # more.
        wait_for(
            lambda: launch.call("driver", "progress")["tick"] > asked + 100, "the loop to go on"
        )
        figures = launch.finish(signal.SIGINT)
    for path in figures["recordings"]:
        recording = Recording(tmp_path / path)
        kept = accounts(recording)
        for topic in (DEVICE_STATE, PROXY, FORCE):
            seqs = [message.seq for message in recording.messages(topic)]
            assert seqs == sorted(set(seqs))
            # A logger that is starved may lose messages, and counts them where it records all
            # topics of their sender.
            sender = kept.get({PROXY: "environment", FORCE: "coupling"}.get(topic, "driver"))
            assert sender is None or sender.lost == figures["ticks"] + 1 - len(seqs)
