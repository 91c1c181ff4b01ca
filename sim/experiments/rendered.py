"""Rendered stiffness and damping against frequency, and the K–B plane (Z-width).

The force is held between samples and delayed: at the port the law H is G(jω) = H(e^{jωT}) e^{−jω(d
+ ½)T} sinc(ωT/2) for motions below half the sampling rate. A spring and a damper have G = K + jωB,
so Re G is the felt stiffness at a frequency, and Im G/ω the damping. A delay reduces it by K (d +
½) T (Colgate & Brown, "Factors affecting the Z-width of a haptic display", 1994).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw, Law
from nodes.stability.effective_damping import damping_needed
from nodes.stability.k_max import k_max, without_spring
from nodes.stability.plant import Plant
from sim.arrays import Array
from sim.experiments.k_max_simulated import at_stiffness

LOWEST = 0.1  # lowest frequency of a response by default [Hz]
POINTS = 400  # number of its points
PRECISION = 1e-5  # relative precision of a passive stiffness


@dataclass(frozen=True)
class FeltResponse:
    """Rendered impedance against frequency, each shape (n,)."""

    frequency_hz: Array
    stiffness_n_per_m: Array  # at the port, including hold and delay
    damping_n_s_per_m: Array
    law_stiffness_n_per_m: Array  # of the law alone, applied without hold or delay
    law_damping_n_s_per_m: Array
    magnitude_n_per_m: Array  # magnitude at the port
    phase_deg: Array


def frequencies(period: float, lowest: float = LOWEST, points: int = POINTS) -> Array:
    """Return logarithmically spaced frequencies up to half the sampling rate [Hz]."""
    highest = 0.5 / period
    if not 0.0 < lowest < highest:
        raise ValueError(
            f"lowest is {lowest:g} Hz, expected between 0 and half the rate, {highest:g} Hz"
        )
    return np.asarray(np.geomspace(lowest, highest, points))


def port(
    law: CompiledLaw, period: float, delay: float, frequency_hz: Array
) -> NDArray[np.complex128]:
    """Return G(jω) at the port [N/m]: the held law, `delay` ticks late.

    Raises ValueError for a law with own code.
    """
    _linear(law)
    angle = 2.0 * np.pi * frequency_hz * period
    late = np.exp(-1j * angle * (delay + 0.5)) * np.sinc(angle / (2.0 * np.pi))
    return np.asarray(law.response(np.exp(1j * angle)) * late)


def _linear(law: CompiledLaw) -> None:
    if law.evaluate is not None:
        raise ValueError("law: has code of its own and no response; play it instead")


def rendered(
    law: CompiledLaw,
    period: float,
    delay: float = 0.0,
    frequency_hz: Array | None = None,
) -> FeltResponse:
    """Return the response of a law at a period [s] and a delay [ticks].

    The default frequencies are `frequencies`.
    """
    at = (
        frequencies(period)
        if frequency_hz is None
        else np.asarray(frequency_hz, dtype=np.float64)
    )
    if not (
        at.size and np.all(at > 0.0) and np.all(at <= 0.5 / period * (1.0 + 1e-12))
    ):
        raise ValueError(
            f"frequency_hz: expected above 0 and up to half the rate, {0.5 / period:g} Hz"
        )
    felt = port(law, period, delay, at)
    own = law.response(np.exp(2j * np.pi * at * period))
    pulse = 2.0 * np.pi * at
    phase = np.degrees(np.unwrap(np.angle(felt)))
    return FeltResponse(
        at,
        felt.real,
        felt.imag / pulse,
        own.real,
        own.imag / pulse,
        np.abs(felt),
        phase,
    )


@dataclass(frozen=True)
class ZWidth:
    """Largest stiffness over the damping gain, each shape (n,); NaN where there is none."""

    kind: str  # of the law
    gain: Array  # B, in the law's own unit
    # nominal K up to which the loop with the known device is stable
    k_max_n_per_m: Array
    h1_max_n_per_m: Array  # H(1) at `k_max_n_per_m`
    # nominal K up to which the law is passive with the device's damping, for any hand
    passive_n_per_m: Array


def z_width(law: Law, plant: Plant, gains: Sequence[float]) -> ZWidth:
    """Return the K–B plane of a law on a device: largest stable and passive K per gain."""
    for field in ("stiffness", "damping"):
        if field not in law.__struct_fields__:
            raise ValueError(
                f"law kind {law.kind} has no parameter {field!r}: its K-B plane has no axis for it"
            )
    rows = [
        _widest(msgspec.structs.replace(law, damping=float(gain)), plant)
        for gain in gains
    ]
    edges, felt, passive = (np.array(column) for column in zip(*rows, strict=True))
    return ZWidth(law.kind, np.asarray(gains, dtype=np.float64), edges, felt, passive)


def _widest(law: Law, plant: Plant) -> tuple[float, float, float]:
    found = k_max(without_spring(law, plant.period), plant)
    edge, felt = (
        np.nan if value is None else value
        for value in (found.k_max_n_per_m, found.h1_max_n_per_m)
    )
    return edge, felt, passive_stiffness(at_stiffness(law, plant.period), plant)


def passive_stiffness(
    law_of_stiffness: Callable[[float], CompiledLaw], plant: Plant
) -> float:
    """Return the largest K at which the device's damping makes a law passive [N/m].

    NaN if there is none. The required damping is a maximum of functions linear in K, so it is
    convex, and the passive K form one interval.
    """

    def needed(stiffness: float) -> float:
        law = law_of_stiffness(stiffness)
        return (
            damping_needed(law, plant.period, plant.delay) if law.h1 > 0.0 else np.inf
        )

    # Even without delay a spring needs K T/2 of damping: no law is passive far above this
    # bound.
    grid = np.geomspace(1e-3, 1.0, 17) * 4.0 * plant.damping / plant.period
    values = [needed(k) for k in grid.tolist()] if plant.damping > 0.0 else [np.inf]
    if not min(values) <= plant.damping:
        low, high, found = _least_between(
            needed, grid, int(np.argmin(values)), plant.damping
        )
        if found is None:
            return float("nan")
        low = found
    else:
        last = max(i for i, value in enumerate(values) if value <= plant.damping)
        low = float(grid[last])
        high = float(grid[min(last + 1, len(grid) - 1)])
    while high - low > PRECISION * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if needed(middle) <= plant.damping else (low, middle)
    return low


def _least_between(
    needed: Callable[[float], float], grid: Array, at: int, enough: float
) -> tuple[float, float, float | None]:
    """Bracket a grid's minimum; return both ends and a K that needs at most `enough`.

    The K is None if there is none.
    """
    low = float(grid[max(at - 1, 0)])
    high = float(grid[min(at + 1, len(grid) - 1)])
    for _ in range(24 if np.isfinite(needed(float(grid[at]))) else 0):
        left = low + (high - low) / 3.0
        right = high - (high - low) / 3.0
        values = needed(left), needed(right)
        if min(values) <= enough:
            return low, high, left if values[0] <= enough else right
        low, high = (low, right) if values[0] <= values[1] else (left, high)
    return low, high, None


def error_of(
    law: CompiledLaw,
    period: float,
    delay: float,
    wanted: NDArray[np.complex128],
    frequency_hz: Array,
) -> float:
    """Return the relative RMS distance of the rendered impedance from another one."""
    felt = port(law, period, delay, frequency_hz)
    return float(np.sqrt(np.mean(np.abs(felt / wanted - 1.0) ** 2)))
