"""How long an environment takes for its part of a tick: counted in bins of equal ratios, compiled and interpreted alike.

In real time only: in lockstep nobody looks at a clock. A compiled tick counts from the message in
hand to the answer's stamp, decoding included; an interpreted one, and a scene of bodies, from the
decoded message to the proxy. Receiving and sending are the transport's.
"""

from __future__ import annotations

import math
from collections.abc import MutableSequence, Sequence
from itertools import accumulate
from typing import Final

from nodes.base.status_report import Counters
from nodes.compiled.rules import rule

BINS: Final = 136  # room for counts: from `LEAST` to 13 ms
LEAST: Final = 1e-7  # where the first bin begins [s]
PER_OCTAVE: Final = 8  # bins for each doubling: a quantile is known to 4.4 %
_AT = (("p50", 0.5), ("p99", 0.99), ("p999", 0.999))


class SpentCounters(Counters):
    """Counters of an environment without compiled ticks."""

    def __init__(self) -> None:
        super().__init__()
        self.spent = [0] * BINS


@rule
def note_spent(counts: MutableSequence[int], seconds: float) -> None:
    """Count one tick."""
    place = 0
    if seconds > LEAST:
        place = min(int(PER_OCTAVE * math.log2(seconds / LEAST)), BINS - 1)
    counts[place] += 1


def spent_us(counts: Sequence[int]) -> dict[str, float]:
    """Tell quantiles, each by the middle of its bin, and the largest by its bin's end [µs]; empty where nothing was counted."""
    ticks = sum(counts)
    if not ticks:
        return {}

    def edge(place: float) -> float:
        return float(f"{1e6 * LEAST * 2.0 ** (place / PER_OCTAVE):.3g}")

    below = list(accumulate(counts))
    found = {
        name: edge(next(place for place, sum_ in enumerate(below) if sum_ >= part * ticks) + 0.5)
        for name, part in _AT
    }
    return found | {"max": edge(1 + max(place for place, count in enumerate(counts) if count))}
