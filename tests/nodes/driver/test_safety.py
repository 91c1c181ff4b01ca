"""The driver's safety: every limit at its edge, and no sequence of messages whatever that gets past one."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from messages.types import ZERO, Force, Vector
from nodes.driver.limits import STOP_TIME
from nodes.driver.passivity import PassivityParameters
from nodes.driver.safety import REGAIN, let_go, rearm, soft_stop
from tests.support.safety import UP, Port, T, force

# -- watchdog --------------------------------------------------------------------------------------------------------


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
        f"active → damping at tick {7 + watchdog}: no fresh force for {watchdog} ticks, limit {watchdog}",
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
    # The driver was held up from tick 1 to tick 500: the first tick it sees again is over the watchdog at once.
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
    assert port.changes() == ["waiting → ramp", "ramp → active", "active → damping", "damping → zero", "zero → ramp"]


@pytest.mark.parametrize(("away", "first"), [(1, 0.85), (3, 0.65), (9, 0.05), (10, 0.05), (500, 0.05)])
def test_a_force_that_was_away_comes_back_by_a_ramp_as_long_as_the_gap_asks_for(away: int, first: float) -> None:
    """Of 20 ticks, five for each tick without force: what remains is the share it begins with, and each tick adds 1/20."""
    port = Port(watchdog=2, damping_ticks=3, recovery=20 * T)
    port.answer(force(0), 0)
    assert port.force == UP  # the first force has no ramp unless one is asked for
    for silent in range(away + 1):
        port.missed(1 + silent, ZERO)
    shares = []
    for tick in range(2 + away, 2 + away + 25):
        port.answer(force(tick), tick)
        shares.append(port.force[2])
    expected = [min(max(1.0 - REGAIN * away / 20, 0.0) + (n + 1) / 20, 1.0) for n in range(25)]
    assert shares == pytest.approx(expected, abs=1e-15)  # a sum of two quotients


def test_a_ramp_that_is_interrupted_goes_on_from_less_not_from_the_whole_force() -> None:
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
    # Less than the watchdog, but the device has a deadline of its own: it held no force since tick 35.
    let_go(port.s, 45, 35.0)
    port.answer(force(45), 45)
    assert port.force[2] == 0.05
    # A driver that was started again does not know for how long there was no force.
    port = Port(recovery=20 * T)
    port.s.ramp_ticks = port.s.recovery_ticks
    port.answer(force(0), 0)
    assert port.force[2] == 0.05


def test_the_guard_judges_what_the_ramp_lets_through() -> None:
    port = Port(watchdog=1, damping_ticks=0, recovery=10 * T, guard=PassivityParameters())
    port.answer(force(0), 0)
    for tick in range(1, 9):
        port.missed(tick, ZERO)
    # It moves out by 1 mm a tick, and 0.5 mJ are in store: 0.5 N of the 0.8 N that the ramp lets through.
    port.s.guard_energy[0], port.s.guard_step[2] = -5e-4, 1e-3
    port.answer(force(9, 8.0), 9)
    assert port.force[2] == pytest.approx(0.5, rel=1e-12)  # a quotient
    assert port.s.lowered == 1


def test_the_ramp_is_of_the_largest_force_not_of_what_is_cut_from_it() -> None:
    port = Port(peak_force=2.0, ramp=10 * T)
    port.answer(force(0, 200.0), 0)
    assert port.force[2] == 0.2


def test_a_ramp_that_pushes_too_fast_goes_back_and_a_hand_that_pushes_in_does_not_hold_it_up() -> None:
    port = Port(ramp=100 * T)
    for tick in range(20):
        port.answer(force(tick), tick)
    assert port.force[2] == 0.2
    for tick, (speed, share) in enumerate([(0.25, 0.21), (0.26, 0.16), (0.26, 0.11), (-1.0, 0.12), (0.0, 0.13)], 20):
        port.moves((0.0, 0.0, speed))
        port.answer(force(tick), tick)
        assert port.force[2] == share


def test_a_force_that_is_late_does_not_hurry_the_ramp() -> None:
    port = Port(ramp=4 * T)
    port.answer(force(10), 10)
    # Three answers in one tick: one step of the ramp, not three, nor one for each tick that had no answer.
    for seq in (11, 12, 13):
        assert port.answer(force(seq), 13)
    assert port.force[2] == 2 / 4
    port = Port(ramp=100 * T)
    port.answer(force(10), 10)
    for seq in (11, 12, 13):
        port.answer(force(seq), 13)
    assert port.force[2] == 0.02


# -- what is refused --------------------------------------------------------------------------------------------------


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
def test_forces_are_refused_by_age_order_and_future(seq: int, tick: int, why: str | None) -> None:
    port = Port(max_age=5)
    port.answer(force(10), 10)
    assert port.answer(force(seq, 3.0), tick) is (why is None)
    assert port.force[2] == (3.0 if why is None else 1.0)
    assert {key for key, count in port.refused.items() if count} == (set() if why is None else {why})


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_force_that_is_not_finite_is_refused_even_behind_the_codec(value: float) -> None:
    port = Port()
    port.answer(force(0), 0)
    assert not port.answer(Force(seq=1, stamp=0.0, force=(0.0, value, 0.0)), 1)
    assert port.force == UP
    assert port.refused["not_finite"] == 1


# -- limits -----------------------------------------------------------------------------------------------------------


def test_peak_holds_at_its_edge_and_is_counted() -> None:
    port = Port(peak_force=2.0)
    port.answer(force(0, 2.0), 0)
    assert (port.force[2], port.limited["peak"]) == (2.0, 0)
    port.answer(force(1, math.nextafter(2.0, 3.0)), 1)
    assert (port.force[2], port.limited["peak"]) == (2.0, 1)
    port.answer(force(2, -1e300), 2)
    assert port.force[2] == -2.0


def test_slew_is_shared_by_all_forces_of_one_tick() -> None:
    port = Port(slew=0.5 / T)
    port.answer(force(0, 0.2), 0)
    assert port.force[2] == 0.2
    port.answer(force(3, 10.0), 5)
    assert port.force[2] == 0.7
    # The slew of tick 5 is used up; late answers in the same tick cannot take another step, nor one back.
    port.answer(force(4, 10.0), 5)
    port.answer(force(5, -10.0), 5)
    assert port.force[2] == 0.7
    port.answer(force(6, -10.0), 6)
    assert port.force[2] == pytest.approx(0.2, abs=1e-15)  # 0.7 − 0.5, one rounding


def test_zero_and_fault_are_reached_within_the_slew_too() -> None:
    port = Port(slew=0.4 / T, watchdog=1, damping_ticks=0, workspace=((-1.0, 1.0),) * 3)
    for tick in range(3):
        port.answer(force(tick, 1.0), tick)
    assert port.force[2] == 1.0
    got = []
    for tick in range(3, 7):
        port.missed(tick, ZERO)
        got.append(round(port.force[2], 12))
    assert got == [0.6, 0.2, 0.0, 0.0]


def test_continuous_force_comes_down_at_the_slew_and_stays_at_its_limit() -> None:
    limit, slew, tau = 1.75, 100.0 * T, 1.0
    port = Port(continuous_force=limit, thermal_time=tau, slew=slew / T, peak_force=7.9)
    keep = math.exp(-T / tau)
    heat, handed = 0.0, []
    for tick in range(2000):
        port.answer(force(tick, 7.9), tick)
        handed.append(port.force[2])
        heat = keep * heat + (1.0 - keep) * handed[-1] ** 2
        assert heat <= limit**2 * (1.0 + 1e-12)  # the last bits of 2000 sums
    assert max(handed) > 2.0 * limit  # short forces are still large
    assert handed[-1] == pytest.approx(limit, rel=1e-3)  # and after ten time constants the limit is used, not less
    assert max(abs(b - a) for a, b in pairwise(handed)) <= slew * (1.0 + 1e-12)
    assert port.limited["continuous"] > 0


def test_continuous_force_also_counts_ticks_without_an_answer() -> None:
    port = Port(continuous_force=1.0, thermal_time=0.1, watchdog=10_000, peak_force=5.0)
    keep = math.exp(-T / 0.1)
    port.answer(force(0, 5.0), 0)
    heat = (1.0 - keep) * port.force[2] ** 2
    for tick in range(1, 300):
        port.missed(tick, ZERO)
        heat = keep * heat + (1.0 - keep) * port.force[2] ** 2
        assert heat <= 1.0 + 1e-12  # 300 sums
    assert port.state == "active"


@pytest.mark.parametrize(
    ("slew", "watchdog", "tau"), [(50.0, 20, 3.0), (50.0, 2, 0.1), (100.0, 10, 1.0), (20_000.0, 10, 0.5)]
)
def test_continuous_force_holds_through_gap_after_gap(slew: float, watchdog: int, tau: float) -> None:
    """With room for one gap alone it was exceeded by up to 20 %: each tick of the way down may be followed by another one."""
    limit, keep = 1.75, math.exp(-T / tau)
    port = Port(continuous_force=limit, thermal_time=tau, slew=slew, peak_force=7.9, watchdog=watchdog)
    heat, tick = 0.0, 0
    for _ in range(1500):
        port.answer(force(tick, 7.9), tick)
        # Held for as long as it may be, whenever the motor is hot.
        held = 1 + (watchdog if heat > 0.9 * limit**2 else 0)
        heat = keep**held * heat + (1.0 - keep**held) * port.force[2] ** 2
        assert heat <= limit**2 * (1.0 + 1e-12)  # the last bits of 1500 sums
        tick += held
    # It is used all the same: of the limit at least so much as is left when every tick is followed by a gap.
    assert heat > 0.8 * limit**2


def test_continuous_force_holds_through_a_gap_in_which_the_device_holds_its_force() -> None:
    """As many ticks as the watchdog has are lost while the force is large: over the limit, were that not foreseen."""
    limit, tau = 1.75, 0.2
    keep = math.exp(-T / tau)
    for lost_after in range(1, 60, 3):
        port = Port(continuous_force=limit, thermal_time=tau, slew=100.0, peak_force=7.9)
        heat, tick = 0.0, 0
        for n in range(400):
            port.answer(force(tick, 7.9), tick)
            passed = 11 if n == lost_after else 1
            for _ in range(passed):
                heat = keep * heat + (1.0 - keep) * port.force[2] ** 2
                assert heat <= limit**2 * (1.0 + 1e-12)  # the last bits of 400 sums
            tick += passed


def test_outside_the_workspace_there_is_no_force_and_back_inside_it_grows_again() -> None:
    port = Port(workspace=((-1.0, 1.0), (-1.0, 1.0), (0.0, 0.1)), ramp=2 * T, recovery=0.0)
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
    assert port.changes() == ["waiting → ramp", "ramp → active", "active → fault", "fault → zero", "zero → ramp"]


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_position_that_is_not_finite_is_a_fault_and_must_not_be_used(value: float) -> None:
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


# -- a loop that swings -----------------------------------------------------------------------------------------------


def swung(port: Port, times: int, apart: int, gained: float, both: bool = False) -> int:
    """Ask for more than the peak again and again; give the tick after."""
    tick = 0
    for n in range(times):
        for k in range(apart):
            port.watch_swings(gained * n, (0.0, 0.0, -0.2), tick)
            z = 20.0 if k == 0 else -20.0 if both else 1.0
            port.answer(force(tick, z), tick)
            tick += 1
    port.watch_swings(gained * times, (0.0, 0.0, -0.2), tick)
    return tick


@pytest.mark.parametrize(
    ("times", "apart", "gained", "both", "state"),
    [
        (6, 10, 1e-9, False, "stopped"),
        (5, 10, 1e-9, False, "active"),  # once less
        (6, 10, 0.0, False, "active"),  # nobody who taps a surface hard gets energy from it
        (6, 10, -1e-3, False, "active"),
        (6, 200, 1e-9, False, "stopped"),  # 5 times 0.4 s are 2 s
        (6, 201, 1e-9, False, "active"),
        (3, 10, 1e-9, True, "stopped"),  # from one side to the other is a swing too, with no tick in between
    ],
)
def test_a_force_that_swings_at_its_limit_and_gives_out_energy_stops_the_driver(
    times: int, apart: int, gained: float, both: bool, state: str
) -> None:
    port = Port(peak_force=8.0)
    swung(port, times, apart, gained, both)
    assert port.state == state
    assert [kind for kind, _ in port.events if kind == "stopped"] == ["stopped"] * (state == "stopped")


def test_a_stop_is_for_good_and_damps_first() -> None:
    port = Port(peak_force=8.0, damping=0.5, damping_ticks=5, workspace=((-0.1, 0.1),) * 3)
    tick = swung(port, 6, 2, 1e-3)  # stopped in the tick before this one: 4 of 5 are left
    for passed, answered in enumerate([True, False] * 5):
        port.watch_position(ZERO, tick)
        port.watch_swings(1.0, (0.0, 0.0, -0.2), tick)
        if answered:
            assert port.answer(force(tick, 3.0), tick)
        else:
            port.missed(tick, (0.0, 0.0, -0.2))
        assert port.force[2] == pytest.approx(0.5 * 0.2 if passed < 4 else 0.0, abs=1e-15)
        tick += 1
    # A position that is none must not leave a brake behind that no position answers.
    port.s.stopped_at = tick
    port.watch_swings(1.0, (0.0, 0.0, -0.2), tick)
    assert not port.watch_position((0.2, 0.0, 0.0), tick)
    assert port.missed(tick, ZERO) == ZERO
    assert port.state == "stopped"


def test_a_stop_ends_only_when_somebody_asks_and_then_by_the_whole_ramp() -> None:
    port = Port(peak_force=8.0, damping_ticks=0, recovery=20 * T)
    assert not rearm(port.s, 0)
    assert port.events == []
    tick = swung(port, 6, 10, 1e-3)
    for _ in range(500):
        port.watch_swings(0.0, ZERO, tick)
        port.answer(force(tick, 4.0), tick)
        assert (port.state, port.force) == ("stopped", ZERO)
        tick += 1
    assert rearm(port.s, tick)
    assert port.state == "zero"
    shares = []
    for _ in range(25):
        port.watch_swings(0.0, ZERO, tick)
        port.answer(force(tick, 4.0), tick)
        shares.append(port.force[2] / 4.0)
        tick += 1
    assert shares == pytest.approx([min((n + 1) / 20, 1.0) for n in range(25)], abs=1e-15)  # quotients
    assert port.changes()[-2:] == ["zero → ramp", "ramp → active"]
    assert any(kind == "rearmed" and reason.startswith("stopped → zero at tick") for kind, reason in port.events)
    # It swings again, from where it is now: six times anew, not once.
    for n in range(1, 7):
        assert port.state == "active"
        port.answer(force(tick, 20.0), tick)
        port.answer(force(tick + 1, 1.0), tick + 1)
        tick += 2
        port.watch_swings(1e-3 * n, ZERO, tick)
    assert port.state == "stopped"


def test_a_device_outside_its_workspace_has_no_force_after_a_stop_either() -> None:
    port = Port(peak_force=8.0, damping_ticks=0, recovery=20 * T, workspace=((-0.1, 0.1),) * 3)
    tick = swung(port, 6, 10, 1e-3)
    assert not port.watch_position((0.2, 0.0, 0.0), tick)
    assert rearm(port.s, tick)
    assert not port.watch_position((0.2, 0.0, 0.0), tick + 1)
    port.answer(force(tick + 1, 4.0), tick + 1)
    assert (port.state, port.force) == ("fault", ZERO)


def test_without_a_largest_force_or_by_request_nobody_stops_it() -> None:
    for port in (Port(), Port(peak_force=8.0, stop_after=None)):
        assert not port.s.stop_after


# -- the end ----------------------------------------------------------------------------------------------------------


@given(
    start=st.floats(-7.9, 7.9),
    slew=st.one_of(st.none(), st.floats(5.3, 1e5)),
)
def test_soft_stop_ends_at_zero_within_slew_and_time(start: float, slew: float | None) -> None:
    port = Port(slew=slew, peak_force=7.9)
    port.s.force[:] = (0.0, start, -0.5 * start)
    steps = soft_stop(port.force, port.s.slew, T)
    assert steps[-1] == ZERO
    assert len(steps) * T <= STOP_TIME + T  # rounding the number of steps up
    most = slew * T if slew is not None else abs(start) / 10.0
    for before, after in pairwise([port.force, *steps]):
        assert all(abs(b - a) <= most * (1.0 + 1e-9) + 1e-12 for a, b in zip(before, after, strict=True))


def test_soft_stop_without_force_is_one_zero() -> None:
    assert soft_stop(ZERO, math.inf, T) == [ZERO]


# -- no sequence of messages whatever ---------------------------------------------------------------------------------

anything = st.one_of(st.floats(-20.0, 20.0), st.sampled_from([1e308, -1e308, math.nan, math.inf, 5e-324, 0.0]))
vectors = st.tuples(anything, anything, anything)
places = st.one_of(st.just(0.0), st.floats(-0.2, 0.2), st.just(math.nan))
messages = st.tuples(st.integers(-12, 2), vectors)
ticks = st.tuples(
    st.integers(1, 3),  # ticks passed: more than one is an overrun
    st.tuples(places, places, places),
    st.lists(messages, max_size=8),  # forces that arrive in this tick, by the tick they answer
)


@settings(max_examples=150, deadline=None)
@given(
    run=st.lists(ticks, min_size=1, max_size=60),
    peak=st.floats(0.1, 10.0),
    slew=st.floats(1.0, 5e3),
    continuous=st.one_of(st.none(), st.floats(0.05, 5.0)),
    watchdog=st.integers(1, 5),
    ramp=st.sampled_from([0.0, 3 * T]),
)
def test_no_sequence_of_messages_gets_past_a_limit(
    run: list[tuple[int, Vector, list[tuple[int, Vector]]]],
    peak: float,
    slew: float,
    continuous: float | None,
    watchdog: int,
    ramp: float,
) -> None:
    box = ((-0.1, 0.1),) * 3
    port = Port(
        peak_force=peak,
        slew=slew,
        continuous_force=continuous,
        thermal_time=0.05,
        watchdog=watchdog,
        damping_ticks=2,
        ramp=ramp,
        workspace=box,
    )
    keep = math.exp(-T / 0.05)
    heat, tick, since = 0.0, 0, 0
    gaps: list[int] = []
    for passed, position, arrivals in run:
        tick += passed
        gaps += [passed - 1] * (passed > 1)
        held = sum(v * v for v in port.force)
        heat = keep ** (passed - 1) * (heat - held) + held
        port.watch_position(position, tick)
        inside = all(abs(value) <= 0.1 for value in position)
        handed = [port.force]
        answered = False
        for offset, vector in arrivals:
            seq = max(tick + offset, 0)
            before = port.s.force_seq
            if port.answer(Force(seq=seq, stamp=0.0, force=vector), tick):
                assert before < seq <= tick
                assert tick - seq <= 5
                assert all(map(math.isfinite, vector))
                since = tick
                answered = answered or seq == tick
                handed.append(port.force)
        if not answered:
            port.missed(tick, (0.0, 0.0, 0.3))
            handed.append(port.force)
        for vector in handed:
            assert all(abs(value) <= peak for value in vector)
        most = slew * T * (1.0 + 1e-9)  # sums of a handful of steps
        for axis in range(3):
            assert sum(abs(b[axis] - a[axis]) for a, b in pairwise(handed)) <= most
        heat = keep * heat + (1.0 - keep) * max(sum(v * v for v in vector) for vector in handed[1:] or handed)
        if continuous is not None and max(gaps, default=0) <= watchdog:
            # Gaps in which the device holds its force are provided for, as many as there may be.
            assert heat <= continuous**2 * (1.0 + 1e-9)
        if tick - since >= watchdog + 2 + math.ceil(peak / (slew * T)) and port.state != "waiting":
            assert port.force == ZERO or passed > 1
        if not inside:
            assert port.state == "fault"
    assert all(kind and reason for kind, reason in port.events)
