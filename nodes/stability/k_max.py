"""Largest stable stiffness of a law with a known device, without simulation.

The stiffness enters the closed loop in one tap, so on the stability boundary K = −1/P(z) − D(z) for
a z on the unit circle (P the device with its delay, D the derivative part). All boundaries are
therefore the real values of one curve. Between two of them the loop is stable throughout or not at
all, and one pole radius decides which. For PD without delay the Jury conditions are linear in K and
give the same in closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw, Law
from nodes.stability.bracketed_roots import roots_between
from nodes.stability.closed_loop import pole_radius
from nodes.stability.judge import last_inside
from nodes.stability.occurring import Edge, edge_at, position_over_force
from nodes.stability.pair import as_one
from nodes.stability.plant import Plant, held_plant
from nodes.stability.resonances import resonances


@dataclass(frozen=True)
class KMax:
    """Where raising the nominal stiffness makes the loop unstable."""

    # upper end of the lowest stable interval of nominal K [N/m]; None if no K is stable, infinite
    # if all are
    k_max_n_per_m: float | None
    h1_max_n_per_m: float | None  # the stiffness H(1) rendered there [N/m]
    method: str  # ``closed_form`` or ``pole_radius``
    # stable intervals of nominal K, lowest first [N/m]; the closed form has at most one
    stable: tuple[tuple[float, float], ...]


def without_spring(law: Law, period: float) -> CompiledLaw:
    """Return a compiled law without its spring K: the derivative part D.

    K is the parameter ``stiffness``, or H(1) for a law without it.
    """
    compiled = law.compile(period)
    spring = getattr(law, "stiffness", None)
    return with_spring(compiled, -(compiled.h1 if spring is None else spring))


def with_spring(derivative: CompiledLaw, stiffness: float) -> CompiledLaw:
    """Return a derivative part with a nominal stiffness [N/m] added to its newest tap."""
    return replace(
        derivative, taps=(derivative.taps[0] + stiffness, *derivative.taps[1:])
    )


def k_max(derivative: CompiledLaw, plant: Plant, method: str | None = None) -> KMax:
    """Return the largest stable nominal stiffness of a derivative part; K > 0 and H(1) > 0.

    `derivative` comes from `without_spring`. `method`: None uses the closed form if there is one.
    Raises ValueError if the closed form is requested and there is none (more than two taps,
    sections, or a delay), and for a law with own code, which has no poles.
    """
    if derivative.evaluate is not None:
        raise ValueError(
            "law: has code of its own and no poles; use --method simulation or lockstep"
        )
    plant = as_one(plant)
    closed = (
        len(derivative.taps) <= 2
        and not derivative.sections
        and plant.delay == 0.0
        and plant.partner is None
    )
    if method == "closed_form" and not closed:
        raise ValueError(
            "method: closed_form needs a spring or PD without delay; this law has"
            f" {len(derivative.taps)} taps and {len(derivative.sections)} sections at a delay of"
            f" {plant.delay:g} ticks; use pole_radius"
        )
    leak = derivative.h1
    floor = max(0.0, -leak)
    if closed and method in (None, "closed_form"):
        name = "closed_form"
        stable = _jury(derivative, plant, floor)
    else:
        name = "pole_radius"
        stable = _between_boundaries(derivative, plant, floor)
    if not stable:
        return KMax(None, None, name, ())
    top = stable[0][1]
    return KMax(top, top + leak, name, tuple(stable))


def _jury(
    derivative: CompiledLaw, plant: Plant, floor: float
) -> list[tuple[float, float]]:
    """Return the stable interval of z³ + a₂z² + a₁z + a₀; a₂ and a₁ are linear in K."""
    held = held_plant(plant)
    n1, n0, _ = held.numerator
    _, trace, determinant = held.denominator
    h0, h1 = (*derivative.taps, 0.0)[:2]
    a2 = trace + n1 * h0
    a1 = determinant + n1 * h1 + n0 * h0
    a0 = n0 * h1
    # each condition reads c + s·K > 0
    conditions = [
        (1.0 + a2 + a1 + a0, n1 + n0),
        (1.0 - a2 + a1 - a0, n0 - n1),
        (1.0 - a0 * a0 - a1 + a0 * a2, a0 * n1 - n0),
        (1.0 - a0 * a0 + a1 - a0 * a2, n0 - a0 * n1),
    ]
    low = floor
    high = math.inf
    for constant, slope in conditions:
        if slope > 0.0:
            low = max(low, -constant / slope)
        elif slope < 0.0:
            high = min(high, -constant / slope)
        elif constant <= 0.0:
            return []
    # P(1) > 0 repeats the floor up to rounding: use the floor itself.
    low = floor if low <= floor + 1e-12 * high else low
    return [(low, high)] if abs(a0) < 1.0 and low < high else []


def _between_boundaries(
    derivative: CompiledLaw, plant: Plant, floor: float
) -> list[tuple[float, float]]:
    """Return the stable cells of the K axis, which all boundaries divide.

    The middle of a cell decides; the last cell is unbounded.
    """
    cuts = [
        floor,
        *(
            k
            for k in boundaries(derivative, plant)
            if k > floor * (1.0 + 1e-12) + 1e-12
        ),
    ]
    stable = []
    for low, high in zip(cuts, [*cuts[1:], math.inf], strict=True):
        middle = 0.5 * (low + high) if math.isfinite(high) else 2.0 * low + 1.0
        if pole_radius(with_spring(derivative, middle), plant) < 1.0:
            stable.append((low, high))
        elif stable:
            break
    return stable


def boundaries(derivative: CompiledLaw, plant: Plant) -> list[float]:
    """Return all nominal stiffnesses at which a pole is on the unit circle [N/m]."""
    return [stiffness for stiffness, _ in crossings(derivative, plant)]


def edge_of(derivative: CompiledLaw, plant: Plant) -> Edge | None:
    """Return the oscillation at K_max (THEORY.md §9).

    None without a K_max, at ω = 0 or ω_N, and for a pair of bodies.
    """
    plant = as_one(plant)
    if plant.partner is not None:
        return None
    limit = k_max(derivative, plant).k_max_n_per_m
    if limit is None or not math.isfinite(limit):
        return None
    stiffness, theta = min(
        crossings(derivative, plant), key=lambda c: abs(c[0] - limit)
    )
    if abs(stiffness - limit) > 1e-6 * limit or not 0.0 < theta < math.pi:
        return None
    return edge_at(derivative, plant, theta / plant.period)


def crossings(derivative: CompiledLaw, plant: Plant) -> list[tuple[float, float]]:
    """Return all nominal stiffnesses [N/m] with a pole on the unit circle and its ωT, sorted."""
    plant = as_one(plant)
    held = held_plant(plant)
    other = plant.other
    numerator = np.array(held.numerator)
    denominator = np.array(held.denominator)

    def curve(theta: NDArray[np.float64] | float) -> NDArray[np.complex128]:
        z = np.exp(1j * np.asarray(theta, dtype=np.float64))
        if other is not None:
            return np.asarray(
                -1.0 / position_over_force(z, plant) - derivative.response(z)
            )
        top = np.polyval(numerator, z)
        late = z ** (held.whole + 1)
        bottom = np.polyval(denominator, z) * late
        loop = bottom + top * derivative.response(z)
        return np.asarray(-loop / top)

    # Sixteen points per fastest turn of the curve; logarithmic at low frequency, for heavy devices.
    turns = held.whole if other is None else max(held.whole, math.ceil(other.delay)) + 8
    count = 16 * (len(derivative.taps) + turns + 8)
    even = np.linspace(0.0, np.pi, count + 1)[1:-1]
    grid = np.union1d(even, np.geomspace(1e-7, np.pi, 801)[:-1])
    peaks = resonances(derivative).tolist()
    grid = np.union1d(grid, [theta for theta in peaks if theta < math.pi])
    signs = np.sign(curve(grid).imag)
    found = [
        (float(curve(grid[i]).real), float(grid[i]))
        for i in np.flatnonzero(signs == 0.0)
    ]
    turned = np.flatnonzero(signs[:-1] * signs[1:] < 0.0)
    if len(turned):
        at = roots_between(
            lambda theta: curve(theta).imag, grid[turned], grid[turned + 1]
        )
        found += zip(curve(at).real.tolist(), at.tolist(), strict=True)
    # z = 1 and z = −1 are always on the curve; without friction the device does not respond at z =
    # −1.
    found.append((-_stiffness_of(plant) - derivative.h1, 0.0))
    if _answers_at_nyquist(plant) or (other is not None and _answers_at_nyquist(other)):
        found.append((float(curve(math.pi).real), math.pi))
    return sorted(found)


def _stiffness_of(plant: Plant) -> float:
    """Return the stiffness to ground, of a pair that of both ends in series [N/m]."""
    if plant.partner is None:
        return plant.stiffness
    both = plant.stiffness + plant.partner.stiffness
    return plant.stiffness * plant.partner.stiffness / both if both > 0.0 else 0.0


def _answers_at_nyquist(plant: Plant) -> bool:
    """Return whether an alternating force moves the device; without friction it does not."""
    numerator = np.array(held_plant(plant).numerator)
    return bool(abs(np.polyval(numerator, -1.0)) > 1e-12 * np.abs(numerator).sum())


@dataclass(frozen=True)
class Tolerance:
    """Tolerances of one property each, the others fixed; None where no limit was found."""

    # limits of the moving mass; searched from 1e-4 to 1e4 of the declared one
    mass_min_kg: float | None
    mass_max_kg: float | None
    # least damping of the device; None if stable without damping
    damping_min_n_s_per_m: float | None
    # largest stiffness of a hand; searched up to 1e6 N/m
    hand_stiffness_max_n_per_m: float | None
    # largest delay, fractions included; searched up to 100 ticks
    delay_max_ticks: float | None


def tolerance(law: CompiledLaw, plant: Plant) -> Tolerance | None:
    """Return tolerances of mass, damping, hand stiffness and delay; None if already unstable."""

    def within(other: Plant) -> bool:
        return pole_radius(law, other) < 1.0

    if not within(plant):
        return None
    decades = np.geomspace(1.0, 1e4, 81)[1:]
    hands = plant.stiffness + np.geomspace(1.0, 1e6, 61)
    later = np.concatenate([np.arange(1, 81) / 20.0, np.arange(5, 101)])
    delays = plant.delay + later

    def changed(field: str, value: float) -> Plant:
        fields: dict[str, Any] = {field: value}
        return replace(plant, **fields)

    def edge(field: str, steps: NDArray[np.float64]) -> float | None:
        """Return the first limit along the steps, by bisection."""
        inside: float = getattr(plant, field)
        for step in steps.tolist():
            if not within(changed(field, step)):
                return last_inside(
                    lambda value: within(changed(field, value)), inside, step, 40
                )
            inside = step
        return None

    return Tolerance(
        mass_min_kg=edge("mass", plant.mass / decades),
        mass_max_kg=edge("mass", plant.mass * decades),
        damping_min_n_s_per_m=edge(
            "damping", plant.damping * np.linspace(1.0, 0.0, 41)[1:]
        ),
        hand_stiffness_max_n_per_m=edge("stiffness", hands),
        delay_max_ticks=edge("delay", delays),
    )
