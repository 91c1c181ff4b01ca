"""The law that a shape or region makes of a law: the one that is judged in its place.

A shape scales the law's force at rest by one factor and the rest by another. In a viscous region
the proxy trails behind the device by T/(T + τ) of the way a tick: the law is in series with
H = ρ(1 − q)/(1 − ρq) = 1 − (1 − ρ)/(1 − ρq), where q delays by a tick and ρ = τ/(τ + T). By partial
fractions this is again a law of taps and sections.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import zip_longest

from nodes.base.setup import Effect
from nodes.coupling.law_on_axis import still_of
from nodes.laws import CompiledLaw

# parts of a region's lag that a device meets on its way in, at which a law is judged
LAGS = (1.0, 0.5, 0.2, 0.05)
_FEW = 12.0  # exponent up to which dividing taps by powers of ρ loses less than half of the digits
_SMALL = 1e-14  # part of an impulse response that is left out
_APART = 1e-6  # least distance of two poles


def felt_laws(law: CompiledLaw, effect: Effect, period: float) -> list[CompiledLaw]:
    """Return the laws that a device feels where `effect` acts, at a sampling period [s].

    A region's lag grows from its boundary, so there are several; `law` has no code of its own.
    """
    scaled = factored(law, effect.stiffness, effect.damping)
    if effect.lag == 0.0:
        return [scaled]
    if effect.line:  # a viscous region and a line: the sum of both
        return [
            added(trailing(law, part * effect.lag, period), scaled) for part in LAGS
        ]
    return [trailing(scaled, part * effect.lag, period) for part in LAGS]


def added(law: CompiledLaw, other: CompiledLaw) -> CompiledLaw:
    """Return the sum of two laws."""
    taps = zip_longest(law.taps, other.taps, fillvalue=0.0)
    return CompiledLaw(tuple(a + b for a, b in taps), law.sections + other.sections)


def factored(law: CompiledLaw, stiffness: float, damping: float) -> CompiledLaw:
    """Return a law whose force at rest, and the rest of it, have factors."""
    taps = [damping * tap for tap in law.taps]
    taps[0] += (stiffness - damping) * still_of(law)
    return CompiledLaw(
        tuple(taps),
        tuple((damping * b0, damping * b1, a1, a2) for b0, b1, a1, a2 in law.sections),
    )


def trailing(law: CompiledLaw, lag: float, period: float) -> CompiledLaw:
    """Return a law in series with a proxy that trails behind the device by `lag` [s]."""
    rho = lag / (lag + period)
    while any(_same_pole(section, rho) for section in law.sections):
        rho -= 2.0 * _APART
    taps = list(law.taps)
    sections = list(law.sections)
    last = len(taps) - 1
    more: list[tuple[float, float, float, float]] = []
    if last * -math.log(rho) <= _FEW:
        end = sum(tap * rho**-m for m, tap in enumerate(law.taps))
        # N(q)/(1 − ρq) = Q(q) + N(1/ρ)/(1 − ρq), Q from its highest power down
        quotient = [0.0] * last
        value = 0.0
        for m in range(last, 0, -1):
            value = (value - law.taps[m]) / rho
            quotient[m - 1] = value
        more.append((-(1.0 - rho) * end, 0.0, -rho, 0.0))
    else:
        quotient = _quotient(law.taps, rho)
    taps += [0.0] * (len(quotient) - len(taps))
    for m, value in enumerate(quotient):
        taps[m] -= (1.0 - rho) * value
    for section in law.sections:
        (b0, _, a1, a2) = section
        w = _residue(section, rho)
        u = b0 - w
        v = w * a2 / rho
        more += [
            (-(1.0 - rho) * u, -(1.0 - rho) * v, a1, a2),
            (-(1.0 - rho) * w, 0.0, -rho, 0.0),
        ]
    return CompiledLaw(tuple(taps), (*sections, *more))


def _quotient(taps: Sequence[float], rho: float) -> list[float]:
    """Return taps through 1/(1 − ρq), as far as they matter."""
    found: list[float] = []
    value = most = 0.0
    while len(found) < len(taps) or abs(value) > _SMALL * most:
        value = rho * value + (taps[len(found)] if len(found) < len(taps) else 0.0)
        most = max(most, abs(value))
        found.append(value)
    return found


def _same_pole(section: tuple[float, float, float, float], rho: float) -> bool:
    _, _, a1, a2 = section
    return abs(rho * rho + a1 * rho + a2) < _APART


def _residue(section: tuple[float, float, float, float], rho: float) -> float:
    b0, b1, a1, a2 = section
    return (b0 + b1 / rho) / (1.0 + a1 / rho + a2 / (rho * rho))


def effective(law: CompiledLaw, effect: Effect, period: float) -> str:
    """Return the stiffness and damping that a device feels, as text.

    They are those of slow motion: the force at rest, and the first derivative in the frequency.
    """
    stiffness, slope = slow(law, period)
    drag = stiffness * effect.lag
    if effect.lag > 0.0 and not effect.line:
        return f"K 0 N/m, B {effect.stiffness * drag:.3g} N s/m"
    slope = effect.damping * slope + drag
    text = f"K {effect.stiffness * stiffness:.4g} N/m, B {slope:.3g} N s/m"
    if effect.line:
        text += f", and −{effect.stiffness * stiffness:.4g} N/m from half its reach on"
    return text


def slow(law: CompiledLaw, period: float) -> tuple[float, float]:
    """Return H(1) [N/m], and the damping of slow motion −T dH/dq at q = 1 [N s/m]."""
    slope = sum(m * tap for m, tap in enumerate(law.taps))
    for b0, b1, a1, a2 in law.sections:
        above = b0 + b1
        below = 1.0 + a1 + a2
        if below != 0.0:
            slope += (b1 * below - above * (a1 + 2.0 * a2)) / (below * below)
    return still_of(law), -period * slope
