"""The driver as last line of safety, on real processes, with one fault at a time."""

from __future__ import annotations

import contextlib
import functools
import json
import math
import os
import signal
import time
from itertools import pairwise
from pathlib import Path

import pytest

from messages.transport.requests import ControlError
from nodes.compiled.choose_tick import choose
from nodes.driver.limits import SafetyParameters
from nodes.driver.safety import RETURN_SPEED
from nodes.recording.reader import Recording
from sim.cli.bench.loop import KERNELS
from sim.measure.rig import full_pipe
from tests.support import INSTALLED
from tests.support.launching import Running, running, wait_for
from tests.support.logging_arm import DAMPING, LAW_DAMPING, diary, forces, scene

PERIOD = 0.002


# -- the compiled tick under a driver that exists
# -------------------------------------------------------------------------


def _is_past(until: float) -> bool:
    return time.monotonic() > until


@pytest.mark.process
@pytest.mark.realtime
def test_a_driver_that_is_not_virtual_has_the_compiled_tick_too(tmp_path: Path) -> None:
    kernels = [
        "nodes.environment.kernel",
        "nodes.coupling.kernel",
        "nodes.driver.kernel",
    ]
    assert choose("compiled", kernels, print) == "compiled"
    path = scene(tmp_path, run={"duration": 0.6, "tick": "compiled"})
    with running(tmp_path, path, environment=INSTALLED) as launch:
        figures = launch.finish()
    assert figures["tick"] == "compiled"
    compiled = figures["ticks_compiled"]
    assert min(
        compiled[node] for node in ("driver", "environment", "coupling")
    ) > 0.8 * (figures["ticks"] - figures["missed"])
    # 1 mm into 1000 N/m, at rest: after a ramp of 0.15 s at 500 Hz, because the arm begins there.
    assert forces(tmp_path).count(1.0) > 0.8 * (
        figures["ticks"] - figures["missed"] - 75
    )


# -- a reader that pauses or goes away
# ---------------------------------------------------------------------------------


@pytest.mark.process
@pytest.mark.parametrize("reader", ["paused", "gone"])
def test_the_force_goes_down_and_the_launch_ends_whoever_reads_what_is_printed(
    tmp_path: Path, reader: str
) -> None:
    reading, writing = full_pipe()
    if reader == "gone":
        os.close(reading)
    try:
        path = scene(tmp_path, chain={"required": False})
        with running(tmp_path, path, environment=INSTALLED, stderr=writing) as launch:
            wait_for(lambda: forces(tmp_path)[-1:] == [1.0], "the arm is pressed")
            os.kill(launch.pid("coupling"), signal.SIGKILL)
            # Damping of an arm that stands still is zero too, but the launch must go on to say so
            # on its topics.
            wait_for(
                lambda: launch.call("driver", "progress")["safety"] == "zero",
                "the watchdog bites",
            )
            assert abs(forces(tmp_path)[-1]) == 0.0
            ticks = launch.wait_ticks(20)
            figures = launch.finish(signal.SIGINT, code=1)
            assert (figures["exit_reason"], figures["ticks"] >= ticks) == (
                "SIGINT",
                True,
            )
            assert figures["nodes"]["driver"]["state"] == "finished"
        assert [call for _, call, _ in diary(tmp_path)][-2:] == ["close", "closed"]
        told = [
            event.reason
            for event in Recording(tmp_path / "run.mcap").messages("/driver/event")
        ]
        assert any(reason.startswith("damping → zero") for reason in told)
    finally:
        os.close(writing)
        if reader == "paused":
            os.close(reading)


# -- ticks that are lost
# ------------------------------------------------------------------------------------------------


@pytest.mark.process
@pytest.mark.realtime
def test_damping_knows_the_time_that_passed_while_the_driver_was_held_up(
    tmp_path: Path,
) -> None:
    speed = 0.1
    path = scene(
        tmp_path,
        chain={"required": False},
        at=0.0,
        swing=0.05,
        speed=speed,
        safety={"damping_ticks": 100_000, "watchdog": 10},
        declared={"peak_force": 10.0, "hold": 10.0, "workspace": [[-0.1, 0.1]] * 3},
    )
    with running(tmp_path, path, environment=INSTALLED) as launch:
        driver = launch.pid("driver")
        launch.wait_ticks(20)
        os.kill(launch.pid("coupling"), signal.SIGKILL)
        wait_for(
            lambda: launch.call("driver", "progress")["safety"] == "damping",
            "damping begins",
        )
        launch.wait_ticks(5)
        seen = len(diary(tmp_path))
        for _ in range(8):
            overruns = launch.call("driver", "progress")["overruns"]
            os.kill(driver, signal.SIGSTOP)
            until = time.monotonic() + 25 * PERIOD
            wait_for(functools.partial(_is_past, until), "ticks pass")
            os.kill(driver, signal.SIGCONT)
            wait_for(
                lambda overruns=overruns: (
                    launch.call("driver", "progress")["overruns"] > overruns + 10
                ),  # type: ignore[misc]
                "they are lost",
            )
            launch.wait_ticks(5)
        launch.finish(signal.SIGINT, code=1)
    damped = [
        value for _, call, value in diary(tmp_path)[seen:] if call == "write_force"
    ]
    # b·v; of a sample that is read a little after its time a little more, where one period for 25
    # ticks gave 25 times that.
    assert max(map(abs, damped)) <= 3.0 * DAMPING * speed
    assert max(map(abs, damped)) >= 0.5 * DAMPING * speed


