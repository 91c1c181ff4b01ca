"""A virtual device's delay changed live: forces keep their order, energy is right."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from messages.transport.requests import ControlError
from nodes.driver.motion import set_latency, set_motion
from nodes.driver.passivity import through
from nodes.driver.state import DriverState
from sim.device.driver import SimDevice
from sim.device.model import DeviceModel
from tests.support.launching import running
from tests.support.setups import setup_of


def test_forces_under_way_arrive_as_they_would_have_and_none_overtakes() -> None:
    setup = setup_of(axes=["x"], pace="realtime")
    device = SimDevice(DeviceModel(mass=1.0, delay=3.0), setup)
    speeds = []
    for seq in range(9):
        device.read_position(seq)
        speeds.append(device.parts[0].state.v)
        if seq == 2:
            device.delay_by(0.0)
        # 1 N until then, 2 N from then on.
        device.write_force((1.0 if seq < 2 else 2.0, 0.0, 0.0), seq, 0.0)
    gained = [
        (after - before) / setup.period for before, after in itertools.pairwise(speeds)
    ]
    # The force of tick 0 acts from tick 3 on, that of tick 1 from tick 4 on; those of tick 2 and
    # later, at once behind them. A step of 1 kg in T with F newton gains F T: the rest is rounding
    # of nine sums.
    assert gained == pytest.approx([0.0, 0.0, 0.0, 1.0, 2.0, 2.0, 2.0, 2.0], abs=1e-12)


def test_what_the_driver_takes_to_be_under_way_goes_on_with_another_latency() -> None:
    state = DriverState()
    state.period = 0.002
    kept = set_motion(state, 2.0)
    length = state.line_length
    for force in (1.0, 2.0, 3.0):
        for i in range(3):
            own = slice(i * length, (i + 1) * length)
            line = kept[1][own]
            through(line, force * (i + 1), state.line_part)
            kept[1][own] = line
    later = set_latency(state, 3.5)
    assert (state.line_length, state.line_part) == (5, 0.5)
    # Newest first; what is older than was kept is the oldest that was.
    assert [later[5 * i : 5 * i + 5].tolist() for i in range(3)] == [
        [force * (i + 1) for force in (3.0, 2.0, 1.0, 1.0, 1.0)] for i in range(3)
    ]
    assert set_latency(state, 0.0).tolist() == []
    assert state.line_length == 0


@pytest.mark.process
def test_in_lockstep_it_is_fixed_and_so_is_all_else(tmp_path: Path) -> None:
    with running(
        tmp_path, "touch_wall", "pace:=lockstep", "duration:=1e5", "--without", "logger"
    ) as launch:
        with pytest.raises(ControlError, match=r"device\.delay: is fixed in lockstep"):
            launch.call("driver", "param.set", values={"device.delay": 1.0})
        with pytest.raises(ControlError, match=r"except device\.delay and passivity"):
            launch.call("driver", "param.set", values={"device.mass": 1.0})
