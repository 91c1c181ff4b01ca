"""Detect ringing: a force that oscillates faster than any hand moves."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

WINDOW = 0.3  # time span analysed [s]
# Reversals within the window that count as ringing; a hand or a settling contact has fewer.
TURNS = 10
# Smallest reversal counted: absolute [N], and relative to the largest force in the window.
SMALLEST_REVERSAL, REVERSAL_SHARE = 0.1, 0.25


class Ring(NamedTuple):
    """Frequency and amplitude of ringing."""

    frequency: float  # frequency of the oscillation [Hz]
    force: float  # largest magnitude of the force [N]

    def __str__(self) -> str:
        return f"It rings at {self.frequency:.0f} Hz, up to {self.force:.1f} N"


class Ringing:
    """Detects ringing in the force of a run, tick by tick."""

    def __init__(self) -> None:
        self._turns: deque[float] = deque()
        # Monotonically decreasing, so that the first entry is the window's maximum.
        self._peaks: deque[tuple[float, float]] = deque()
        self._extreme = 0.0
        self._rising = True

    def take(self, time: float, force: float) -> None:
        """Add the force of a tick [N] at a time [s]."""
        turns, peaks = self._turns, self._peaks
        if peaks and time < peaks[-1][0]:
            # Time jumped back in a recording.
            turns.clear()
            peaks.clear()
        while peaks and peaks[-1][1] <= abs(force):
            peaks.pop()
        peaks.append((time, abs(force)))
        while time - peaks[0][0] > WINDOW:
            peaks.popleft()
        back = max(SMALLEST_REVERSAL, REVERSAL_SHARE * peaks[0][1])
        change = force - self._extreme if self._rising else self._extreme - force
        if change >= 0.0:
            self._extreme = force
        elif -change > back:
            turns.append(time)
            self._extreme, self._rising = force, not self._rising
        while turns and time - turns[0] > WINDOW:
            turns.popleft()

    def ring(self) -> Ring | None:
        """Return the present ringing; None if there is none."""
        if len(self._turns) < TURNS:
            return None
        span = self._turns[-1] - self._turns[0]
        return (
            Ring((len(self._turns) - 1) / (2.0 * span), self._peaks[0][1])
            if span > 0.0
            else None
        )
