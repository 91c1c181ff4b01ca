"""The frequency that occurs: at the edge of stability a known device rings at one ω_c, and passivity there is all it takes.

On the edge z = exp(jω_c T) is a pole, so law and held device balance: H(z) z^{−d} = −1/P(z). The real part of that over 1 − z
is Colgate's condition at this one frequency, with the device's damping as the held device shows it there (THEORY.md §9):

    K_max = 2 (b R(ω_c) − f(ω_c))/T,    R = 1 + tan²(ω_c T/2)/3 for light damping,

exactly. Leaving R out, K ≈ 2 (b − f(ω_c))/T is always low, and needs no mass: only the swing that one can see.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass

from nodes.laws import CompiledLaw
from nodes.stability.held_plant import held_plant

__all__ = [
    "Edge",
    "damping_shown",
    "edge_at",
]


@dataclass(frozen=True)
class Edge:
    """What a loop does at its edge of stability.

    Attributes
    ----------
    omega_rad_per_s : float
        ω_c, the frequency that occurs [rad/s]; 0 where the loop drifts rather than rings.
    f_n_s_per_m : float
        f(ω_c) of the law with the loop's delay, nominal K taken as the spring [N s/m].
    damping_factor : float
        R(ω_c): by how much the held device damps more than b.
    k_simple_n_per_m : float
        2 (b − f(ω_c))/T, Colgate's condition at ω_c alone [N/m].
    k_exact_n_per_m : float
        2 (b R − f(ω_c))/T: K_max itself [N/m].
    """

    omega_rad_per_s: float
    f_n_s_per_m: float
    damping_factor: float
    k_simple_n_per_m: float
    k_exact_n_per_m: float


def damping_shown(theta: float, period: float, mass: float, damping: float, stiffness: float = 0.0) -> float:
    """Damping that a held device shows at one frequency: T Re{−1/((1 − z) P(z))}.

    Parameters
    ----------
    theta : float
        ωT, 0 < ωT < π.
    period : float
        Sampling period T [s].
    mass, damping, stiffness : float
        Device and hand [kg], [N s/m], [N/m].

    Returns
    -------
    float
        b R [N s/m]; for k = 0 and light damping b (1 + tan²(ωT/2)/3).
    """
    z = cmath.exp(1j * theta)
    return period * (-1.0 / ((1.0 - z) * _held(z, period, mass, damping, 0.0, stiffness))).real


def edge_at(
    derivative: CompiledLaw,
    period: float,
    omega: float,
    damping: float,
    mass: float | None = None,
    delay: float = 0.0,
    stiffness: float = 0.0,
) -> Edge:
    """Tell the stiffness that Colgate's condition allows at one frequency.

    Parameters
    ----------
    derivative : CompiledLaw
        Derivative part D of the law.
    period : float
        Sampling period T [s].
    omega : float
        Frequency at which the device swings, 0 < ω < π/T [rad/s].
    damping : float
        b [N s/m].
    mass : float or None
        m [kg]; only the exact figure needs it. None takes the light device, R = 1 + tan²(ωT/2)/3.
    delay : float
        Whole or fractional delay [ticks].
    stiffness : float
        Of a hand [N/m].

    Returns
    -------
    Edge
        The figures.

    Raises
    ------
    ValueError
        When the frequency is not between 0 and Nyquist.
    """
    theta = omega * period
    if not 0.0 < theta < math.pi:
        raise ValueError(
            f"omega = {omega:g} rad/s: must be between 0 and {math.pi / period:g} rad/s, the Nyquist frequency"
        )
    z = cmath.exp(1j * theta)
    whole = math.floor(delay)
    late = z**-whole
    if delay > whole:
        # A fraction of a tick splits the hold; of a free, light device that is the delay's own share of the response.
        body = (1.0 if mass is None else mass, 0.0 if mass is None else damping, stiffness)
        late *= _held(z, period, body[0], body[1], delay - whole, body[2]) / _held(
            z, period, body[0], body[1], 0.0, body[2]
        )
    # D late + K (late − 1): what law and delay do beside the spring K/2. It is linear in K, which is solved for.
    by_law = period * (derivative.response(z) * late / (1.0 - z)).real
    by_spring = period * (late / (1.0 - z)).real
    if mass is None:
        factor = 1.0 + math.tan(0.5 * theta) ** 2 / 3.0
    else:
        factor = damping_shown(theta, period, mass, damping, stiffness) / damping if damping > 0.0 else 1.0
    simple, exact = ((damping * r - by_law) / by_spring for r in (1.0, factor))
    return Edge(omega, by_law + exact * (by_spring - 0.5 * period), factor, simple, exact)


def _held(z: complex, period: float, mass: float, damping: float, delay: float, stiffness: float) -> complex:
    plant = held_plant(mass, damping, period, delay, stiffness)
    n2, n1, n0 = plant.numerator
    _, d1, d0 = plant.denominator
    return ((n2 * z + n1) * z + n0) / (z ** (plant.whole + 1) * ((z + d1) * z + d0))
