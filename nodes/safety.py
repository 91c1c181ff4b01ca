"""The last line before the device: no force is handed over that is stale, unlimited or unasked for.

A small machine of states, the same for the virtual device and for hardware::

    waiting ──first force──▶ ramp ──▶ active ──no fresh force for `watchdog` ticks──▶ damping ──▶ zero
                              ▲                                                                  │
                              ├──────────────────────── a fresh force ───────────────────────────┘
                            zero ◀──back inside── fault ◀──outside the workspace── any of them

Limits come from the device and from the launch file, whichever is lower; a launch file that asks for more is told so.
Whatever messages come in whatever order: on each axis the force stays within the peak, all changes made during one tick
add up to no more than the slew, and the mean square of the force stays within the continuous limit.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Annotated, Any

import msgspec

from messages.types import ZERO, Force, Vector
from nodes.device import Bounds, DeviceLimits, Workspace
from nodes.kernels import limit
from nodes.thermal import Motor

NonNegative = Annotated[float, msgspec.Meta(ge=0.0)]
Positive = Annotated[float, msgspec.Meta(gt=0.0)]

STOP_TIME = 1.5
"""Longest way from the largest force down to zero [s]; a launcher waits twice as long before it presses on."""

REASONS = 8
"""Changes of state that the summary of a run tells; all of them are on the driver's event topic."""


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
    damping: NonNegative = 0.5
    max_age: Annotated[int, msgspec.Meta(ge=0)] = 5
    peak_force: Positive | None = None
    continuous_force: Positive | None = None
    thermal_time: Positive = 1.0
    slew: Positive | None = None
    ramp: NonNegative = 0.0
    workspace: Workspace | None = None


class Limits(msgspec.Struct, frozen=True, kw_only=True):
    """What holds: of the device's limits and the launch file's, the lower of each.

    Attributes
    ----------
    peak : float or None
        Largest magnitude on an axis [N].
    slew : float or None
        Largest change per tick [N].
    continuous : float or None
        Largest root-mean-square force [N].
    watchdog, damping_ticks, max_age : int
        As in the parameters [ticks].
    workspace : tuple of tuple of float, shape (3, 2)
        Smallest and largest coordinate of each axis [m].
    told : tuple of str
        What the launch file asked for in vain: path, value, limit and what holds instead.
    """

    peak: float | None
    slew: float | None
    continuous: float | None
    watchdog: int
    damping_ticks: int
    max_age: int
    workspace: Workspace
    told: tuple[str, ...]


def lower(parameters: SafetyParameters, device: DeviceLimits, period: float, where: str = "safety") -> Limits:
    """Take the lower of what a launch file asks for and what the device bears.

    Parameters
    ----------
    parameters : SafetyParameters
        Of the launch file.
    device : DeviceLimits
        Of the device; they hold whatever the parameters say.
    period : float
        Sampling period T [s].
    where : str
        Path of the parameters, for what is told.

    Returns
    -------
    Limits
        What holds.
    """
    told: list[str] = []

    def least(name: str, wanted: float | None, bears: float, unit: str) -> float | None:
        if wanted is not None and wanted > bears:
            told.append(f"{where}.{name}: {wanted:g} {unit}, limit {bears:g} {unit} of the device, which holds")
        value = bears if wanted is None else min(bears, wanted)
        return value if math.isfinite(value) else None

    peak = least("peak_force", parameters.peak_force, device.peak_force, "N")
    slew = least("slew", parameters.slew, device.slew, "N/s")
    if slew is not None and (peak is None or peak > slew * STOP_TIME):
        # What could not be taken down in time is not built up: the soft stop must end, and within the slew.
        if peak is not None:
            told.append(
                f"{where}.slew: {slew:g} N/s takes {peak / slew:.3g} s from {peak:g} N to zero, limit {STOP_TIME:g} s; "
                f"the largest force is {slew * STOP_TIME:g} N"
            )
        peak = slew * STOP_TIME
    silence = device.silence / period
    ticks = {}
    for name, least_ticks in (("watchdog", 1), ("damping_ticks", 0), ("max_age", 0)):
        wanted = getattr(parameters, name)
        most = max(least_ticks, int(silence)) if math.isfinite(silence) else wanted
        if wanted > most and wanted != getattr(SafetyParameters(), name):
            told.append(
                f"{where}.{name}: {wanted} ticks, limit {most} ticks ({device.silence:g} s) of the device, which holds"
            )
        ticks[name] = min(wanted, most)
    bounds: list[Bounds] = []
    for axis, (low, high) in enumerate(device.workspace):
        wanted_low, wanted_high = (-math.inf, math.inf) if parameters.workspace is None else parameters.workspace[axis]
        if parameters.workspace is not None and (wanted_low < low or wanted_high > high):
            told.append(
                f"{where}.workspace[{axis}]: {wanted_low:g} to {wanted_high:g} m, limit {low:g} to {high:g} m of the device, "
                "which holds"
            )
        bounds.append((max(low, wanted_low), min(high, wanted_high)))
    return Limits(
        peak=peak,
        slew=None if slew is None else slew * period,
        continuous=least("continuous_force", parameters.continuous_force, device.continuous_force, "N"),
        watchdog=ticks["watchdog"],
        damping_ticks=ticks["damping_ticks"],
        max_age=ticks["max_age"],
        workspace=(bounds[0], bounds[1], bounds[2]),
        told=tuple(told),
    )


