"""A lockstep launch beyond test_every_launch_file: ends, limits, files, lost answers."""

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
from nodes.launcher import launch_file, scenario_files
from nodes.recording.accounts import accounts
from nodes.recording.reader import Recording
from sim.cli.bench.loop import KERNELS
from sim.play.player import play
from tests.support.launching import haptic, launch_json, running, wait_for

SHORT = "duration:=1.2"


@pytest.fixture(scope="module", autouse=True)
def compiled_before() -> None:
    """Compile the ticks before the time limit of a launch starts."""
    told: list[str] = []
    assert choose("compiled", KERNELS, told.append) == "compiled", told


def bits(values: list[float]) -> list[int]:
    return [int(v) for v in np.array(values).view(np.int64)]


def assert_same_bits(
    tmp_path: Path,
    scenario: str,
    *assignments: str,
    laid_over: tuple[Path, ...] = (),
    tick: str = "auto",
) -> None:
    given = scenario_files.parse_assignments([*assignments, "pace:=lockstep"])
    trace = play(launch_file.read(scenario, given, laid_over)).along()

    options = [word for path in laid_over for word in ("--params", str(path))]
    figures = launch_json(
        tmp_path, scenario, *assignments, "pace:=lockstep", "--tick", tick, *options
    )
    assert tick in ("auto", figures["tick"])
    states = Recording(tmp_path / figures["recording"]).messages(DEVICE_STATE)
    ticks = len(trace.force)
    assert figures["ticks"] == ticks
    # One state a tick, and a last one that tells where the device came to rest.
    assert [state.seq for state in states] == list(range(ticks + 1))
    assert bits([state.position[2] for state in states[:ticks]]) == bits(
        list(trace.measured)
    )
    assert bits([state.force[2] for state in states[1:]]) == bits(list(trace.force))


@pytest.mark.process
@pytest.mark.parametrize("tick", ["plain", "compiled"])
def test_a_device_that_comes_to_the_end_of_its_workspace_stops_there(
    tick: str, tmp_path: Path
) -> None:
    """With friction and encoder, at the outermost count inside, over a soft floor."""
    narrow = tmp_path / "narrow.yaml"
    narrow.write_text(
        "driver: {safety: {workspace: [[-1, 1], [-1, 1], [-0.0009, 0.1]]}}",
        encoding="utf-8",
    )
    words = ("floor_buzz", "stiffness:=50", "law:=pd", "apply:=next_tick", SHORT)
    assert_same_bits(tmp_path, *words, laid_over=(narrow,), tick=tick)
    trace = play(
        launch_file.read(
            words[0], scenario_files.parse_assignments([*words[1:]]), (narrow,)
        )
    ).along()
    # 39.1 counts of 2.3e-5 m; without the stop it would rest 20 mm deep.
    assert trace.measured.min() == -39 * 2.3e-5
    assert np.count_nonzero(trace.measured == -39 * 2.3e-5) > 100


@pytest.mark.process
@pytest.mark.parametrize("tick", ["plain", "compiled"])
def test_a_driver_that_limits_and_never_stops_does_the_same_everywhere(
    tick: str, tmp_path: Path
) -> None:
    """The fast loop limits slew and peak by the driver's own rules."""
    hard = tmp_path / "hard.yaml"
    hard.write_text(
        "{driver: {safety: {slew: 500.0, stop_after: null}}, coupling: {stability: warn}}",
        encoding="utf-8",
    )
    words = ("floor_drop", "stiffness:=1e5", "damping:=0", SHORT)
    assert_same_bits(tmp_path, *words, laid_over=(hard,), tick=tick)
    launch = launch_file.read(
        words[0], scenario_files.parse_assignments([*words[1:]]), (hard,)
    )
    force = play(launch).along().force
    # 500 N/s are 1 N a tick; the peak is that of the scenario.
    changes = np.abs(np.diff(force, prepend=0.0))
    assert np.count_nonzero(changes == 1.0) > 10
    assert changes.max() <= 1.0 + 40.0 * np.finfo(float).eps


@pytest.mark.slow
def test_designs_that_were_just_made_are_rendered_bit_for_bit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Files of ``haptic study design`` start any scenario with a coupling."""
    words = (
        "--mass",
        "0.1",
        "--taps",
        "3",
        "--delay",
        "1",
        "--out",
        str(tmp_path),
        "--json",
    )
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
        (
            "coupling: pd",
            "given.yaml.coupling: expected a mapping of parameters, got 'pd'",
        ),
        ("[1, 2]", "given.yaml: expected a mapping from node to parameters"),
        ("driver: {device: {mass: -1.0}}", "driver.device.mass"),
    ):
        (tmp_path / "given.yaml").write_text(text, encoding="utf-8")
        assert (
            told
            in haptic(
                tmp_path, "launch", "floor_drop", "--params", "given.yaml", code=2
            ).stderr
        )
    assert (
        "elsewhere.yaml"
        in haptic(
            tmp_path, "launch", "floor_drop", "--params", "elsewhere.yaml", code=2
        ).stderr
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
    """A stalled node gets a repeated question, and answers both."""
    with running(tmp_path, "two_loggers", "duration:=0", "pace:=lockstep") as launch:
        stalled = launch.call(node, "status")["pid"]
        os.kill(stalled, signal.SIGSTOP)
        try:
            wait_for(
                lambda: "publishing it again" in launch.errors, "the driver asks again"
            )
            asked = launch.call("driver", "progress")["tick"]
        finally:
            os.kill(stalled, signal.SIGCONT)
        # Both answers are there: the one that was waited for, and the one that nobody waits for any
        # more.
        wait_for(
            lambda: launch.call("driver", "progress")["tick"] > asked + 100,
            "the loop to go on",
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
            sender = kept.get(
                {PROXY: "environment", FORCE: "coupling"}.get(topic, "driver")
            )
            assert sender is None or sender.lost == figures["ticks"] + 1 - len(seqs)
