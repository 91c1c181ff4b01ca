"""The reported final motion is the device's: rest, swing, fall, or movement."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from nodes.driver.motion import REST, act, ending, find_velocity, sample
from tests.support.launching import haptic, launch_json
from tests.support.safety import state_of

T = 0.002


@pytest.mark.parametrize("frequency", [12.0, 50.0, 180.0])
def test_a_swing_is_told_with_its_size_and_frequency(frequency: float) -> None:
    samples = [1e-3 * math.sin(2.0 * math.pi * frequency * k * T) for k in range(125)]
    found = ending(samples, 0.0, T)
    assert found.motion == "swinging"
    # Sampled every 2 ms a crossing is late by up to one tick: over the n half periods seen, T in
    # n/(2f).
    assert found.frequency_hz == pytest.approx(
        frequency, rel=2.0 * T / (125 * T - 1.0 / frequency)
    )
    # At 180 Hz a sample is at most 65° from a crest: cos 65° of it at worst, in 125 samples much
    # nearer.
    assert 1.8e-3 < found.swing_m <= 2e-3


def test_rest_ends_where_a_fingertip_begins_to_feel() -> None:
    for swing, motion in ((0.99 * REST, "at rest"), (1.01 * REST, "swinging")):
        assert (
            ending([0.5 * swing * (-1) ** k for k in range(64)], 0.0, T).motion
            == motion
        )


def test_a_fall_is_a_fall_only_without_a_force() -> None:
    fall = [-0.5 * 9.81 * (k * T) ** 2 for k in range(64)]
    assert ending(fall, 0.0, T).motion == "falling"
    assert ending(fall, 1.0, T).motion == "moving"
    # The mean velocity of the last tick, which ends at 63 T.
    assert ending(fall, 0.0, T).velocity_m_per_s == pytest.approx(
        -9.81 * 62.5 * T, rel=1e-9
    )
    assert ending([0.1 * k * T for k in range(64)], 0.0, T).motion == "moving"


@pytest.mark.process
def test_who_has_just_bounced_does_not_fall(tmp_path: Path) -> None:
    """Rising after its first bounce, the mass was reported as falling."""
    final = launch_json(tmp_path, "floor_drop", "pace:=lockstep", "duration:=0.1")[
        "final"
    ]
    assert final["velocity_m_per_s"] > 0.0
    assert final["motion"] == "moving"


@pytest.mark.process
def test_launches_say_what_is(tmp_path: Path) -> None:
    words = ("pace:=lockstep", "--no-plot", "--without", "logger")
    rest = haptic(tmp_path, "launch", "floor_drop", *words).stdout
    assert "\n  at rest   position -0.9810 mm, force +0.9810 N" in rest
    buzz = haptic(
        tmp_path, "launch", "floor_buzz", "friction:=0.005", "damping:=12", *words
    ).stdout
    assert "\n  swinging  position" in buzz
    assert "to and fro at" in buzz
    figures = launch_json(
        tmp_path, "floor_drop", "pace:=lockstep", "height:=0.3", "duration:=0.2"
    )
    assert figures["final"]["motion"] == "falling"


def test_a_tick_that_is_sampled_twice_at_the_end_has_a_velocity() -> None:
    """Ctrl-C in lockstep samples a tick twice, which divided by a zero time."""
    s = state_of((2,))
    sample(s, 0.0)
    act(s, 1)
    for _ in range(2):
        s.place[2] = 0.001
        sample(s, 0.002)
        find_velocity(s)
        # 1 mm in a tick of 2 ms; a quotient of two floats, rounded once.
        assert s.velocity[2] == pytest.approx(0.5, rel=1e-15)
