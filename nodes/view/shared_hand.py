"""Share the hand's target among pages: one owner at a time, no jumps, taps while unowned.

If a page falls silent with its socket open, its browser is busy and the finger may still be on the
mouse: the target stays for a while, then returns home slowly; when the page is heard again, it
comes back equally slowly. If a page closes or lets go, the hand returns to its path at once.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from pathlib import Path

from messages.types import ZERO, Vector
from nodes.driver.pointer import PointerWriter

SILENCE_LIMIT = 2.0  # time that the target of a silent page stays [s]
SLOWLY = 0.05  # speed at which it then returns home, and comes back [m/s]
EVERY, PRESS, DEPTH = (
    3.0,
    0.9,
    0.004,
)  # taps of an unowned hand: period, duration [s], depth [m]
REST = 1.0  # time that its path must be at rest before the first tap [s]


def _towards(here: Vector, there: Vector, way: float) -> Vector:
    far = math.dist(here, there)
    if far <= way:
        return there
    x, y, z = (a + (b - a) * way / far for a, b in zip(here, there, strict=True))
    return x, y, z


class SharedHand:
    """Target of the hand, shared among pages; used by one thread."""

    def __init__(self, path: Path) -> None:
        try:
            self._writer: PointerWriter | None = PointerWriter(path)
        except FileNotFoundError:
            self._writer = None
        self.there = self._writer is not None  # whether the launch has a hand to drag
        self.taken = False  # whether any page has taken it so far
        self._owner = 0
        self._lapsed = 0
        self._heard = self._stepped = -math.inf
        self._slow = False
        self._wanted = self._at = self._home = self._present = ZERO
        self._still = math.inf
        self._taps = -math.inf

    def move(self, owner: int, target: Sequence[float] | None) -> str:
        """Move the target for page `owner`, or release it (None); return an error or ""."""
        if self._writer is None:
            none = "hand: this launch has none; try haptic launch touch_wall --view"
            return "" if target is None else none
        if target is None:
            if self._owner == owner:
                self._release(self._writer)
            if self._lapsed == owner:
                self._lapsed = 0
            return ""
        if self._owner not in (0, owner):
            return "hand: another page holds it"
        try:
            wanted = float(target[0]), float(target[1]), float(target[2])
        except (ValueError, OverflowError) as error:
            return f"hand: {error}"
        if not all(map(math.isfinite, wanted)):
            return f"hand: {wanted} m, expected three finite numbers"
        if self._owner != owner:
            if not self._writer.take():
                return "hand: another page holds it"
            self._owner = owner
            self.taken = True
            self._home = self._at = self._present
            # Back after a silence: the finger may have been on the mouse all the time.
            self._slow = self._lapsed == owner
        self._lapsed = 0
        self._wanted, self._heard = wanted, time.monotonic()
        if not self._slow:
            self._at = wanted
            self._writer.write(wanted)
        return ""

    def step(self, present: Vector) -> None:
        """Renew the target, starting at the `present` one; called once per screen refresh."""
        now = time.monotonic()
        before = self._stepped
        self._stepped = now
        if present != self._present or math.isinf(self._still):
            self._present, self._still = present, now
        if self._writer is None or not self._owner:
            return
        way = SLOWLY * min(0.1, now - before)
        if now - self._heard < SILENCE_LIMIT:
            if self._slow:
                self._at = _towards(self._at, self._wanted, way)
                self._slow = self._at != self._wanted
        else:
            self._slow = True
            self._at = _towards(self._at, self._home, way)
            if self._at == self._home:
                self._lapsed = self._owner
                self._release(self._writer)
                return
        self._writer.write(self._at)

    def tap(self, axis: int, surface: float | None, side: float) -> None:
        """Tap the surface now and then while no page has taken the hand."""
        now = time.monotonic()
        writer = self._writer
        if writer is None or self.taken or surface is None:
            return
        if not writer.take():
            # A page of another view owns the hand.
            self.taken = True
            return
        self._tap(writer, now, axis, surface - side * DEPTH)
        writer.leave()

    def _tap(
        self, writer: PointerWriter, now: float, axis: int, deepest: float
    ) -> None:
        if now - self._taps > EVERY:
            if now - self._still < REST:
                return
            self._taps = now
            self._home = self._present
        done = (now - self._taps) / PRESS
        if done >= 1.0:
            if self._at != self._home:
                writer.let_go()
                self._at = self._home
            return
        # Down and up like a finger: smooth at both ends, with a pause inside.
        share = min(1.0, 1.6 * math.sin(math.pi * done) ** 2)
        target = list(self._home)
        target[axis] += share * (deepest - target[axis])
        self._at = target[0], target[1], target[2]
        writer.write(self._at)

    def _release(self, writer: PointerWriter) -> None:
        writer.let_go()
        writer.leave()
        self._owner, self._slow = 0, False

    def close(self) -> None:
        """Close the pointer file."""
        if self._writer is not None:
            self._writer.close()
