"""Forces rebuilt from a driver's states equal those handed to its device."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest

from messages.codec import Decoder
from messages.types import DeviceState
from sim.identify.forces import handed_over
from tests.support.rules_of_time import RULES
from tests.support.scripted import Script, played
from tests.support.scripted_world import T
from tests.support.scripts import TICKS, answer, driver

Turn = list[tuple[float, float]]
"""Time of a hand-over [ticks], and force [N]."""


def play(script: Script, axis: int, folder: Path) -> tuple[list[DeviceState], Turn]:
    """Run a driver; return its states and the forces on its device, with its own hold."""
    outcome, node = played(script, "plain", folder)
    states = [Decoder(DeviceState).decode(frames[1]) for _, frames in outcome.sent]
    sampled = {state.seq for state in states}
    hold = node.driving.device_hold_ticks
    given: list[Any] = [*outcome.given, (math.inf, (0.0, 0.0, 0.0), 0.0)]
    turn = [(-1.0, 0.0)]
    for (seq, force, offset), (then, _, after) in pairwise(given):
        turn.append((seq + offset, force[axis]))
        # In a tick that it did not sleep through, the driver takes it for held until the end.
        gone = (
            seq + hold
            if math.floor(seq + hold) not in sampled
            else float(math.ceil(seq + hold))
        )
        if gone < min(then + after, TICKS):
            turn.append((gone, 0.0))
    return states, [one for one in turn if one[0] < TICKS]


def acting(turn: Turn, when: float) -> float:
    return [force for at, force in turn if at <= when][-1]


def impulse(turn: Turn, begin: float, end: float) -> float:
    cuts = [begin, *(at for at, _ in turn if begin < at < end), end]
    return sum(acting(turn, low) * (high - low) for low, high in pairwise(cuts))


def assert_rebuilt(states: list[DeviceState], turn: Turn, axis: int) -> int:
    """Compare with the forces handed over; return the number of changes."""
    found = handed_over(states, axis)
    told = list(zip(found.at.tolist(), found.force.tolist(), strict=True))
    assert np.all(np.diff(found.at) >= 0.0)
    compared = 0
    for before, state in pairwise(states):
        # A mean is rounded once a tick, and divided by a hundredth of a tick at least.
        assert impulse(told, before.seq, state.seq) == pytest.approx(
            impulse(turn, before.seq, state.seq), abs=1e-9
        ), state.seq
        if before.seq in found.unsure:
            continue
        cuts = sorted(
            {
                before.seq,
                *(at for at, _ in turn + told if before.seq < at < state.seq),
                state.seq,
            }
        )
        for low, high in pairwise(cuts):
            if high - low > 1e-6:
                assert acting(told, 0.5 * (low + high)) == pytest.approx(
                    acting(turn, 0.5 * (low + high)), abs=1e-6
                ), low
                compared += 1
    return compared


@pytest.mark.parametrize("apply", ["on_arrival", "next_tick"])
@pytest.mark.parametrize("rule", RULES)
def test_the_forces_of_every_rule_are_those_that_were_handed_over(
    rule: str, apply: str, tmp_path: Path
) -> None:
    states, turn = play(RULES[rule].script._replace(apply=apply), 2, tmp_path)
    assert assert_rebuilt(states, turn, 2) > 0.8 * len(states)


def test_a_guard_that_acts_at_the_end_of_a_tick_left_its_late_answer_as_it_was_until_then(
    tmp_path: Path,
) -> None:
    """The lowered force was assumed for the whole rest of the tick."""
    # A spring that pushes out more strongly than it was pushed in: the guard has something to
    # lower, and something in store.
    script = driver(
        [
            answer(
                seq,
                2_600.0 if seq % 3 == 0 else 600.0,
                (0.0, 0.0, 2.0 * math.cos(0.2 * seq) + 1.0),
            )
            for seq in range(TICKS)
            if seq % 3 != 1
        ],
        position=lambda seq: (0.0, 0.0, -1e-3 * math.cos(0.2 * seq)),
        guard={"stiffness": 500.0, "damping": 5.0},
    )
    states, turn = play(script, 2, tmp_path)
    ends = [
        state
        for before, state in pairwise(states)
        if state.force_seq == before.seq - 1 != before.force_seq
    ]
    assert any(
        acting(turn, state.seq - 0.1) != acting(turn, state.seq) for state in ends
    )
    assert_rebuilt(states, turn, 2)


@pytest.mark.parametrize("slept", [1, 5])
@pytest.mark.parametrize("answered", [True, False])
def test_a_device_that_lets_go_while_the_driver_sleeps(
    slept: int, answered: bool, tmp_path: Path
) -> None:
    """A force of the tick before is known by its mean only, and marked so."""
    hold = 2.5 if slept > 2 else 1.5
    script = driver(
        [answer(seq) for seq in range(TICKS) if answered or seq != 29],
        {30: 2_000 * slept + 500},
        limits={"hold": hold * T},
        watchdog=30,
    )
    states, turn = play(script, 2, tmp_path)
    assert acting(turn, 30 + slept - 0.25) == 0.0
    assert_rebuilt(states, turn, 2)
    unsure = handed_over(states, 2).unsure.tolist()
    assert unsure == (list(range(29, 30 + slept)) if answered else [])


def test_what_was_held_behind_a_gap_of_the_recording_is_told_by_the_mean(
    tmp_path: Path,
) -> None:
    """Identification and replays use the mean until the first change."""
    script = driver(
        [
            answer(seq, 500.0 + 300.0 * (seq % 3), (0.0, 0.0, 1.0 + 0.1 * seq))
            for seq in range(TICKS)
        ]
    )
    states, turn = play(script, 2, tmp_path)
    found = handed_over([state for state in states if not 40 < state.seq <= 45], 2)
    told = list(zip(found.at.tolist(), found.force.tolist(), strict=True))
    for when in (45.1, 45.9, 46.1):
        assert acting(told, when) == pytest.approx(acting(turn, when), abs=1e-9), when


def test_without_means_the_last_force_of_each_tick_is_told(tmp_path: Path) -> None:
    """For drivers and earlier recordings without means, a replay uses what there is."""
    script = driver(
        [answer(seq, 500.0, (0.0, 0.0, 1.0 + 0.1 * seq)) for seq in range(TICKS)]
    )
    states, turn = play(script, 2, tmp_path)
    found = handed_over(
        [
            msgspec.structs.replace(state, mean_force=(0.0, 0.0, 0.0))
            for state in states
        ],
        2,
    )
    told = list(zip(found.at.tolist(), found.force.tolist(), strict=True))
    assert all(
        acting(told, seq + 0.9) == acting(turn, seq + 0.9)
        for seq in range(10, TICKS - 1)
    )
    assert len(found.unsure)


def test_a_late_answer_whose_delay_is_rounded_is_one_force() -> None:
    """Rounding put the delay an ulp before the first change, counting the force twice."""
    at = 0.3
    assert (at + 1) - 1 > at
    force = [(0.0, 0.0, 0.0)] * 2 + [(0.0, 0.0, 6.0)]
    means = [(0.0, 0.0, 0.0)] * 2 + [(0.0, 0.0, 6.0 * (1.0 - at))]
    states = [
        DeviceState(
            seq=seq,
            stamp=0.0,
            position=(0.0, 0.0, 0.0),
            force=force[seq],
            mean_force=means[seq],
        )
        for seq in range(3)
    ]
    states[2] = msgspec.structs.replace(
        states[2], force_seq=0, age=1, delay=at + 1, changed_at=at
    )
    found = handed_over(states, 2)
    assert [
        (force, answers)
        for force, answers in zip(found.force, found.answers, strict=True)
        if force
    ] == [(6.0, 0)]
