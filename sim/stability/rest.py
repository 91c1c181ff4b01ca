"""Friction that stops limit cycles on a wall seen through an encoder.

The encoder's error, at most half a step Δ, passes through the law and becomes a force that may
drive the device for ever (a limit cycle, felt as buzz). Coulomb friction f_c dissipates more than
that force supplies if it exceeds the force (THEORY.md §5). There are two bounds and an estimate,
which is no bound: small oscillations below one encoder step persist at 1.5 times its friction.

- any motion: f_c ≥ (Δ/2) Σ|h_m|. This is a proof if the law itself is passive on the device's
  damping;
- alternation: f_c ≥ Δ |H(−1)|/2, for motion across one encoder edge and back every tick (Abbott and
  Okamura 2005 for a spring);
- describing function: the oscillation across one edge at the frequency that the known device allows
  (Diolaiti et al. 2006).
"""

from __future__ import annotations

import cmath
import math
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from nodes.stability.effective_damping import damping_needed
from nodes.stability.plant import Plant

if TYPE_CHECKING:
    from nodes.laws import CompiledLaw

_POINTS = 2000


class ComesToRest(StrEnum):
    """Whether a friction is enough for rest."""

    PROVEN = "proven"
    ESTIMATED = "estimated"  # at least the estimate, which may err either way
    NOT_PROVEN = "not_proven"


@dataclass(frozen=True)
class Rest:
    """Friction with which a device comes to rest on a law, in three ways."""

    # bound of the error's force: with at least this friction no motion persists [N]
    friction_bound_n: float
    # whether that is a proof: the law, without the encoder, is passive on the device's damping
    certain: bool
    # no tick-by-tick chatter across one encoder edge with at least this friction [N]
    friction_alternating_n: float
    # no oscillation of a known device across one edge, by describing function [N]; an estimate that
    # may err either way; None without a mass
    friction_estimated_n: float | None
    buzz_hz: float | None  # frequency of that oscillation [Hz]; None if there is none

    def free(self, friction: float) -> ComesToRest:
        """Return whether Coulomb friction [N] keeps the device at rest."""
        if friction >= self.friction_bound_n:
            return ComesToRest.PROVEN if self.certain else ComesToRest.ESTIMATED
        known = self.friction_estimated_n
        enough = known is not None and friction >= known
        return ComesToRest.ESTIMATED if enough else ComesToRest.NOT_PROVEN

    def text(self) -> str:
        """Return the frictions as text."""
        kind = (
            "proof"
            if self.certain
            else "no proof: the law is not passive on this damping"
        )
        guess = (
            ""
            if self.friction_estimated_n is None
            else f"; estimate, no bound: {self.friction_estimated_n:.4g} N"
        )
        return (
            f"every motion stops with friction from {self.friction_bound_n:.4g} N ({kind}){guess}"
            " (THEORY.md §5)"
        )


def rest(law: CompiledLaw, loop: Plant | float, resolution: float) -> Rest:
    """Return the friction with which a law comes to rest; a period [s] gives no estimate."""
    # the estimate needs a single body of mass, damping and stiffness
    plant = loop if isinstance(loop, Plant) and loop.partner is None else None
    period, damping, delay = (
        (loop.period, loop.damping, loop.delay)
        if isinstance(loop, Plant)
        else (loop, 0.0, 0.0)
    )
    estimated, buzz = (
        (None, None) if plant is None else _describing(law, plant, resolution)
    )
    return Rest(
        friction_bound_n=0.5 * resolution * absolute_sum(law),
        certain=damping_needed(law, period, delay) <= damping,
        friction_alternating_n=0.5 * resolution * abs(law.h_nyquist),
        friction_estimated_n=estimated,
        buzz_hz=buzz,
    )


def stiffest_at_rest(
    derivative: CompiledLaw, resolution: float, friction: float
) -> float:
    """Return the largest nominal stiffness with Σ|h_m| ≤ 2 f_c/Δ [N/m].

    For PD it is 2 f_c/Δ − 2B/T. It is negative if D alone needs more friction.
    """
    newest = derivative.taps[0] + sum(b0 for b0, *_ in derivative.sections)
    return (
        2.0 * friction / resolution - (absolute_sum(derivative) - abs(newest)) - newest
    )


def absolute_sum(law: CompiledLaw) -> float:
    """Return Σ|h_m|, the largest force per deflection [N/m]; for PD H(−1).

    Sections are summed until the rest is below rounding.
    """
    if not law.sections:
        return sum(map(abs, law.taps))
    total, settled = 0.0, 0
    state = [[0.0, 0.0] for _ in law.sections]
    for k in range(1_000_000):
        value = law.taps[k] if k < len(law.taps) else 0.0
        for (b0, b1, a1, a2), y in zip(law.sections, state, strict=True):
            new = (b0 if k == 0 else b1 if k == 1 else 0.0) - a1 * y[0] - a2 * y[1]
            y[1], y[0] = y[0], new
            value += new
        total += abs(value)
        settled = settled + 1 if abs(value) < 1e-12 * total else 0
        if settled > 100 and k >= len(law.taps):
            break
    return total


def _describing(
    law: CompiledLaw, plant: Plant, resolution: float
) -> tuple[float, float | None]:
    """Return the largest f_c at which an oscillation across one edge balances; its frequency.

    The encoder is a relay of Δ/2, friction a relay of f_c against the velocity. With amplitude A at
    ω: (k − m ω²) A + (2Δ/π) Re G = 0 and ω b A + 4 f_c/π + (2Δ/π) Im G = 0, G the law with its hold
    and delay, k the hand's stiffness.
    """
    best, at = 0.0, None
    for i in range(1, _POINTS + 1):
        theta = math.pi * i / _POINTS
        half = 0.5 * theta
        late = cmath.exp(-1j * theta * (plant.delay + 0.5)) * math.sin(half) / half
        g = law.response(cmath.exp(1j * theta)) * late
        omega = theta / plant.period
        inertia = plant.mass * omega * omega - plant.stiffness
        if g.real * inertia <= 0.0:
            continue
        friction = (
            0.5 * resolution * (-g.imag - plant.damping * omega / inertia * g.real)
        )
        if friction > best:
            best, at = friction, omega / (2.0 * math.pi)
    return best, at
