"""Swings: a loop that reaches its peak force repeatedly, and generates energy, is stopped."""

from __future__ import annotations

from typing import Final

from nodes.compiled.rules import rule
from nodes.driver import notes
from nodes.driver.motion import find_velocity
from nodes.driver.safety import enter
from nodes.driver.state import STOPPED, DriverState

# a loop is stopped that reaches the peak `stop_after` times within it and generates energy [s]
STOP_WINDOW: Final = 2.0
# a force that stays at its limit and generates energy stops the loop within STOP_WINDOW / PRESSES
PRESSES: Final = 2


@rule
def watch_swings(s: DriverState, seq: int) -> None:
    """Stop if the force repeatedly reaches its limit while the loop generates energy.

    Energy is compared between moments at which the force reaches its limit, which excludes the
    energy stored in the surface. A surface that absorbs energy, as one that is tapped hard does, is
    not stopped. A force that stays at its limit counts repeatedly while more was generated than
    when it came there: a hand that keeps pushing only absorbs energy.
    """
    if s.safety != STOPPED:
        _watch_press(s, seq)
    if s.safety != STOPPED and s.peaked != 0:
        s.peaked = 0
        # ring of the newest moments: tick, and the energy generated until then [J]
        at = s.peaks_count % s.stop_after
        s.peaks[2 * at] = float(seq)
        s.peaks[2 * at + 1] = s.energy
        s.peaks_count += 1
        first = s.peaks_count % s.stop_after if s.peaks_count >= s.stop_after else 0
        span = (seq - s.peaks[2 * first]) * s.period
        gained = s.energy - s.peaks[2 * first + 1]
        if s.peaks_count >= s.stop_after and span <= STOP_WINDOW and gained > 0.0:
            s.stopped_at = seq
            enter(
                s, STOPPED, seq, notes.SWINGS, s.peak, float(s.stop_after), span, gained
            )
    if s.safety == STOPPED:
        find_velocity(s)
        damped = seq - s.stopped_at < s.damping_ticks
        for i in range(3):
            s.brake[i] = -s.damping * s.velocity[i] if damped else 0.0


@rule
def _watch_press(s: DriverState, seq: int) -> None:
    """Count a force that stays at its limit and generates energy as reaching it again."""
    if s.sides[0] == 0 and s.sides[1] == 0 and s.sides[2] == 0:
        s.pressed_since = -1
    elif s.pressed_since < 0 or s.peaked != 0:
        s.pressed_since = s.pressed_at = seq
        s.pressed_energy = s.energy
    elif seq - s.pressed_at >= s.pressed_ticks and s.energy > s.pressed_energy:
        s.pressed_at = seq
        s.peaked = 1
