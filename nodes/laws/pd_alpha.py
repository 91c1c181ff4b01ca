"""PDα: spring and one fractional derivative (paper, eq. 6)."""

from __future__ import annotations

from typing import Any, ClassVar

from nodes.laws import CompiledLaw, Law
from nodes.laws.derivatives import realise
from nodes.laws.fields import Damping, Gains, Order, Stiffness, Taps, term_gain


class PDAlpha(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """F = K x + B_α D^α x.

    stiffness: Nominal K [N/m]. The stiffness at rest is H(1) = K + B_α·D(1), because a truncated
        derivative leaks (THEORY.md §1).
    damping: B_α: [N s^α/m] with physical gains, else [N s/m].
    order: α, 0 < α < 4.
    taps: Length of the derivative's tap vector; the paper's FIR order n is ``taps`` − 1.
    gains: Unit of `damping`, see `nodes.laws.fields.term_gain`; no default, because the units
        differ by (T/2)^(α−1).
    derivative: Registered realisation of D^α (entry points ``haptic.derivatives``).
    """

    kind: ClassVar[str] = "pd_alpha"
    example: ClassVar[dict[str, Any]] = {
        "stiffness": 1000.0,
        "damping": 3.0,
        "order": 1.2,
        "taps": 10,
        "gains": "paper",
    }
    stiffness: Stiffness
    damping: Damping
    order: Order
    taps: Taps
    gains: Gains
    derivative: str = "gl"

    def compile(self, period: float) -> CompiledLaw:
        """Return the taps and sections."""
        gain = term_gain(self.damping, self.order, self.gains, period, self.taps)
        unit = realise(self.derivative, self.order, self.taps, period)
        return combine(self.stiffness, [(gain, unit)])


def combine(stiffness: float, terms: list[tuple[float, CompiledLaw]]) -> CompiledLaw:
    """Return the sum of a spring and weighted derivatives as one law."""
    taps = [0.0] * max([1, *(len(unit.taps) for _, unit in terms)])
    sections = []
    for gain, unit in terms:
        for m, tap in enumerate(unit.taps):
            taps[m] += gain * tap
        sections += [(gain * b0, gain * b1, a1, a2) for b0, b1, a1, a2 in unit.sections]
    taps[0] += stiffness
    return CompiledLaw(tuple(taps), tuple(sections))
