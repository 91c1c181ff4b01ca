"""A driver with late answers waits: no faster than answers come, within its watchdog."""

from __future__ import annotations

import math

import pytest

from nodes.compiled.layout import state_of
from nodes.driver.lateness import BEHIND, patience
from nodes.driver.state import ACTIVE, DAMPING, FAULT, IDLE, NOTHING, RAMP, DriverState

T = 0.002
DEADLINE = 10.0


def waits(
    unanswered: int,
    safety: int = ACTIVE,
    since: int = 1000,
    max_age: int = 5,
    hold: float = math.inf,
) -> float:
    """Return the periods that tick 1000 waits for its answer, after a force one tick before."""
    s = state_of(DriverState)
    s.unanswered, s.safety, s.since, s.seq, s.watchdog, s.max_age, s.period = (
        unanswered,
        safety,
        since,
        1000,
        10,
        max_age,
        T,
    )
    s.written, s.device_hold_ticks = 999, hold
    return (patience(s, DEADLINE, DEADLINE + T) - DEADLINE) / T


# 10 s are known to 2⁻⁵⁰ of themselves, which is 10⁻¹¹ of a period.
CLOSE = 1e-9


@pytest.mark.parametrize(
    ("unanswered", "periods"),
    [
        (0, 1),
        (BEHIND - 1, 1),
        (BEHIND, 2),
        (2 * BEHIND - 1, 2),
        (2 * BEHIND, 3),
        (5 * BEHIND, 6),
        (10**9, 6),
    ],
)
def test_it_waits_longer_the_more_ticks_were_not_answered_and_never_longer_than_a_force_may_be_old(
    unanswered: int, periods: int
) -> None:
    assert waits(unanswered) == pytest.approx(periods, abs=CLOSE)


def test_a_lockstep_driver_or_one_that_takes_no_old_force_waits_for_one_tick() -> None:
    assert waits(10**9, max_age=0) == pytest.approx(1, abs=CLOSE)


@pytest.mark.parametrize("safety", [ACTIVE, RAMP])
@pytest.mark.parametrize(
    ("silent", "periods"), [(0, 6), (4, 6), (5, 5), (8, 2), (9, 1), (20, 1)]
)
def test_the_watchdog_is_looked_at_on_time(
    safety: int, silent: int, periods: int
) -> None:
    # The last fresh force was `silent` ticks ago; damping begins ten ticks after it.
    assert waits(10**9, safety, since=1000 - silent) == pytest.approx(
        periods, abs=CLOSE
    )


@pytest.mark.parametrize(
    ("hold", "periods"), [(10.0, 6), (7.0, 6), (4.5, 3.5), (2.0, 1), (0.5, 1)]
)
def test_it_asks_again_before_the_device_lets_go(hold: float, periods: float) -> None:
    assert waits(10**9, hold=hold) == pytest.approx(periods, abs=CLOSE)


@pytest.mark.parametrize("safety", [DAMPING, FAULT])
def test_a_force_that_is_made_anew_each_tick_is_not_held_up(safety: int) -> None:
    assert waits(10**9, safety) == pytest.approx(1, abs=CLOSE)


@pytest.mark.parametrize("safety", [IDLE, NOTHING])
def test_without_a_force_on_the_device_nothing_is_watched(safety: int) -> None:
    assert waits(10**9, safety, since=0) == pytest.approx(6, abs=CLOSE)
