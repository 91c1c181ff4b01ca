"""The last line before the device: no force is handed over that is stale, unlimited or unasked for.

A small machine of states, the same for the virtual device and for hardware::

    waiting ──first force──▶ ramp ──▶ active ──no fresh force for `watchdog` ticks──▶ damping ──▶ zero
                              ▲─────────────────── a fresh force, or back inside ──────┴──── fault (outside the workspace)

Limits come from the device and from the launch file, whichever is lower.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated

import msgspec

from messages.types import ZERO, Force, Vector
from nodes.device import DeviceLimits
from nodes.kernels import limit

NonNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]
Bounds = tuple[float, float]


class SafetyParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Limits of the driver; what is None is left to the device's own limit.

    Attributes
    ----------
    watchdog : int
        Ticks without a fresh force before damping begins; armed by the first force.
    damping_ticks : int
        Ticks of damping before the force is zero.
    damping : float
        Damper against the device's own velocity meanwhile [N s/m].
    max_age : int
        Oldest force that is accepted [ticks].
    peak_force : float or None
        Largest magnitude on an axis [N].
    continuous_force : float or None
        Largest root-mean-square force over `thermal_time` [N].
    thermal_time : float
        Time constant of the motor's heating [s].
    slew : float or None
        Fastest change of force [N/s].
    ramp : float
        Time in which forces grow to their full size after a start or a recovery [s].
    workspace : tuple of tuple of float, shape (3, 2), or None
        Smallest and largest coordinate of each axis [m]; outside there is no force.
    """

    watchdog: Annotated[int, msgspec.Meta(ge=1)] = 10
    damping_ticks: Annotated[int, msgspec.Meta(ge=0)] = 50
    damping: NonNegative = 0.0
    max_age: Annotated[int, msgspec.Meta(ge=0)] = 5
    peak_force: Positive | None = None
    continuous_force: Positive | None = None
    thermal_time: Positive = 1.0
    slew: Positive | None = None
    ramp: NonNegative = 0.0
    workspace: tuple[Bounds, Bounds, Bounds] | None = None


def _lower(device: float, wanted: float | None) -> float | None:
    value = device if wanted is None else min(device, wanted)
    return value if math.isfinite(value) else None


