"""Difference thresholds of force and stiffness, far above a model's tolerance."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Threshold:
    """A just noticeable difference, relative to the stimulus."""

    quantity: str  # quantity felt
    low: float  # smallest measured value [1]
    high: float  # largest [1]
    source: str  # source of the measurement
    outcomes: tuple[str, ...]  # outcomes of a scene to which it applies


# From abstracts: 7 % (Pang et al.); 22 % (Tan et al. 1995, without work and final-force cues); 8
# % with these cues (Tan, Pang & Durlach 1992, as quoted in their paper "Manual resolution of
# compliance when work and force cues are minimized"). The upper ends are from memory.
THRESHOLDS = (
    Threshold(
        "force",
        0.07,
        0.10,
        "7 %: Pang, Tan & Durlach, Perception & Psychophysics 49 (1991) 531; 10 %: Jones,"
        " Perception 18 (1989) 681, quoted from memory, not re-read",
        ("peak_force", "rest_force", "force"),
    ),
    Threshold(
        "stiffness",
        0.08,
        0.23,
        "8 %: Tan, Pang & Durlach (1992), as quoted by its authors; 22 %: Tan et al., Perception &"
        " Psychophysics 57 (1995) 495; 23 %: Jones & Hunter, Experimental Brain Research 79 (1990)"
        " 150, quoted from memory, not re-read",
        ("k_max",),
    ),
)


def tolerances(usual: float, felt: bool) -> Callable[[str], float]:
    """Return the tolerance per outcome: `usual`, or a hand's threshold if `felt`.

    Outcomes without a threshold (settling, travel, limit cycle, proxy) use `usual`.
    """
    known = (
        {outcome: threshold.low for threshold in THRESHOLDS for outcome in threshold.outcomes}
        if felt
        else {}
    )
    return lambda outcome: known.get(outcome, usual)
