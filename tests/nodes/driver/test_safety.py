"""The driver's safety: its watchdog, its ramps, refused forces, and runs without it."""

from __future__ import annotations

import math

import pytest

from messages.types import ZERO, Force
from nodes.driver.passivity import PassivityParameters
from nodes.driver.safety import REGAIN, RETURN_SPEED, let_go
from tests.support.safety import UP, Port, T, force

# -- watchdog
# --------------------------------------------------------------------------------------------------


def test_nothing_is_handed_over_before_the_first_force() -> None:
    port = Port(watchdog=3)
    assert all(port.missed(tick, ZERO) is None for tick in range(100))
    assert port.state == "waiting"
    assert port.force == ZERO
    assert port.events == []


@pytest.mark.parametrize("watchdog", [1, 2, 10])
def test_watchdog_holds_for_n_minus_1_ticks_and_damps_at_n(watchdog: int) -> None:
    port = Port(watchdog=watchdog, damping_ticks=5, damping=2.0)
    assert port.answer(force(7), 7)
    velocity = (0.1, 0.0, -0.25)
    for silent in range(1, watchdog):
        assert port.missed(7 + silent, velocity) is None
        assert port.state == "active"
        assert port.force == UP
    assert port.missed(7 + watchdog, velocity) == (-0.2, 0.0, 0.5)
    assert port.state == "damping"
    assert port.events[-1] == (
        "safety",
        (
            f"active → damping at tick {7 + watchdog}: no fresh force for {watchdog} ticks, limit"
            f" {watchdog}"
        ),
    )


def test_a_fresh_force_one_tick_before_the_watchdog_starts_it_anew() -> None:
    port = Port(watchdog=4)
    port.answer(force(0), 0)
    for tick in range(1, 4):
        assert port.missed(tick, ZERO) is None
    port.answer(force(4), 4)
    for tick in range(5, 8):
        assert port.missed(tick, ZERO) is None
    port.missed(8, ZERO)
    assert port.changes() == ["waiting → active", "active → damping"]


@pytest.mark.parametrize("damping_ticks", [0, 1, 6])
def test_damping_lasts_its_ticks_and_then_the_force_is_zero(damping_ticks: int) -> None:
    port = Port(watchdog=2, damping_ticks=damping_ticks, damping=1.0)
    port.answer(force(0), 0)
    port.missed(1, UP)
    handed = [port.missed(tick, UP) for tick in range(2, 2 + damping_ticks + 3)]
    assert handed == [(0.0, 0.0, -1.0)] * damping_ticks + [ZERO] * 3
    assert port.state == "zero"


def test_silence_counts_ticks_that_the_driver_itself_left_out() -> None:
    port = Port(watchdog=10, damping_ticks=0)
    port.answer(force(0), 0)
    # The driver was held up from tick 1 to tick 500: the first tick it sees again is over the
    # watchdog at once.
    assert port.missed(500, ZERO) == ZERO
    assert port.state == "zero"


def test_forces_resume_by_themselves_with_the_ramp() -> None:
    port = Port(watchdog=1, damping_ticks=0, ramp=4 * T, recovery=4 * T)
    got = []
    for tick in range(4):
        port.answer(force(tick), tick)
        got.append(port.force[2])
    assert got == [0.25, 0.5, 0.75, 1.0]
    port.missed(4, ZERO)
    assert port.force == ZERO
    port.answer(force(5), 5)
    assert port.force[2] == 0.25
    assert port.changes() == [
        "waiting → ramp",
        "ramp → active",
        "active → damping",
        "damping → zero",
        "zero → ramp",
    ]


@pytest.mark.parametrize(
    ("away", "first"), [(1, 0.85), (3, 0.65), (9, 0.05), (10, 0.05), (500, 0.05)]
)
def test_a_force_that_was_away_comes_back_by_a_ramp_as_long_as_the_gap_asks_for(
    away: int, first: float
) -> None:
    """Of 20 ticks, each tick without force costs five; then 1/20 per tick."""
    port = Port(watchdog=2, damping_ticks=3, recovery=20 * T)
    port.answer(force(0), 0)
    assert port.force == UP  # the first force has no ramp unless one is asked for
    for silent in range(away + 1):
        port.missed(1 + silent, ZERO)
    shares = []
    for tick in range(2 + away, 2 + away + 25):
        port.answer(force(tick), tick)
        shares.append(port.force[2])
    expected = [
        min(max(1.0 - REGAIN * away / 20, 0.0) + (n + 1) / 20, 1.0) for n in range(25)
    ]
    assert shares == pytest.approx(expected, abs=1e-15)  # a sum of two quotients


