"""FIR: raw taps, for laws designed at tap level (``haptic study design``).

A designed law may have recursive sections besides its taps, like every compiled law.
"""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import msgspec

from nodes.laws import CompiledLaw, Law
from nodes.laws.fields import MAX_TAPS
from nodes.parameters.store import ParameterError


class RecursiveSection(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """One recursive section of a law.

    b0, b1: Gains on the newest deflection and the one before it [N/m].
    a1, a2: Feedback of the section's last force and the one before it.
    """

    b0: float
    b1: float = 0.0
    a1: float
    a2: float = 0.0


class FIR(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """F[k] = Σ h_m x[k−m] with the given taps, plus recursive sections if any.

    taps: h_0 ... h_n [N/m]. They are designed for one sampling period; at another the law differs.
    period: Sampling period that the taps were designed for [s]. If given, the law refuses any
        other.
    recursive: Parallel sections y = b0·x + b1·x₋₁ − a1·y₋₁ − a2·y₋₂, added to the taps.
    """

    kind: ClassVar[str] = "fir"
    example: ClassVar[dict[str, Any]] = {"taps": [2500.0, -1500.0], "period": 0.002}
    taps: Annotated[tuple[float, ...], msgspec.Meta(min_length=1, max_length=MAX_TAPS)]
    period: Annotated[float, msgspec.Meta(gt=0.0)] | None = None
    recursive: (
        Annotated[tuple[RecursiveSection, ...], msgspec.Meta(max_length=8)] | None
    ) = None

    def compile(self, period: float) -> CompiledLaw:
        """Return taps and sections as given."""
        if self.period is not None and abs(period / self.period - 1.0) > 1e-6:
            raise ParameterError(
                f"these taps were made for T = {self.period:g} s and the loop runs at T ="
                f" {period:g} s; run at rate {1.0 / self.period:g} Hz or design the law again for"
                " this period",
                path="period",
            )
        return CompiledLaw(
            self.taps,
            tuple(
                (part.b0, part.b1, part.a1, part.a2) for part in self.recursive or ()
            ),
        )
