"""Trials that end otherwise: the driver stops the loop, or the position does not follow."""

from __future__ import annotations

import itertools
import json
import signal
import threading
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from messages.topics import DEVICE_STATE
from messages.transport.requests import ControlError
from nodes.driver.limits import SafetyParameters
from nodes.recording.reader import Recording
from sim.drill.faults import SteppedClock
from sim.drill.faulty_device import LATE, SCALE
from sim.drill.given_design import given_design, given_prediction, given_record
from sim.identify.borrowed import PushedLaunch, borrowed
from sim.tune.knocking import STRIDE, Plan, factor_of
from tests.support.launching import running, typed, wait_for

T = 0.002
PEAK = 3.0

SCENE = {
    "summary": "A device held at a point",
    "run": {"rate": 1.0 / T, "duration": 0.0, "pace": "lockstep", "cpu": "any"},
    "nodes": {
        "driver": {
            "kind": "sim_driver",
            "parameters": {
                "device": {"mass": 0.1, "damping": 1.0, "delay": 1.0},
                "safety": {"peak_force": PEAK, "workspace": [[-0.05, 0.05]] * 3},
            },
        },
        "environment": {
            "kind": "environment",
            "parameters": {"surface": {"kind": "anchor", "position": [0.0, 0.0, 0.0]}},
        },
        "coupling": {
            "kind": "coupling",
            "parameters": {
                "law": "pd",
                "laws": {"pd": {"kind": "pd", "stiffness": 300.0, "damping": 2.0}},
            },
        },
        "logger": {"kind": "logger", "parameters": {"path": "run.mcap"}},
    },
}


def designed(
    folder: Path,
    taps: list[float],
    edge: float | None = None,
    first: int = 0,
    near: int = 60,
    last: int = 60,
) -> None:
    """Write a design and a prediction: trials from `first` to `last`, large steps to `near`."""
    law, predicted = (
        given_design(taps, T),
        given_prediction(sum(taps), edge_factor=edge, knock_m=2e-3),
    )
    (folder / "tuning").mkdir()
    given_record(law, predicted, Plan(first, near, last)).write(
        folder / "tuning" / "tune.json"
    )


@pytest.mark.slow
def test_a_trial_that_the_driver_stops_is_a_verdict_and_the_launch_goes_on(
    tmp_path: Path,
) -> None:
    """Without it every later trial met a dead driver."""
    (tmp_path / "held.yaml").write_text(json.dumps(SCENE))
    designed(tmp_path, [20000.0, -19500.0])
    with running(tmp_path, "held.yaml") as launch:
        typed(launch, "tune", "--steps", "verify", "--json", code=1)
        # It takes forces again, and the launch has its own law back.
        wait_for(
            lambda: launch.call("driver", "progress")["safety"] == "active",
            "forces to be back",
        )
        assert launch.call("coupling", "law.list")["active"] == "pd"
        figures = launch.finish(signal.SIGINT)
    after = json.loads((tmp_path / "tuning" / "tune.json").read_text())["verified"]
    assert not after["holds"]
    stops = [step["factor"] for step in after["steps"] if step["ended_by"] == "stop"]
    rested = [step["factor"] for step in after["steps"] if step["rests"]]
    # The first stride of 22 % is stopped; what lies below it is tried afterwards, on a driver that
    # takes forces again.
    assert stops[-1] == pytest.approx(factor_of(STRIDE))
    assert all(factor < max(stops) for factor in rested)
    assert len(after["steps"]) > 2
    times = figures["safety"]["entered"]["stopped"]
    assert times == len(stops)
    assert launch.errors.count("[driver] rearmed: stopped → zero") >= 1
    # From nothing, by the whole ramp.
    states = Recording(tmp_path / "run.mcap").messages(DEVICE_STATE)
    ramp = round(SafetyParameters().recovery / T)
    for before, state in pairwise(states):
        if before.safety == "stopped" != state.safety:
            back = [one for one in states if state.seq <= one.seq < state.seq + ramp]
            # Two roundings.
            assert all(
                abs(one.force[0])
                <= PEAK * (one.seq - before.seq + 1) / ramp * (1.0 + 1e-15)
                for one in back
            )


@pytest.mark.process
def test_a_launch_that_somebody_tunes_already_is_refused_and_left_to_him(
    tmp_path: Path,
) -> None:
    """The second tuning restored the first one's soft spring as the user's law."""
    (tmp_path / "held.yaml").write_text(json.dumps(unrecorded()))
    with running(tmp_path, "held.yaml") as launch:
        with borrowed(PushedLaunch(launch.run)) as held:
            held.check()
            launch.call(
                "coupling",
                "param.set",
                values={
                    "laws.trial": {"kind": "pd", "stiffness": 200.0, "damping": 2.0}
                },
            )
            launch.call("coupling", "law.switch", law="trial", ramp=0)
            with (
                pytest.raises(ControlError, match="held by another client"),
                borrowed(PushedLaunch(launch.run)),
            ):
                raise AssertionError
            assert launch.call("coupling", "law.list")["active"] == "trial"
            assert (
                launch.call("coupling", "lease.renew", names=["borrowed"])["run_out"]
                == []
            )
        assert launch.call("coupling", "law.list")["active"] == "pd"
        # And is there for the next one.
        with borrowed(PushedLaunch(launch.run)) as held:
            assert held.law == "pd"
        launch.finish(signal.SIGINT)


