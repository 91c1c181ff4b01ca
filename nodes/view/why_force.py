"""Why there is a force, or none, in words: the question that everybody asks who feels nothing."""

from __future__ import annotations

import math
import re
from collections import deque
from typing import NamedTuple

from messages.types import DeviceState, Force, Proxy

SILENT = 0.5  # without a state for so long the driver counts as silent [s]
LITTLE = 1e-9  # a force below this is none [N]
_STATES = {
    "waiting": "the driver waits for the first force of the coupling",
    "damping": "the coupling is late; the driver damps the device meanwhile",
    "zero": "the coupling is silent; the watchdog has let go until a fresh force comes",
    "fault": "the device is outside its workspace; bring it back inside",
}

WINDOW = 0.3  # of a force that may ring so much is looked at [s]
TURNS = 10  # a hand, and a contact that settles, turn the force back less often than so in the window
LEAST, SHARE = 0.1, 0.25  # what counts as turning back: by so much [N], and by such a part of the strongest force of late


class Ring(NamedTuple):
    """How a loop rings."""

    frequency: float  # how often the force goes to and fro [Hz]
    force: float  # its largest magnitude [N]


class Ringing:
    """Watches the force of a run, tick by tick."""

    def __init__(self) -> None:
        self._turns: deque[float] = deque()
        # Falling in force, so that the first one is the largest of the window.
        self._peaks: deque[tuple[float, float]] = deque()
        self._extreme = 0.0
        self._rising = True

    def take(self, time: float, force: float) -> None:
        """Take the force of one tick."""
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
        """Tell how it rings; None when it does not."""
        if len(self._turns) < TURNS:
            return None
        span = self._turns[-1] - self._turns[0]
        return Ring((len(self._turns) - 1) / (2.0 * span), self._peaks[0][1]) if span > 0.0 else None


_STROKES = re.compile(r"limit of (\S+) N, or stayed there, (\d+) times within (\S+) s and gave out (\S+) mJ")


def stop_in_words(reason: str) -> tuple[str, float]:
    """Shorten the reason of a stop, and tell in how long a time it came about [s]; one put otherwise stays as it is."""
    found = _STROKES.search(reason)
    if found is None:
        return reason, 0.0
    limit, strokes, span, energy = found.groups()
    return f"{strokes} strokes to the limit of {limit} N within {span} s, {energy} mJ given out", float(span)


_LATER = re.compile(r"the device answers (\S+) ticks later")


def delay_in(reason: str) -> float | None:
    """Read from an event how late a virtual device answers from then on [ticks]."""
    found = _LATER.match(reason)
    return float(found.group(1)) if found else None


def size(vector: tuple[float, float, float]) -> float:
    """Length of a vector."""
    return math.sqrt(sum(part * part for part in vector))


def explain(
    state: DeviceState | None,
    proxy: Proxy | None,
    force: Force | None,
    silent: float,
    why: str = "",
    ring: Ring | None = None,
    device: str = "",
) -> tuple[str, str]:
    """Say why there is a force or none."""
    if state is None:
        return "rest", "No force: the driver has not ticked yet."
    if silent > SILENT:
        return "stop", f"No force: nothing has come from the driver for {silent:.1f} s."
    because = f" ({why})" if why else ""
    given = size(state.force)
    if state.safety == "stopped":
        return "stop", f"Too hard: it swung, and the driver stopped it{f': {why}' if why else ''}."
    if state.safety in ("waiting", "zero", "fault") and given <= LITTLE:
        return "stop", f"No force: {_STATES[state.safety]}{because}."
    if state.safety in _STATES:
        return "warn", f"{given:.2f} N: {_STATES[state.safety]}{because}."
    if device:
        # It takes the driver's forces, and does not give them.
        return "stop", f"No force, or another one: {device}."
    law = force.law if force is not None else ""
    asked = size(force.force) if force is not None else 0.0
    if law == "fallback":
        return "warn", f"{given:.2f} N: the law failed, so the fallback renders; choose a law to go on."
    if state.safety == "ramp":
        return "warn", f"{given:.2f} N: the driver lets the force in slowly after a start."
    if proxy is None:
        # A recording of the states alone never holds an answer.
        return "warn", f"{f'{given:.2f} N' if given > LITTLE else 'No force'}: the environment has not answered yet."
    if ring is not None:
        how = f"It rings, {ring.frequency:.0f} times a second and up to {ring.force:.1f} N"
        return "warn", f"{how}: this wall is harder than the loop can render."
    if not proxy.contact:
        if any(proxy.normal):
            return "rest", f"No force: nothing is touched; the surface is {abs(proxy.distance) * 1e3:.1f} mm away."
        return "rest", "No force: there is nothing to touch."
    # Another tick's force says nothing about limits.
    same = force is not None and force.seq == state.force_seq
    if same and asked > given + 0.02 * asked + LITTLE and state.age == 0 and asked > 0.05:
        return ("warn", f"{given:.2f} N of the {asked:.2f} N that the law asks for: the driver's limits hold the rest back.")
    if given <= LITTLE:
        return "rest", f"No force: {law or 'the law'} renders none at this deflection."
    depth = f", {abs(proxy.distance) * 1e3:.2f} mm deep" if any(proxy.normal) else ""
    return "ok", f"{given:.2f} N: {law or 'the law'} pushes back{depth}."
