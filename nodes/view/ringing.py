"""Whether a loop rings: the force goes to and fro faster than any hand."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

WINDOW = 0.3  # of a force that may ring so much is looked at [s]
# a hand, and a contact that settles, turn the force back less often than so in the window
TURNS = 10
# what counts as turning back: by so much [N], and by such a part of the strongest force of late
LEAST, SHARE = 0.1, 0.25


class Ring(NamedTuple):
    """How a loop rings."""

    frequency: float  # how often the force goes to and fro [Hz]
    force: float  # its largest magnitude [N]

    def __str__(self) -> str:
        return f"It rings, {self.frequency:.0f} times a second and up to {self.force:.1f} N"


class Ringing:
    """Watches the force of a run, tick by tick."""

    def __init__(self) -> None:
        self._turns: deque[float] = deque()
        # Falling in force, so that the first one is the largest of the window.
        self._peaks: deque[tuple[float, float]] = deque()
        self._extreme = 0.0
        self._rising = True

    def take(self, time: float, force: float) -> None:
        """Add the force of one tick [N], at a time [s]."""
        turns, peaks = self._turns, self._peaks
        if peaks and time < peaks[-1][0]:
            # The past again, in a recording.
            turns.clear()
            peaks.clear()
        while peaks and peaks[-1][1] <= abs(force):
            peaks.pop()
        peaks.append((time, abs(force)))
        while time - peaks[0][0] > WINDOW:
            peaks.popleft()
        back = max(LEAST, SHARE * peaks[0][1])
        change = force - self._extreme if self._rising else self._extreme - force
        if change >= 0.0:
            self._extreme = force
        elif -change > back:
            turns.append(time)
            self._extreme, self._rising = force, not self._rising
        while turns and time - turns[0] > WINDOW:
            turns.popleft()

    def ring(self) -> Ring | None:
        """Return how the force rings; None when it does not."""
        if len(self._turns) < TURNS:
            return None
        span = self._turns[-1] - self._turns[0]
        return (
            Ring((len(self._turns) - 1) / (2.0 * span), self._peaks[0][1]) if span > 0.0 else None
        )
