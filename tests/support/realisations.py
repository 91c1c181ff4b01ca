"""Shared by tests of D^α: the loop's rendering, the scale of rounding, the response."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from nodes.arithmetic import fir, push, sections
from nodes.laws import CompiledLaw
from nodes.laws.derivatives import derivative_kinds
from sim.device.filters import filtered
from sim.lab.charts.derivative_errors import response

T = 0.002
EPS = 2.0**-52
KINDS = sorted(derivative_kinds())
BDF = ("bdf2", "bdf3", "bdf4", "bdf5", "bdf6")
RECURSIVE = (
    "tustin_cfe",
    "al_alaoui_cfe",
    "oustaloup_tustin",
    "oustaloup_matched",
    "least_squares",
)
# What one tick of the loop does with: a length each realisation takes at any order.
LENGTH = {**dict.fromkeys(KINDS, 64), **dict.fromkeys(RECURSIVE, 11)}


def apply(law: CompiledLaw, samples: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the output of a law from rest, by BLAS instead of the kernels."""
    output = filtered(law.taps or (0.0,), [1.0], samples)
    for b0, b1, a1, a2 in law.sections:
        output = output + filtered([b0, b1], [1.0, a1, a2], samples)
    return output


def loop(law: CompiledLaw, samples: list[float]) -> list[float]:
    """Return the output as the coupling renders it: its own kernels over its own ring buffer."""
    length = max(len(law.taps), 2)
    history, head = [0.0] * (2 * length), 0
    flat = [c for section in law.sections for c in section]
    state = [0.0] * (2 * len(law.sections))
    output = []
    for sample in samples:
        head = push(history, head, length, sample)
        force = fir(law.taps, history, head)
        if flat:
            force += sections(flat, state, history[head], history[head + 1])
        output.append(force)
    return output


def size(law: CompiledLaw) -> float:
    """Return the sum of the magnitudes of all weights of a unit deflection: scale of rounding."""
    return math.fsum(map(abs, law.taps)) + sum(
        float(np.sum(np.abs(filtered([b0, b1], [1.0, a1, a2], np.eye(1, 4000)[0]))))
        for b0, b1, a1, a2 in law.sections
    )


def ticks(count: int, step: float) -> NDArray[np.float64]:
    """Return the sampling instants [s]."""
    return np.arange(count, dtype=np.float64) * np.float64(step)


def at(law: CompiledLaw, fraction: float) -> complex:
    """Return the response at a fraction of Nyquist."""
    return complex(response(law, np.array([math.pi * fraction]))[0])
