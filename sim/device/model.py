"""Model of the virtual device: one axis of mass, damping, and optional terms of a scene.

Between two changes of the force the device obeys m x'' + b x' + k x = u with constant u (k is the
stiffness of a hand, 0 without one), whose solution is known exactly. So nothing is integrated
numerically: a step is a few multiplications, whatever its length, and has no discretisation error
that could be mistaken for (in)stability of the coupling; semi-implicit Euler would overstate K_max
by 1/(1 − 1/n_sub).

The kernels are plain functions on floats, as those of `nodes.arithmetic`: the driver node calls
them interpreted, the one-process simulator compiles the same functions. They use only `math`;
absent terms are None.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import msgspec

from nodes.compiled.rules import rule
from nodes.parameters.checked import NonNegative, Positive, check_fields
from nodes.parameters.store import convert
from sim.device.hand import Hand

SMALLEST = 1e-12  # smallest mass [kg] and encoder step [m]

Coefficients = tuple[float, float, float, float, float, float]

# Adding and subtracting 1.5 * 2**52 rounds to the nearest integer (halves to even) for any
# |count| < 2**51, and never overflows or raises, so that a diverging run can continue.
_WHOLE = 6755399441055744.0


@rule
def decay_mean(y: float) -> float:
    """Return the mean of e^{−t} over (0, y), (1 − e^{−y})/y without cancellation, for y ≥ 0."""
    if y == 0.0:
        return 1.0
    return -math.expm1(-y) / y


@rule
def coefficients(
    mass: float, damping: float, stiffness: float, duration: float
) -> Coefficients:
    """Return the exact map of m x'' + b x' + k x = u over `duration` [s] with constant u.

    For m > 0 [kg], b ≥ 0 [N s/m], k ≥ 0 [N/m]: x⁺ = a11 x + a12 v + b1 u, v⁺ = a21 x + a22 v + b2 u
    with a11, a12 [s], a21 [1/s], a22, b1 [m/N], b2 [m/(s N)], accurate to rounding for any damping,
    also for b → 0 and k → 0. With k = 0 it is the plant of the stability theory, q = (1 −
    e^{−bT/m}) m/b.
    """
    alpha = damping * duration / mass
    kappa = stiffness * duration * duration / mass
    if alpha < 1.0 and kappa < 1.0:
        # Taylor series of the response to a unit step, y'' + (b/m) y' + (k/m) y = 1, in units of
        # the duration. Its terms satisfy y[j+2] = −(α (j+1) y[j+1] + κ y[j]) / ((j+2)(j+1)), from
        # y[0] = y[1] = 0, y[2] = 1/2.
        older = 0.0
        newer = 0.5
        response = 0.5
        slope = 1.0
        j = 1
        while abs(newer) + abs(older) > 1e-18:
            term = -(alpha * (j + 1) * newer + kappa * older) / ((j + 2) * (j + 1))
            older = newer
            newer = term
            response += term
            slope += (j + 2) * term
            j += 1
        a12 = duration * slope
        b1 = duration * duration / mass * response
        a11 = 1.0 - kappa * response
        a22 = a11 - alpha * slope
        return a11, a12, -(stiffness / mass) * a12, a22, b1, a12 / mass
    s = damping / (2.0 * mass)
    squared = s * s - stiffness / mass
    if squared >= 0.0:
        root = math.sqrt(squared)
        slow = stiffness / mass / (s + root)
        fast = s + root
        slow_decay = math.exp(-slow * duration)
        a12 = slow_decay * duration * decay_mean(2.0 * root * duration)
        a11 = slow_decay + slow * a12
        a22 = math.exp(-fast * duration) - slow * a12
        b1 = (duration * decay_mean(slow * duration) - a12) / (mass * fast)
    else:
        root = math.sqrt(-squared)
        decay = math.exp(-s * duration)
        a12 = decay * math.sin(root * duration) / root
        a11 = decay * math.cos(root * duration) + s * a12
        a22 = decay * math.cos(root * duration) - s * a12
        b1 = (1.0 - a11) / stiffness
    return a11, a12, -(stiffness / mass) * a12, a22, b1, a12 / mass


@rule
def advance(x: float, v: float, u: float, coefs: Coefficients) -> tuple[float, float]:
    """Return x [m], v [m/s] after one exact step under a held force u [N], without friction."""
    return coefs[0] * x + coefs[1] * v + coefs[4] * u, coefs[2] * x + coefs[
        3
    ] * v + coefs[5] * u


@rule
def quantise(x: float, resolution: float | None) -> float:
    """Round a position to encoder counts (halves to even) [m]; None or 0 is an ideal sensor."""
    if resolution is None or resolution == 0.0:
        return x
    return ((x / resolution + _WHOLE) - _WHOLE) * resolution


@rule
def end_stop(x: float, v: float, low: float, high: float) -> tuple[float, float]:
    """Stop a position x [m] and velocity v [m/s] at the ends of the device, inelastically."""
    if x < low:
        return low, 0.0
    if x > high:
        return high, 0.0
    return x, v


def ends_of(
    workspace: tuple[float, float], resolution: float | None
) -> tuple[float, float]:
    """Return where a device stops [m]: its workspace, or its outermost encoder counts within."""
    low, high = workspace
    if resolution is None:
        return low, high
    if math.isfinite(low):
        first = math.ceil(low / resolution)
        low = (first if first * resolution >= low else first + 1) * resolution
    if math.isfinite(high):
        last = math.floor(high / resolution)
        high = (last if last * resolution <= high else last - 1) * resolution
    return low, high


@rule
def saturate(force: float, peak: float | None) -> float:
    """Limit a force to the motor's largest when it is applied [N]; None is unlimited."""
    if peak is not None:
        if force > peak:
            return peak
        if force < -peak:
            return -peak
    return force


