"""A loop that swings at the force limit and gives out energy is stopped until rearmed."""

from __future__ import annotations

import pytest

from messages.types import ZERO
from nodes.driver.safety import rearm
from tests.support.safety import Port, T, force


def swung(port: Port, times: int, apart: int, gained: float, both: bool = False) -> int:
    """Request more than the peak repeatedly; return the next tick."""
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
        (
            6,
            10,
            0.0,
            False,
            "active",
        ),  # nobody who taps a surface hard gets energy from it
        (6, 10, -1e-3, False, "active"),
        (6, 200, 1e-9, False, "stopped"),  # 5 times 0.4 s are 2 s
        (6, 201, 1e-9, False, "active"),
        # from one side to the other is a swing too, with no tick in between
        (3, 10, 1e-9, True, "stopped"),
    ],
)
def test_a_force_that_swings_at_its_limit_and_gives_out_energy_stops_the_driver(
    times: int, apart: int, gained: float, both: bool, state: str
) -> None:
    port = Port(peak_force=8.0)
    swung(port, times, apart, gained, both)
    assert port.state == state
    assert [kind for kind, _ in port.events if kind == "stopped"] == ["stopped"] * (
        state == "stopped"
    )


def test_a_stop_is_for_good_and_damps_first() -> None:
    port = Port(
        peak_force=8.0, damping=0.5, damping_ticks=5, workspace=((-0.1, 0.1),) * 3
    )
    # stopped in the tick before this one: 4 of 5 are left
    tick = swung(port, 6, 2, 1e-3)
    for passed, answered in enumerate([True, False] * 5):
        port.watch_position(ZERO, tick)
        port.watch_swings(1.0, (0.0, 0.0, -0.2), tick)
        if answered:
            assert port.answer(force(tick, 3.0), tick)
        else:
            port.missed(tick, (0.0, 0.0, -0.2))
        assert port.force[2] == pytest.approx(
            0.5 * 0.2 if passed < 4 else 0.0, abs=1e-15
        )
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
    # quotients
    assert shares == pytest.approx(
        [min((n + 1) / 20, 1.0) for n in range(25)], abs=1e-15
    )
    assert port.changes()[-2:] == ["zero → ramp", "ramp → active"]
    assert any(
        kind == "rearmed" and reason.startswith("stopped → zero at tick")
        for kind, reason in port.events
    )
    # It swings again, from where it is now: six times anew, not once.
    for n in range(1, 7):
        assert port.state == "active"
        port.answer(force(tick, 20.0), tick)
        port.answer(force(tick + 1, 1.0), tick + 1)
        tick += 2
        port.watch_swings(1e-3 * n, ZERO, tick)
    assert port.state == "stopped"


def test_a_device_outside_its_workspace_has_no_force_after_a_stop_either() -> None:
    port = Port(
        peak_force=8.0, damping_ticks=0, recovery=20 * T, workspace=((-0.1, 0.1),) * 3
    )
    tick = swung(port, 6, 10, 1e-3)
    assert not port.watch_position((0.2, 0.0, 0.0), tick)
    assert rearm(port.s, tick)
    assert not port.watch_position((0.2, 0.0, 0.0), tick + 1)
    port.answer(force(tick + 1, 4.0), tick + 1)
    assert (port.state, port.force) == ("fault", ZERO)


def test_without_a_largest_force_or_by_request_nobody_stops_it() -> None:
    for port in (Port(), Port(peak_force=8.0, stop_after=None)):
        assert not port.s.stop_after
