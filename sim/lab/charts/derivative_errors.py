"""Cost and error of a realisation of D^α, computed from its taps and sections.

The reference is (jω)^α. Part of the error of every causal realisation is a pure delay, exactly αT/2
for (1 − z⁻¹)^α. So errors are given raw and with the best pure delay removed, in the bands of a
hand (a few hertz), a contact (tens of hertz) and encoder noise (Nyquist).
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
    """Return the frequency response of taps and sections."""
    found: ComplexArray = law.response(
        np.exp(1j * np.asarray(angles, dtype=np.float64))
    )
    return found


def largest_pole(law: CompiledLaw) -> float:
    """Return the largest pole magnitude of the sections."""
    return max(
        (
            float(np.max(np.abs(np.roots([1.0, a1, a2]))))
            for _, _, a1, a2 in law.sections
        ),
        default=0.0,
    )


def best_delay(relative: ComplexArray, angles: Array) -> float:
    """Return the pure delay that best fits a relative response to 1 [ticks].

    Gauss-Newton on |G e^{jθτ} − g| with a free gain g.
    """
    delay = -float(
        np.sum(np.unwrap(np.angle(relative)) * angles) / np.sum(angles * angles)
    )
    for _ in range(20):
        turned = relative * np.exp(1j * angles * delay)
        gain = float(np.mean(turned.real))
        slope = 1j * angles * turned
        step = float(
            np.sum((np.conj(slope) * (gain - turned)).real) / np.sum(np.abs(slope) ** 2)
        )
        delay += step
        if abs(step) < 1e-12:
            break
    return delay


def lengths_taken(
    kind: str, order: float, period: float, upto: int = 2000
) -> tuple[int, int] | None:
    """Return the range of lengths that a realisation accepts, found by trial."""

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
    """Return cost per tick and errors of a realisation, or of a law that represents one.

    `error_raw` and `error_aligned`: root mean square of H/(jω)^α − 1 over the slow, hand and
    contact bands, without and with removal of the best-fitting pure delay, `delay_ticks`.
    `leak`: D(1)·T^α; `nyquist_gain`: D(−1)·(T/2)^α, both 1 for GL's first tap.
    """
    law = realise(kind, order, taps, period) if law is None else law
    angles = {
        name: math.pi * np.geomspace(low, high, _PER_BAND, dtype=np.float64)
        for name, (low, high) in BANDS.items()
    }
    relative = {
        name: response(law, a) / (1j * a / period) ** order
        for name, a in angles.items()
    }
    fitted = ("slow", "hand", "contact")
    delay = best_delay(
        np.concatenate([relative[n] for n in fitted]),
        np.concatenate([angles[n] for n in fitted]),
    )

    def rms(band: str, delay: float) -> float:
        return float(
            np.sqrt(
                np.mean(
                    np.abs(relative[band] * np.exp(1j * angles[band] * delay) - 1.0)
                    ** 2
                )
            )
        )

    def whole(delay: float) -> float:
        return math.sqrt(
            math.fsum(rms(band, delay) ** 2 for band in fitted) / len(fitted)
        )

    return {
        "order": order,
        "taps": taps,
        # One per tap, four per section; older deflections and section outputs are stored
        # too.
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