class Safety:
    """Decides what is handed to the device at each tick.

    Parameters
    ----------
    parameters : SafetyParameters
        Limits of the launch file.
    device : DeviceLimits
        Limits of the device; they hold whatever the parameters say.
    period : float
        Sampling period T [s].
    axes : list of int
        Axes that the scene computes; the others get no force.
    tell : callable
        Called with kind and reason of what must not be overlooked.
    where : str
        Path of the parameters, for what is told.

    Attributes
    ----------
    state : str
        ``waiting``, ``ramp``, ``active``, ``damping``, ``zero`` or ``fault``.
    force : tuple of float, shape (3,)
        What was handed over last [N].
    force_seq : int
        Tick that the last admitted force answers; -1 before the first one.
    refused : dict of str to int
        Forces refused, by reason: ``future``, ``replayed``, ``stale``, ``not_finite``.
    limited : dict of str to int
        Forces lowered, by limit: ``peak``, ``slew``, ``continuous``.
    limits : Limits
        What holds.
    """

    def __init__(
        self,
        parameters: SafetyParameters,
        device: DeviceLimits,
        period: float,
        axes: list[int],
        tell: Callable[[str, str], None],
        where: str = "safety",
    ) -> None:
        self.limits = lower(parameters, device, period, where)
        self._damping = parameters.damping
        self._tell = tell
        self._axes = axes
        self._period = period
        self._ramp_ticks = round(parameters.ramp / period)
        self._ramp_from = 0
        self._workspace = [
            (axis, low, high)
            for axis, (low, high) in enumerate(self.limits.workspace)
            if math.isfinite(low) or math.isfinite(high)
        ]
        continuous = self.limits.continuous
        self._motor = (
            None if continuous is None else Motor(continuous, parameters.thermal_time, period, self.limits.slew)
        )
        self._since = 0
        self._tick = -1
        self._slewed = [0.0, 0.0, 0.0]
        self.state = "waiting"
        self.force: Vector = ZERO
        self.force_seq = -1
        self.refused = {"future": 0, "replayed": 0, "stale": 0, "not_finite": 0}
        self.limited = {"peak": 0, "slew": 0, "continuous": 0}
        self._entered: dict[str, int] = {}
        self._reasons: deque[str] = deque(maxlen=REASONS)
        for text in self.limits.told:
            tell("limit", text)

    def summary(self) -> dict[str, Any]:
        """Summarise what happened.

        Returns
        -------
        dict
            ``state`` now, how often each state was ``entered``, forces ``refused`` by reason and ``limited`` by limit, the
            last ``reasons`` for a change of state, and what was ``told`` about the launch file's limits.
        """
        return {
            "state": self.state,
            "entered": dict(self._entered),
            "refused": dict(self.refused),
            "limited": dict(self.limited),
            "reasons": list(self._reasons),
            "told": list(self.limits.told),
        }

    def _enter(self, state: str, seq: int, reason: str) -> None:
        if state != self.state:
            text = f"{self.state} → {state} at tick {seq}: {reason}"
            self.state = state
            self._entered[state] = self._entered.get(state, 0) + 1
            self._reasons.append(text)
            self._tell("safety", text)

    def admit(self, force: Force, seq: int) -> bool:
        """Judge whether a received force may be used at all.

        Parameters
        ----------
        force : Force
            As decoded.
        seq : int
            The present tick.

        Returns
        -------
        bool
            False for one that was seen before (replayed), that is older than ``max_age``, that answers a tick which has not
            been, or that is not finite.
        """
        x, y, z = force.force
        if not math.isfinite(x + y + z):
            why, reason = "not_finite", f"a force for tick {force.seq} that is not finite: {force.force}"
        elif force.seq > seq:
            why, reason = "future", f"a force for tick {force.seq}, which has not been: now is {seq}"
        elif force.seq <= self.force_seq:
            why = "replayed"
            reason = f"a force for tick {force.seq} once more: {self.force_seq} was the last (replayed or out of order)"
        elif seq - force.seq > self.limits.max_age:
            why, reason = "stale", f"a force {seq - force.seq} ticks old at tick {seq}, limit {self.limits.max_age}"
        else:
            return True
        self.refused[why] += 1
        self._tell(f"refused_{why}", reason)
        return False

    def command(self, wanted: Vector, answers: int, seq: int) -> Vector:
        """Turn an admitted force into what the device gets.

        Parameters
        ----------
        wanted : tuple of float, shape (3,)
            The force asked for [N].
        answers : int
            The tick that it answers.
        seq : int
            The present tick.

        Returns
        -------
        tuple of float, shape (3,)
            Force within all limits [N].
        """
        self.force_seq = answers
        self._since = seq
        if self.state == "fault":
            return self._hand_over(ZERO, seq)
        if self.state not in ("active", "ramp"):
            self._ramp_from = seq
            reason = "the first force" if self.state == "waiting" else "fresh forces again"
            self._enter("ramp" if self._ramp_ticks else "active", seq, reason)
        if self.state == "ramp":
            done = seq - self._ramp_from + 1
            if done < self._ramp_ticks:
                share = done / self._ramp_ticks
                wanted = (wanted[0] * share, wanted[1] * share, wanted[2] * share)
            else:
                self._enter("active", seq, f"ramp of {self._ramp_ticks} ticks done")
        return self._hand_over(wanted, seq)

    def missed(self, seq: int, velocity: Vector, held: Vector | None = None) -> Vector | None:
        """Decide about a tick that closes without the force that answers it.

        Parameters
        ----------
        seq : int
            The tick that closes.
        velocity : tuple of float, shape (3,)
            The device's own velocity [m/s].
        held : tuple of float, shape (3,), or None
            What to hold until the watchdog bites [N]; None for the last force.

        Returns
        -------
        tuple of float, shape (3,), or None
            Force to hand over [N]; None to let the device hold the last one.
        """
        limits = self.limits
        silent = seq - self._since
        if self.state == "waiting":
            return None
        if self.state in ("active", "ramp"):
            if silent < limits.watchdog:
                last = self.force
                return None if self._hand_over(last if held is None else held, seq) == last else self.force
            self._enter("damping", seq, f"no fresh force for {silent} ticks, limit {limits.watchdog}")
        if self.state == "damping":
            if silent < limits.watchdog + limits.damping_ticks:
                b = -self._damping
                return self._hand_over((b * velocity[0], b * velocity[1], b * velocity[2]), seq)
            self._enter("zero", seq, f"no fresh force for {silent} ticks")
        return self._hand_over(ZERO, seq)

    def let_go(self) -> None:
        """Note that the device has let go of the force by itself, because the driver hung."""
        self.force = ZERO

    def watch_position(self, position: Vector, seq: int) -> bool:
        """Look whether the device is inside its workspace; outside there is no force.

        Parameters
        ----------
        position : tuple of float, shape (3,)
            Sampled position [m].
        seq : int
            The present tick.

        Returns
        -------
        bool
            False when the position is not finite: it must not be used.
        """
        if not math.isfinite(position[0] + position[1] + position[2]):
            self._enter("fault", seq, f"the device gives position {position}")
            return False
        for axis, low, high in self._workspace:
            if not low <= position[axis] <= high:
                self._enter(
                    "fault", seq, f"{'xyz'[axis]} = {position[axis]:.4g} m, workspace {low:.4g} to {high:.4g} m"
                )
                return True
        if self.state == "fault":
            # Not active yet: a force must come first, which may then grow by the ramp.
            self._enter("zero", seq, "back inside the workspace")
        return True

    def _hand_over(self, wanted: Vector, seq: int) -> Vector:
        """Apply all limits, tick by tick: several forces in one tick share one slew."""
        last, slewed, motor = self.force, self._slewed, self._motor
        peak, slew = self.limits.peak, self.limits.slew
        if seq != self._tick:
            if motor is not None:
                motor.close(last, seq - self._tick if self._tick >= 0 else 0)
            self._tick = seq
            slewed[0] = slewed[1] = slewed[2] = 0.0
        limited = [0.0, 0.0, 0.0]
        for i in self._axes:
            left = None if slew is None else max(slew - slewed[i], 0.0)
            value = limited[i] = limit(wanted[i], last[i], peak, left)
            if value != wanted[i]:
                which = "peak" if peak is not None and abs(wanted[i]) > peak else "slew"
                self.limited[which] += 1
        if motor is not None:
            lefts = None if slew is None else min(max(slew - slewed[i], 0.0) for i in self._axes)
            cooled = motor.lower(last, limited, lefts)
            if cooled is not limited:
                self.limited["continuous"] += 1
                self._tell("limit", f"continuous force at tick {seq}: limit {self.limits.continuous:.3g} N reached")
                limited = cooled
            motor.note(limited)
        for i in self._axes:
            slewed[i] += abs(limited[i] - last[i])
        self.force = (limited[0], limited[1], limited[2])
        return self.force

    def soft_stop(self) -> list[Vector]:
        """Plan the way to zero force for the end of the loop.

        Returns
        -------
        list of tuple of float, shape (s, 3)
            Forces for the next ticks [N], the last one zero: ten equal steps, or more where the slew limit asks for it, fewer
            where ten periods are longer than `STOP_TIME`.
        """
        start = self.force
        if start == ZERO:
            return [ZERO]
        steps = max(1, min(10, int(STOP_TIME / self._period)))
        if self.limits.slew is not None:
            steps = max(steps, math.ceil(max(map(abs, start)) / self.limits.slew))
        return [
            (start[0] * left / steps, start[1] * left / steps, start[2] * left / steps)
            for left in range(steps - 1, -1, -1)
        ]