def test_a_ramp_that_is_interrupted_goes_on_from_less_not_from_the_whole_force() -> (
    None
):
    port = Port(watchdog=1, damping_ticks=0, recovery=100 * T)
    port.answer(force(0), 0)
    for tick in range(1, 60):
        port.missed(tick, ZERO)
    for tick in range(60, 70):
        port.answer(force(tick), tick)
    assert port.force[2] == pytest.approx(0.1, abs=1e-15)
    port.missed(70, ZERO)
    port.answer(force(71), 71)
    # A tick away costs five of the ten.
    assert port.force[2] == pytest.approx(0.06, abs=1e-15)


def test_after_a_fault_and_after_the_device_let_go_the_whole_ramp_is_due() -> None:
    port = Port(watchdog=50, recovery=20 * T, workspace=((-1.0, 1.0),) * 3)
    port.answer(force(0), 0)
    port.watch_position((0.0, 0.0, 2.0), 1)
    port.watch_position(ZERO, 2)
    port.answer(force(2), 2)
    assert port.force[2] == 0.05
    for tick in range(3, 30):
        port.answer(force(tick), tick)
    assert port.force == UP
    # Less than the watchdog, but the device has a deadline of its own: it held no force since tick
    # 35.
    let_go(port.s, 45, 35.0)
    port.answer(force(45), 45)
    assert port.force[2] == 0.05
    # A driver that was started again does not know for how long there was no force.
    port = Port(recovery=20 * T)
    port.s.ramp_ticks = port.s.recovery_ticks
    port.answer(force(0), 0)
    assert port.force[2] == 0.05


def test_the_guard_judges_what_the_ramp_lets_through() -> None:
    port = Port(
        watchdog=1, damping_ticks=0, recovery=10 * T, guard=PassivityParameters()
    )
    port.answer(force(0), 0)
    for tick in range(1, 9):
        port.missed(tick, ZERO)
    # It moves out by 1 mm a tick, and 0.5 mJ are in store: 0.5 N of the 0.8 N that the ramp lets
    # through.
    port.s.guard_energy[0], port.s.guard_step[2] = -5e-4, 1e-3
    port.answer(force(9, 8.0), 9)
    assert port.force[2] == pytest.approx(0.5, rel=1e-12)  # a quotient
    assert port.s.lowered == 1


def test_the_ramp_is_of_the_largest_force_not_of_what_is_cut_from_it() -> None:
    port = Port(peak_force=2.0, ramp=10 * T)
    port.answer(force(0, 200.0), 0)
    assert port.force[2] == 0.2


def test_a_ramp_that_pushes_too_fast_goes_back_and_a_hand_that_pushes_in_does_not_hold_it_up() -> (
    None
):
    port = Port(ramp=100 * T)
    for tick in range(20):
        port.answer(force(tick), tick)
    assert port.force[2] == 0.2
    speeds = [
        (0.125, 0.21),
        (0.1875, 0.215),
        (0.25, 0.215),
        (0.375, 0.205),
        (9.0, 0.155),
        (-1.0, 0.165),
        (0.0, 0.175),
    ]
    for tick, (speed, share) in enumerate(speeds, 20):
        port.moves((0.0, 0.0, speed))
        port.answer(force(tick), tick)
        # a sum of shares of ticks
        assert port.force[2] == pytest.approx(share, rel=1e-15)


