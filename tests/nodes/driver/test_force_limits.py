"""The driver's force limits: at the edge, until the end, for every message sequence."""

from __future__ import annotations

import math
import sys
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from messages.types import ZERO, Force, Vector
from nodes.compiled.published import message_of
from nodes.driver.limits import STOP_TIME
from nodes.driver.soft_stop import soft_stop
from nodes.driver.state import PUBLISHED
from tests.support.safety import Port, T, force


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
    # The slew of tick 5 is used up; late answers in the same tick cannot take another step, nor one
    # back.
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
        assert port.events is not None  # notes of a tick become events after it
    assert max(handed) > 2.0 * limit  # short forces are still large
    # and after ten time constants the limit is used, not less
    assert handed[-1] == pytest.approx(limit, rel=1e-3)
    assert max(abs(b - a) for a, b in pairwise(handed)) <= slew * (1.0 + 1e-12)
    lowered = port.limited["continuous"]
    assert lowered > 1000
    # The first time is told, then the second, the fourth, the eighth.
    reasons = [reason for _, reason in port.events if "continuous" in reason]
    assert len(reasons) == lowered.bit_length(), port.events


def test_heat_is_told_as_part_of_what_the_device_bears() -> None:
    limit, tau, given, ticks = 3.0, 0.5, 2.0, 400
    port = Port(continuous_force=limit, thermal_time=tau, peak_force=7.9)
    unlimited = Port(peak_force=7.9)
    for one in (port, unlimited):
        for tick in range(ticks):
            assert one.answer(Force(seq=tick, stamp=0.0, force=(0.0, 0.0, given)), tick)
    # The tick under way is not over: the mean square is that of the ticks before it.
    expected = (given / limit) ** 2 * (1.0 - math.exp(-(ticks - 1) * T / tau))
    # A rounding per tick, of a sum that grows to at most one.
    assert message_of(PUBLISHED)(port.s, "active").heat == pytest.approx(
        expected, abs=ticks * sys.float_info.epsilon
    )
    assert message_of(PUBLISHED)(unlimited.s, "active").heat == 0.0


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
    ("slew", "watchdog", "tau"),
    [(50.0, 20, 3.0), (50.0, 2, 0.1), (100.0, 10, 1.0), (20_000.0, 10, 0.5)],
)
def test_continuous_force_holds_through_gap_after_gap(
    slew: float, watchdog: int, tau: float
) -> None:
    """With margin for one gap only it was exceeded by 20 %: gaps may follow each other."""
    limit, keep = 1.75, math.exp(-T / tau)
    port = Port(
        continuous_force=limit,
        thermal_time=tau,
        slew=slew,
        peak_force=7.9,
        watchdog=watchdog,
    )
    heat, tick = 0.0, 0
    for _ in range(1500):
        port.answer(force(tick, 7.9), tick)
        # Held for as long as it may be, whenever the motor is hot.
        held = 1 + (watchdog if heat > 0.9 * limit**2 else 0)
        heat = keep**held * heat + (1.0 - keep**held) * port.force[2] ** 2
        assert heat <= limit**2 * (1.0 + 1e-12)  # the last bits of 1500 sums
        tick += held
    # It is used all the same: of the limit at least so much as is left when every tick is followed
    # by a gap.
    assert heat > 0.8 * limit**2


def test_continuous_force_holds_through_a_gap_in_which_the_device_holds_its_force() -> (
    None
):
    """A whole watchdog of lost ticks at a large force must stay within the limit."""
    limit, tau = 1.75, 0.2
    keep = math.exp(-T / tau)
    for lost_after in range(1, 60, 3):
        port = Port(
            continuous_force=limit, thermal_time=tau, slew=100.0, peak_force=7.9
        )
        heat, tick = 0.0, 0
        for n in range(400):
            port.answer(force(tick, 7.9), tick)
            passed = 11 if n == lost_after else 1
            for _ in range(passed):
                heat = keep * heat + (1.0 - keep) * port.force[2] ** 2
                assert heat <= limit**2 * (1.0 + 1e-12)  # the last bits of 400 sums
            tick += passed


# -- the end
# --------------------------------------------------------------------------------------------------


@given(start=st.floats(-7.9, 7.9), slew=st.one_of(st.none(), st.floats(5.3, 1e5)))
def test_soft_stop_ends_at_zero_within_slew_and_time(
    start: float, slew: float | None
) -> None:
    port = Port(slew=slew, peak_force=7.9)
    port.s.force[:] = (0.0, start, -0.5 * start)
    steps = soft_stop(port.force, port.s.slew, T)
    assert steps[-1] == ZERO
    assert len(steps) * T <= STOP_TIME + T  # rounding the number of steps up
    most = slew * T if slew is not None else abs(start) / 10.0
    for before, after in pairwise([port.force, *steps]):
        assert all(
            abs(b - a) <= most * (1.0 + 1e-9) + 1e-12
            for a, b in zip(before, after, strict=True)
        )


def test_soft_stop_without_force_is_one_zero() -> None:
    assert soft_stop(ZERO, math.inf, T) == [ZERO]


# -- no sequence of messages whatever
# ---------------------------------------------------------------------------------

anything = st.one_of(
    st.floats(-20.0, 20.0),
    st.sampled_from([1e308, -1e308, math.nan, math.inf, 5e-324, 0.0]),
)
vectors = st.tuples(anything, anything, anything)
places = st.one_of(st.just(0.0), st.floats(-0.2, 0.2), st.just(math.nan))
messages = st.tuples(st.integers(-12, 2), vectors)
ticks = st.tuples(
    st.integers(1, 3),  # ticks passed: more than one is an overrun
    st.tuples(places, places, places),
    # forces that arrive in this tick, by the tick they answer
    st.lists(messages, max_size=8),
)


@settings(max_examples=150)
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
        heat = keep * heat + (1.0 - keep) * max(
            sum(v * v for v in vector) for vector in handed[1:] or handed
        )
        if continuous is not None and max(gaps, default=0) <= watchdog:
            # Gaps in which the device holds its force are provided for, as many as there may be.
            assert heat <= continuous**2 * (1.0 + 1e-9)
        if (
            tick - since >= watchdog + 2 + math.ceil(peak / (slew * T))
            and port.state != "waiting"
        ):
            assert port.force == ZERO or passed > 1
        if not inside:
            assert port.state == "fault"
    assert all(kind and reason for kind, reason in port.events)
