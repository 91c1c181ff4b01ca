"""The virtual device's deadline and delay in real time, against a free mass."""

from __future__ import annotations

import pytest

from sim.device.model import DeviceModel
from sim.device.state import VirtualDevice, read_axis, write_axis

T = 0.002
MASS = 0.5


def _speed(hold: float, delay: float, offset: float) -> float:
    """Push a free mass with 1 N at tick 3 while the device holds it; return its speed [m/s]."""
    model = DeviceModel(mass=MASS, damping=0.0, delay=delay)
    device = VirtualDevice(model, T, lockstep=False, hold=hold * T)
    for seq in range(40):
        read_axis(device.state, seq)
        if seq == 3:
            write_axis(device.state, 1.0, seq, offset)
    return float(device.state.v)


@pytest.mark.parametrize(
    ("hold", "delay", "offset", "until"),
    [(4.0, 0.0, 0.0, 7), (4.0, 0.0, 0.25, 8), (2.5, 0.75, 0.5, 7)],
)
def test_a_force_that_nobody_renews_is_gone_at_the_first_tick_after_the_deadline(
    hold: float, delay: float, offset: float, until: int
) -> None:
    # From the write, later by the delay, to the tick at which `hold` ticks have passed; F t / m,
    # some roundings of sums.
    felt = until - (3.0 + offset + delay)
    assert _speed(hold, delay, offset) == pytest.approx(felt * T / MASS, rel=1e-12)


@pytest.mark.parametrize("next_tick", [False, True])
@pytest.mark.parametrize("delay", [0.0, 0.4, 1.0, 2.3])
def test_a_force_in_lockstep_begins_to_act_by_the_whole_delay_later(
    delay: float, next_tick: bool
) -> None:
    """1 N for one tick from s moves a mass by F T (t − s − T/2)/m until t."""
    model = DeviceModel(mass=MASS, damping=0.0, delay=delay)
    device = VirtualDevice(model, T, next_tick)
    for seq in range(12):
        read_axis(device.state, seq)
        write_axis(device.state, 1.0 if seq == 3 else 0.0, seq, 0.0)
    begins = 3.0 + delay + (1.0 if next_tick else 0.0)
    assert device.state.x == pytest.approx(
        T / MASS * (12.0 - begins - 0.5) * T, rel=1e-12
    )
