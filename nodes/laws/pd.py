"""PD: spring and damper (paper, eq. 1)."""

from __future__ import annotations

from typing import Any, ClassVar

from nodes.laws import CompiledLaw, Law
from nodes.parameters.checked import NonNegative, Positive


class PD(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """F = K x + B dx/dt with the backward difference, taps [K + B/T, −B/T].

    stiffness: K [N/m].
    damping: B [N s/m].
    """

    kind: ClassVar[str] = "pd"
    example: ClassVar[dict[str, Any]] = {"stiffness": 1000.0, "damping": 3.0}
    stiffness: Positive
    damping: NonNegative = 0.0

    def compile(self, period: float) -> CompiledLaw:
        """Return the taps."""
        return CompiledLaw(
            (self.stiffness + self.damping / period, -self.damping / period)
        )
