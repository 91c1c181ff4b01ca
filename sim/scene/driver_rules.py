"""The driver's rules beyond guard, peak and slew, for the scene in one process: ramp, stop, motor heat, workspace.

They are the nodes' own (nodes/driver), called in the order of the driver's tick in lockstep.
"""

from __future__ import annotations

import math
from typing import Any

import msgspec

from nodes.driver.device import DeviceLimits
from nodes.driver.limits import SafetyParameters, lower
from nodes.driver.motion import act, set_motion
from nodes.driver.passivity import PassivityParameters, set_guard
from nodes.driver.safety import set_safety
from nodes.driver.state import DriverState
from nodes.driver.tick import decide, take_sample
from sim.device.model import DeviceModel


class DriverRules:
    """What a driver does with each force of a scene of one axis, in lockstep.

    Parameters
    ----------
    device : DeviceModel
        The device.
    period : float
        Sampling period T [s].
    next_tick : bool
        Whether forces take effect one tick later.
    parameters : SafetyParameters
        Of its safety; the first axis of the workspace is the scene's.
    passivity : PassivityParameters or None
        Of its guard.

    Attributes
    ----------
    state : DriverState
        All that it keeps.
    """

    def __init__(
        self,
        device: DeviceModel,
        period: float,
        next_tick: bool,
        parameters: SafetyParameters,
        passivity: PassivityParameters | None,
    ) -> None:
        if parameters.workspace is not None:
            nothing = (-math.inf, math.inf)
            parameters = msgspec.structs.replace(parameters, workspace=(parameters.workspace[0], nothing, nothing))
        s: Any = DriverState()
        self.state = s
        s.period, s.virtual, s.next_tick, s.axes = period, 1, next_tick, 1
        set_safety(s, parameters, lower(parameters, DeviceLimits(), period), period)
        self._kept = set_motion(s, device.delay)
        set_guard(s, passivity)

    def sample(self, tick: int, measured: float) -> float:
        """Take a sample; the position that is published."""
        self.state.place[0] = measured
        take_sample(self.state, tick, tick * self.state.period)
        return float(self.state.position[0])

    def command(self, tick: int, wanted: float) -> float:
        """Turn the law's force into what the device gets."""
        self.state.got_seq, self.state.got[0] = tick, wanted
        decide(self.state, tick)
        act(self.state, 1)
        return float(self.state.force[0])
