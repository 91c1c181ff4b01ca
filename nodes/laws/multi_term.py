"""Multi-term law: spring and a sum of fractional derivatives (paper, eq. 10)."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import msgspec

from nodes.laws import CompiledLaw, Law
from nodes.laws.derivatives import realise
from nodes.laws.fields import Damping, Gains, Order, Stiffness, Taps, term_gain
from nodes.laws.pd_alpha import combine


class Term(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One fractional term A_i D^{α_i}.

    gain: A_i, of either sign: [s^(α−1)] with physical gains, dimensionless with the others.
    order: α_i, 0 < α_i < 4.
    """

    gain: float
    order: Order


class MultiTerm(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """F = K x + B Σ_i A_i D^{α_i} x.

    stiffness: Nominal K [N/m]; the stiffness at rest is H(1) (THEORY.md §1).
    damping: B, common to all terms [N s/m].
    terms: Gains and orders, at least one term.
    taps: Length of each derivative's tap vector; the paper's FIR order n is ``taps`` − 1.
    gains: Unit of the terms' gains, see `nodes.laws.fields.term_gain`; no default, because the
        units differ by (T/2)^(α−1) per term.
    derivative: Registered realisation of D^α (entry points ``haptic.derivatives``).
    """

    kind: ClassVar[str] = "multi_term"
    example: ClassVar[dict[str, Any]] = {
        "stiffness": 1000.0,
        "damping": 3.0,
        "terms": [{"gain": 1.69, "order": 1.5}, {"gain": 1.32, "order": 3.47}],
        "taps": 4,
        "gains": "paper",
    }
    stiffness: Stiffness
    damping: Damping
    terms: Annotated[tuple[Term, ...], msgspec.Meta(min_length=1)]
    taps: Taps
    gains: Gains
    derivative: str = "gl"

    def compile(self, period: float) -> CompiledLaw:
        """Return the taps and sections."""
        gains = (
            self.damping
            * term_gain(term.gain, term.order, self.gains, period, self.taps)
            for term in self.terms
        )
        units = (
            realise(self.derivative, term.order, self.taps, period)
            for term in self.terms
        )
        return combine(self.stiffness, list(zip(gains, units, strict=True)))
