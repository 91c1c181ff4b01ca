"""The oscillation at the edge of stability: Colgate's condition at one frequency is exact.

At the edge z = exp(jω_c T) is a pole, so law and held device balance: H(z) z^{−d} = −1/P(z). The
real part of that over 1 − z is Colgate's condition at this one frequency, with the device's damping
as the held device shows it there (THEORY.md §9):

    K_max = 2 (b R(ω_c) − f(ω_c))/T,    R = 1 + tan²(ω_c T/2)/3 for light damping,

exactly. Without R, K ≈ 2 (b − f(ω_c))/T is always low, and needs no mass, only the visible
oscillation.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass, replace
from typing import Any

from nodes.laws import CompiledLaw
from nodes.stability.plant import Plant, held_plant


@dataclass(frozen=True)
class Edge:
    """A loop at its edge of stability."""

    # ω_c, the frequency of oscillation [rad/s]; 0 if the loop drifts instead
    omega_rad_per_s: float
    # f(ω_c) of the law with the loop's delay, nominal K as the spring [N s/m]
    f_n_s_per_m: float
    damping_factor: float  # R(ω_c), damping shown by the held device over b
    k_simple_n_per_m: float  # 2 (b − f(ω_c))/T, Colgate's condition at ω_c alone [N/m]
    k_exact_n_per_m: float  # 2 (b R − f(ω_c))/T, K_max itself [N/m]


def damping_shown(plant: Plant, theta: float) -> float:
    """Return the damping b R that a held device shows at ωT [N s/m]: T Re{−1/((1 − z) P(z))}.

    For light damping it is b (1 + tan²(ωT/2)/3).
    """
    z = cmath.exp(1j * theta)
    shown: complex = -1.0 / (
        (1.0 - z) * position_over_force(z, replace(plant, delay=0.0))
    )
    return plant.period * shown.real


def edge_at(
    derivative: CompiledLaw, plant: Plant, omega: float, light: bool = False
) -> Edge:
    """Return what Colgate's condition allows at one frequency [rad/s].

    With `light`, b ≪ m/T is assumed and the mass is not used.
    """
    period, damping = plant.period, plant.damping
    theta = omega * period
    if not 0.0 < theta < math.pi:
        raise ValueError(
            f"omega = {omega:g} rad/s: must be between 0 and {math.pi / period:g} rad/s, the"
            " Nyquist frequency"
        )
    z = cmath.exp(1j * theta)
    whole = math.floor(plant.delay)
    late = z**-whole
    if plant.delay > whole:
        # A fraction of a tick splits the hold; for a free, light device that is the delay's own
        # response.
        body = replace(plant, mass=1.0, damping=0.0) if light else plant
        late *= position_over_force(
            z, replace(body, delay=plant.delay - whole)
        ) / position_over_force(z, replace(body, delay=0.0))
    # D late + K (late − 1): contribution of law and delay beyond the spring K/2, linear in K.
    by_law = period * (derivative.response(z) * late / (1.0 - z)).real
    by_spring = period * (late / (1.0 - z)).real
    if light:
        factor = 1.0 + math.tan(0.5 * theta) ** 2 / 3.0
    else:
        factor = damping_shown(plant, theta) / damping if damping > 0.0 else 1.0
    simple, exact = ((damping * r - by_law) / by_spring for r in (1.0, factor))
    return Edge(
        omega, by_law + exact * (by_spring - 0.5 * period), factor, simple, exact
    )


def position_over_force(z: Any, plant: Plant) -> Any:
    """Return P(z), the response of the held device to a force, with its delay [m/N].

    Of a pair it is that of the distance between both.
    """
    if plant.other is not None:
        return position_over_force(
            z, replace(plant, partner=None)
        ) + position_over_force(z, plant.other)
    held = held_plant(plant)
    n2, n1, n0 = held.numerator
    _, d1, d0 = held.denominator
    top = (n2 * z + n1) * z + n0
    bottom = (z + d1) * z + d0
    return top / (z ** (held.whole + 1) * bottom)
