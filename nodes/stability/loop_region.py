"""The region in which device and world lie at each frequency, and the stiffness it allows.

Deflection x = p − y, force F = H x. The device answers p = −P F, the world D' y = V F, with D' = 1
− w and w = exp(−jωT). The loop oscillates at ω iff D'/H + D' P + V = 0. The unknown parts of P and
V form a region of the complex plane:

- a device of damping b in any hand, its force held and late by d = i + φ ticks: a disc of radius
  T/2b about ψ T/2b with ψ = (1 − φ) w^(1+i) + φ w^(2+i), aliases included. A stepped tool with
  anything passive attached is another disc;
- any passive world that answers the force in the same tick: the half plane Re V ≥ 0.

Discs add up. With H = K + h, the loop is outside the region iff a quadratic inequality in K holds
at each frequency (THEORY.md §18), so one search serves all certificates
(`nodes.stability.k_window`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.stability.dips import Reals
from nodes.stability.plant import Plant, held_step
from nodes.stability.resonances import resonances

Complexes = NDArray[np.complex128]


@dataclass(frozen=True)
class Disc:
    """Everything passive that a held, late force moves against one damper."""

    radius: float | Callable[[Reals], Reals]  # T/2b, or a function of ωT [m/N]
    delay: float  # of the force, whole or fractional [ticks]
    # Weights [1] and lags [rad] of ψ at each frequency, where aliases have discs of their own size;
    # None: as of `lags`.
    aliases: Callable[[Reals], list[tuple[Reals, Reals]]] | None = None

    @property
    def lags(self) -> tuple[tuple[int, float], ...]:
        """Whole lags [ticks] and their weights [1], whose sum is ψ."""
        whole = math.floor(self.delay)
        late = self.delay - whole
        return (
            ((whole + 1, 1.0),)
            if late == 0.0
            else ((whole + 1, 1.0 - late), (whole + 2, late))
        )

    def parts(self, theta: Reals) -> list[tuple[Reals, Reals]]:
        """Return weights [1] and lags [rad] of which ψ is the sum at each frequency."""
        if self.aliases is not None:
            return self.aliases(theta)
        return [
            (np.full(theta.shape, weight), lag * theta) for lag, weight in self.lags
        ]

    def turn(self, theta: Reals) -> Complexes:
        """Return ψ, the centre of the disc over its radius."""
        total = np.zeros(theta.shape, dtype=np.complex128)
        for weight, lag in self.parts(theta):
            total += weight * np.exp(-1j * lag)
        return total

    def radii(self, theta: Reals) -> Reals:
        """Return the radius at each frequency [m/N]."""
        return (
            self.radius(theta)
            if callable(self.radius)
            else np.full(theta.shape, self.radius)
        )


@dataclass(frozen=True)
class Region:
    """Region of D'P + V: a known device or none, discs, and the half plane of implicit worlds."""

    period: float  # sampling period [s]
    known: Plant | None  # device of known mass, damping and hand
    discs: tuple[Disc, ...] = ()
    # whether every passive world that answers in the same tick is included
    any_world: bool = False

    def quadratic(
        self, derivative: CompiledLaw, theta: Reals
    ) -> tuple[Reals, Reals, Reals]:
        """Return a, b, c of a K² + b K + c > 0, which holds iff K + h is outside the region.

        Each is accurate relative to its own size at small frequencies, because differences of
        numbers near 1 are written as sines.
        """
        w = np.exp(-1j * theta)
        step = 2.0 * np.sin(0.5 * theta) ** 2 + 1j * np.sin(theta)  # D' = 1 − w
        h = derivative.response(1.0 / w)
        known = (
            np.zeros_like(w) if self.known is None else known_answer(self.known, theta)
        )
        centre = known.copy()
        for disc in self.discs:
            centre += disc.radii(theta) * disc.turn(theta)
        turned = np.conj(step) * centre
        if self.any_world:
            # Re{D'/H} + Re centre − radius > 0, times |H|²
            room = known.real - sum(
                (disc.radii(theta) * _short_of_one(disc, theta) for disc in self.discs),
                np.zeros_like(theta),
            )
            return (
                room,
                2.0 * room * h.real + step.real,
                room * np.abs(h) ** 2 + (np.conj(step) * h).real,
            )
        # |D'/H + centre|² − radius² > 0, times |H|²
        room = (
            np.abs(known) ** 2
            + 2.0 * (np.conj(known) * (centre - known)).real
            - sum(
                (
                    one.radii(theta) * other.radii(theta) * _apart(one, other, theta)
                    for one in self.discs
                    for other in self.discs
                ),
                np.zeros_like(theta),
            )
        )
        linear = 2.0 * turned.real
        return (
            room,
            2.0 * room * h.real + linear,
            room * np.abs(h) ** 2 + 2.0 * (turned * h).real + np.abs(step) ** 2,
        )

    def grown(
        self, law: CompiledLaw, disc: Disc, theta: Reals
    ) -> tuple[Reals, Reals, Reals]:
        """Return a, b, c of a r² + 2 b r + c > 0, which holds iff a law stays outside.

        The region is that of the discs plus one more of radius r, with the lags of `disc`; only for
        a region without the half plane of worlds.
        """
        w = np.exp(-1j * theta)
        h = law.response(1.0 / w)
        step = 2.0 * np.sin(0.5 * theta) ** 2 + 1j * np.sin(theta)
        psi = disc.turn(theta)
        known = (
            np.zeros_like(w) if self.known is None else known_answer(self.known, theta)
        )
        near = (np.conj(psi) * (step / h + known)).real
        for one in self.discs:
            near = near - one.radii(theta) * _apart(one, disc, theta)
        return (
            -_apart(disc, disc, theta),
            near,
            self.quadratic(law, theta)[2] / np.abs(h) ** 2,
        )

    def frequencies(self, law: CompiledLaw) -> Reals:
        """Return frequencies ωT in (0, π] that resolve every turn of region and law [rad]."""
        longest = max(
            [
                0.0 if self.known is None else self.known.delay,
                *(disc.delay for disc in self.discs),
            ]
        )
        turns = 16 * (len(law.taps) + math.ceil(longest) + 8)
        parts = [np.linspace(0.0, math.pi, turns + 1)[1:]]
        lowest = 1e-6
        if self.known is not None:
            corner = self.known.damping * self.period / self.known.mass
            lowest = min(lowest, max(1e-3 * corner, 1e-9))
            if self.known.stiffness > 0.0:
                # Hand and mass resonate, in a band that may be narrow.
                rings = self.period * math.sqrt(self.known.stiffness / self.known.mass)
                around = np.geomspace(1e-6, 0.5, 60)
                parts.append(
                    rings * np.concatenate([1.0 - around, [1.0], 1.0 + around])
                )
        parts += [
            np.geomspace(lowest, math.pi, 2001 if law.sections else 801),
            resonances(law),
        ]
        grid = np.unique(np.concatenate(parts))
        return np.asarray(grid[(grid > 0.0) & (grid <= math.pi)], dtype=np.float64)


