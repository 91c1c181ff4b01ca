"""How much of a change a hand feels: difference thresholds of the literature, beside which a tolerance of a model is small."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Threshold:
    """A just noticeable difference, as a part of what is felt."""

    quantity: str  # what is felt
    low: float  # smallest that was measured [1]
    high: float  # largest [1]
    source: str  # who measured it
    outcomes: tuple[str, ...]  # outcomes of a scene that it is about


THRESHOLDS = (
    Threshold(
        "force",
        0.07,
        0.10,
        "Jones, Perception 18 (1989) 681; Pang, Tan & Durlach, Perception & Psychophysics 49"
        " (1991) 531",
        ("peak_force", "rest_force", "force"),
    ),
    Threshold(
        "stiffness",
        0.08,
        0.23,
        "Tan et al., Perception & Psychophysics 57 (1995) 495; Jones & Hunter, Experimental Brain"
        " Research 79 (1990) 150",
        ("k_max",),
    ),
)


def tolerances(usual: float, felt: bool) -> Callable[[str], float]:
    """Return the tolerance of each outcome: `usual`, or where `felt`, the smallest difference that a hand notices.

    Outcomes without a threshold (settling, travel, a limit cycle, the proxy) keep `usual`.
    """
    known = (
        {outcome: threshold.low for threshold in THRESHOLDS for outcome in threshold.outcomes}
        if felt
        else {}
    )
    return lambda outcome: known.get(outcome, usual)
