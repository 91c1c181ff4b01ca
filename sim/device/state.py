"""The virtual device from tick to tick: what the driver node holds.

It adds no arithmetic of its own to the kernels of `sim.device.model`, so the scene in one process (`sim.scene.loop`),
which calls those kernels in the same order, gives the same bits.
"""

from __future__ import annotations

import math
from collections import deque

from sim.device.friction import move
from sim.device.model import Coefficients, DeviceModel, coefficients, end_stop, ends_of, quantise, saturate, split_delay


class VirtualDevice:
    """State of the virtual device, from tick to tick.

    Parameters
    ----------
    model : DeviceModel
        Its parameters.
    period : float
        Sampling period T [s].
    next_tick : bool
        Whether a force takes effect one tick later (``apply: next_tick``).
    workspace : tuple of float, shape (2,)
        Where it stops [m].

    Attributes
    ----------
    position : float
        True position [m].
    velocity : float
        True velocity [m/s].
    ticks : int
        Ticks done so far.
    target : float or None
        Where a hand pulls to instead of along its path [m].
    commands : deque of float
        Forces under way in lockstep, newest first [N].
    ends : tuple of float, shape (2,)
        Where it stops [m].
    early, late : float
        For how long of a tick the older and the newer force under way acts [s].
    early_map, late_map : tuple of float, shape (6,)
        `coefficients` of these times.
    """

    def __init__(
        self,
        model: DeviceModel,
        period: float,
        next_tick: bool = False,
        workspace: tuple[float, float] = (-math.inf, math.inf),
    ) -> None:
        self.model = model
        self.period = period
        self.position = model.position
        self.velocity = model.velocity
        self.ticks = 0
        self.target: float | None = None
        self._mass = model.moving_mass
        self._damping = model.moving_damping
        self._grip = model.grip
        self.ends = ends_of(workspace, model.resolution)
        # Only a hand's pull changes from tick to tick.
        self._weight = model.load(0, period) if model.hand is None else None
        whole, part = split_delay(model.delay + (1.0 if next_tick else 0.0))
        # Newest command first; before tick 0 nothing was commanded.
        self.commands: deque[float] = deque([0.0] * (whole + 2), maxlen=whole + 2)
        self.early = part * period
        self.late = period - self.early
        self.early_map = coefficients(self._mass, self._damping, self._grip, self.early)
        self.late_map = coefficients(self._mass, self._damping, self._grip, self.late)

    def measured(self) -> float:
        """Read the encoder."""
        return quantise(self.position, self.model.resolution)

    def load(self) -> float:
        """Give the force on the device that is not the motor's, during the present tick."""
        return self.model.load(self.ticks, self.period, self.target) if self._weight is None else self._weight

    def tick(self, force: float) -> None:
        """Go through one whole tick with the model's own delay.

        For lockstep, where the force that answers a tick is known before the tick passes.
        """
        self.commands.appendleft(force)
        peak = self.model.peak_force
        load = self.load()
        if self.early > 0.0:
            self._move(saturate(self.commands[-1], peak) + load, self.early, self.early_map)
        self._move(saturate(self.commands[-2], peak) + load, self.late, self.late_map)
        self.ticks += 1

    def _move(self, u: float, duration: float, step: Coefficients) -> None:
        x, v = self.position, self.velocity
        x, v = move(x, v, u, duration, step, self._mass, self._damping, self._grip, self.model.friction)
        self.position, self.velocity = end_stop(x, v, *self.ends)

    def pass_time(self, force: float, duration: float) -> None:
        """Hold one force for part of a tick: real time, where the split is the measured arrival.

        Call `end_tick` when the parts of a tick add up to the period.
        """
        if duration <= 0.0:
            return
        u = saturate(force, self.model.peak_force) + self.load()
        self._move(u, duration, coefficients(self._mass, self._damping, self._grip, duration))

    def end_tick(self) -> None:
        """Count a tick that went by in parts."""
        self.ticks += 1