@pytest.mark.process
@pytest.mark.smoke
def test_the_soft_stop_begins_at_the_force_that_is_on_the_device(
    tmp_path: Path,
) -> None:
    # Slewing all the time, under next_tick the force decided last has not been handed over yet.
    slew = 0.3
    path = scene(
        tmp_path,
        run={"apply": "next_tick"},
        swing=0.004,
        speed=0.5,
        safety={"slew": slew / PERIOD},
    )
    with running(tmp_path, path, environment=INSTALLED) as launch:
        wait_for(lambda: len(forces(tmp_path)) > 200, "forces are written")
        launch.finish(signal.SIGINT)
    steps = [abs(later - earlier) for earlier, later in pairwise(forces(tmp_path))]
    assert max(steps) <= slew * (1.0 + 1e-9)  # sums of a handful of steps
    assert forces(tmp_path)[-1] == 0.0


AGAIN = {"respawn": True, "respawn_delay": 0.05}


def killed(launch: Running, node: str) -> None:
    """Kill a node, and wait for its successor."""
    before = launch.pid(node)
    os.kill(before, signal.SIGKILL)

    def back() -> bool:
        with contextlib.suppress(ControlError):
            return bool(launch.call(node, "status", timeout=0.3)["pid"] != before)
        return False

    wait_for(back, f"{node} is back")


