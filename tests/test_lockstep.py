"""Four processes in lockstep and the same scene in one process give the same bits.

This test holds the project together: what a study computes in one process is what the loop renders. Equality is exact, not
within a tolerance, because both call the same functions on the same floats in the same order.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from messages.topics import DEVICE_STATE, FORCE
from nodes import launchfile
from nodes.recording import Recording
from sim.scene import from_launch
from tests.launching import launch_json

SHORT = "duration:=1.2"
VARIANTS = (
    ("floor_drop", "apply:=next_tick", "law:=multi_term"),
    ("floor_drop", "law:=pd_alpha", "rate:=1000"),
    ("floor_buzz", "apply:=next_tick", "law:=pd_alpha"),
    ("wall_press", "delay:=1.3", "law:=multi_term"),
    ("wall_press", "delay:=0.4", "apply:=next_tick"),
)
"""Beyond each scenario as it stands: every law, quantiser and friction, whole and fractional delay, both rules of apply."""


def bits(values: list[float]) -> list[int]:
    return [int(v) for v in np.array(values).view(np.int64)]


@pytest.mark.parametrize(
    "words", [(name,) for name in launchfile.scenarios()] + list(VARIANTS), ids=lambda words: " ".join(words)
)
def test_four_processes_give_the_bits_of_one(words: tuple[str, ...], tmp_path: Path) -> None:
    given = launchfile.parse_assignments([*words[1:], "pace:=lockstep"])
    _, arguments = launchfile.read_arguments(launchfile.find(words[0]))
    duration = [] if words[0] == "floor_swap" or "duration" not in arguments else [SHORT]
    launch = launchfile.read(words[0], {**given, **launchfile.parse_assignments(duration)})
    played = from_launch(launch)
    trace = played.play()

    figures = launch_json(tmp_path, words[0], *words[1:], *duration, "pace:=lockstep")

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


def test_lockstep_twice_gives_the_same_recording(tmp_path: Path) -> None:
    found = []
    for part in ("one", "two"):
        folder = tmp_path / part
        folder.mkdir()
        figures = launch_json(folder, "floor_buzz", SHORT, "pace:=lockstep")
        states = Recording(folder / figures["recording"]).messages(DEVICE_STATE)
        found.append([(state.seq, state.stamp, state.position, state.force, state.energy) for state in states])
    assert found[0] == found[1]
