"""How the device moves, and what the forces on it give out: every rate is over the time that really passed.

A tick can be lost because the driver was held up, or because the position it got is no position. Then the next sample ends a
longer step: its displacement is divided by all the ticks that it took, and its energy is that of the mean force over them.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence

from messages.types import ZERO, Vector
from nodes.driver.ending import Ending, ending
from nodes.driver.mean_force import Latency
from nodes.driver.passivity import observe

RECENT = 0.25
"""Time at the end of a run that tells how it ends [s]; at least `LEAST` ticks."""

LEAST = 64


class Motion:
    """Samples of one device.

    Parameters
    ----------
    period : float
        Sampling period T [s].
    axes : list of int
        Axes that the scene computes.
    virtual : bool
        Whether the device lives in the time of the ticks; another one goes on moving while a sample is late.
    latency : Latency or None
        What is between handing a force over and its acting; None for nothing.

    Attributes
    ----------
    position, before : tuple of float, shape (3,)
        Newest sample and the one before it [m].
    elapsed : int
        Ticks between the two.
    acting : list of float, shape (3,)
        Mean force handed over since the newest sample [N].
    acted : list of float, shape (3,)
        Mean force that acted between the two newest samples [N].
    energy, highest : float
        Energy given out up to the newest sample, and the most so far [J].
    covered : int
        Ticks since the newest sample whose forces are in `acting`.
    at, at_before : float
        When the two newest samples were taken [s].
    samples, kept : int
        Samples so far, and how many of them are kept.
    recent : array of float, shape (3 kept,)
        The newest samples, the n-th at 3 (n modulo kept) [m].
    """

    def __init__(self, period: float, axes: list[int], virtual: bool, latency: Latency | None = None) -> None:
        self._period, self._axes, self._virtual = period, axes, virtual
        self.position: Vector = ZERO
        self.before: Vector = ZERO
        self.elapsed = 1
        self.acting: list[float] = [0.0, 0.0, 0.0]
        self.acted = self.acting
        self._latency = latency
        self.samples, self.kept = 0, max(LEAST, round(RECENT / period))
        self.recent = array("d", [0.0]) * (3 * self.kept)
        self.energy = self.highest = 0.0
        self.covered = 0
        self._begun = False
        self.at = self.at_before = 0.0

    def sample(self, position: Vector, at: float) -> bool:
        """Take a new sample; whether ticks have passed since the last one, at the end of a run none have."""
        if self._begun and not self.covered:
            self.position, self.at = position, at
            return False
        self.at_before, self.at = self.at, at
        n = 3 * (self.samples % self.kept)
        self.recent[n], self.recent[n + 1], self.recent[n + 2] = position
        self.samples += 1
        if not self._begun:
            self._begun = True
            self.before = self.position = position
            self.covered = 0
            return False
        before = self.before = self.position
        self.position = position
        self.elapsed = self.covered
        self.covered = 0
        acted = self.acting if self._latency is None else self._latency.acted(self.acting, self.elapsed)
        energy = self.energy
        for i in self._axes:
            energy = observe(energy, acted[i], position[i] - before[i])
        self.acted = acted
        self.energy = energy
        if energy > self.highest:
            self.highest = energy
        return True

    def act(self, force: list[float], ticks: int = 1) -> None:
        """Let ticks pass."""
        covered = self.covered
        if covered:
            mean = self.acting
            self.acting = [
                (before * covered + now * ticks) / (covered + ticks) for before, now in zip(mean, force, strict=True)
            ]
        else:
            self.acting = force
        self.covered = covered + ticks

    def endings(self, force: Vector) -> list[Ending]:
        """Tell how the device has moved lately."""
        order = [n % self.kept for n in range(max(0, self.samples - self.kept), self.samples)]
        return [ending([self.recent[3 * n + i] for n in order], acting, self._period) for i, acting in enumerate(force)]

    def velocity(self) -> Vector:
        """Find the velocity between the last two samples."""
        span = self.elapsed * self._period
        if not self._virtual:
            span = max(span, self.at - self.at_before)
        now, before = self.position, self.before
        return (now[0] - before[0]) / span, (now[1] - before[1]) / span, (now[2] - before[2]) / span


def scaled(force: Sequence[float], share: float) -> list[float]:
    """Scale a force."""
    return [share * value for value in force]
