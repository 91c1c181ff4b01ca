"""Motion of the device and energy of the forces on it, over the time that really passed.

A tick can be lost because the driver was held up, or because its position is invalid. The next
sample then ends a longer step: its displacement is divided by all its ticks, and its energy is that
of the mean force over them. Within a tick the mean force is split where measured arrivals changed
it, which makes energies exact under zero-order hold. Between two samples even motion is assumed;
with one force per tick nothing is assumed.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from itertools import pairwise
from typing import Final, NamedTuple

from nodes.compiled.memory import reals_at
from nodes.compiled.rules import rule
from nodes.driver.passivity import line_of, observe, through
from nodes.driver.state import DriverState

# time at the end of a run that determines its ending [s]; at least `MIN_SAMPLES` ticks
RECENT: Final = 0.25
MIN_SAMPLES: Final = 64
# largest oscillation that counts as rest [m]: about the threshold of a fingertip near 250 Hz
REST = 1e-6
# least acceleration without force that counts as falling [m/s²]; a damped, gliding device has less
_FALL = 1.0


def set_motion(s: DriverState, latency: float) -> list[array[float]]:
    """Allocate samples and the force delay line. Return the arrays (keep a reference)."""
    s.places_count = max(MIN_SAMPLES, round(RECENT / s.period))
    places = array("d", [0.0]) * (3 * s.places_count)
    s.places = places.buffer_info()[0]
    s.elapsed = 1
    return [places, set_latency(s, latency)]


def set_latency(s: DriverState, latency: float) -> array[float]:
    """Resize the force delay line, keeping forces in flight. Return its buffer.

    The caller must keep a reference to the buffer.
    """
    line, part = line_of(latency) if latency else ([], 0.0)
    length = len(line)
    before = s.line_length
    kept = array("d", [0.0]) * (3 * length)
    old = reals_at(s.lines, 3 * before)
    for i in range(3):
        for k in range(length):
            kept[i * length + k] = (
                old[i * before + min(k, before - 1)] if before else s.acting[i]
            )
    s.lines = kept.buffer_info()[0]
    s.line_length = length
    s.line_part = part
    return kept


@rule
def sample(s: DriverState, at: float) -> bool:
    """Use the position read as the newest sample. Return whether ticks have passed.

    A position that `jumped` ends no motion: its step is zero, and so are velocity and energy.
    """
    if s.begun != 0 and s.covered == 0:
        s.at = at  # at the end of a run
        for i in range(3):
            s.position[i] = s.place[i]
        return False
    s.at_before = s.at
    s.at = at
    places = reals_at(s.places + 24 * (s.samples % s.places_count), 3)
    stepped = bool(s.begun != 0)
    for i in range(3):
        places[i] = s.place[i]
        s.before[i] = s.position[i] if stepped and s.jumped == 0 else s.place[i]
        s.position[i] = s.place[i]
    s.samples += 1
    if stepped:
        s.elapsed = s.covered
        energy = s.energy
        for i in range(3):
            s.acted[i] = s.acting[i]
            if s.line_length > 0:
                line = reals_at(s.lines + 8 * i * s.line_length, s.line_length)
                total = through(line, s.acting[i], s.line_part)
                for _ in range(1, s.elapsed):
                    total += through(line, s.acting[i], s.line_part)
                s.acted[i] = total if s.elapsed == 1 else total / s.elapsed
        for n in range(s.axes):
            i = s.axis[n]
            energy = observe(energy, s.acted[i], s.position[i] - s.before[i])
        s.energy = energy
        s.highest = max(s.highest, energy)
    s.begun = 1
    s.covered = 0
    return stepped


@rule
def act(s: DriverState, ticks: int) -> None:
    """Advance by some ticks with the mean force."""
    covered = s.covered
    for i in range(3):
        if covered:
            s.acting[i] = (s.acting[i] * covered + s.mean[i] * ticks) / (
                covered + ticks
            )
        else:
            s.acting[i] = s.mean[i]
    s.covered = covered + ticks


@rule
def split(s: DriverState, offset: float) -> None:
    """Accumulate the mean force up to `offset` (0–1) of this tick."""
    share = offset - s.split
    if share > 0.0:
        for i in range(3):
            s.mean[i] += share * s.handed[i]
        s.split = offset


@rule
def find_velocity(s: DriverState) -> None:
    """Set the velocity between the last two samples; real time counts for a real device."""
    span = s.elapsed * s.period
    if s.virtual == 0:
        span = max(span, s.at - s.at_before)
    for i in range(3):
        s.velocity[i] = (s.position[i] - s.before[i]) / span


def endings(s: DriverState) -> list[Ending]:
    """Return how the device moved at the end, axis by axis."""
    places = reals_at(s.places, 3 * s.places_count)
    order = [
        n % s.places_count for n in range(max(0, s.samples - s.places_count), s.samples)
    ]
    return [
        ending([places[3 * n + i] for n in order], s.force[i], s.period)
        for i in range(3)
    ]


class Ending(NamedTuple):
    """Motion at the end of a run on one axis."""

    motion: str  # ``at rest``, ``swinging``, ``falling`` or ``moving``
    swing_m: float  # range of the samples [m]
    frequency_hz: float  # frequency of the oscillation [Hz]; 0 for any other motion
    velocity_m_per_s: float  # at the end [m/s]


def ending(samples: Sequence[float], force: float, period: float) -> Ending:
    """Return the motion of the last samples of one axis."""
    if len(samples) < 2:
        return Ending("at rest", 0.0, 0.0, 0.0)
    swing = max(samples) - min(samples)
    velocity = (samples[-1] - samples[-2]) / period
    if not swing > REST:
        return Ending("at rest", swing, 0.0, velocity)
    middle = 0.5 * (max(samples) + min(samples))
    above = [value > middle for value in samples]
    crossings = [k for k in range(1, len(above)) if above[k] != above[k - 1]]
    # two crossings of the middle are there and back; a third makes it an oscillation
    if len(crossings) >= 3:
        frequency = (
            0.5 * (len(crossings) - 1) / ((crossings[-1] - crossings[0]) * period)
        )
        return Ending("swinging", swing, frequency, velocity)
    # Only the newer half: a bounce before it, or within it, is no fall.
    half = (len(samples) - 1) // 4
    last = samples[-1 - 2 * half :]
    bend = last[-1] - 2.0 * last[half] + last[0]
    acceleration = bend / (half * period) ** 2 if half else 0.0
    one_way = all(
        (after - before) * velocity >= 0.0 for before, after in pairwise(last)
    )
    falls = (
        force == 0.0
        and abs(acceleration) > _FALL
        and acceleration * velocity > 0.0
        and one_way
    )
    return Ending("falling" if falls else "moving", swing, 0.0, velocity)
