"""What a realisation of D^α costs and what it gets wrong, measured on its taps and sections alone.

The reference is (jω)^α itself. Part of every causal realisation's error is a pure delay, that of (1
− z⁻¹)^α exactly αT/2. So errors are given raw and with the best pure delay removed, in the bands of
a hand (a few hertz), a contact (tens of hertz) and an encoder's noise (Nyquist).
"""

import math

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.laws.derivatives import realise
from sim.arrays import Array

ComplexArray = NDArray[np.complex128]

BANDS: dict[str, tuple[float, float]] = {
    "slow": (0.001, 0.01),
    "hand": (0.01, 0.1),
    "contact": (0.1, 0.5),
    "high": (0.5, 0.9),
}
_PER_BAND = 60


def response(law: CompiledLaw, angles: Array) -> ComplexArray:
    """Frequency response of taps and sections."""
    found: ComplexArray = law.response(np.exp(1j * np.asarray(angles, dtype=np.float64)))
    return found


def largest_pole(law: CompiledLaw) -> float:
    """Largest magnitude of the poles of the sections."""
    return max(
        (float(np.max(np.abs(np.roots([1.0, a1, a2])))) for _, _, a1, a2 in law.sections),
        default=0.0,
    )


def best_delay(relative: ComplexArray, angles: Array) -> float:
    """Pure delay that brings a relative response closest to 1: Gauss-Newton on |G e^{jθτ} − g|, its gain g free."""
    delay = -float(np.sum(np.unwrap(np.angle(relative)) * angles) / np.sum(angles * angles))
    for _ in range(20):
        turned = relative * np.exp(1j * angles * delay)
        gain = float(np.mean(turned.real))
        slope = 1j * angles * turned
        step = float(np.sum((np.conj(slope) * (gain - turned)).real) / np.sum(np.abs(slope) ** 2))
        delay += step
        if abs(step) < 1e-12:
            break
    return delay


def lengths_taken(
    kind: str, order: float, period: float, upto: int = 2000
) -> tuple[int, int] | None:
    """Find the lengths at which a realisation can be had, by asking it."""

    def taken(taps: int) -> bool:
        try:
            realise(kind, order, taps, period)
        except ValueError:
            return False
        return True

    first = next((n for n in range(2, 64) if taken(n)), None)
    if first is None:
        return None
    if taken(upto):
        return first, upto
    low, high = first, upto
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if taken(middle) else (low, middle)
    return first, low


def analyse(
    kind: str, order: float, taps: int, period: float, law: CompiledLaw | None = None
) -> dict[str, float]:
    """Measure one realisation, or a law that stands for one: what it costs per tick, and what it gets wrong.

    `error_raw` and `error_aligned`: root mean square of H/(jω)^α − 1 over the slow, hand and
    contact bands, and after the pure delay that fits them best, `delay_ticks`. `leak`: D(1)·T^α;
    `nyquist_gain`: D(−1)·(T/2)^α, both 1 for GL's first tap.
    """
    law = realise(kind, order, taps, period) if law is None else law
    angles = {
        name: math.pi * np.geomspace(low, high, _PER_BAND, dtype=np.float64)
        for name, (low, high) in BANDS.items()
    }
    relative = {name: response(law, a) / (1j * a / period) ** order for name, a in angles.items()}
    fitted = ("slow", "hand", "contact")
    delay = best_delay(
        np.concatenate([relative[n] for n in fitted]), np.concatenate([angles[n] for n in fitted])
    )

    def rms(band: str, delay: float) -> float:
        return float(
            np.sqrt(np.mean(np.abs(relative[band] * np.exp(1j * angles[band] * delay) - 1.0) ** 2))
        )

    def whole(delay: float) -> float:
        return math.sqrt(math.fsum(rms(band, delay) ** 2 for band in fitted) / len(fitted))

    return {
        "order": order,
        "taps": taps,
        # One per tap, four per section; older deflections, and outputs of sections too.
        "multiplies": len(law.taps) + 4 * len(law.sections),
        "states": max(0, len(law.taps) - 1) + 2 * len(law.sections),
        "error_raw": whole(0.0),
        "error_aligned": whole(delay),
        "delay_ticks": delay,
        "leak": law.h1 * period**order,
        "nyquist_gain": law.h_nyquist * (0.5 * period) ** order,
        "largest_pole": largest_pole(law),
        **{f"error_{band}": rms(band, delay) for band in BANDS},
    }
