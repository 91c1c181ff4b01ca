"""Fractional standard linear solid: a spring parallel to a relaxing arm.

The arm is a spring in series with a fractional damper. Special cases are `pd_alpha` (Kelvin–Voigt,
without relaxation), a filtered velocity (order 1) and a Maxwell element (without the spring), which
supports no permanent load. With full memory the arm is a sum of exponentials
(`nodes.laws.derivatives.relaxation`) and relaxes completely.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import msgspec

from nodes.laws import CompiledLaw, Law
from nodes.laws.derivatives.relaxation import relaxation, step_answer
from nodes.laws.fields import Damping, Taps


class FractionalSLS(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """F = K x + A, A + τ^α D^α A = B_α D^α x, with the Grünwald–Letnikov D^α (THEORY.md §16).

    stiffness: K of the spring [N/m]; 0 for a Maxwell element alone.
    damping: B_α of the arm [N s^α/m]; at high frequency the arm is a spring of B_α/τ^α.
    order: α, 0 < α ≤ 1.
    relaxation: τ [s].
    taps: Length of a short memory, n + 1 deflections; its truncation leaks, so H(1) is not K. None:
        full memory, which relaxes.
    """

    kind: ClassVar[str] = "fractional_sls"
    example: ClassVar[dict[str, Any]] = {
        "stiffness": 900.0,
        "damping": 8.0,
        "order": 0.6,
        "relaxation": 0.004,
    }
    stiffness: Annotated[float, msgspec.Meta(ge=0.0)]
    damping: Damping
    order: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]
    relaxation: Annotated[float, msgspec.Meta(gt=0.0)]
    taps: Taps | None = None

    def compile(self, period: float) -> CompiledLaw:
        """Return taps and sections: none with short memory, one at order 1, else up to twelve."""
        spring = self.damping / self.relaxation**self.order
        if self.taps is not None:
            answer = step_answer(
                self.order, (self.relaxation / period) ** self.order, self.taps
            )
            arm = [
                spring * (now - before)
                for now, before in zip(answer, [0.0, *answer], strict=False)
            ]
            return CompiledLaw((arm[0] + self.stiffness, *arm[1:]))
        whole = relaxation(self.order, self.relaxation, period)
        taps = [spring * tap for tap in whole.taps]
        sections = [
            (spring * b0, spring * b1, a1, a2) for b0, b1, a1, a2 in whole.sections
        ]
        return CompiledLaw((taps[0] + self.stiffness, *taps[1:]), tuple(sections))