class Safety:
    """Decides what is handed to the device at each tick.

    Parameters
    ----------
    parameters : SafetyParameters
        Limits of the launch file.
    limits : DeviceLimits
        Limits of the device; they hold whatever the parameters say.
    period : float
        Sampling period T [s].
    axes : list of int
        Axes that the scene computes.
    tell : callable
        Called with kind and reason of what must not be overlooked.

    Attributes
    ----------
    state : str
        ``waiting``, ``ramp``, ``active``, ``damping``, ``zero`` or ``fault``.
    force : tuple of float, shape (3,)
        What was handed over last [N].
    """

    def __init__(
        self,
        parameters: SafetyParameters,
        limits: DeviceLimits,
        period: float,
        axes: list[int],
        tell: Callable[[str, str], None],
    ) -> None:
        self._parameters = parameters
        self._tell = tell
        self._axes = axes
        self._period = period
        self._peak = _lower(limits.peak_force, parameters.peak_force)
        self._slew = None if parameters.slew is None else parameters.slew * period
        self._continuous = _lower(limits.continuous_force, parameters.continuous_force)
        self._heat = 0.0
        self._forget = math.exp(-period / parameters.thermal_time)
        self._ramp_ticks = round(parameters.ramp / period)
        self._ramped = 0
        self._workspace = self._narrower(limits.workspace, parameters.workspace)
        self._since = 0
        self.state = "waiting"
        self.force: Vector = ZERO
        self.force_seq = -1
        self.refused = 0

    def _narrower(
        self, device: tuple[Bounds, Bounds, Bounds], wanted: tuple[Bounds, Bounds, Bounds] | None
    ) -> list[tuple[int, float, float]]:
        bounds = []
        for axis, (low, high) in enumerate(device):
            if wanted is not None:
                low, high = max(low, wanted[axis][0]), min(high, wanted[axis][1])  # noqa: PLW2901
            if math.isfinite(low) or math.isfinite(high):
                bounds.append((axis, low, high))
        return bounds

    def _enter(self, state: str, reason: str) -> None:
        if state != self.state:
            self._tell("safety", f"{self.state} → {state}: {reason}")
            self.state = state

    def admit(self, force: Force, seq: int) -> bool:
        """Judge whether a received force may be used at all.

        Parameters
        ----------
        force : Force
            As decoded; its floats are finite.
        seq : int
            The present tick.

        Returns
        -------
        bool
            False for one that was seen before (replayed), that is older than ``max_age``, or that answers a tick which has
            not been.
        """
        if self.force_seq < force.seq <= seq and seq - force.seq <= self._parameters.max_age:
            return True
        self.refused += 1
        if force.seq > seq:
            reason = f"a force for tick {force.seq}, which has not been: now is {seq}"
        elif force.seq <= self.force_seq:
            reason = f"a force for tick {force.seq} once more: {self.force_seq} was the last (replayed or out of order)"
        else:
            reason = f"a force {seq - force.seq} ticks old at tick {seq}, limit {self._parameters.max_age}"
        self._tell("refused", reason)
        return False

    def command(self, force: Force, seq: int) -> Vector:
        """Turn an admitted force into what the device gets.

        Parameters
        ----------
        force : Force
            The force asked for.
        seq : int
            The present tick.

        Returns
        -------
        tuple of float, shape (3,)
            Force within all limits [N].
        """
        self.force_seq = force.seq
        self._since = seq
        if self.state not in ("active", "ramp", "fault"):
            self._ramped = 0
            reason = "the first force" if self.state == "waiting" else f"fresh forces again at tick {seq}"
            self._enter("ramp" if self._ramp_ticks else "active", reason)
        if self.state == "fault":
            return self._hand_over(ZERO)
        wanted = force.force
        if self.state == "ramp":
            self._ramped += 1
            share = self._ramped / self._ramp_ticks
            wanted = (wanted[0] * share, wanted[1] * share, wanted[2] * share)
            if self._ramped >= self._ramp_ticks:
                self._enter("active", f"ramp of {self._ramp_ticks} ticks done")
        return self._hand_over(wanted)

    def missed(self, seq: int, velocity: Vector) -> Vector | None:
        """Decide about a tick that closes without a fresh force.

        Parameters
        ----------
        seq : int
            The tick that closes.
        velocity : tuple of float, shape (3,)
            The device's own velocity [m/s].

        Returns
        -------
        tuple of float, shape (3,), or None
            Force to hand over [N]; None to let the device hold the last one.
        """
        parameters = self._parameters
        silent = seq - self._since
        if self.state == "waiting" or silent < parameters.watchdog:
            return None
        if self.state in ("active", "ramp"):
            self._enter("damping", f"no fresh force for {silent} ticks, limit {parameters.watchdog}")
        if self.state == "damping" and silent >= parameters.watchdog + parameters.damping_ticks:
            self._enter("zero", f"no fresh force for {silent} ticks")
        if self.state == "damping":
            b = -parameters.damping
            return self._hand_over((b * velocity[0], b * velocity[1], b * velocity[2]))
        self.force = ZERO
        return ZERO

    def watch_position(self, position: Vector, seq: int) -> None:
        """Look whether the device is inside its workspace; outside there is no force.

        Parameters
        ----------
        position : tuple of float, shape (3,)
            Sampled position [m].
        seq : int
            The present tick.
        """
        for axis, low, high in self._workspace:
            if not low <= position[axis] <= high:
                self._enter(
                    "fault",
                    f"{'xyz'[axis]} = {position[axis]:.4g} m at tick {seq}, workspace {low:.4g} to {high:.4g} m",
                )
                return
        if self.state == "fault":
            self._ramped = 0
            self._enter("ramp" if self._ramp_ticks else "active", f"back inside the workspace at tick {seq}")

    def _hand_over(self, wanted: Vector) -> Vector:
        last = self.force
        limited = [0.0, 0.0, 0.0]
        for i in self._axes:
            limited[i] = limit(wanted[i], last[i], self._peak, self._slew)
        if self._continuous is not None:
            squared = sum(value * value for value in limited)
            bound = self._continuous * self._continuous
            self._heat = self._forget * self._heat + (1.0 - self._forget) * squared
            if self._heat > bound and squared > bound:
                share = math.sqrt(bound / squared)
                limited = [value * share for value in limited]
                self._heat = bound
                self._tell("limit", f"continuous force {math.sqrt(squared):.3g} N, limit {self._continuous:.3g} N")
        self.force = (limited[0], limited[1], limited[2])
        return self.force

    def soft_stop(self) -> list[Vector]:
        """Plan the way to zero force for the end of the loop.

        Returns
        -------
        list of tuple of float, shape (s, 3)
            Forces for the next ticks [N], the last one zero: ten equal steps, or more where the slew limit asks for it.
        """
        start = self.force
        if start == ZERO:
            return [ZERO]
        steps = 10
        if self._slew:
            steps = max(steps, math.ceil(max(map(abs, start)) / self._slew))
        steps = min(steps, 1000)
        return [
            (start[0] * left / steps, start[1] * left / steps, start[2] * left / steps)
            for left in range(steps - 1, -1, -1)
        ]
