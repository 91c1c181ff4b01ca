"""Counters of an environment whose tick is not compiled."""

from nodes.base.status_report import Counters
from nodes.environment.spent import BINS


class SpentCounters(Counters):
    """Counters of an environment without compiled ticks."""

    def __init__(self) -> None:
        super().__init__()
        self.spent = [0] * BINS
