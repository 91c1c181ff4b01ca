"""What a launch reported at its end."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sim.api.notebook_results import Result, bars
from sim.api.recordings import read

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class RunSummary(Result):
    """What a launch reported at its end: the figures of ``haptic launch --json``.

    Attributes
    ----------
    scenario, exit_reason : str
        What was launched, and why it ended.
    ticks, missed : int
        Ticks done, and those whose force was late.
    rate_hz : float
        Measured [Hz].
    response_us : dict of str to float
        Percentiles of the response time [µs].
    final : dict
        Position [m], force [N] and motion at the end.
    recording : str or None
        Path of the recording.
    all : dict
        Everything.
    """

    scenario: str
    exit_reason: str
    ticks: int
    missed: int
    rate_hz: float
    response_us: dict[str, float]
    final: dict[str, Any]
    recording: str | None
    all: dict[str, Any]

    def figures(self) -> dict[str, Any]:
        """List the figures that fit on a screen."""
        return {name: value for name, value in super().figures().items() if name != "all"}

    def plot(self) -> Figure:
        """Draw its recording; without one, the response times.

        Returns
        -------
        matplotlib.figure.Figure
            Position and force, or the percentiles.
        """
        if self.recording is not None and Path(self.recording).exists():
            return read(self.recording).plot()
        return bars(self.response_us, "response time [µs]", self.scenario)
