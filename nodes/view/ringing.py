"""Detect ringing: a force that goes to and fro and generates energy at every stroke.

A stroke ends where the force turns back. What the loop generated in a whole cycle, less the work of
the steady push meanwhile, is positive for every cycle of a loop that sings, at any frequency; a
surface that is tapped, or a contact that settles, absorbs energy. A loop that bounces may have two
unequal pulses, of which one absorbs: then it is positive for two cycles.

`observe_stroke` and `is_ringing` are plain rules: the static page plays them as JavaScript.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

from messages.types import Vector

# longest cycle; a hand seldom goes to and fro 4 times a second [s]
SLOWEST: Final = 0.26
STROKES: Final = 5  # strokes in a row that generate energy
SPAN: Final = 0.1  # shortest ringing that is reported [s]
# Smallest stroke counted: absolute [N], and relative to the largest force lately.
SMALLEST_STROKE: Final = 0.1
STROKE_SHARE: Final = 0.25
LATELY: Final = 0.3  # time in which the largest force lately is forgotten [s]
# a stroke below this part of the last two of its direction settles
FADING: Final = 0.7
TURNS: Final = 4  # turns stored: two cycles
SMOOTHING: Final = 0.25  # weight of the newest cycle in the frequency


class Strokes:
    """State of the rules, for the force of one axis."""

    def __init__(self, axis: int) -> None:
        self.axis = axis
        self.time = 0.0  # of the newest tick [s]
        self.rising = 1
        self.peak = 0.0  # largest force lately [N]
        self.pushed = [0.0, 0.0, 0.0]  # integral of the force over time [N s]
        # Furthest force of this stroke, and time, energy, position and push where it was.
        self.furthest = 0.0
        self.at = [0.0] * 8
        # The same for the newest turns, their forces, and the sizes of the strokes before them [N].
        self.turns = 0
        self.turned_at = 0.0  # force at the newest turn [N]
        self.turned = [0.0] * 32
        self.forces = [0.0] * 4
        self.sizes = [0.0] * 4
        self.strokes = 0  # strokes in a row that generated energy
        self.since = 0.0  # when the first of them began [s]
        self.cycle = 0.0  # smoothed duration of a cycle [s]
        self.most = 0.0  # largest force of the newest turns [N]


def forget_strokes(s: Strokes, time: float) -> None:
    """Begin anew, as after a jump of time."""
    s.time = time
    s.peak = s.furthest = s.turned_at = 0.0
    for i in range(TURNS):
        s.sizes[i] = 0.0
        s.forces[i] = 0.0
    s.turns = s.strokes = 0
    s.rising = 1


def mark_furthest(
    s: Strokes, time: float, position: Vector, force: float, energy: float
) -> None:
    """Note where the force is furthest along this stroke."""
    s.furthest = force
    s.at[0] = time
    s.at[1] = energy
    for i in range(3):
        s.at[2 + i] = position[i]
        s.at[5 + i] = s.pushed[i]


def observe_stroke(
    s: Strokes, time: float, position: Vector, force: Vector, energy: float
) -> None:
    """Add a tick: its time [s], position [m], force [N] and energy generated so far [J]."""
    past = time - s.time
    if past < 0.0 or past > SLOWEST:
        forget_strokes(s, time)
        past = 0.0
    s.time = time
    now = force[s.axis]
    for i in range(3):
        s.pushed[i] += force[i] * past
    s.peak = max(abs(now), s.peak * (1.0 - min(1.0, past / LATELY)))
    back = max(SMALLEST_STROKE, STROKE_SHARE * s.peak)
    change = now - s.furthest
    if s.rising == 0:
        change = -change
    if change >= 0.0:
        mark_furthest(s, time, position, now, energy)
    elif -change > back:
        end_stroke(s)
        s.rising = 1 - s.rising
        mark_furthest(s, time, position, now, energy)


def energy_since(s: Strokes, turn: int) -> float:
    """Return what was generated since a turn, less the work of the steady push meanwhile [J]."""
    first = 8 * (turn % TURNS)
    past = s.at[0] - s.turned[first]
    if past <= 0.0:
        return 0.0
    gained = s.at[1] - s.turned[first + 1]
    for i in range(3):
        moved = s.at[2 + i] - s.turned[first + 2 + i]
        gained -= (s.at[5 + i] - s.turned[first + 5 + i]) / past * moved
    return gained


def end_stroke(s: Strokes) -> None:
    """End a stroke where the force was furthest."""
    cycle = 0.0
    period = 0.0
    gained = 0.0
    before = 0.0
    size = abs(s.furthest - s.turned_at)
    lasts = False
    if s.turns >= 2:
        # A cycle began at the turn before the last.
        cycle = s.at[0] - s.turned[8 * ((s.turns - 2) % TURNS)]
        period = cycle
        gained = energy_since(s, s.turns - 2)
        before = s.sizes[(s.turns - 2) % TURNS]
        lasts = size >= FADING * before
    if s.turns >= TURNS:
        gained = max(gained, energy_since(s, s.turns - TURNS))
        lasts = lasts or size >= FADING * s.sizes[s.turns % TURNS]
        if min(size, before) < FADING * max(size, before):
            # Unequal pulses come back every other cycle.
            period = s.at[0] - s.turned[8 * (s.turns % TURNS)]
    if 0.0 < cycle <= SLOWEST and gained > 0.0 and lasts:
        s.strokes += 1
        s.cycle += (period - s.cycle) * (SMOOTHING if s.strokes > 1 else 1.0)
    else:
        s.strokes = 0
        s.since = s.at[0]
    s.turned_at = s.furthest
    newest = s.turns % TURNS
    s.sizes[newest] = size
    s.forces[newest] = s.furthest
    s.most = 0.0
    for i in range(TURNS):
        s.most = max(s.most, abs(s.forces[i]))
    for i in range(8):
        s.turned[8 * newest + i] = s.at[i]
    s.turns += 1


def is_ringing(s: Strokes) -> bool:
    """Whether the force rings at the newest tick."""
    last = s.turned[8 * ((s.turns + TURNS - 1) % TURNS)]
    return s.strokes >= STROKES and last - s.since >= SPAN and s.time - last <= SLOWEST


class Ring(NamedTuple):
    """Frequency and amplitude of ringing."""

    frequency: float  # frequency of the oscillation [Hz]
    force: float  # largest magnitude of the force [N]

    def __str__(self) -> str:
        return f"It rings at {self.frequency:.0f} Hz, up to {self.force:.1f} N"


class Ringing:
    """Detects ringing in the force of a run along one axis, tick by tick."""

    def __init__(self, axis: int = 0) -> None:
        self._strokes = Strokes(axis)

    def take(self, time: float, position: Vector, force: Vector, energy: float) -> None:
        """Add a tick; see `observe_stroke`."""
        observe_stroke(self._strokes, time, position, force, energy)

    def ring(self) -> Ring | None:
        """Return the present ringing; None if there is none."""
        s = self._strokes
        return Ring(1.0 / s.cycle, s.most) if is_ringing(s) else None


def ring_of(
    position: Sequence[float], force: Sequence[float], period: float, delay: float
) -> Ring | None:
    """Return how a recorded loop of one axis rings at its end.

    Parameters
    ----------
    position, force : sequence of float, shape (n,)
        Device [m] and force [N] at each tick.
    period : float
        Sampling period [s].
    delay : float
        Delay from a tick to its force taking effect [ticks].
    """
    watched = Ringing()
    energy = 0.0
    whole = int(delay)
    part = delay - whole
    for k in range(len(position)):
        watched.take(k * period, (position[k], 0.0, 0.0), (force[k], 0.0, 0.0), energy)
        if k + 1 < len(position):
            newer = force[k - whole] if k >= whole else 0.0
            older = force[k - whole - 1] if k > whole else 0.0
            acting = (1.0 - part) * newer + part * older
            energy += acting * (position[k + 1] - position[k])
    return watched.ring()