@pytest.mark.process
def test_a_coupling_started_again_has_its_parameters_and_no_jump(
    tmp_path: Path,
) -> None:
    with running(
        tmp_path, scene(tmp_path, chain=AGAIN), environment=INSTALLED
    ) as launch:
        wait_for(lambda: forces(tmp_path)[-1:] == [1.0], "the arm is pressed")
        launch.call("coupling", "param.set", values={"laws.pd.stiffness": 700.0})
        launch.call(
            "environment",
            "param.set",
            values={"surface": {"kind": "plane", "axis": "z", "position": 0.001}},
        )
        wait_for(
            lambda: forces(tmp_path)[-1:] == [pytest.approx(1.4, abs=1e-9)],
            "they are in place",
        )
        for _ in range(2):
            for node in ("environment", "coupling"):
                killed(launch, node)
            assert (
                launch.call("coupling", "param.get", name="laws.pd.stiffness") == 700.0
            )
            wait_for(
                lambda: forces(tmp_path)[-1:] == [pytest.approx(1.4, abs=1e-9)],
                "forces flow again",
            )
        launch.finish(signal.SIGINT)
    # Held still, the arm is felt as a spring: from a history of zeros the damper alone would give 3
    # N.
    assert max(forces(tmp_path)[len(forces(tmp_path)) // 2 :]) <= 1.4 + 1e-9
    told = Recording(tmp_path / "run.mcap").messages("/coupling/event")
    assert [event.kind for event in told].count("resumed") == 2


@pytest.mark.process
@pytest.mark.realtime
def test_a_logger_started_again_leaves_alone_what_was_recorded(tmp_path: Path) -> None:
    with running(
        tmp_path, scene(tmp_path, chain=AGAIN), environment=INSTALLED
    ) as launch:
        for _ in range(2):
            # What its predecessors have, the last half second excepted, must stay.
            launch.wait_ticks(400)
            killed(launch, "logger")
        launch.wait_ticks(50)
        figures = launch.finish(signal.SIGINT)
        told = json.loads(
            launch.haptic("bag", "info", "run.mcap", "--json").stdout.splitlines()[-1]
        )
    assert [Path(path).name for path in told["parts"]] == [
        "run.mcap",
        "run.2.mcap",
        "run.3.mcap",
    ]
    assert told["recovered"] is True
    whole = Recording(tmp_path / "run.mcap")
    seen = [state.seq for state in whole.messages("/device/state")]
    assert seen == sorted(seen)
    assert (seen[0] <= 100, seen[-1]) == (True, figures["nodes"]["driver"]["seq"])
    alone = [
        Recording(tmp_path / name).topics["/device/state"].messages
        for name in ("run.2.mcap", "run.3.mcap")
    ]
    assert len(seen) > sum(alone) + 100


# -- positions that are none
# ---------------------------------------------------------------------------------------------


WRONG = (1.7e308, -1.7e308, None, 0.11)


@pytest.mark.process
@pytest.mark.smoke
@pytest.mark.realtime
def test_positions_outside_the_workspace_are_a_fault_and_no_data(
    tmp_path: Path,
) -> None:
    # Each for a tenth of a second, and for a tick or two.
    glitches = [
        (begin, begin + length, wrong)
        for k, wrong in enumerate(WRONG)
        for begin, length in ((0.4 + 0.4 * k, 0.1), (0.6 + 0.4 * k, 0.004))
    ]
    path = scene(tmp_path, glitches=glitches)
    with running(tmp_path, path, environment=INSTALLED) as launch:
        over = glitches[-1][1] + 0.3
        wait_for(
            lambda: diary(tmp_path)[-1][0] - diary(tmp_path)[1][0] > over,
            "the glitches are over",
        )
        wait_for(lambda: forces(tmp_path)[-1] == 1.0, "forces flow again")
        figures = launch.finish(signal.SIGINT)
    # At tick 0 the history is empty, as it is in one process; from then on the arm stands still.
    first = 1.0 + LAW_DAMPING * 0.001 / PERIOD
    assert all(
        math.isfinite(force) and 0.0 <= force <= first + 1e-9
        for force in forces(tmp_path)[:10]
    )
    assert all(
        math.isfinite(force) and 0.0 <= force <= 1.0 + 1e-9
        for force in forces(tmp_path)[10:]
    )
    assert figures["safety"]["entered"]["fault"] >= len(WRONG)
    recording = Recording(tmp_path / "run.mcap")
    states = recording.messages("/device/state")
    assert {state.position[2] for state in states} == {-0.001}
    # An arm that stands still gets no energy, whatever its encoders said meanwhile.
    assert all(state.energy == 0.0 for state in states)
    assert not any(
        event.kind == "fallback" for event in recording.messages("/coupling/event")
    )


# -- what goes on pushing while nobody answers
# ------------------------------------------------------------------------------

PUSHED = """
summary: Something pushes against a floor
run: {{duration: 0.0, tick: {tick}}}
nodes:
  driver:
    kind: sim_driver
    parameters:
      safety: {{peak_force: 40.0, slew: 20000.0, workspace: [[-0.2, 0.2], [-0.2, 0.2], [-0.2,
        0.2]]}}
      device: {{mass: 0.1, damping: 1.0, {pushes}}}
  environment: {{kind: environment, respawn: true, respawn_delay: 0.2,
    parameters: {{surface: {{kind: plane, position: 0.0}}}}}}
  coupling:
    kind: coupling
    respawn: true
    respawn_delay: 0.2
    parameters: {{law: pd, laws: {{pd: {{kind: pd, stiffness: 1000.0, damping: 3.0}}}}}}
  logger: {{kind: logger, parameters: {{path: run.mcap}}}}
"""
HAND = "hand: {mass: 0.1, damping: 2.0, stiffness: 150.0, path: [[0.0, -0.06]]}"
WEIGHT = "gravity: 9.81"


@pytest.mark.process
@pytest.mark.realtime
@pytest.mark.parametrize(
    ("tick", "pushes", "strength"),
    [
        ("compiled", HAND, 150.0 * 0.06),
        pytest.param("plain", HAND, 150.0 * 0.06, marks=pytest.mark.slow),
        pytest.param("compiled", WEIGHT, 0.981, marks=pytest.mark.slow),
    ],
)
def test_what_has_sunk_in_meets_a_force_that_grows_by_the_ramp_and_is_not_thrown(
    tmp_path: Path, tick: str, pushes: str, strength: float
) -> None:
    """Without a ramp the whole force returned in one tick: 40 N on a hand of 9 N."""
    assert choose("compiled", KERNELS, print) == "compiled"
    path = tmp_path / "pushed.yaml"
    path.write_text(PUSHED.format(tick=tick, pushes=pushes))
    with running(tmp_path, str(path)) as launch:
        launch.wait_ticks(200)
        for node in ("coupling", "environment"):
            killed(launch, node)
            launch.wait_ticks(500)
        launch.finish(signal.SIGINT)
    states = Recording(tmp_path / "run.mcap").messages("/device/state")
    recovery = round(SafetyParameters().recovery / PERIOD)
    silent = [
        a.seq for a, b in pairwise(states) if (a.safety, b.safety) == ("zero", "ramp")
    ]
    assert len(silent) >= 2
    for last in silent:
        after = [state for state in states if last <= state.seq <= last + 450]
        depth = -min(state.position[2] for state in after)
        assert depth > 0.03
        for state in after:
            # two roundings
            assert abs(state.force[2]) <= 40.0 * max(state.seq - last, 0) / recovery * (
                1.0 + 1e-15
            )
        # What takes energy is who pushes, on the way out, and the speed of that way; a tick or two
        # of acceleration beyond it.
        speed = 1.5 * RETURN_SPEED
        given = max(state.energy for state in after) - after[0].energy
        assert given <= strength * depth + 0.5 * 0.2 * speed**2 + 1.0 * speed * depth
