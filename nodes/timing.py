"""Counting response times: one bin per microsecond, so that percentiles of any length of run cost no memory."""

from __future__ import annotations

from array import array

BINS = 50_000


class ResponseTimes:
    """A histogram of response times.

    Attributes
    ----------
    count : int
        Ticks that were answered.
    longest : float
        Longest response [s].
    """

    def __init__(self) -> None:
        self._bins = array("Q", [0]) * (BINS + 1)
        self.count = 0
        self.longest = 0.0

    def add(self, response: float) -> None:
        """Count one response.

        Parameters
        ----------
        response : float
            From publishing the state to receiving its answer [s].
        """
        bin_ = int(response * 1e6)
        self._bins[bin_ if bin_ < BINS else BINS] += 1
        self.count += 1
        if response > self.longest:
            self.longest = response

    def percentile(self, share: float) -> float:
        """Find the response that a share of the ticks did not exceed.

        Parameters
        ----------
        share : float
            0 to 1.

        Returns
        -------
        float
            Upper edge of the bin, to the microsecond, but never more than the longest response [s]; 0 without any ticks.
        """
        if self.count == 0:
            return 0.0
        wanted = share * self.count
        seen = 0
        for bin_, number in enumerate(self._bins):
            seen += number
            if number and seen >= wanted and bin_ < BINS:
                return min((bin_ + 1) * 1e-6, self.longest)
        return self.longest

    def summary_us(self) -> dict[str, float]:
        """Summarise in microseconds.

        Returns
        -------
        dict of str to float
            ``p50 p99 p999 max``.
        """
        shares = {"p50": 0.5, "p99": 0.99, "p999": 0.999}
        figures = {name: round(self.percentile(share) * 1e6, 1) for name, share in shares.items()}
        return {**figures, "max": round(self.longest * 1e6, 1)}
