"""Fractional standard linear solid: a spring beside an arm that relaxes; Kelvin and Voigt's and Maxwell's are within it.

The arm is a spring in series with a fractional damper: τ^α D^α of its force is felt back. Without
relaxation the law is `pd_alpha` (Kelvin–Voigt); with order 1 the arm is a velocity behind a filter;
without the spring it is Maxwell's, which bears nothing for ever. With its whole memory the arm is a
sum of exponentials (`nodes.laws.derivatives.relaxation`), and relaxes.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec

from nodes.laws import CompiledLaw, Law
from nodes.laws.derivatives.relaxation import relaxation, step_answer
from nodes.laws.fields import Damping, Taps


class FractionalSLS(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """F = K x + A, A + τ^α D^α A = B_α D^α x, with D^α by Grünwald and Letnikov's sum (THEORY.md §16).

    stiffness: K of the spring [N/m]; 0 for a Maxwell element alone.
    damping: B_α of the arm [N s^α/m]; at high frequency the arm is a spring of B_α/τ^α.
    order: α, 0 < α ≤ 1.
    relaxation: τ [s].
    taps: Length of a short memory, n + 1 deflections: its end leaks, H(1) is not K. None: the whole
        memory, which relaxes.
    """

    kind: ClassVar[str] = "fractional_sls"
    stiffness: Annotated[float, msgspec.Meta(ge=0.0)]
    damping: Damping
    order: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]
    relaxation: Annotated[float, msgspec.Meta(gt=0.0)]
    taps: Taps | None = None

    def compile(self, period: float) -> CompiledLaw:
        """Turn the parameters into taps and sections: one section at order 1, eleven below it, none for a short memory."""
        spring = self.damping / self.relaxation**self.order
        if self.taps is not None:
            answer = step_answer(self.order, (self.relaxation / period) ** self.order, self.taps)
            arm = [
                spring * (now - before) for now, before in zip(answer, [0.0, *answer], strict=False)
            ]
            return CompiledLaw((arm[0] + self.stiffness, *arm[1:]))
        whole = relaxation(self.order, self.relaxation, period)
        taps = [spring * tap for tap in whole.taps]
        sections = [(spring * b0, spring * b1, a1, a2) for b0, b1, a1, a2 in whole.sections]
        return CompiledLaw((taps[0] + self.stiffness, *taps[1:]), tuple(sections))
