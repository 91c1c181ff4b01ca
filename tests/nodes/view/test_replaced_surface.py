"""A surface replaced while it runs: drawn and compared anew, named in a replay."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import msgspec
import pytest
from mcap.reader import make_reader

from messages.topics import DEVICE_STATE, event
from messages.types import DeviceState, Event
from nodes.base.setup import Setup
from nodes.launcher.runs import RunInfo
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordWriter
from nodes.view.comparison import Comparison
from nodes.view.foxglove_scene import DrawnScene, export_foxglove
from nodes.view.live import Facts, LiveRun
from nodes.view.replay import ReplayPages
from nodes.view.shown_surface import ShownSurface
from tests.support.setups import setup_of

PLANE: dict[str, Any] = {"kind": "oriented_plane", "position": [0.0, 0.0, -0.02]}
BALL: dict[str, Any] = {"kind": "sphere", "position": [0.05, 0.0, 0.0], "radius": 0.03}
REPLACED = Event(
    seq=60, stamp=0.12, node="environment", kind="surface", reason="kind", data={}
)


def environment(*axes: str) -> Setup:
    return setup_of(
        name="environment",
        kind="environment",
        factory="nodes.environment.node:Environment",
        axes=list(axes),
        parameters={"surface": PLANE},
    )


def run_of(setup: Setup) -> RunInfo:
    return RunInfo(run="r", scenario="s", launcher=0, nodes={"environment": setup})


def test_its_shape_is_the_one_that_replaced_it() -> None:
    shown = ShownSurface(run_of(environment("x", "y", "z")))
    (plane,) = shown.shape(lambda: False)["parts"]
    found = shown.replaced({"surface": {**BALL, "friction": {"static": 0.4}}})
    assert found is not None
    (ball,) = found["parts"]
    assert ball["points"] != plane["points"]
    assert found["friction"] == 0.4
    assert (shown.surface or {})["kind"] == "sphere"
    assert shown.replaced({"surface": {"kind": "free"}}) == {}
    flat = ShownSurface(run_of(environment("x")))
    assert flat.shape(lambda: False) == {}
    assert flat.replaced({"surface": BALL}) is None


def test_a_shape_that_begins_to_move_is_followed_and_one_that_stops_is_not(
    tmp_path: Path,
) -> None:
    setup = msgspec.structs.replace(
        environment("x", "y", "z"), run_dir=str(tmp_path), run="r"
    )
    shown = ShownSurface(run_of(setup))
    moving = {**BALL, "motion": {"speed": 0.1}}
    found = shown.replaced({"surface": moving})
    assert found is not None
    assert found["parts"][0]["pose"] == 0
    assert shown._bodies is not None
    shown.replaced({"surface": BALL})
    assert shown._bodies is None


def test_b_touches_the_surface_as_it_is_by_now() -> None:
    run = run_of(environment("x"))
    played = Comparison(run, "driver", lambda *_: None)
    played._targets = [(0.0, 0.0, 0.0)]
    played.touch("environment", BALL)
    assert played._setups["environment"].parameters["surface"] == BALL
    assert played._targets == [], "B begins anew"
    # The launch's own description stays as it is.
    assert run.nodes["environment"].parameters["surface"] == PLANE


def test_an_event_of_the_environment_has_it_read_again() -> None:
    facts = Facts("r", "s", "", 0.002, "realtime", "on_arrival", ["x"], "driver")
    live = LiveRun(facts)
    # A page that is opened later does not know what happened before.
    assert live.reshaped
    live.reshaped = False
    live.keep(event("environment"), msgspec.structs.replace(REPLACED, kind="mesh"), 0.1)
    assert not live.reshaped
    live.keep(event("environment"), REPLACED, 0.1)
    assert live.reshaped


@pytest.mark.parametrize("replaced", [True, False])
def test_a_replay_says_that_it_draws_the_one_of_the_launch(
    tmp_path: Path, replaced: bool
) -> None:
    pages = ReplayPages(recorded(tmp_path, REPLACED if replaced else None))
    hello = json.loads(pages.hello)
    assert len(hello["shape"]["parts"]) == 1
    told = "The surface was replaced at 0.1 s: drawn is the one of the launch."
    assert hello["notice"] == (told if replaced else "")


def recorded(folder: Path, change: Event | None) -> Path:
    """Record 100 ticks beside a ball, which is replaced."""
    path = folder / "run.mcap"
    known = {"environment": json.dumps({"surface": BALL})}
    facts = {"rate_hz": "500", "axes": "x,y,z"}
    with RecordWriter(path, facts, parameters=known) as writer:
        for seq in range(100):
            state = DeviceState(
                seq=seq, stamp=0.002 * seq, position=(0.0, 0.0, 0.0), force_seq=seq - 1
            )
            writer.write(DEVICE_STATE, state, state.stamp)
            if change is not None and seq == change.seq:
                writer.write(event("environment"), change, change.stamp)
    return path


def test_foxglove_draws_the_one_that_replaced_it() -> None:
    """Also one of nothing, which takes the old one away."""
    scene = DrawnScene({"environment": {"surface": PLANE}}, 0.002)
    (plane,) = scene.still(0)
    scene.replace("environment", {"surface": BALL})
    (ball,) = scene.still(1)
    assert ball["id"] == plane["id"] == "environment"
    corners = len(ball["triangles"][0]["points"])
    assert corners > len(plane["triangles"][0]["points"])
    scene.replace("environment", {"surface": {"kind": "free"}})
    (nothing,) = scene.still(2)
    assert (nothing["id"], nothing["triangles"]) == ("environment", [])
    assert (
        DrawnScene({"environment": {"surface": {"kind": "free"}}}, 0.002).still(0) == []
    )


@pytest.mark.parametrize(
    ("reason", "goes"),
    [
        ("surface.radius 0.03 → 0.02, surface.friction.static none → 0.4", True),
        ("surface.friction.static none → 0.4", False),
    ],
)
def test_an_export_for_foxglove_draws_no_surface_that_was_replaced(
    tmp_path: Path, reason: str, goes: bool
) -> None:
    """A recording has only the launch's; friction alone is not seen."""
    change = msgspec.structs.replace(REPLACED, reason=reason)
    recording = Recording(recorded(tmp_path, change))
    (out,) = export_foxglove(recording, tmp_path / "scene.mcap")
    with out.open("rb") as stream:
        updates = [
            json.loads(message.data)["entities"]
            for *_, message in make_reader(stream).iter_messages(topics=["/scene"])
        ]
    drawn = [one for update in updates for one in update if one["id"] == "environment"]
    assert len(drawn[0]["triangles"]) == 1
    assert [len(one["triangles"]) for one in drawn[1:]] == ([0] if goes else [])
    told = [one["texts"][0]["text"] for each in updates for one in each if one["texts"]]
    assert told == (
        [
            "environment: its surface was replaced at 0.1 s; a recording has only the first one"
        ]
        if goes
        else []
    )
