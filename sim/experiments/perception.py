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


# Every value stands in an abstract that was read: 7 % of 2.5 to 10 N between thumb and finger; 8,
# 11 and 13 % at shoulder, wrist and elbow; 22 % without cues of work and final force. 8 % with
# these cues is their authors' own, as their paper "Manual resolution of compliance when work and
# force cues are minimized" quotes it. Often cited beside them and not read: Jones, Perception 18
# (1989) 681, for force (10 %, elsewhere quoted as 7 %); Jones & Hunter, Experimental Brain Research
# 79 (1990) 150, for stiffness (23 %).
THRESHOLDS = (
    Threshold(
        "force",
        0.07,
        0.13,
        "7 %: Pang, Tan & Durlach, Perception & Psychophysics 49 (1991) 531; 8 to 13 %: Feyzabadi"
        " et al., IEEE Trans. Haptics 6 (2013) 309, doi:10.1109/TOH.2013.4",
        ("peak_force", "rest_force", "force"),
    ),
    Threshold(
        "stiffness",
        0.08,
        0.22,
        "8 %: Tan, Pang & Durlach (1992), as quoted by its authors; 22 %: Tan et al., Perception &"
        " Psychophysics 57 (1995) 495; not read: 23 %, Jones & Hunter, Experimental Brain Research"
        " 79 (1990) 150",
        ("k_max",),
    ),
)


def tolerances(usual: float, felt: bool) -> Callable[[str], float]:
    """Return the tolerance per outcome: `usual`, or a hand's threshold if `felt`.

    Outcomes without a threshold (settling, travel, limit cycle, proxy) use `usual`.
    """
    known = (
        {
            outcome: threshold.low
            for threshold in THRESHOLDS
            for outcome in threshold.outcomes
        }
        if felt
        else {}
    )
    return lambda outcome: known.get(outcome, usual)
