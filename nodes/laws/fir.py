"""FIR: raw taps, for laws designed at tap level (``haptic study design``) rather than through a formula.

A designed law may have a recursive part beside its taps: sections, as every law of this package
compiles to.
"""

from __future__ import annotations

from typing import Annotated, ClassVar

import msgspec

from nodes.laws import CompiledLaw, Law
from nodes.laws.fields import MAX_TAPS


class RecursiveSection(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One recursive part of a law.

    b0, b1: Gains on the newest deflection and the one before it [N/m].
    a1, a2: Feedback of its last force and the one before it.
    """

    b0: float
    b1: float = 0.0
    a1: float
    a2: float = 0.0


class FIR(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """F[k] = Σ h_m x[k−m] with the taps as they are given, and recursive sections beside them where there are any.

    taps: h_0 ... h_n [N/m]. They were made for one sampling period; at another one they are another
        law.
    period: Sampling period that the taps were made for [s]. When given, the law refuses to run at
        any other.
    recursive: Parallel sections y = b0·x + b1·x₋₁ − a1·y₋₁ − a2·y₋₂, added to the taps.
    """

    kind: ClassVar[str] = "fir"
    taps: Annotated[tuple[float, ...], msgspec.Meta(min_length=1, max_length=MAX_TAPS)]
    period: Annotated[float, msgspec.Meta(gt=0.0)] | None = None
    recursive: Annotated[tuple[RecursiveSection, ...], msgspec.Meta(max_length=8)] | None = None

    def compile(self, period: float) -> CompiledLaw:
        """Hand out the taps."""
        if self.period is not None and abs(period / self.period - 1.0) > 1e-6:
            raise ValueError(
                f"period: these taps were made for T = {self.period:g} s and the loop runs at T ="
                f" {period:g} s; run at rate {1.0 / self.period:g} Hz or design the law again for"
                " this period"
            )
        return CompiledLaw(
            self.taps, tuple((part.b0, part.b1, part.a1, part.a2) for part in self.recursive or ())
        )
