"""Histogram of tick durations of an environment, in logarithmic bins.

Durations are measured in real time only, not in lockstep. A compiled tick counts from receiving the
message to stamping the answer, decoding included; an interpreted tick, and a scene of bodies,
counts from the decoded message to the proxy. Receiving and sending are not included.
"""

from __future__ import annotations

import math
from collections.abc import MutableSequence, Sequence
from itertools import accumulate
from typing import Final

from nodes.compiled.rules import rule

BINS: Final = 136  # bins, from SHORTEST_SPENT to 13 ms
SHORTEST_SPENT: Final = 1e-7  # lower edge of the first bin [s]
PER_OCTAVE: Final = 8  # bins for each doubling, so a quantile is exact to 4.4 %
_AT = (("p50", 0.5), ("p99", 0.99), ("p999", 0.999))


@rule
def note_spent(counts: MutableSequence[int], seconds: float) -> None:
    """Count a tick that took `seconds`."""
    place = 0
    if seconds > SHORTEST_SPENT:
        place = min(int(PER_OCTAVE * math.log2(seconds / SHORTEST_SPENT)), BINS - 1)
    counts[place] += 1


def spent_us(counts: Sequence[int]) -> dict[str, float]:
    """Return quantiles (bin centres) and maximum (bin edge) [µs]; empty without ticks."""
    ticks = sum(counts)
    if not ticks:
        return {}

    def edge(place: float) -> float:
        return float(f"{1e6 * SHORTEST_SPENT * 2.0 ** (place / PER_OCTAVE):.3g}")

    below = list(accumulate(counts))
    found = {
        name: edge(
            next(place for place, sum_ in enumerate(below) if sum_ >= part * ticks)
            + 0.5
        )
        for name, part in _AT
    }
    return found | {
        "max": edge(1 + max(place for place, count in enumerate(counts) if count))
    }
