"""Launch files and launcher: scenarios run, mistakes name their path, summaries are true."""

from __future__ import annotations

import json
import math
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from messages.topics import DEVICE_STATE, FORCE, PROXY
from nodes.cli import main
from nodes.driver.response_times import ResponseTimes
from nodes.launcher import launch_file, scenario_files
from nodes.launcher.wiring import wire
from nodes.parameters.store import ParameterError
from nodes.recording.reader import Recording
from nodes.recording.summary import summarise
from tests.support import slowly
from tests.support.launching import (
    DEADLINE,
    HAPTIC,
    assert_nothing_left,
    haptic,
    launch_json,
    private_runtime_dir,
)

PROMISED = {
    "scenario", "ticks", "missed", "rate_hz", "response_us", "age_ticks_max", "recording", "plot",
    "exit_reason", "final",
}  # fmt: skip

IN_LOCKSTEP = {
    *("box_edges", "floor_buzz", "floor_guarded", "floor_swap", "identify"),
    *("reach", "rough_plane", "sphere_feel", "touch_wall", "two_loggers", "world_feel"),
}
"""Scenarios that other tests launch in lockstep in every run (tests/sim/play)."""


def assert_summary_is_true(figures: dict[str, Any], states: list[Any]) -> None:
    """Compare the summary with the recorded ticks."""
    times = ResponseTimes()
    for state in states[1:]:
        if state.response > 0.0:
            times.add(state.response)
    assert figures["response_us"] == times.summary_us()
    assert figures["age_ticks_max"] == max(state.age for state in states)
    span = states[-1].stamp - states[0].stamp
    # The mean rate is of the deadlines; each end of the recorded span may have been woken late.
    late = states[0].lateness + states[-1].lateness
    assert (states[-1].seq - states[0].seq) / span == pytest.approx(
        figures["rate_hz"], rel=late / span + 1e-6
    )
    final = figures["final"]["position_m"]
    assert final in (*states[-1].position, list(states[-1].position))


@pytest.mark.process
@pytest.mark.smoke("floor_drop", "wall_press", "touch_wall")
@pytest.mark.parametrize(
    "scenario",
    [
        *slowly(sorted(IN_LOCKSTEP)),
        *sorted(scenario_files.scenarios().keys() - IN_LOCKSTEP),
    ],
)
def test_every_scenario_runs_in_real_time(scenario: str, tmp_path: Path) -> None:
    _, arguments = scenario_files.read_arguments(scenario_files.find(scenario))
    # Some run until they are stopped. One swaps its law, which it does here within the half second.
    words = ["duration:=0.5"] if "duration" in arguments else []
    words += ["first:=0.15", "second:=0.3"] if scenario == "floor_swap" else []
    figures = launch_json(tmp_path, scenario, *words)
    assert set(figures) >= PROMISED
    assert figures["exit_reason"] == "done"
    recording = Recording(tmp_path / figures["recording"])
    counts = recording.topics
    ticks = figures["ticks"] + figures["overruns"]
    assert counts[DEVICE_STATE].messages == figures["ticks"] + 1
    # What the driver itself could not sample is counted as an overrun; nothing else may be missing
    # from the record. A machine that is busy leaves out the first ticks, too: no gap, for nothing
    # stands before it.
    assert (
        counts[DEVICE_STATE].gaps + counts[DEVICE_STATE].first_seq
        == figures["overruns"]
    )
    states = recording.messages(DEVICE_STATE)
    assert states[-1].seq == ticks
    assert states[-1].missed == figures["missed"]
    if "chains" not in figures:
        assert_summary_is_true(figures, states)
        assert summarise(recording).response_us == figures["response_us"]
    if scenario == "free_space":
        assert {message.force for message in recording.messages(FORCE)} == {
            (0.0, 0.0, 0.0)
        }


@pytest.mark.process
def test_floor_drop_settles_at_weight_over_stiffness(tmp_path: Path) -> None:
    figures = launch_json(
        tmp_path, "floor_drop", "stiffness:=800", "mass:=0.08", "pace:=lockstep"
    )
    # 3 s are 60 time constants 2m/(b+B) = 50 ms: what is left of the bounce is below the rounding
    # of a micrometre.
    assert figures["final"]["position_m"] == pytest.approx(
        -0.08 * 9.81 / 800.0, rel=1e-9
    )
    assert figures["final"]["force_n"] == pytest.approx(0.08 * 9.81, rel=1e-9)
    recording = Recording(tmp_path / figures["recording"])
    for topic in (DEVICE_STATE, PROXY, FORCE):
        assert recording.topics[topic].gaps == 0
        assert recording.topics[topic].messages == figures["ticks"] + 1


