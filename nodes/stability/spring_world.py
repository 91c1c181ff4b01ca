"""A law against a spring that answers in the same tick, for every stiffness of a range.

The spring adds a compliance s to the device's response: 1/H + P + s = 0 at an oscillation. At a
fixed frequency its imaginary part is a quadratic equation in K that does not depend on s, and its
real part then gives s. All oscillations with springs of the range are therefore points on two
curves over the frequency; the window ends where such a point begins (THEORY.md §18).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.closed_loop import pole_radius
from nodes.stability.dips import Reals
from nodes.stability.judge import last_inside
from nodes.stability.k_max import with_spring
from nodes.stability.k_window import Window
from nodes.stability.loop_region import Complexes, Region, known_answer
from nodes.stability.plant import Plant
from nodes.stability.world_loop import Body, world_radius

_ZOOMS = 12


def spring_window(
    derivative: CompiledLaw, plant: Plant, softest: float, stiffest: float
) -> Window | None:
    """Return the lowest window of K above max(0, −D(1)) stable with every spring of a range.

    `softest`, `stiffest`: ends of the range [N/m]; an infinite `stiffest` includes the wall. None
    if there is no such window.
    """
    floor = max(0.0, -derivative.h1)
    swings = _Swings(derivative, plant, 1.0 / stiffest, 1.0 / softest)
    cuts = sorted(
        {
            (floor, 0.0),
            *(
                (k, theta)
                for k, theta in swings.cuts()
                if k > floor * (1.0 + 1e-9) + 1e-9
            ),
        }
    )
    inside: tuple[float, float] | None = None
    for i, (low, _) in enumerate(cuts):
        high = cuts[i + 1][0] if i + 1 < len(cuts) else math.inf
        if high <= low * (1.0 + 1e-12):
            continue
        middle = 0.5 * (low + high) if math.isfinite(high) else 2.0 * low + 1e3
        stable = stable_with_springs(
            with_spring(derivative, middle), plant, softest, stiffest
        )
        if stable and inside is None:
            inside = low, 0.0
        if not stable and inside is not None:
            return Window(inside[0], low, cuts[i][1])
    return None if inside is None else Window(inside[0], math.inf, math.pi)


def wall_swings(derivative: CompiledLaw, plant: Plant) -> list[tuple[float, float]]:
    """Return the K [N/m] and ωT at which the loop with a wall oscillates."""
    return _Swings(derivative, plant, 0.0, 0.0).cuts()


def stable_with_springs(
    law: CompiledLaw, plant: Plant, softest: float, stiffest: float
) -> bool:
    """Return whether the loop of a law is stable with every spring of a range."""
    newest = law.taps[0] + sum(b0 for b0, *_ in law.sections)
    if not (law.h1 > 0.0 and 1.0 + newest / softest > 0.0):
        return False
    try:
        radius = (
            world_radius(law, plant, Body(stiffness=stiffest))
            if math.isfinite(stiffest)
            else pole_radius(law, plant)
        )
    except ValueError:
        return False
    if radius >= 1.0:
        return False
    theta = Region(plant.period, plant).frequencies(law)

    def balance(at: Reals) -> Complexes:
        return np.asarray(
            1.0 / law.response(np.exp(1j * at)) + _answer(plant, at),
            dtype=np.complex128,
        )

    value = balance(theta)
    found = [float(value[-1].real)]  # z = −1 is always real
    found += [
        float(balance(np.array([at]))[0].real)
        for at in _real_at(balance, theta[:-1], value[:-1])
    ]
    return not any(1.0 / stiffest <= -real <= 1.0 / softest for real in found)


def _real_at(
    curve: Callable[[Reals], Complexes], theta: Reals, value: Complexes
) -> list[float]:
    """Return the ωT at which a curve crosses the real axis, by bisection between grid points."""
    above = value.imag >= 0.0
    found = []
    for i in np.flatnonzero(above[:-1] != above[1:]):

        def before(at: float, side: bool = bool(above[i])) -> bool:
            return bool(curve(np.array([at]))[0].imag >= 0.0) is side

        found.append(last_inside(before, float(theta[i]), float(theta[i + 1]), 60))
    return found


def _answer(plant: Plant, theta: Reals) -> Complexes:
    """Return P, position over force of the held device [m/N]."""
    return np.asarray(
        known_answer(plant, theta)
        / (2.0 * np.sin(0.5 * theta) ** 2 + 1j * np.sin(theta)),
        dtype=np.complex128,
    )


@dataclass(frozen=True)
class _Swings:
    """Stiffnesses and compliances with which the loop oscillates, over the frequency."""

    derivative: CompiledLaw
    plant: Plant
    least: float  # compliance [m/N]
    most: float

    def points(self, theta: Reals) -> tuple[Reals, Reals]:
        """Return K [N/m] and compliance [m/N] on both branches, shape (2, n); NaN if undefined."""
        h = self.derivative.response(np.exp(1j * theta))
        p = _answer(self.plant, theta)
        with np.errstate(invalid="ignore", divide="ignore"):
            root = np.sqrt(h.imag / p.imag - h.imag**2)
            k = np.stack([-h.real - root, -h.real + root])
            compliance = -(1.0 / (k + h) + p).real
        return k, compliance

    def cuts(self) -> list[tuple[float, float]]:
        """Return the K and ωT at which oscillations within the range begin or end."""
        theta = Region(self.plant.period, self.plant).frequencies(self.derivative)[:-1]
        found = [
            cut
            for end in (self.least, self.most)
            if math.isfinite(end)
            for cut in self._ends(theta, end)
        ]
        h = self.derivative.response(np.exp(1j * theta))
        # a bare spring has one frequency for all compliances, and no extrema
        if np.abs(h.imag).max() > 0.0:
            k, _ = self.points(theta)
            found += [
                turn
                for branch in (0, 1)
                for turn in self._turns(branch, theta, k[branch])
            ]
        alternating = (
            float(self.derivative.h_nyquist),
            float(_answer(self.plant, np.array([math.pi]))[0].real),
        )
        for end in (self.least, self.most):
            if alternating[1] + end != 0.0:
                found.append((-1.0 / (alternating[1] + end) - alternating[0], math.pi))
        # A newest gain of −1/s puts a pole at infinity.
        newest = self.derivative.taps[0] + sum(
            b0 for b0, *_ in self.derivative.sections
        )
        found += [
            (-1.0 / end - newest, math.pi)
            for end in (self.least, self.most)
            if end > 0.0
        ]
        return [(stiffness, at) for stiffness, at in found if math.isfinite(stiffness)]

    def _turns(self, branch: int, theta: Reals, k: Reals) -> list[tuple[float, float]]:
        """Return the extrema of K on a branch within the range of compliances."""
        found = []
        with np.errstate(invalid="ignore"):
            inner = k[1:-1]
            turning = ((inner < k[:-2]) & (inner <= k[2:])) | (
                (inner > k[:-2]) & (inner >= k[2:])
            )
        for i in np.flatnonzero(turning) + 1:
            left = theta[i - 1]
            right = theta[i + 1]
            sign = 1.0 if k[i] <= k[i - 1] else -1.0
            for _ in range(_ZOOMS):
                cells = np.linspace(left, right, 17)
                values = sign * self.points(cells)[0][branch]
                best = int(np.nanargmin(values))
                left = cells[max(best - 1, 0)]
                right = cells[min(best + 1, 16)]
            compliance = float(self.points(cells[best : best + 1])[1][branch, 0])
            if (
                self.least * (1.0 - 1e-9) - 1e-15
                <= compliance
                <= self.most * (1.0 + 1e-9)
            ):
                found.append((sign * float(values[best]), float(cells[best])))
        return found

    def _ends(self, theta: Reals, end: float) -> list[tuple[float, float]]:
        """Return K and ωT of oscillations with the spring at one end of the range (real K)."""

        def curve(at: Reals) -> Complexes:
            answer = _answer(self.plant, at) + end
            return np.asarray(
                -1.0 / answer - self.derivative.response(np.exp(1j * at)),
                dtype=np.complex128,
            )

        return [
            (float(curve(np.array([at]))[0].real), at)
            for at in _real_at(curve, theta, curve(theta))
        ]
