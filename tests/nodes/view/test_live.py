"""State of a run for pages: its end, ringing, and the inputs of B."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from messages.types import DeviceState, NodeStatus
from nodes.launcher import launch_file
from nodes.launcher.run_end import write_end
from nodes.launcher.runs import RunInfo
from nodes.view.comparison import FREE, Changed, Comparison
from nodes.view.live import Facts, LiveRun
from nodes.view.ringing import ring_of
from sim.drill.drill import scene as drill_scene
from sim.drill.last_line import ORDER
from sim.play.hops import setup_of
from tests.support.browser import viewing
from tests.support.coroutines import complete
from tests.support.launching import running, wait_for
from tests.support.live_page import live, texts


def facts(run_dir: Path, *axes: str) -> Facts:
    return Facts(
        "run",
        "scenario",
        "",
        0.002,
        "realtime",
        "on_arrival",
        list(axes),
        "driver",
        str(run_dir),
    )


def status(state: str, reason: str = "") -> NodeStatus:
    return NodeStatus(
        seq=1,
        stamp=0.0,
        node="driver",
        kind="sim_driver",
        state=state,
        pid=1,
        reason=reason,
    )


@pytest.mark.slow
def test_a_page_goes_on_with_a_driver_that_failed_and_is_started_again(
    tmp_path: Path,
) -> None:
    """Only the launcher decides whether a failed driver ends the run."""
    content = drill_scene()
    driver = content["nodes"]["driver"]
    driver["kind"], driver["parameters"]["order"] = "faulty_driver", ORDER
    (tmp_path / "failing.yaml").write_text(json.dumps(content), encoding="utf-8")
    with (
        running(tmp_path, "./failing.yaml", "--without", "logger") as launch,
        viewing(tmp_path, environment=launch.environment) as url,
        live(url) as page,
    ):
        wait_for(lambda: texts(page, "status")["safety"] == "active", "forces")
        (tmp_path / ORDER).write_text("fails in read_position", encoding="ascii")
        wait_for(lambda: "driver: ended with" in launch.errors, "the driver's failure")
        (tmp_path / ORDER).unlink()
        wait_for(lambda: "driver: started again" in launch.errors, "another driver")
        again = launch.call("driver", "status", timeout=20.0)["seq"]
        found = wait_for(
            lambda: (
                (now := texts(page, "status"))["tick"] > again
                and now["safety"] == "active"
                and now
            ),
            "it",
        )
        assert found["ended"] == ""


def test_a_failed_driver_is_the_end_when_the_launcher_says_so(tmp_path: Path) -> None:
    run = LiveRun(facts(tmp_path, "x"))
    run.keep("/driver/status", status("failed", "unplugged"), 1.0)
    run.tick(1.0)
    assert run.ended == ""
    write_end(tmp_path, "driver: ended with exit code 1")
    run.tick(1.1)
    assert run.ended == "driver: ended with exit code 1"
    # Beside a launch whose directory has gone before anybody looked.
    late = LiveRun(facts(tmp_path / "gone", "x"))
    late.keep("/driver/status", status("failed", "unplugged"), 1.0)
    late.end("the view was stopped")
    assert late.ended == "unplugged"
    done = LiveRun(facts(tmp_path / "gone", "x"))
    done.keep("/driver/status", status("finished"), 1.0)
    assert done.ended == "finished"


def test_of_several_axes_a_loop_rings_along_any_of_them(tmp_path: Path) -> None:
    for axes, along, rings in (
        (("x",), 0, True),
        (("x",), 2, False),
        (("x", "y", "z"), 0, True),
        (("x", "y", "z"), 2, True),
    ):
        run = LiveRun(facts(tmp_path, *axes))
        energy = 0.0
        for seq in range(250):
            force, place, turn = [0.0] * 3, [0.0] * 3, 2.0 * math.pi * seq * 0.002
            # A contact that comes and goes, 40 times a second, and generates 0.4 mJ each time.
            place[along] = 1e-3 * math.sin(40.0 * turn)
            force[along] = -2.0 * max(0.0, math.sin(40.0 * turn - 0.5))
            energy += 0.4e-3 * 40.0 * 0.002 if along in map("xyz".index, axes) else 0.0
            # And a spring that a hand shakes to and fro, 3 times a second: that is none.
            force[1] = math.sin(3.0 * turn)
            (x, y, z), where = force, (place[0], place[1], place[2])
            run.keep(
                "/device/state",
                DeviceState(
                    seq=seq, stamp=0.0, position=where, force=(x, y, z), energy=energy
                ),
                seq * 0.002,
            )
        found = run.rings()
        assert (found is not None) == rings, (axes, along)
        assert found is None or 36.0 < found.frequency < 44.0


def test_how_a_simulated_b_rings_can_be_sent(tmp_path: Path) -> None:
    """Its figures were numbers of numpy, at which the view ended."""
    run = LiveRun(facts(tmp_path, "x"))
    turns = 2.0 * math.pi * 24.0 * 0.002 * np.arange(600)
    ring = ring_of(1e-3 * np.sin(turns), -4.0 * np.sin(turns - 0.5), 0.002, 0.0)
    assert ring is not None
    run.sings = lambda: {"a": None, "b": ring}
    run.tick(1.0)
    (status,) = map(json.loads, run.board.since(0, 0)[0])
    assert status["sings"]["b"]["frequency"] == pytest.approx(24.0, rel=0.05)


def test_b_is_played_with_its_law_as_it_is_by_now() -> None:
    told: list[dict[str, Any]] = []
    played = Comparison(
        RunInfo(run="r", scenario="s", launcher=0, nodes={}),
        "driver",
        lambda _, document: told.append(document),
    )
    soft, hard = (
        {"kind": "pd", "stiffness": stiffness, "damping": 3.0}
        for stiffness in (500.0, 900.0)
    )
    played.follow({"pd": soft})
    assert told == [], "none is played"
    played.choose("pd", soft)
    played.follow({"pd": soft, "other": hard})
    assert told == [{"law": "pd", "at": None}]
    played.follow({"pd": hard})
    assert told == [{"law": "pd", "at": None}] * 2, "it begins anew"
    assert played._chosen.described == hard
    # At another stiffness than the launch's it keeps that, whatever the launch's law does.
    played.choose("pd", hard, Changed(stiffness=4000.0))
    played.follow({"pd": {**hard, "damping": 2.0}})
    assert played._chosen.described == {
        "kind": "pd",
        "stiffness": 4000.0,
        "damping": 2.0,
    }
    assert told[-1] == {"law": "pd", "at": 4000.0}
    fir = {"kind": "fir", "taps": [600.0, -100.0]}
    played.choose("fir", fir, Changed(hardness=1000.0))
    assert played._chosen.described["taps"] == [1200.0, -200.0]


@pytest.mark.parametrize("other", ["", "gone"])
def test_a_law_unchosen_before_its_simulation_begins_is_no_error(other: str) -> None:
    """The task of a step begins later than the step: "nothing" may be chosen in between."""
    told: list[dict[str, Any]] = []
    played = Comparison(
        RunInfo(run="r", scenario="s", launcher=0, nodes={}),
        "driver",
        lambda _, document: told.append(document),
    )

    async def visit() -> None:
        played.choose("pd", {"kind": "pd", "stiffness": 500.0, "damping": 3.0})
        for seq in (0, 1):
            zero = (0.0, 0.0, 0.0)
            played.take("", DeviceState(seq=seq, stamp=0.0, position=zero, force=zero))
        played.step(1.0, 1.0)
        assert played._job is not None
        played.choose(other, {})
        await played._job
        await played.close()

    complete(visit())
    assert told == [{"law": "pd", "at": None}, {"law": other, "at": None}]


def state(seq: int, force: float) -> DeviceState:
    """Return a state in which device and target go along y and z."""
    at = (0.0, 1e-3 * seq, -2e-3 * seq)
    return DeviceState(
        seq=seq, stamp=0.0, position=at, target=at, force=(0.0, 0.0, force)
    )


def test_b_of_three_axes_begins_where_a_is_free() -> None:
    """A proxy that begins inside a shape does not feel it."""
    launch = launch_file.read("sphere_feel", {})
    nodes = {name: setup_of(launch, name) for name in launch.nodes}
    run = RunInfo(run="r", scenario="s", launcher=0, nodes=nodes)
    played = Comparison(run, "driver", lambda *_: None)
    assert played.there
    played.choose("pd", {"kind": "pd", "stiffness": 500.0, "damping": 3.0})
    ticks = math.ceil(FREE / 0.002)
    for seq in range(20):
        played.take("", state(seq, 1.0))
    # The first of them comes after one with a force, so it does not count.
    begun = 21 + ticks
    for seq in range(20, begun):
        played.take("", state(seq, 0.0))
    assert played._targets == []
    played.take("", state(begun, 0.0))
    played.take("", state(begun + 3, 0.0))
    assert played._from == begun
    place, speed = played._begin
    assert place == state(begun, 0.0).position
    assert speed == pytest.approx((0.0, 0.5, -1.0))
    # Two states were lost: their targets lie in between.
    wanted = [state(begun + k, 0.0).target for k in range(4)]
    assert np.allclose(played._targets, wanted, rtol=0.0, atol=1e-15)


def test_moving_bodies_and_shapes_are_not_compared() -> None:
    launch = launch_file.read("sphere_feel", {})
    ball = dict(launch.nodes["environment"].parameters["surface"])
    moving = {"kind": "union", "shapes": [{**ball, "motion": {}}]}
    for surface in ({**ball, "motion": {}}, moving):
        nodes = {name: setup_of(launch, name) for name in launch.nodes}
        parameters = {"surface": surface}
        nodes["environment"] = msgspec.structs.replace(
            nodes["environment"], parameters=parameters
        )
        run = RunInfo(run="r", scenario="s", launcher=0, nodes=nodes)
        assert not Comparison(run, "driver", lambda *_: None).there