@pytest.mark.process
def test_wall_press_reaches_the_balance_of_hand_and_wall(tmp_path: Path) -> None:
    figures = launch_json(tmp_path, "wall_press", "pace:=lockstep", "duration:=2.0")
    states = Recording(tmp_path / figures["recording"]).messages(DEVICE_STATE)
    # k_hand (0.03 − x) = K (x − 0.02): two springs in series.
    balance = (300.0 * 0.03 + 1000.0 * 0.02) / 1300.0
    # 1 s after the last corner, 8 time constants
    assert states[-1].position[0] == pytest.approx(balance, abs=1e-6)
    assert states[-1].force[0] == pytest.approx(-1000.0 * (balance - 0.02), abs=1e-3)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (
            ("flor_drop",),
            "no launch file is named 'flor_drop'; available: box_edges, floor",
        ),
        (("floor_drop", "stifness:=3"), "no argument 'stifness'; available: rate"),
        (
            ("floor_swap", "fifo:=0"),
            "no argument 'fifo'; run.fifo:=0 sets it in any launch file",
        ),
        (
            ("floor_drop", "stiffness:=soft"),
            "arguments.stiffness: expected a number, got 'soft' (given as stiffness:=soft)",
        ),
        (
            ("floor_drop", "rate:=1"),
            "floor_drop.yaml:3: arguments.rate: 1.0 Hz, limit: at least 50 Hz",
        ),
        (
            ("floor_drop", "pace:=slow"),
            "arguments.pace: 'slow', expected one of realtime, lockstep",
        ),
        (("nowhere.yaml",), "nowhere.yaml: no such file"),
        (("floor_drop", "--without", "camera"), "no node 'camera'; available: driver"),
    ],
)
def test_mistakes_are_told_with_path_value_and_limit(
    words: tuple[str, ...],
    told: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main.main(["launch", *words]) == 2
    assert told in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.process
@pytest.mark.smoke
@pytest.mark.parametrize(
    ("word", "told"),
    [
        ("mass:=-1", "driver.device.mass: expected a number above 0, got -1.0"),
        ("law:=spring", "coupling.law: no law is named 'spring'; available: pd"),
        ("stiffness:=-5", "coupling.laws.pd.stiffness"),
    ],
)
def test_mistakes_that_a_node_would_make_are_told_before_it_starts(
    word: str, told: str, tmp_path: Path
) -> None:
    done = haptic(tmp_path, "launch", "floor_drop", word, code=2)
    assert told in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.process
@pytest.mark.smoke
def test_mistakes_are_told_before_anything_is_compiled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    done = haptic(
        tmp_path, "launch", "floor_drop", "mass:=-1", "--tick", "compiled", code=2
    )
    assert "driver.device.mass: expected a number above 0, got -1.0" in done.stderr
    assert not (tmp_path / "cache").exists()


def test_launch_files_are_checked_completely(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    good = scenario_files.find("floor_drop").read_text(encoding="utf-8")
    broken = {
        "kind: sim_driver": (
            "kind: robot",
            "nodes.driver.kind: 'robot' is not installed",
        ),
        "kind: plane": (
            "kind: cone",
            "environment.surface.kind: 'cone' is not an installed surface",
        ),
        "mass: $(var mass)": ("mass: $(var speed)", "$(var speed) is not an argument"),
        "required: false": (
            "requird: false",
            "nodes.logger.requird: no such parameter; available: kind, ",
        ),
        "gravity: 9.81": ("gravity: .nan", "not a finite number"),
        "  logger:": ("  Logger!:", "a node's name has lower-case"),
    }
    for before, (after, told) in broken.items():
        path = tmp_path / "broken.yaml"
        path.write_text(good.replace(before, after, 1), encoding="utf-8")
        assert main.main(["launch", str(path)]) == 2
        assert told in capsys.readouterr().err


def test_arguments_keep_the_type_of_their_default() -> None:
    launch = launch_file.read("floor_drop", {"stiffness": 900})
    assert launch.arguments["stiffness"] == 900.0
    assert isinstance(launch.arguments["stiffness"], float)
    with pytest.raises(ParameterError, match="expected a number, got True"):
        launch_file.read("floor_drop", {"stiffness": True})


def test_listing_and_arguments_for_people_and_machines(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main.main(["launch", "--list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)
    assert set(listed["scenarios"]) == set(scenario_files.scenarios())
    assert main.main(["launch", "--show-args", "floor_drop"]) == 0
    assert "stiffness:=1000.0 N/m" in capsys.readouterr().out


def test_percentiles_are_those_of_the_values() -> None:
    times = ResponseTimes()
    # a permutation of 0.5 … 999.5 µs
    values = [(i * 7919 % 1000 + 0.5) * 1e-6 for i in range(1000)]
    for value in values:
        times.add(value)
    summary = times.summary_us()
    assert summary == {"p50": 500.0, "p99": 990.0, "p999": 999.0, "max": 999.5}
    assert math.isclose(times.longest, max(values))


def test_a_publisher_waits_for_every_subscription_of_the_launch(tmp_path: Path) -> None:
    """A logger of three topics must not count as three, or first messages are lost."""
    setups = wire(launch_file.read("two_loggers", {}), "r", tmp_path, {})
    # One by the next hop, one by the logger of everything, three by the logger of the loop's
    # topics.
    assert {
        name: setups[name].listeners for name in ("driver", "environment", "coupling")
    } == {"driver": 5, "environment": 5, "coupling": 5}
    assert setups["logger"].listeners == 3


def test_a_launch_past_the_edge_is_refused_on_a_real_device_only(
    tmp_path: Path,
) -> None:
    """A virtual device cannot break, and its page may go past the limit."""
    content = yaml.safe_load(
        scenario_files.find("touch_wall").read_text(encoding="utf-8")
    )
    content["nodes"]["driver"] = {"kind": "force_dimension_driver"}
    content["nodes"]["coupling"]["parameters"]["plant"] = {
        "mass": 0.15,
        "damping": 3.0,
        "stiffness": 150.0,
    }
    (tmp_path / "real.yaml").write_text(yaml.safe_dump(content), encoding="utf-8")

    def wired(scenario: str, stiffness: float) -> bool:
        return wire(
            launch_file.read(scenario, {"stiffness": stiffness}), "r", tmp_path, {}
        )["coupling"].virtual

    real = str(tmp_path / "real.yaml")
    assert not wired(real, 1000.0)
    with pytest.raises(
        ParameterError,
        match=r"laws\.pd: pole radius .* that is accepted is 5800; to start anyway, set .* to warn",
    ):
        wired(real, 900_000.0)
    assert wired("touch_wall", 900_000.0)


@pytest.mark.slow
def test_files_of_the_user_beside_the_recording_are_not_imported(
    tmp_path: Path,
) -> None:
    """A user's scripts must not replace modules that a node imports."""
    for name in ("sim", "messages", "nodes", "yaml", "zmq", "selectors"):
        (tmp_path / f"{name}.py").write_text(
            f"raise SystemExit('{name}.py of the user was imported')\n",
            encoding="utf-8",
        )
    with private_runtime_dir() as runtime_dir:
        done = subprocess.run(
            [
                Path(sys.executable).parent / "haptic",
                "launch",
                "floor_drop",
                "pace:=lockstep",
                "duration:=0.2",
                "--json",
            ],
            cwd=tmp_path,
            env={**os.environ, "HAPTIC_RUNTIME_DIR": str(runtime_dir)},
            capture_output=True,
            text=True,
            check=False,
            timeout=DEADLINE,
        )
        assert_nothing_left(runtime_dir)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout.splitlines()[-1])["exit_reason"] == "done"


# One more than the processors of a small machine.
LAUNCHES = min(5, len(os.sched_getaffinity(0)) + 1)


@pytest.mark.process
def test_launches_at_once_keep_apart_and_safe(tmp_path: Path) -> None:
    """More launches than processors in one runtime directory stay separate."""
    peak = 3.0
    processes = []
    with private_runtime_dir() as runtime:
        environment = {**os.environ, "HAPTIC_RUNTIME_DIR": str(runtime)}
        for number in range(LAUNCHES):
            folder = tmp_path / str(number)
            folder.mkdir()
            # Each its own: what it records tells whose forces it rendered.
            words = (
                "wall_press",
                "duration:=1",
                f"stiffness:={400 + 50 * number}",
                "--json",
                "--no-plot",
            )
            (folder / "limits.yaml").write_text(
                f"driver: {{safety: {{peak_force: {peak}}}}}\n"
            )
            command = [*HAPTIC, "launch", *words, "--params", "limits.yaml"]
            with (
                open(folder / "stdout.txt", "wb") as out,
                open(folder / "stderr.txt", "wb") as told,
            ):
                processes.append(
                    subprocess.Popen(
                        command, cwd=folder, env=environment, stdout=out, stderr=told
                    )
                )
        codes = [process.wait(3.0 * DEADLINE) for process in processes]
        assert_nothing_left(runtime)
    errors = [
        (tmp_path / str(number) / "stderr.txt").read_text()
        for number in range(LAUNCHES)
    ]
    assert codes == [0] * LAUNCHES, errors
    runs = set()
    for number in range(LAUNCHES):
        figures = json.loads(
            (tmp_path / str(number) / "stdout.txt").read_text().splitlines()[-1]
        )
        recording = Recording(tmp_path / str(number) / figures["recording"])
        runs.add(recording.manifest["run"])
        assert str(float(400 + 50 * number)) in recording.manifest["arguments"]
        states = recording.messages(DEVICE_STATE)
        assert states
        assert max(abs(part) for state in states for part in state.force) <= peak * (
            1.0 + 1e-15
        )
        # A machine that is too slow for all of them lets ticks go, and old forces with them; what
        # swings so late is stopped.
        assert {state.safety for state in states} <= {
            "waiting",
            "zero",
            "ramp",
            "active",
            "damping",
            "stopped",
        }
    assert len(runs) == LAUNCHES
