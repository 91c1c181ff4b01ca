"""What a realisation of D^α costs and what it gets wrong, measured on its taps and sections alone.

The reference is (jω)^α itself. Part of every causal realisation's error is a pure delay, that of (1 − z⁻¹)^α exactly αT/2. So
errors are given raw and with the best pure delay removed, in the bands of a hand (a few hertz), a contact (tens of hertz) and
an encoder's noise (Nyquist).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.laws.derivatives import realise
from sim.arrays import Array

ComplexArray = NDArray[np.complex128]

BANDS: dict[str, tuple[float, float]] = {"slow": (0.001, 0.01), "hand": (0.01, 0.1), "contact": (0.1, 0.5), "high": (0.5, 0.9)}
_PER_BAND = 60


@dataclass(frozen=True)
class BandError:
    """Error against (jω)^α over one band of frequencies."""

    raw: float  # root mean square of |H/(jω)^α − 1| over the band, log-spaced [1]
    aligned: float  # the same after the best pure delay of the whole range is removed [1]
    phase: float  # largest phase error, raw [rad]


@dataclass(frozen=True)
class Analysis:
    """Figures of one realisation at one order, length and period."""

    kind: str  # registered name
    order: float  # α
    taps: int  # length n + 1 as asked for
    period: float  # sampling period T [s]
    multiplies: int  # multiplications per tick in the loop's kernels: one per tap, four per section
    states: int  # numbers remembered from tick to tick: older deflections and outputs of sections
    delay: float  # pure delay that fits best from the slow to the contact band [ticks]
    leak: float  # D(1)·T^α: answer to a held offset, in units in which GL's first tap is 1
    nyquist: float  # D(−1)·(T/2)^α: gain at Nyquist, 1 for GL with infinite memory
    pole: float  # largest magnitude of a pole, 0 without sections
    bands: dict[str, BandError]  # errors by band, names and edges as in `BANDS` (fractions of Nyquist)

    def error(self, aligned: bool = True) -> float:
        """One number for a chart: root mean square over the slow, hand and contact bands."""
        values = [self.bands[name].aligned if aligned else self.bands[name].raw for name in ("slow", "hand", "contact")]
        return math.sqrt(math.fsum(v * v for v in values) / len(values))


def response(law: CompiledLaw, angles: Array) -> ComplexArray:
    """Frequency response of taps and sections."""
    found: ComplexArray = law.response(np.exp(1j * np.asarray(angles, dtype=np.float64)))
    return found


def largest_pole(law: CompiledLaw) -> float:
    """Largest magnitude of the poles of the sections."""
    return max((float(np.max(np.abs(np.roots([1.0, a1, a2])))) for _, _, a1, a2 in law.sections), default=0.0)


def apply(law: CompiledLaw, samples: Array) -> Array:
    """Output of a law from rest, by scipy's filters rather than the loop's kernels."""
    from scipy.signal import lfilter

    output: Array = np.asarray(lfilter(law.taps or (0.0,), [1.0], samples), dtype=np.float64)
    for b0, b1, a1, a2 in law.sections:
        output = output + lfilter([b0, b1], [1.0, a1, a2], samples)
    return output


def multiplies(law: CompiledLaw) -> int:
    """Multiplications per tick in the loop's kernels."""
    return len(law.taps) + 4 * len(law.sections)


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


def lengths_taken(kind: str, order: float, period: float, upto: int = 2000) -> tuple[int, int] | None:
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


def analyse(kind: str, order: float, taps: int, period: float, law: CompiledLaw | None = None) -> Analysis:
    """Measure one realisation, or a law that stands for one."""
    law = realise(kind, order, taps, period) if law is None else law
    angles = {name: math.pi * np.geomspace(low, high, _PER_BAND, dtype=np.float64) for name, (low, high) in BANDS.items()}
    relative = {name: response(law, a) / (1j * a / period) ** order for name, a in angles.items()}
    fitted = ("slow", "hand", "contact")
    delay = best_delay(np.concatenate([relative[n] for n in fitted]), np.concatenate([angles[n] for n in fitted]))
    bands = {}
    for name, a in angles.items():
        raw, aligned = (
            np.sqrt(np.mean(np.abs(r - 1.0) ** 2)) for r in (relative[name], relative[name] * np.exp(1j * a * delay))
        )
        bands[name] = BandError(float(raw), float(aligned), float(np.max(np.abs(np.angle(relative[name])))))
    states = max(0, len(law.taps) - 1) + 2 * len(law.sections)
    leak, nyquist = law.h1 * period**order, law.h_nyquist * (0.5 * period) ** order
    return Analysis(kind, order, taps, period, multiplies(law), states, delay, leak, nyquist, largest_pole(law), bands)
