"""The driver's rules beyond guard, peak and slew, for the scene in one process: ramp, stop, motor heat, workspace.

They are the nodes' own (nodes/driver), called in the order of the driver's tick in lockstep.
"""

from __future__ import annotations

import math
from functools import partial

import msgspec

from messages.types import ZERO, Vector
from nodes.driver.device import DeviceLimits
from nodes.driver.limits import SafetyParameters
from nodes.driver.mean_force import Latency
from nodes.driver.motion import Motion
from nodes.driver.passivity import PassivityGuard, PassivityParameters
from nodes.driver.safety import Safety
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
    safety : Safety
        The safety.
    """

    def __init__(
        self,
        device: DeviceModel,
        period: float,
        next_tick: bool,
        parameters: SafetyParameters,
        passivity: PassivityParameters | None,
    ) -> None:
        limits = DeviceLimits(latency=device.delay * period)
        if parameters.workspace is not None:
            nothing = (-math.inf, math.inf)
            parameters = msgspec.structs.replace(parameters, workspace=(parameters.workspace[0], nothing, nothing))
        self.safety = Safety(parameters, limits, period, [0], lambda *_: None)
        self._period, self._late = period, 1.0 if next_tick else 0.0
        self._latency = Latency(device.delay) if device.delay else None
        self._motion = Motion(period, [0], True, self._latency)
        guarded = passivity is not None and passivity.guard == "on"
        self._guard = PassivityGuard(passivity, period, [0]) if passivity is not None and guarded else None
        self._handed: Vector = ZERO

    def sample(self, tick: int, measured: float) -> float:
        """Take a sample; the position that is published."""
        position, motion, safety = (float(measured), 0.0, 0.0), self._motion, self.safety
        if safety.watch_position(position, tick):
            stepped = motion.sample(position, tick * self._period)
            if self._guard is not None and stepped:
                self._guard.observe(motion.acted, motion.before, position, motion.elapsed)
            if safety.swings:
                safety.watch_swings(motion.energy, motion.velocity, tick)
        return motion.position[0]

    def command(self, tick: int, wanted: float) -> float:
        """Turn the law's force into what the device gets."""
        handed, chosen = self._handed, None
        if self._guard is not None:
            backlog = ZERO if self._latency is None else self._latency.backlog()
            chosen = partial(self._guard.control, pending=handed, share=self._late, backlog=backlog)
        force = (float(wanted), 0.0, 0.0)
        command = self.safety.command(force, tick, tick, self._motion.velocity, chosen)
        self._motion.act(list(handed if self._late else command))
        self._handed = command
        return command[0]
