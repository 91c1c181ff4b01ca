"""Which force acted: the mean over a tick whose force changed within it, for energies exact under zero-order hold."""

from __future__ import annotations

from messages.types import Vector
from nodes.driver.passivity import backlog, line_of, through


class Split:
    """Mean force of one tick, split where the measured arrivals changed it.

    Between two samples the device is taken to move evenly; with one force per tick nothing is assumed.

    Parameters
    ----------
    at_start : tuple of float, shape (3,)
        Force that acts when the tick begins [N].
    fixed : tuple of float, shape (3,), or None
        Force of the whole tick where what arrives now acts later (``next_tick``) [N].
    """

    def __init__(self, at_start: Vector, fixed: Vector | None) -> None:
        self._fixed = fixed
        self._now = at_start
        self._since = 0.0
        self._sum = [0.0, 0.0, 0.0]

    def change(self, force: Vector, offset: float) -> None:
        """Let a force take effect at a place in the tick."""
        self._add(offset)
        self._now = force

    def _add(self, offset: float) -> None:
        share, now, total = offset - self._since, self._now, self._sum
        if share > 0.0:
            for i in range(3):
                total[i] += share * now[i]
            self._since = offset

    def mean(self) -> list[float]:
        """Give the mean of the tick."""
        if self._fixed is not None:
            return list(self._fixed)
        self._add(1.0)
        return self._sum


class Latency:
    """Forces on their way through a device that applies them later than they are handed over.

    Parameters
    ----------
    ticks : float
        Its latency [ticks].

    Attributes
    ----------
    lines : list of list of float, shape (3, n)
        Forces on their way, newest first [N].
    part : float
        Fraction of a tick by which the oldest one still acts.
    """

    def __init__(self, ticks: float) -> None:
        self.lines = [line_of(ticks)[0] for _ in range(3)]
        self.part = line_of(ticks)[1]

    def acted(self, handed: list[float], ticks: int) -> list[float]:
        """Tell what acted since the sample before."""
        part = self.part
        total = [through(line, force, part) for line, force in zip(self.lines, handed, strict=True)]
        for _ in range(ticks - 1):
            for i, force in enumerate(handed):
                total[i] += through(self.lines[i], force, part)
        return total if ticks == 1 else [force / ticks for force in total]

    def backlog(self) -> Vector:
        """Give the force times ticks that is still on its way."""
        x, y, z = (backlog(line, self.part) for line in self.lines)
        return x, y, z
