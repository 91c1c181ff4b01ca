"""Recordings as arrays and figures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from sim.studies.notebook_results import Result, figure_of, overlay, two_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


# Names of `Played` for columns of a recording.
_NAMES = {
    "time_s": "time",
    "measured_m": "position",
    "proxy_m": "proxy",
    "force_n": "force",
}


class TickTable(Result):
    """Columns with one row per tick; the base of recorded and of live tables."""

    scenario: str
    _table: dict[str, NDArray[Any]]

    @property
    def label(self) -> str:
        """Name of its curves beside those of others."""
        return self.scenario

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the columns of nodes/recording/table.py, e.g. ``time`` [s], ``position`` [m]."""
        return self._table

    def __getitem__(self, column: str) -> NDArray[Any]:
        """Return one column, e.g. ``recorded["position"]``, also by its name in `Played`."""
        column = _NAMES.get(column, column)
        if column not in self._table:
            raise KeyError(
                f"{column!r} is no column; there are {', '.join(self._table)}"
            )
        return self._table[column]

    def _ipython_key_completions_(self) -> list[str]:
        return list(self._table)

    def plot(self, ax: Sequence[Axes] | None = None) -> Figure:
        """Plot position, proxy and force of the axis that moves most.

        In the two axes `ax` if given, without the proxy. ``haptic bag plot`` plots more.
        """
        time, position, proxy, force = (
            self._table[name] for name in ("time", "position", "proxy", "force")
        )
        axis = (
            int((position.max(axis=0) - position.min(axis=0)).argmax())
            if len(position)
            else 0
        )
        top, below = two_axes(ax, height=2.2)
        name = "device" if ax is None else f"{self.label} {'xyz'[axis]}"
        top.plot(time, position[:, axis] * 1e3, label=name)
        if ax is None:
            top.plot(time, proxy[:, axis] * 1e3, ls="--", label="proxy")
        top.set(
            ylabel=f"position {'xyz'[axis]} [mm]",
            title=self.scenario if ax is None else "",
        )
        top.legend(frameon=False)
        below.step(time, force[:, axis], where="post", label=name)
        below.set(ylabel=f"force {'xyz'[axis]} [N]", xlabel="time [s]")
        return figure_of(top)


@dataclass(frozen=True, repr=False)
class Recorded(TickTable):
    """A recording: one row per tick, as ``haptic bag export`` writes it."""

    path: Path  # path of the file
    scenario: str  # name of the launched scenario
    duration_s: float  # from the first to the last stamp [s]
    messages: dict[str, int]  # number of messages of each topic
    complete: bool  # whether its writer closed it
    marks: tuple[tuple[float, str], ...]  # marks of ``run.mark``: time [s] and text
    not_read: tuple[str, ...]  # topics of other programs
    _table: dict[str, NDArray[Any]]

    @property
    def label(self) -> str:
        """Name of its curves beside those of others: its file's."""
        return self.path.stem


def read(recording: str | Path, **options: Any) -> Recorded:
    """Read a recording, or a table of another program.

    Parameters
    ----------
    recording : str or Path
        MCAP file of a launch, or a CSV, NPZ, MAT or Parquet file.
    **options : object
        Of a table: ``columns={"position": "x", "force": "F", "time": "t"}``, ``units={"position":
        "mm"}``, ``rate`` [Hz], ``axis``, ``ignore_times``, ``decimal_comma``; ``haptic bag import
        --help`` explains them.

    Returns
    -------
    Recorded
        Its columns as numpy arrays.

    Raises
    ------
    nodes.recording.writer.RecordError
        If the file is not a recording, or is damaged.

    Examples
    --------
    >>> from sim.api.launching import launch
    >>> with launch("floor_drop", pace="lockstep", duration=0.4) as run:
    ...     path = run.wait().recording
    >>> read(path)["position"].shape
    (201, 3)
    """
    from nodes.recording import table
    from nodes.recording.facts import marks_of
    from nodes.recording.reader import Recording
    from sim.api.own_data import as_recording

    with as_recording(recording, **options) as path:
        found = Recording(path)
        columns = table.read(path)
        begin = float(columns["stamp"][0])
        return Recorded(
            Path(recording),
            found.manifest.get("scenario", ""),
            found.duration,
            {topic: figures.messages for topic, figures in found.topics.items()},
            found.complete,
            tuple((event.stamp - begin, event.reason) for event in marks_of(found)),
            tuple(found.foreign),
            columns,
        )


def plot(
    what: Result
    | str
    | Path
    | Sequence[Result | str | Path]
    | Mapping[str, Result | str | Path],
) -> Figure:
    """Plot a result, or a recording given by path; several of one kind over each other.

    Parameters
    ----------
    what : Result, str, Path, or a list or mapping of them
        Any result of `haptic`, or the file of a recording. Several are drawn in one figure: plays
        and recordings together, else results of one kind; a mapping names them in the legend.

    Returns
    -------
    matplotlib.figure.Figure
        The figure; a notebook shows it.

    Raises
    ------
    TypeError
        If results of a list have no common axes.

    Examples
    --------
    >>> from sim.api.played import play
    >>> plot(play("floor_drop")).savefig("drop.pdf")
    >>> softer, stiffer = (play("floor_drop", stiffness=k, duration=0.5) for k in (800, 1600))
    >>> len(plot([softer, stiffer]).axes)
    2
    """
    if isinstance(what, Mapping):
        return overlay(
            {
                name: one if isinstance(one, Result) else read(one)
                for name, one in what.items()
            }
        )
    if isinstance(what, list | tuple):
        return overlay([one if isinstance(one, Result) else read(one) for one in what])
    one: Any = what
    found: Figure = (one if isinstance(one, Result) else read(one)).plot()
    return found