@pytest.mark.slow
def test_of_a_launch_of_several_chains_the_one_that_is_pushed_is_recorded(
    tmp_path: Path,
) -> None:
    """The recorder subscribed to `/device/state`, which the whole launch lacks."""
    with running(tmp_path, "two_hands", "duration:=0") as launch:
        loop = PushedLaunch(launch.run.within("left"))
        assert loop.chosen == f"{launch.run.run}/left"
        typed(
            launch,
            "bag",
            "record",
            DEVICE_STATE,
            "--run",
            loop.chosen,
            "--duration",
            "0.2",
            "--out",
            "push.mcap",
        )
        launch.finish(signal.SIGINT, code=None)
    recording = Recording(tmp_path / "push.mcap")
    assert recording.namespace == "left"
    assert recording.messages(DEVICE_STATE)


def unrecorded() -> dict[str, Any]:
    """Return the scene without a logger."""
    scene: dict[str, Any] = json.loads(json.dumps(SCENE))
    del scene["nodes"]["logger"]
    return scene


def verified_with(
    order: str,
    folder: Path,
    taps: list[float],
    edge: float | None = None,
    first: int = 0,
    last: int = 60,
) -> str:
    """Tune on a device with wrong positions; return the output. Nothing may be delivered."""
    scene = unrecorded()
    driver = scene["nodes"]["driver"]
    driver["kind"] = "faulty_driver"
    driver["parameters"]["order"] = "order"
    (folder / "held.yaml").write_text(json.dumps(scene))
    designed(folder, taps, edge, first, last=last)
    with running(folder, "held.yaml") as launch:
        (folder / "order").write_text(order)
        done = typed(launch, "tune", "--steps", "verify", code=1)
        assert launch.call("coupling", "law.list")["active"] == "pd"
        launch.finish(signal.SIGINT)
    assert not (folder / "tuning" / "tuned.yaml").exists()
    return done.stdout


@pytest.mark.slow
def test_an_encoder_that_is_stuck_is_not_a_device_at_rest(tmp_path: Path) -> None:
    """With a stuck position every law came to rest, and the stiffest was delivered."""
    assert "the encoder is stuck" in verified_with(
        "0.0", tmp_path, [800.0, -700.0], last=2 * STRIDE
    )


NO = "the law holds                                      NO"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("lie", "told", "taps", "first"),
    [
        # A sign: every spring pushes away. A gain: ten times the law that was designed, whose edge
        # is a little below it then. A delay that jumps by ten ticks: the edge is a little below the
        # law, too.
        (f"{SCALE}-1", NO, [800.0, -700.0], 0),
        (f"{SCALE}10", NO, [2000.0, -1750.0], -3),
        (f"{LATE}10", NO, [800.0, -700.0], -6),
        # A quarter of it: every knock rests, far beyond where the model has the edge.
        (
            f"{SCALE}0.25",
            "the device differs from the identified one",
            [800.0, -700.0],
            0,
        ),
    ],
)
def test_a_device_that_lies_while_its_law_is_tried_gets_none(
    lie: str, told: str, taps: list[float], first: int, tmp_path: Path
) -> None:
    assert told in verified_with(
        lie, tmp_path, taps, edge=1.5, first=first, last=3 * STRIDE
    )


@pytest.mark.slow
def test_a_wall_clock_that_is_set_in_mid_trial_changes_no_verdict(
    tmp_path: Path,
) -> None:
    """−1 h, +2 h, five times a second, in every process of launch and verb."""
    (tmp_path / "held.yaml").write_text(json.dumps(unrecorded()))
    designed(tmp_path, [8000.0, -7600.0], first=45, near=45)
    clock, over = SteppedClock(), threading.Event()

    def step_about() -> None:
        for seconds in itertools.cycle((-3600.0, 7200.0, 0.0)):
            clock.step(seconds)
            if over.wait(0.2):
                return

    steps = []
    try:
        for environment in (None, clock.prepare()):
            with running(tmp_path, "held.yaml", environment=environment) as launch:
                stepping = threading.Thread(target=step_about)
                if environment:
                    stepping.start()
                try:
                    # The clock is stepped in what starts with it.
                    verify = launch.haptic if environment else partial(typed, launch)
                    verify("tune", "--steps", "verify", "--json", code=None)
                finally:
                    over.set()
                    if environment:
                        stepping.join()
                launch.finish(signal.SIGINT)
            told = json.loads((tmp_path / "tuning" / "tune.json").read_text())[
                "verified"
            ]
            steps.append([(step["factor"], step["rests"]) for step in told["steps"]])
            over.clear()
    finally:
        clock.tidy()
    assert steps[0] == steps[1]
    assert {rests for _, rests in steps[0]} == {True, False}
