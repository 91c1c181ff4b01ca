"""Fractional standard linear solid: a spring beside an arm that relaxes; Kelvin and Voigt's and Maxwell's are within it.

The arm is a spring in series with a fractional damper: τ^α D^α of its force is felt back. Without relaxation the law is
`pd_alpha` (Kelvin–Voigt); with order 1 the arm is a velocity behind a filter; without the spring it is Maxwell's, which bears
nothing for ever.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec

from nodes.laws import CompiledLaw, Law
from nodes.laws.derivatives.gl import coefficients
from nodes.laws.fields import Damping, Taps


class FractionalSLS(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """F = K x + A, A + τ^α D^α A = B_α D^α x, with D^α by Grünwald and Letnikov's sum (THEORY.md §16).

    stiffness: K of the spring [N/m]; 0 for a Maxwell element alone.
    damping: B_α of the arm [N s^α/m]; at high frequency the arm is a spring of B_α/τ^α.
    order: α, 0 < α ≤ 1.
    relaxation: τ [s].
    taps: Length of the arm's response that is kept, n + 1: a short memory, whose end leaks.
    """

    kind: ClassVar[str] = "fractional_sls"
    stiffness: Annotated[float, msgspec.Meta(ge=0.0)]
    damping: Damping
    order: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]
    relaxation: Annotated[float, msgspec.Meta(gt=0.0)]
    taps: Taps

    def compile(self, period: float) -> CompiledLaw:
        """Turn the parameters into taps: the quotient of two power series."""
        share = (self.relaxation / period) ** self.order
        series = coefficients(self.order, self.taps)
        arm: list[float] = []  # with G = (1 − w)^α the arm is (B_α/τ^α) c G/(1 + c G), c = (τ/T)^α
        for m, g in enumerate(series):
            felt = sum(series[j] * arm[m - j] for j in range(1, m + 1))
            arm.append(share * (g - felt) / (1.0 + share))
        spring = self.damping / self.relaxation**self.order
        taps = [spring * one for one in arm]
        taps[0] += self.stiffness
        return CompiledLaw(tuple(taps))
