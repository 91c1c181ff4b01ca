"""A fractional relaxation with full memory, as a sum of exponentials.

The arm of a fractional solid, A + τ^α D^α A = E τ^α D^α x with the Grünwald–Letnikov D^α = ((1 −
w)/T)^α, answers a step x with E s_m, where Σ s_m w^m = c (1 − w)^(α−1) / (1 + c (1 − w)^α), c =
(τ/T)^α. For 0 < α < 1 this function is analytic except for a cut along w > 1, so s_m = ∫ t^m μ(t)
dt over (0, 1) with a positive density, the jump across the cut (for continuous time see Gorenflo
and Mainardi, "Fractional calculus", 1997). With t = e^−s and r = (1 − t)/t,

    μ(t) dt = (1/π) sin(πα) u / (1 + 2 u cos(πα) + u²) (s/r) d ln s,   u = c r^α.

Gauss's rule with two nodes in each cell of ln s turns it into exponentials with positive weights:
the sum relaxes to zero, as the solid does, and is passive where the solid is. The first values are
exact.
"""

from __future__ import annotations

import itertools
import math

from nodes.laws import CompiledLaw
from nodes.laws.derivatives.gl import coefficients
from nodes.laws.derivatives.parallel import parallel

_HEAD = 4  # values of the step response that are exact
_CELL = 1.8  # width of a cell of ln s
_POINTS = 48  # samples of the density per cell
_FASTEST = 12.0  # rate that decays within a tick [1/tick]
_SLOWEST = 5e-7  # slowest rate [1/tick]; slower parts relax at this rate


def relaxation(order: float, time: float, period: float) -> CompiledLaw:
    """Return the arm of unit stiffness for relaxation time τ and period T [s].

    Its step response finally decays as t^−α.
    """
    share = (time / period) ** order
    if order == 1.0:
        # One exponential, exactly: (1 − w) c/(1 + c) / (1 − p w).
        pole = share / (1.0 + share)
        return CompiledLaw((0.0,), ((pole, -pole, -pole, 0.0),))
    poles, weights = exponentials(order, share)
    exact = step_answer(order, share, _HEAD)
    fitted = [
        math.fsum(w * p**m for w, p in zip(weights, poles, strict=True))
        for m in range(_HEAD)
    ]
    rest = [a - b for a, b in zip(exact[1:], fitted[1:], strict=True)]
    residues = [w * p for w, p in zip(weights, poles, strict=True)]
    return parallel([exact[0], *rest], poles, residues, 1, 1.0)


def step_answer(order: float, share: float, count: int) -> list[float]:
    """Return the first `count` values of the step response, from s_0 on.

    They are the summed quotient of two power series.
    """
    series = coefficients(order, count)
    arm: list[float] = []
    for m, g in enumerate(series):
        felt = math.fsum(series[j] * arm[m - j] for j in range(1, m + 1))
        arm.append(share * (g - felt) / (1.0 + share))
    total = 0.0
    answer = []
    for one in arm:
        total += one
        answer.append(total)
    return answer


def exponentials(order: float, share: float) -> tuple[list[float], list[float]]:
    """Return poles and positive weights of the step response, s_m ≈ Σ weight pole^m."""
    # The peak lies in the middle of a sample: as order → 1 it is all there is, one exponential.
    sample = _CELL / _POINTS
    peak = _log_peak(order, share)
    top = peak + (math.floor((math.log(_FASTEST) - peak) / sample) + 0.5) * sample
    count = math.ceil((top - math.log(_SLOWEST)) / _CELL)
    poles: list[float] = []
    weights: list[float] = []
    for cell in range(count):
        ends = [
            math.exp(top - (cell + j / _POINTS) * _CELL) for j in range(_POINTS + 1)
        ]
        below = [_below(s, order, share) for s in ends]
        rates = [math.sqrt(fast * slow) for fast, slow in itertools.pairwise(ends)]
        # Over ln r, d ln s is r t/s of it: (s/r) of that is t.
        masses = [
            max(fast - slow, 0.0) * math.exp(-s)
            for (fast, slow), s in zip(itertools.pairwise(below), rates, strict=True)
        ]
        _two_nodes(rates, masses, poles, weights)
    # the slower rest, where t is 1
    slowest = math.exp(top - count * _CELL)
    return [*poles, math.exp(-slowest)], [*weights, _below(slowest, order, share)]


def _below(rate: float, order: float, share: float) -> float:
    """Return the integral of the density over ln r up to a rate s, in closed form.

    It is exact however narrow the peak near order 1 is.
    """
    u = share * math.expm1(rate) ** order
    angle = math.pi * order
    return math.atan2(u * math.sin(angle), 1.0 + u * math.cos(angle)) / angle


def _log_peak(order: float, share: float) -> float:
    """Return ln s where u = 1, the middle of the density over ln r."""
    log_r = -math.log(share) / order
    return math.log(math.log1p(math.exp(min(max(log_r, -700.0), 700.0))))


def _two_nodes(
    rates: list[float], masses: list[float], poles: list[float], weights: list[float]
) -> None:
    """Add exponentials that have the moments of a cell up to the third.

    They are two, but none where no mass is, and one where all of it lies in one sample (order → 1).
    """
    total = math.fsum(masses)
    if total == 0.0:
        return
    mean = math.fsum(s * m for s, m in zip(rates, masses, strict=True)) / total
    second = (
        math.fsum((s - mean) ** 2 * m for s, m in zip(rates, masses, strict=True))
        / total
    )
    third = (
        math.fsum((s - mean) ** 3 * m for s, m in zip(rates, masses, strict=True))
        / total
    )
    # Rounding of the mean alone leaves this much of a second moment.
    if second <= (len(rates) * math.ulp(mean)) ** 2:
        poles.append(math.exp(-mean))
        weights.append(total)
        return
    half = 0.5 * third / second
    root = math.sqrt(half * half + second)
    # low · high = −second: the one of the two that would cancel follows from the other
    far = half + math.copysign(root, half)
    low, high = sorted((far, -second / far))
    poles += [math.exp(-(mean + low)), math.exp(-(mean + high))]
    weights += [total * high / (high - low), -total * low / (high - low)]
