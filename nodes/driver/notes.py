"""What the rules of a driver have to say, in words: they note a code with numbers, and this is its kind and its reason."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, NamedTuple

from nodes.driver.state import NOTE, REFUSED, SAFETY, DriverState

FIRST_FORCE, FRESH_FORCE, DONE_RAMP, SILENT, STILL_SILENT, LET_GO, NO_POSITION, OUTSIDE, BACK_INSIDE, SWINGS = range(10)
CONTINUOUS, HELD_UP, REARMED, JUMPED, REFUSED_FIRST = range(10, 15)  # the last: future, replayed, stale, not finite
_WORDS: Final[tuple[Callable[..., str], ...]] = (
    lambda *_: "the first force",
    lambda *_: "fresh forces again",
    lambda _, ticks, *__: f"ramp of {ticks:.0f} ticks done",
    lambda _, silent, most, *__: f"no fresh force for {silent:.0f} ticks, limit {most:.0f}",
    lambda _, silent, *__: f"no fresh force for {silent:.0f} ticks",
    lambda *_: "no force was written in time, and the device let go by itself",
    lambda _, x, y, z, *__: f"the device gives position {(x, y, z)}",
    lambda _, axis, at, low, high, *__: f"{'xyz'[int(axis)]} = {at:.4g} m, workspace {low:.4g} to {high:.4g} m",
    lambda *_: "back inside the workspace",
    lambda _, peak, times, span, gained, *__: (
        f"the loop gives out energy: its force came to the limit of {peak:g} N, or stayed there, {times:.0f} times within "
        f"{span:.2g} s and gave out {gained * 1e3:.3g} mJ; no force until it is asked for: a softer law first, then "
        "haptic node rearm, or launch again"
    ),
    lambda tick, _, most, *__: f"continuous force at tick {tick}: limit {most:.3g} N reached",
    lambda tick, written, *_: f"no force from tick {written:.0f} to {tick}; the device let go by itself",
    lambda *_: "armed again on request: the force comes back by its ramp, and swings are counted from zero",
    lambda *_: "the position jumped without a motion: what is felt goes to what is asked by the ramp",
    lambda tick, _, answers, *__: f"a force for tick {answers:.0f}, which is still to come: now is {tick}",
    lambda _, __, answers, last, *___: (
        f"a force for tick {answers:.0f} once more: {last:.0f} was the last (replayed or out of order)"
    ),
    lambda tick, _, age, most, *__: f"a force {age:.0f} ticks old at tick {tick}, limit {most:.0f}",
    lambda _, __, answers, x, y, z: f"a force for tick {answers:.0f} that is not finite: {(x, y, z)}",
)

_KINDS: Final = {
    SWINGS: "stopped",
    REARMED: "rearmed",
    CONTINUOUS: "limit",
    HELD_UP: "device",
    **{REFUSED_FIRST + n: f"refused_{why}" for n, why in enumerate(REFUSED)},
}


class Note(NamedTuple):
    """What there is to say: kind and reason of the event, whether it changed the state, and which of its kind it is, or 0."""

    kind: str
    reason: str
    is_change: bool
    which: int


def take_notes(s: DriverState) -> list[Note]:
    """Take what the rules have noted since last time, in words."""
    lines = []
    for n in range(s.notes_count):
        code, seq, change, *numbers = s.notes[NOTE * n : NOTE * (n + 1)]
        reason = _WORDS[int(code)](int(seq), *numbers)
        if change >= 0.0:
            before, after = divmod(int(change), 8)
            reason = f"{SAFETY[before]} → {SAFETY[after]} at tick {seq:.0f}: {reason}"
        count = 0 if change >= 0.0 or code == HELD_UP else int(numbers[0])
        # A change of state goes by a name of its own: among many others it must not be overlooked.
        lines.append(Note(_KINDS.get(int(code), "safety"), reason, change >= 0.0, count))
    s.notes_count = 0
    return lines
