"""The last line before the device: no force is handed over that is stale, unlimited or unasked for.

A small machine of states, the same for the virtual device and for hardware::

    waiting ──first force──▶ ramp ──▶ active ──no fresh force for `watchdog` ticks──▶ damping ──▶ zero
                              ▲                                                                  │
                              ├──────────────────────── a fresh force ───────────────────────────┘
                            zero ◀──back inside── fault ◀──outside the workspace── any of them
                         stopped ◀──the force swings between its limits, and gives out energy── any of them

``stopped`` is for good: damping, then no force, until the driver is started again.
While there is no force, a hand that keeps pushing sinks in, and the law then asks for far more than before. So every force
that was away comes back by a ramp: each tick away takes `REGAIN` ticks of ramp, up to the whole one (`recovery`). A ramp that
pushes the device faster than `RETURN_SPEED` goes back, so that whoever has sunk in is let out, not thrown.
Limits come from the device and from the launch file, whichever is lower; a launch file that asks for more is told so.
Whatever messages come in whatever order: on each axis the force stays within the peak, all changes made during one tick
add up to no more than the slew, and the mean square of the force stays within the continuous limit.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from typing import Any

from messages.types import ZERO, Force, Vector
from nodes.driver.device import DeviceLimits
from nodes.driver.limits import STOP_TIME, SafetyParameters, lower
from nodes.driver.motor_heat import Motor
from nodes.kernels import limit

REACH = 1e6
"""Farther than this no device is: a position beyond is a fault of whoever measured it [m]."""

STOP_WINDOW = 2.0
"""Within so long a loop that swings brings its force to the largest magnitude `stop_after` times, and gives out energy [s]."""

REGAIN = 5
"""Ticks of ramp that one tick without a force costs: after a fifth of `recovery` the whole ramp is due."""

RETURN_SPEED = 0.25
"""Faster than this a force that comes back must not push [m/s]: the reduced speed of ISO 10218-1."""

REASONS = 8
"""Changes of state that the summary of a run tells; all of them are on the driver's event topic."""


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
        ``waiting``, ``ramp``, ``active``, ``damping``, ``zero``, ``fault`` or ``stopped``.
    force : tuple of float, shape (3,)
        What was handed over last [N].
    force_seq : int
        Tick that the last admitted force answers; -1 before the first one.
    since : int
        Tick in which a force was admitted last.
    refused : dict of str to int
        Forces refused, by reason: ``future``, ``replayed``, ``stale``, ``not_finite``.
    limited : dict of str to int
        Forces lowered, by limit: ``peak``, ``slew``, ``continuous``.
    limits : Limits
        What holds.
    motor : Motor or None
        What watches its heat; None without a limit.
    swings : bool
        Whether `watch_swings` has something to watch.
    peaked : bool
        Whether the force has come to its largest magnitude since `watch_swings` looked.
    slewed : list of float, shape (3,)
        How far the force has changed on each axis in the newest tick [N].
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
        self._start_ticks = round(parameters.ramp / period)
        self._recovery_ticks = round(max(parameters.recovery, parameters.ramp) / period)
        # The ramp under way: its length, how much of it is done, and the tick that did so last.
        self._ramp_ticks, self._regained, self._ramp_seq = self._start_ticks, 0, -1
        # Since when there has been no force [ticks].
        self._away_from = 0.0
        self._workspace = [
            (axis, low, high)
            for axis, (low, high) in enumerate(self.limits.workspace)
            if math.isfinite(low) or math.isfinite(high)
        ]
        continuous = self.limits.continuous
        self.motor = (
            None if continuous is None else Motor(continuous, parameters.thermal_time, period, self.limits.slew)
        )
        # A device without limits needs none of what watches them.
        self._unlimited = self.motor is None and self.limits.peak is None and self.limits.slew is None
        # Ticks at which the force came to its largest magnitude, and the energy that was given out until then [J].
        self._peaks: deque[tuple[int, float]] = deque(maxlen=parameters.stop_after)
        # On which side each axis asks for more than that, 0 for neither; and whether one has come to a new side.
        self._sides = [0, 0, 0]
        self.peaked = False
        self._stopped = 0
        self._brake: Vector = ZERO
        self.swings = parameters.stop_after is not None and self.limits.peak is not None
        self.since = 0
        self._tick = -1
        self.slewed = [0.0, 0.0, 0.0]
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
        """Summarise what happened."""
        return {
            "state": self.state,
            "entered": dict(self._entered),
            "refused": dict(self.refused),
            "limited": dict(self.limited),
            "reasons": list(self._reasons),
            "told": list(self.limits.told),
        }

    def resume(self) -> None:
        """Go on in the place of a predecessor that ended with a force on the device: the first force is a recovery."""
        self._ramp_ticks = self._recovery_ticks

    def _enter(self, state: str, seq: int, reason: str) -> None:
        if state != self.state and self.state != "stopped":
            if self.state in ("active", "ramp"):
                if self.state == "active":
                    self._regained = self._recovery_ticks
                self._away_from = seq
            if state == "fault":
                self._regained = 0
            text = f"{self.state} → {state} at tick {seq}: {reason}"
            self.state = state
            self._entered[state] = self._entered.get(state, 0) + 1
            self._reasons.append(text)
            # By a name of its own: among many changes of state it must not be overlooked.
            self._tell("stopped" if state == "stopped" else "safety", text)

    def admit(self, force: Force, seq: int) -> bool:
        """Judge whether a received force may be used at all."""
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

    def command(
        self,
        wanted: Vector,
        answers: int,
        seq: int,
        velocity: Callable[[], Vector],
        guard: Callable[[Vector], Vector] | None = None,
    ) -> Vector:
        """Turn an admitted force into what the device gets; a guard judges what the ramp lets through."""
        self.force_seq = answers
        self.since = seq
        if self.state != "active":
            wanted = self._become_active(wanted, seq, velocity)
        if guard is not None and self.state in ("active", "ramp"):
            wanted = guard(wanted)
        return self._hand_over(wanted, seq)

    def watch_swings(self, energy: float, velocity: Callable[[], Vector], seq: int) -> None:
        """Stop for good when the force comes to its limit again and again and the loop gives out energy meanwhile [J].

        Energy is compared between moments at which the force comes to its limit, so that what a surface has in store then is
        no part of it. A surface that takes energy, as one does that somebody taps hard, is not stopped.
        """
        if self.state == "stopped":
            b, (x, y, z) = -self._damping, velocity()
            damped = seq - self._stopped < self.limits.damping_ticks
            self._brake = (b * x, b * y, b * z) if damped else ZERO
            return
        if not self.peaked:
            return
        self.peaked = False
        self._peaks.append((seq, energy))
        first, before = self._peaks[0]
        span = (seq - first) * self._period
        if len(self._peaks) == self._peaks.maxlen and span <= STOP_WINDOW and energy > before:
            self._stopped = seq
            self._enter(
                "stopped",
                seq,
                f"the loop swings: its force came to the limit of {self.limits.peak:g} N {len(self._peaks)} times within "
                f"{span:.2g} s and gave out {(energy - before) * 1e3:.3g} mJ; no force until the next start: launch again with "
                "a softer law",
            )
            self.watch_swings(energy, velocity, seq)

    def _become_active(self, wanted: Vector, seq: int, velocity: Callable[[], Vector]) -> Vector:
        """Let forces in again: none in a fault, a brake when stopped, a growing share of them during the ramp."""
        if self.state == "fault":
            return ZERO
        if self.state == "stopped":
            return self._brake
        if self.state != "ramp":
            if self.state != "waiting":
                self._ramp_ticks = self._recovery_ticks
                self._regained = max(self._regained - REGAIN * math.ceil(seq - self._away_from), 0)
            reason = "the first force" if self.state == "waiting" else "fresh forces again"
            self._enter("ramp" if self._ramp_ticks else "active", seq, reason)
        if self.state == "active":
            return wanted
        if (peak := self.limits.peak) is not None:
            x, y, z = wanted
            wanted = limit(x, 0.0, peak, None), limit(y, 0.0, peak, None), limit(z, 0.0, peak, None)
        if seq != self._ramp_seq:
            self._ramp_seq = seq
            pushed = sum(f * v for f, v in zip(wanted, velocity(), strict=True))
            is_thrown = pushed > RETURN_SPEED * math.sqrt(sum(f * f for f in wanted))
            self._regained = max(self._regained - REGAIN, 0) if is_thrown else self._regained + 1
        share = self._regained / self._ramp_ticks
        if share < 1.0:
            return wanted[0] * share, wanted[1] * share, wanted[2] * share
        self._enter("active", seq, f"ramp of {self._ramp_ticks} ticks done")
        return wanted

    def answered(self, force: Vector, answers: int, since: int, seq: int, slewed: list[float]) -> None:
        """Take over what compiled ticks did, in the state ``active`` and below all limits."""
        self.force, self.force_seq, self.since = force, answers, since
        self._sides = [0, 0, 0]
        if not self._unlimited:
            self._tick, self.slewed = seq, slewed

    def missed(self, seq: int, velocity: Vector, held: Vector | None = None) -> Vector | None:
        """Decide about a tick that closes without the force that answers it."""
        limits = self.limits
        silent = seq - self.since
        if self.state == "waiting":
            return None
        if self.state == "stopped":
            return self._hand_over(self._brake, seq)
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

    def hold(self, force: Vector) -> None:
        """Note what is on the device where that is not what was decided last: a tick was lost."""
        self.force = force

    def let_go(self, seq: int, since: float) -> None:
        """Note that the device let go by itself at a tick: a force then comes back as after any other gap."""
        self.force = ZERO
        if self.state in ("active", "ramp"):
            self._enter("zero", seq, "no force was written in time, and the device let go by itself")
            self._away_from = since

    def watch_position(self, position: Vector, seq: int) -> bool:
        """Look whether a position is one, and inside the workspace; otherwise there is no force."""
        x, y, z = position
        if not (-REACH <= x <= REACH and -REACH <= y <= REACH and -REACH <= z <= REACH):
            self._enter("fault", seq, f"the device gives position {position}")
            self._brake = ZERO
            return False
        for axis, low, high in self._workspace:
            if not low <= position[axis] <= high:
                self._enter(
                    "fault", seq, f"{'xyz'[axis]} = {position[axis]:.4g} m, workspace {low:.4g} to {high:.4g} m"
                )
                self._brake = ZERO
                return False
        if self.state == "fault":
            # Not active yet: a force must come first, which may then grow by the ramp.
            self._enter("zero", seq, "back inside the workspace")
        return True

    def _hand_over(self, wanted: Vector, seq: int) -> Vector:
        """Apply all limits, tick by tick: several forces in one tick share one slew."""
        if self._unlimited:
            force = [0.0, 0.0, 0.0]
            for i in self._axes:
                force[i] = wanted[i]
            self.force = (force[0], force[1], force[2])
            return self.force
        last, slewed, motor = self.force, self.slewed, self.motor
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
            side = 0 if peak is None or abs(wanted[i]) <= peak else 1 if wanted[i] > 0.0 else -1
            if value != wanted[i]:
                self.limited["peak" if side else "slew"] += 1
            self.peaked = self.peaked or side not in (0, self._sides[i])
            self._sides[i] = side
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

    def soft_stop(self, start: Vector) -> list[Vector]:
        """Plan the way to zero force for the end of the loop."""
        if start == ZERO:
            return [ZERO]
        steps = max(1, min(10, int(STOP_TIME / self._period)))
        if self.limits.slew is not None:
            steps = max(steps, math.ceil(max(map(abs, start)) / self.limits.slew))
        return [
            (start[0] * left / steps, start[1] * left / steps, start[2] * left / steps)
            for left in range(steps - 1, -1, -1)
        ]
