"""How the device moves and comes to an end, and what the forces on it give out: rates are over the time that really passed.

A tick can be lost because the driver was held up, or because the position it got is no position.
Then the next sample ends a longer step: its displacement is divided by all the ticks that it took,
and its energy is that of the mean force over them. Within a tick the mean force is split where the
measured arrivals changed it, for energies exact under zero-order hold: between two samples the
device is taken to move evenly, and with one force per tick nothing is assumed.
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

RECENT: Final = 0.25  # time at the end of a run that tells how it ends [s]; at least `LEAST` ticks
LEAST: Final = 64
# largest swing that counts as rest [m]: about what a fingertip feels at its most sensitive, near
# 250 Hz
REST = 1e-6
# least acceleration without a force that is called falling [m/s²]: a damped device that glides has
# less
_FALL = 1.0


def set_motion(s: DriverState, latency: float) -> list[array[float]]:
    """Lay down samples and forces under way, which act so many ticks late; the arrays must live as long as the state."""
    s.places_count = max(LEAST, round(RECENT / s.period))
    places = array("d", [0.0]) * (3 * s.places_count)
    s.places = places.buffer_info()[0]
    s.elapsed = 1
    return [places, set_latency(s, latency)]


def set_latency(s: DriverState, latency: float) -> array[float]:
    """Lay down the forces under way, with those that are; the array, which must live as long as the state."""
    line, part = line_of(latency) if latency else ([], 0.0)
    length, before = len(line), s.line_length
    kept = array("d", [0.0]) * (3 * length)
    old = reals_at(s.lines, 3 * before)
    for i in range(3):
        for k in range(length):
            kept[i * length + k] = old[i * before + min(k, before - 1)] if before else s.acting[i]
    s.lines, s.line_length, s.line_part = kept.buffer_info()[0], length, part
    return kept


@rule
def sample(s: DriverState, at: float) -> bool:
    """Take the position that was read as the newest sample; whether ticks have passed since the one before.

    A position that `jumped` ends no motion: its step is zero, and so are velocity and energy.
    """
    if s.begun != 0 and s.covered == 0:
        s.at = at  # at the end of a run
        for i in range(3):
            s.position[i] = s.place[i]
        return False
    s.at_before, s.at = s.at, at
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
    """Let ticks pass with the mean force."""
    covered = s.covered
    for i in range(3):
        if covered:
            s.acting[i] = (s.acting[i] * covered + s.mean[i] * ticks) / (covered + ticks)
        else:
            s.acting[i] = s.mean[i]
    s.covered = covered + ticks


@rule
def split(s: DriverState, offset: float) -> None:
    """Take into the tick's mean force what acted up to a place in it."""
    share = offset - s.split
    if share > 0.0:
        for i in range(3):
            s.mean[i] += share * s.handed[i]
        s.split = offset


@rule
def find_velocity(s: DriverState) -> None:
    """Find the velocity between the last two samples; a real device goes on moving while a sample is late."""
    span = s.elapsed * s.period
    if s.virtual == 0:
        span = max(span, s.at - s.at_before)
    for i in range(3):
        s.velocity[i] = (s.position[i] - s.before[i]) / span


def endings(s: DriverState) -> list[Ending]:
    """Tell how the device has moved lately, axis by axis."""
    places = reals_at(s.places, 3 * s.places_count)
    order = [n % s.places_count for n in range(max(0, s.samples - s.places_count), s.samples)]
    return [ending([places[3 * n + i] for n in order], s.force[i], s.period) for i in range(3)]


class Ending(NamedTuple):
    """The last samples of one axis in words and figures."""

    motion: str  # ``at rest``, ``swinging``, ``falling`` or ``moving``
    swing_m: float  # largest less smallest sample, in metres
    frequency_hz: float  # how often it swings to and fro, in Hz; 0 for any other motion
    velocity_m_per_s: float  # at the end, in m/s


def ending(samples: Sequence[float], force: float, period: float) -> Ending:
    """Describe the last samples of one axis."""
    if len(samples) < 2:
        return Ending("at rest", 0.0, 0.0, 0.0)
    swing = max(samples) - min(samples)
    velocity = (samples[-1] - samples[-2]) / period
    if not swing > REST:
        return Ending("at rest", swing, 0.0, velocity)
    middle = 0.5 * (max(samples) + min(samples))
    above = [value > middle for value in samples]
    crossings = [k for k in range(1, len(above)) if above[k] != above[k - 1]]
    # Twice through the middle is there and back; a third time makes it a swing.
    if len(crossings) >= 3:
        frequency = 0.5 * (len(crossings) - 1) / ((crossings[-1] - crossings[0]) * period)
        return Ending("swinging", swing, frequency, velocity)
    # The newer half alone: a bounce before it is no fall, nor is one within it, which turns the
    # device round.
    half = (len(samples) - 1) // 4
    last = samples[-1 - 2 * half :]
    bend = last[-1] - 2.0 * last[half] + last[0]
    acceleration = bend / (half * period) ** 2 if half else 0.0
    one_way = all((after - before) * velocity >= 0.0 for before, after in pairwise(last))
    falls = force == 0.0 and abs(acceleration) > _FALL and acceleration * velocity > 0.0 and one_way
    return Ending("falling" if falls else "moving", swing, 0.0, velocity)
