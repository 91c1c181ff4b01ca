"""PD with low-pass filtered velocity, as most haptic software renders it."""

from __future__ import annotations

import math
from typing import Annotated, Any, ClassVar

import msgspec

from nodes.laws.base import CompiledLaw, Law
from nodes.laws.fields import Damping, Stiffness


class PDFiltered(Law, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """F = K x + B v, v[k] = a v[k−1] + (1−a)(x[k] − x[k−1])/T, a = exp(−2π·cutoff·T).

    See THEORY.md §14.

    stiffness: K, also at rest [N/m].
    damping: B [N s/m].
    cutoff: Cut-off frequency of the low-pass [Hz]; far above the loop's rate the law is plain PD.
    """

    kind: ClassVar[str] = "pd_filtered"
    example: ClassVar[dict[str, Any]] = {
        "stiffness": 1000.0,
        "damping": 3.0,
        "cutoff": 100.0,
    }
    stiffness: Stiffness
    damping: Damping
    cutoff: Annotated[float, msgspec.Meta(gt=0.0)]

    def compile(self, period: float) -> CompiledLaw:
        """Return one tap and one section."""
        pole = math.exp(-2.0 * math.pi * self.cutoff * period)
        gain = self.damping * (1.0 - pole) / period
        return CompiledLaw((self.stiffness,), ((gain, -gain, -pole, 0.0),))
