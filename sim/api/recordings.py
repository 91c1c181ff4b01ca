"""Recordings as arrays and pictures."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from sim.studies.notebook_results import Result, bars, new_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, repr=False)
class Recorded(Result):
    """A recording: one row per tick, as ``haptic bag export`` writes them."""

    path: Path  # the file
    scenario: str  # what was launched
    duration_s: float  # from the first to the last stamp [s]
    messages: dict[str, int]  # how many of each topic
    complete: bool  # whether its writer finished it
    _table: dict[str, NDArray[Any]]

    def columns(self) -> dict[str, NDArray[Any]]:
        """List the columns: ``time`` [s], ``position`` [m], ``force`` [N] and so on, as nodes/recording/table.py has them."""
        return self._table

    def __getitem__(self, column: str) -> NDArray[Any]:
        """Read one column, e.g. ``recorded["position"]``."""
        if column not in self._table:
            raise KeyError(f"{column!r} is no column; there are {', '.join(self._table)}")
        return self._table[column]

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._table)

    def plot(self) -> Figure:
        """Draw position, proxy and force of the axis that moves most; ``haptic bag plot`` draws more."""
        time, position, proxy, force = (
            self._table[name] for name in ("time", "position", "proxy", "force")
        )
        axis = int((position.max(axis=0) - position.min(axis=0)).argmax()) if len(position) else 0
        figure, (top, below) = new_figure(2, height=2.2)
        top.plot(time, position[:, axis] * 1e3, label="device")
        top.plot(time, proxy[:, axis] * 1e3, "--", label="proxy")
        top.set(ylabel=f"position {'xyz'[axis]} [mm]", title=self.scenario)
        top.legend(frameon=False)
        below.step(time, force[:, axis], where="post")
        below.set(ylabel=f"force {'xyz'[axis]} [N]", xlabel="time [s]")
        return figure


def read(recording: str | Path) -> Recorded:
    """Read a recording.

    Parameters
    ----------
    recording : str or Path
        An MCAP file of a launch.

    Returns
    -------
    Recorded
        Its columns are numpy arrays.

    Raises
    ------
    nodes.recording.writer.RecordError
        When it is no recording, or is damaged.

    Examples
    --------
    >>> from sim.api.python_runs import launch
    >>> with launch("floor_drop", pace="lockstep", duration=0.4) as run:
    ...     path = run.wait().recording
    >>> read(path)["position"].shape
    (201, 3)
    """
    from nodes.recording import table
    from nodes.recording.reader import Recording

    found = Recording(recording)
    return Recorded(
        Path(recording),
        found.manifest.get("scenario", ""),
        found.duration,
        {topic: figures.messages for topic, figures in found.topics.items()},
        found.complete,
        table.read(recording),
    )


@dataclass(frozen=True, repr=False)
class RunSummary(Result):
    """What a launch reported at its end: the figures of ``haptic launch --json``."""

    scenario: str  # what was launched
    exit_reason: str  # why it ended
    ticks: int  # ticks done
    missed: int  # those whose force was late
    rate_hz: float  # measured [Hz]
    response_us: dict[str, float]  # percentiles of the response time [µs]
    final: dict[str, Any]  # position [m], force [N] and motion at the end
    recording: str | None  # path of the recording
    all: dict[str, Any]  # everything

    def figures(self) -> dict[str, Any]:
        """List the figures that fit on a screen."""
        return {name: value for name, value in super().figures().items() if name != "all"}

    def plot(self) -> Figure:
        """Draw its recording: position and force; without one, the response times."""
        if self.recording is not None and Path(self.recording).exists():
            return read(self.recording).plot()
        return bars(self.response_us, "response time [µs]", self.scenario)


def plot(what: Result | str | Path) -> Figure:
    """Draw a result, or a recording by its path.

    Parameters
    ----------
    what : Result, str or Path
        Anything that `haptic` returned, or a recording's file.

    Returns
    -------
    matplotlib.figure.Figure
        A notebook shows it.

    Examples
    --------
    >>> from sim.api.played import play
    >>> plot(play("floor_drop")).savefig("drop.pdf")
    """
    return what.plot() if isinstance(what, Result) else read(what).plot()