@pytest.mark.parametrize(
    ("mass", "damping", "spring", "path", "stiffness", "law_damping", "depth", "speed"),
    [
        # They swung around the speed for good when the ramp went forth and back by whole steps.
        (0.158, 1.75, 154.0, -0.0659, 1851.0, 2.37, -0.0286, 0.24),
        (0.245, 1.87, 329.0, -0.0965, 968.0, 3.1, -0.0652, 0.0116),
        (0.569, 2.73, 280.0, -0.0947, 2341.0, 3.97, -0.0226, 0.227),
        (0.154, 3.11, 537.0, -0.0699, 1613.0, 2.17, -0.0541, 0.227),
        (0.164, 3.98, 275.0, -0.0989, 2263.0, 0.729, -0.0725, 0.278),
    ],
)
def test_a_hand_that_has_sunk_in_comes_out_and_is_not_shaken(
    mass: float,
    damping: float,
    spring: float,
    path: float,
    stiffness: float,
    law_damping: float,
    depth: float,
    speed: float,
) -> None:
    """A device in a hand with a spring to a point below the surface, in 0.01-tick steps."""
    port = Port(watchdog=1, damping_ticks=0, recovery=0.15, peak_force=40.0)
    port.answer(force(0), 0)
    for tick in range(1, 100):
        port.missed(tick, ZERO)
    tick, before, fastest = 100, depth, speed
    while port.state != "active":
        velocity, before = (depth - before) / T, depth
        wanted = (
            min(max(-stiffness * depth - law_damping * velocity, 0.0), 40.0)
            if depth < 0.0
            else 0.0
        )
        port.moves((0.0, 0.0, velocity))
        port.answer(force(tick, wanted), tick)
        for _ in range(100):
            speed += (
                (port.force[2] - damping * speed - spring * (depth - path))
                / mass
                * 0.01
                * T
            )
            depth += speed * 0.01 * T
        fastest = max(fastest, speed)
        tick += 1
        assert tick < 100 + 1.0 / T, "no force after a second"
    assert fastest < 4.0 * RETURN_SPEED


def test_a_force_that_is_late_does_not_hurry_the_ramp() -> None:
    port = Port(ramp=4 * T)
    port.answer(force(10), 10)
    # Three answers in one tick: one step of the ramp, not three, nor one for each tick that had no
    # answer.
    for seq in (11, 12, 13):
        assert port.answer(force(seq), 13)
    assert port.force[2] == 2 / 4
    port = Port(ramp=100 * T)
    port.answer(force(10), 10)
    for seq in (11, 12, 13):
        port.answer(force(seq), 13)
    assert port.force[2] == 0.02


# -- what is refused
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seq", "tick", "why"),
    [
        (20, 20, None),
        (21, 20, "future"),
        (15, 20, None),
        (14, 20, "stale"),
        (10, 12, "replayed"),
        (9, 12, "replayed"),
        (11, 12, None),
    ],
)
def test_forces_are_refused_by_age_order_and_future(
    seq: int, tick: int, why: str | None
) -> None:
    port = Port(max_age=5)
    port.answer(force(10), 10)
    assert port.answer(force(seq, 3.0), tick) is (why is None)
    assert port.force[2] == (3.0 if why is None else 1.0)
    assert {key for key, count in port.refused.items() if count} == (
        set() if why is None else {why}
    )


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_force_that_is_not_finite_is_refused_even_behind_the_codec(
    value: float,
) -> None:
    port = Port()
    port.answer(force(0), 0)
    assert not port.answer(Force(seq=1, stamp=0.0, force=(0.0, value, 0.0)), 1)
    assert port.force == UP
    assert port.refused["not_finite"] == 1


# -- where there is no force
# -----------------------------------------------------------------------------------------


def test_outside_the_workspace_there_is_no_force_and_back_inside_it_grows_again() -> (
    None
):
    port = Port(
        workspace=((-1.0, 1.0), (-1.0, 1.0), (0.0, 0.1)), ramp=2 * T, recovery=0.0
    )
    for tick in range(3):
        port.watch_position((0.0, 0.0, 0.1), tick)
        port.answer(force(tick), tick)
    assert port.force == UP
    port.watch_position((0.0, 0.0, math.nextafter(0.1, 1.0)), 3)
    assert port.state == "fault"
    assert port.missed(3, UP) == ZERO  # without waiting for any watchdog
    port.answer(force(4), 4)
    assert port.force == ZERO
    port.watch_position((0.0, 0.0, 0.1), 5)
    assert port.force == ZERO
    port.answer(force(5), 5)
    assert port.force[2] == 0.5
    assert port.changes() == [
        "waiting → ramp",
        "ramp → active",
        "active → fault",
        "fault → zero",
        "zero → ramp",
    ]


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_position_that_is_not_finite_is_a_fault_and_must_not_be_used(
    value: float,
) -> None:
    port = Port()
    port.answer(force(0), 0)
    assert not port.watch_position((0.0, value, 0.0), 1)
    assert port.state == "fault"
    assert port.missed(1, ZERO) == ZERO


def test_axes_that_the_scene_does_not_compute_get_no_force() -> None:
    port = Port(axes=(2,), damping=1.0, watchdog=1)
    port.answer(Force(seq=0, stamp=0.0, force=(5.0, 5.0, 1.0)), 0)
    assert port.force == UP
    assert port.missed(1, (3.0, 3.0, 0.5)) == (0.0, 0.0, -0.5)