def split_delay(delay: float) -> tuple[int, float]:
    """Split a delay d = i + φ [ticks].

    During tick k the force of tick k−i−1 acts for φT, then that of k−i.
    """
    whole = math.floor(delay)
    return whole, delay - whole


_OF_A_PATH = ("path", "file", "columns", "units", "rate")


class DeviceModel(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of the virtual device; terms that are None or omitted are absent.

    mass: m [kg].
    damping: Viscous damping b [N s/m].
    gravity: Acceleration g towards negative positions [m/s²], acting on ``mass`` (the hand carries
        its own).
    position, velocity: State before the first tick [m], [m/s].
    resolution: Position resolution of the encoder [m].
    friction: Coulomb friction [N].
    peak_force: Largest force of the motor [N].
    delay: Delay from sample to applied force [ticks], in addition to that of ``apply: next_tick``.
    hand: A hand that holds the device.
    mass_by_position: Position [m] and mass [kg] of the corners of a piecewise linear mass,
        positions increasing; held before the first and after the last. Replaces ``mass`` as
        inertia (an arm is heavier the further it reaches); gravity still acts on ``mass``. Empty
        for none.
    axes: Fields that differ along an axis of the scene, by name of the axis; of a hand, only the
        differing fields.
    """

    mass: Positive
    damping: NonNegative = 0.0
    gravity: float | None = None
    position: float = 0.0
    velocity: float = 0.0
    resolution: Positive | None = None
    friction: NonNegative | None = None
    peak_force: Positive | None = None
    delay: Annotated[float, msgspec.Meta(ge=0.0, le=1000.0)] = 0.0
    hand: Hand | None = None
    mass_by_position: list[tuple[float, Positive]] = []
    axes: dict[Literal["x", "y", "z"], dict[str, Any]] = {}

    def __post_init__(self) -> None:
        check_fields(self, "device")
        for name, value in (
            ("mass", self.mass),
            ("resolution", self.resolution),
            *self._masses(),
        ):
            if value is not None and value < SMALLEST:
                raise ValueError(
                    f"{name} is {value!r}, expected at least {SMALLEST:g}: below it a step of the"
                    " device is not finite"
                )
        for i, (place, _) in enumerate(self.mass_by_position):
            if i and place <= self.mass_by_position[i - 1][0]:
                raise ValueError(
                    f"mass_by_position[{i}] is at {place} m after {self.mass_by_position[i - 1][0]}"
                    " m: positions must increase"
                )
        for axis, changes in self.axes.items():
            if not changes or "axes" in changes:
                raise ValueError(
                    f"axes.{axis} is {changes!r}: expected fields of a device other than axes"
                )
            self.along(axis)

    def _masses(self) -> list[tuple[str, float]]:
        return [
            (f"mass_by_position[{i}]", mass)
            for i, (_, mass) in enumerate(self.mass_by_position)
        ]

    def along(self, axis: str) -> DeviceModel:
        """Return the model along one axis, with the settings of that axis."""
        changes = self.axes.get(axis)  # type: ignore[call-overload]
        everywhere = msgspec.structs.replace(self, axes={})
        if changes is None:
            return everywhere
        fields = msgspec.to_builtins(everywhere)
        hand = changes.get("hand")
        wanted = {**fields, **changes}
        if isinstance(hand, Mapping):
            # A path of its own replaces a file, and a file a path.
            own = "path" in hand or "file" in hand
            before = fields["hand"] or {}
            base = {k: v for k, v in before.items() if not (own and k in _OF_A_PATH)}
            wanted["hand"] = {**base, **hand}
        made: DeviceModel = convert(wanted, DeviceModel, f"device.axes.{axis}")
        if isinstance(hand, Mapping) and made.hand is not None and made.hand.file:
            made = msgspec.structs.replace(made, hand=made.hand.along(axis, True))
        return made

    @property
    def moving_mass(self) -> float:
        """Mass that the force accelerates, with the hand's [kg]."""
        return self.mass if self.hand is None else self.mass + self.hand.mass

    @property
    def moving_masses(self) -> tuple[float, float]:
        """Smallest and largest mass that the force accelerates, with the hand's [kg]."""
        found = [mass for _, mass in self.mass_by_position] or [self.mass]
        hand = 0.0 if self.hand is None else self.hand.mass
        return min(found) + hand, max(found) + hand

    @property
    def moving_damping(self) -> float:
        """Viscous damping, with the hand's [N s/m]."""
        return self.damping if self.hand is None else self.damping + self.hand.damping

    @property
    def grip(self) -> float:
        """Stiffness of the hand [N/m]; 0 without one."""
        return 0.0 if self.hand is None else self.hand.stiffness

    def load(self, tick: int, period: float, target: float | None = None) -> float:
        """Return the force besides the motor's during a tick [N]: gravity and the hand's spring.

        The hand pulls to its path, or to `target` [m].
        """
        load = 0.0
        if self.gravity is not None:
            load -= self.mass * self.gravity
        if self.hand is not None:
            point = self.hand.point(tick * period) if target is None else target
            load += self.hand.stiffness * point
        return load


@rule
def move_towards(wanted: float, before: float, farthest: float) -> float:
    """Move a dragged target towards `wanted` by one tick, at most by `farthest` [m]."""
    if wanted > before + farthest:
        return before + farthest
    if wanted < before - farthest:
        return before - farthest
    return wanted
