"""The driver's rules for the scene in one process: guard, limits, ramp, stop, motor heat, workspace.

They are the nodes' own (nodes/driver), called in the order of the driver's tick in lockstep.
"""

import math
from collections.abc import Sequence

import msgspec

from messages.types import ZERO, Vector
from nodes.compiled.layout import state_of
from nodes.driver.device import DeviceLimits
from nodes.driver.limits import SafetyParameters, lower
from nodes.driver.motion import act, set_motion
from nodes.driver.passivity import PassivityParameters, set_guard
from nodes.driver.safety_setup import set_safety
from nodes.driver.state import DriverState
from nodes.driver.tick import decide, take_sample
from sim.device.model import DeviceModel


class DriverRules:
    """What a driver does with each force, in lockstep; a scene's one axis counts as the first."""

    def __init__(
        self,
        device: DeviceModel,
        period: float,
        next_tick: bool,
        parameters: SafetyParameters,
        passivity: PassivityParameters | None,
        axes: Sequence[int] = (0,),
    ) -> None:
        if parameters.workspace is not None and len(axes) == 1:
            nothing = (-math.inf, math.inf)
            parameters = msgspec.structs.replace(
                parameters, workspace=(parameters.workspace[0], nothing, nothing)
            )
        s = state_of(DriverState)
        self.state = s  # all that it keeps
        s.period, s.virtual, s.next_tick = period, 1, next_tick
        s.axes, s.axis[:] = len(axes), (*axes, 0, 0)[:3]
        set_safety(s, parameters, lower(parameters, DeviceLimits(), period), period)
        self._kept = set_motion(s, device.delay)
        set_guard(s, passivity)

    def sample(self, tick: int, place: Vector) -> Vector:
        """Take a sample; the position that is published."""
        s = self.state
        s.place[:] = place
        take_sample(s, tick, tick * s.period)
        return s.position[0], s.position[1], s.position[2]

    def command(self, tick: int, wanted: Vector, normal: Vector = ZERO) -> Vector:
        """Turn the law's force, and the normal of the surface that it comes from, into what the device gets."""
        s = self.state
        s.got_seq, s.got[:], s.got_normal[:] = tick, wanted, normal
        decide(s, tick)
        act(s, 1)
        return s.force[0], s.force[1], s.force[2]
