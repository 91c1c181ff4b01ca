"""The delay from force to motion, measured on the emulators by the device check."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from sim.device_check.delay import measure
from tests.support import slowly
from tests.support.devices import Bench, bench, real_devices

REST = 0.06
"""Pause of the emulator after a pulse: six settling times of its hand [s]."""


@pytest.fixture(params=slowly(sorted(real_devices()), but=["touch_driver"]))
def stand(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Bench]:
    with bench(request.param, tmp_path) as made:
        yield made


@pytest.mark.realtime
@pytest.mark.parametrize("late", slowly([0.0, 0.01], but=[0.01]))
def test_the_delay_from_force_to_effect_is_told_with_its_uncertainty(
    stand: Bench, late: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    w = stand.world.state
    w.resolution, w.late = 2e-5, late
    monkeypatch.setattr("sim.device_check.delay.AFTER", REST)
    device = stand.opened()
    # A hand: heavy, and slow; it reaches its speed in 10 ms, which is no delay.
    w.mass, w.damping, w.free_from = 1.0, 100.0, 0.0
    measured = measure(device)
    assert measured.delay is not None, measured.why
    # On the way out it waits for the servo loop, on the way back for a sample: up to a period each.
    # Three times the 95 % are as good as certain.
    assert measured.delay == pytest.approx(
        late + 1.0 / device.servo_rate, abs=3.0 * measured.uncertainty
    )
    assert measured.uncertainty < 0.01


def test_a_handle_that_does_not_move_tells_no_delay(
    stand: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sim.device_check.delay.AFTER", REST)
    device = stand.opened()
    measured = measure(device)
    assert (measured.delay, measured.pulses) == (None, 0)
    assert "hold it more loosely" in measured.why