def known_answer(plant: Plant, theta: Reals) -> Complexes:
    """Return D'P of a known device, force held and late [m/N].

    Without a hand the pole at z = 1 is cancelled exactly.
    """
    whole, (a11, a12, a21, a22), new, old = held_step(plant)
    w = np.exp(-1j * theta)
    position = new[0] + w * old[0]
    speed = new[1] + w * old[1]
    ahead = -2.0 * np.sin(0.5 * theta) ** 2 + 1j * np.sin(theta)  # z − 1
    top = (ahead + (1.0 - a22)) * position + a12 * speed
    if plant.stiffness == 0.0:
        return np.asarray(
            w ** (whole + 1) * top / (ahead + (1.0 - a22)), dtype=np.complex128
        )
    below = (ahead + (1.0 - a11)) * (ahead + (1.0 - a22)) - a12 * a21
    return np.asarray(w ** (whole + 1) * ahead * top / below, dtype=np.complex128)


def _short_of_one(disc: Disc, theta: Reals) -> Reals:
    """Return 1 − Re ψ, as sines."""
    return np.asarray(
        sum(2.0 * weight * np.sin(0.5 * lag) ** 2 for weight, lag in disc.parts(theta)),
        dtype=np.float64,
    )


def _apart(one: Disc, other: Disc, theta: Reals) -> Reals:
    """Return 1 − Re{ψ₁ ψ₂*} as sines: 0 if both have the same whole delay."""
    total = np.zeros_like(theta)
    for weight, lag in one.parts(theta):
        for share, late in other.parts(theta):
            total += 2.0 * weight * share * np.sin(0.5 * (lag - late)) ** 2
    return total
