"""A device with a servo faster than the loop, and the stiffness that its damper allows.

The servo samples the device every T/N and answers with a damper on the backward difference; the
coupling's force comes every T, some servo ticks late. One period of the loop is one linear map (N
exact steps, lifted), so the loop is stable iff the pole radius of that map is below 1, without
approximation.

A heavy device has a closed form, for any delay and damping: at the edge the motion is slow against
both rates, the servo's damper counts in full, and H(1) ≤ (b + B_s)/(T (½ + d)) (THEORY.md §13).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.stability.plant import Plant, held_step


@dataclass(frozen=True)
class TwoRate:
    """A device with a servo."""

    mass: float  # of the device [kg], [N s/m]
    damping: float
    servo_damping: float  # B_s, damping gain of the servo [N s/m]
    ratio: int  # N, servo ticks per tick of the loop
    delay: int = 0  # from the loop's sample to its force taking effect [servo ticks]

    def __post_init__(self) -> None:
        if not (self.mass > 0.0 and self.damping >= 0.0 and self.servo_damping >= 0.0):
            raise ValueError(
                f"mass {self.mass} kg, damping {self.damping}, servo {self.servo_damping} N s/m: no"
                " device"
            )
        if self.ratio < 1 or self.delay < 0:
            raise ValueError(
                f"ratio {self.ratio}, expected at least 1; delay {self.delay} servo ticks, expected"
                " 0 or more"
            )


def heavy_limit(device: TwoRate, period: float) -> float:
    """Return the stiffness limit of a heavy device, (b + B_s)/(T (½ + d)), d in ticks [N/m]."""
    return (device.damping + device.servo_damping) / (
        period * (0.5 + device.delay / device.ratio)
    )


def lifted(law: CompiledLaw, period: float, device: TwoRate) -> NDArray[np.float64]:
    """Return one period of the loop as a matrix.

    The state at a tick of the loop is position, velocity, position one servo tick ago, the n older
    samples of the loop, and the forces that have not taken effect, oldest first. Raises ValueError
    if the law has sections.
    """
    if law.sections:
        raise ValueError("law: only taps can be lifted over the servo's ticks")
    short = period / device.ratio
    _, (a11, a12, a21, a22), (b1, b2), _ = held_step(
        Plant(short, device.mass, device.damping)
    )
    n, waiting = len(law.taps) - 1, device.delay // device.ratio + 1
    size = 3 + n + waiting
    rows = np.eye(size)
    x, v, before = rows[0], rows[1], rows[2]
    samples = [x, *(rows[3 + m] for m in range(n))]
    forces = [rows[3 + n + i] for i in range(waiting)]
    # The force of this tick pulls back: the deflection is −x.
    newest = -sum(
        (tap * sample for tap, sample in zip(law.taps, samples, strict=True)),
        np.zeros(size),
    )
    queue = [*forces, newest]
    for j in range(device.ratio):
        # queue[-1] is this tick's force; it acts from servo tick `delay` on, each older one N servo
        # ticks earlier.
        age = (
            (device.delay - j + device.ratio - 1) // device.ratio
            if j < device.delay
            else 0
        )
        acting = queue[-1 - age]
        servo = -device.servo_damping / short * (x - before)
        u = acting + servo
        x, v, before = a11 * x + a12 * v + b1 * u, a21 * x + a22 * v + b2 * u, x
    return np.array([x, v, before, *samples[:n], *queue[1:]])


def two_rate_radius(law: CompiledLaw, period: float, device: TwoRate) -> float:
    """Return the pole radius of the loop of a law of taps only."""
    return float(np.max(np.abs(np.linalg.eigvals(lifted(law, period, device)))))


def two_rate_k_max(
    derivative: CompiledLaw, period: float, device: TwoRate, steps: int = 400
) -> float | None:
    """Return the upper end of the lowest stable interval of K [N/m].

    It searches in steps over six decades about `heavy_limit`. None if no step is stable, infinite
    if the stiffest is.
    """

    def stable(k: float) -> bool:
        return (
            two_rate_radius(
                replace(
                    derivative, taps=(derivative.taps[0] + k, *derivative.taps[1:])
                ),
                period,
                device,
            )
            < 1.0
        )

    base: float = heavy_limit(device, period) or 1.0
    inside: float | None = None
    for i in range(steps):
        k: float = base * 10.0 ** (-3.0 + 6.0 * i / (steps - 1))
        if stable(k):
            inside = k
            continue
        if inside is None:
            continue
        low, high = inside, k
        while high - low > 1e-12 * high:
            middle = math.sqrt(low * high)
            if middle in (low, high):
                break
            low, high = (middle, high) if stable(middle) else (low, middle)
        return low
    return None if inside is None else math.inf
