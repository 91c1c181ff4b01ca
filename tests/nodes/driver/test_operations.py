"""Requests to a driver: how long its loop pauses, and who may rearm it."""

from __future__ import annotations

import math
import time
from types import SimpleNamespace
from typing import Any, cast

import pytest

from nodes.base.node import Node
from nodes.driver.operations import DriverOperations
from nodes.driver.soft_stop import soft_stop
from nodes.parameters.store import ParameterError
from tests.support.safety import Port


def operations(*, virtual: bool, realtime: bool = False) -> tuple[Any, list[str]]:
    port, woken = Port(), list[str]()
    port.s.realtime = int(realtime)
    node = SimpleNamespace(
        setup=SimpleNamespace(name="driver"),
        events=SimpleNamespace(notify=lambda: woken.append("notified")),
        changes=SimpleNamespace(hand_over=lambda apply: apply(7)),
    )
    return DriverOperations(cast(Node, node), port.s, virtual), woken


@pytest.mark.parametrize("seconds", [0, 0.0, 1.5, 60.0])
def test_a_loop_in_lockstep_pauses_for_a_minute_at_most(seconds: float) -> None:
    requests, woken = operations(virtual=True)
    before = time.monotonic()
    assert requests.pause(seconds) == {}
    assert before + seconds <= requests.paused_until <= time.monotonic() + seconds
    assert woken == ["notified"]


@pytest.mark.parametrize(
    "seconds", [math.nextafter(60.0, 61.0), -5e-324, math.nan, math.inf, "1"]
)
def test_a_longer_pause_is_refused(seconds: object) -> None:
    requests, woken = operations(virtual=True)
    with pytest.raises(ParameterError, match=r"driver.* s: expected 0 to 60 s"):
        requests.pause(seconds)
    assert (requests.paused_until, woken) == (0.0, [])


def test_a_loop_in_real_time_does_not_pause() -> None:
    requests, _ = operations(virtual=True, realtime=True)
    with pytest.raises(ParameterError, match="only a lockstep loop can pause"):
        requests.pause(0.0)


@pytest.mark.parametrize("virtual", [True, False])
@pytest.mark.parametrize("beside", [True, False])
def test_a_real_device_is_rearmed_by_somebody_beside_it(
    virtual: bool, beside: bool
) -> None:
    """One that has not stopped has nothing to rearm."""
    requests, _ = operations(virtual=virtual)
    said = (
        "has not stopped the loop" if virtual or beside else "stand beside the device"
    )
    with pytest.raises(ParameterError, match=said):
        requests.rearm(beside=beside)


@pytest.mark.parametrize(
    ("period", "steps"),
    [(0.002, 10), (0.15, 10), (1.5 / 9.5, 9), (0.3, 5), (1.5, 1), (4.0, 1)],
)
def test_a_soft_stop_has_ten_steps_within_the_stop_time(
    period: float, steps: int
) -> None:
    """Forces fall in equal steps; a slew limit [N/tick] asks for more of them."""
    start = (3.0, -1.0, 0.0)
    expected = [[f * (1.0 - k / steps) for f in start] for k in range(1, steps + 1)]
    found = soft_stop(start, math.inf, period)
    assert len(found) == steps
    for force, wanted in zip(found, expected, strict=True):
        assert force == pytest.approx(wanted, abs=1e-15)  # rounding of 3 N
    assert len(soft_stop(start, 3.0 / 11.0 + 1e-12, period)) == max(steps, 11)
