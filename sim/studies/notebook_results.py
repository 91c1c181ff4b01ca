"""Results for notebooks: small objects with figures, a plot and a table."""

from __future__ import annotations

import dataclasses
import html
import importlib
import inspect
import io
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from nodes.recording.figure_style import styled

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_LONGEST = 6


class Result:
    """Base of results: dataclasses of figures with units in their names.

    Arrays are the columns of `to_pandas`.
    """

    def figures(self) -> dict[str, Any]:
        """Return the scalar figures by name, with the unit at its end."""
        return {
            name: value
            for name, value in self._fields().items()
            if not isinstance(value, np.ndarray)
        }

    def columns(self) -> dict[str, NDArray[Any]]:
        """Return the arrays by name, with a value per tick or point; empty if all are scalar."""
        return {
            name: value
            for name, value in self._fields().items()
            if isinstance(value, np.ndarray)
        }

    def _fields(self) -> dict[str, Any]:
        # Fields that begin with an underscore are for plot().
        fields = dataclasses.fields(self)  # type: ignore[arg-type]
        return {
            field.name: getattr(self, field.name)
            for field in fields
            if not field.name.startswith("_")
        }

    def plot(self) -> Figure:
        """Plot the figures as bars; a subclass may plot its own picture."""
        return bars(self.figures(), "", type(self).__name__)

    def to_pandas(self) -> Any:
        """Return a table, one row per tick or point, or one row of figures. Needs pandas."""
        flat: dict[str, NDArray[Any]] = {}
        for name, values in self.columns().items():
            flat |= (
                {name: values}
                if values.ndim == 1
                else {f"{name}_{'xyz'[i]}": column for i, column in enumerate(values.T)}
            )
        return pandas().DataFrame(flat or [self.figures()])

    def __str__(self) -> str:
        lines = [
            f"  {name:28} {_short(value)}" for name, value in self.figures().items()
        ]
        count = next((len(values) for values in self.columns().values()), 0)
        lines += [f"  {count} rows of {', '.join(self.columns())}"] if count else []
        return "\n".join([type(self).__name__, *lines])

    # A terminal has no tables, so a result's repr shows its figures.
    __repr__ = __str__

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><th style='text-align:left'>{html.escape(name)}</th>"
            f"<td style='text-align:left'>{html.escape(_short(value))}</td></tr>"
            for name, value in self.figures().items()
        )
        return f"<table><caption>{type(self).__name__}</caption>{rows}</table>"


def pandas() -> Any:
    """Import pandas, which is optional."""
    try:
        return importlib.import_module("pandas")
    except ModuleNotFoundError as error:
        raise ModuleNotFoundError(
            "to_pandas() needs pandas: pip install pandas"
        ) from error


def _short(value: Any) -> str:
    if isinstance(value, bool) or value is None:
        return str(value)
    if isinstance(value, float | np.floating):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        return ", ".join(
            f"{key} {_short(inner)}" for key, inner in list(value.items())[:_LONGEST]
        )
    if isinstance(value, list | tuple):
        more = f", … {len(value) - _LONGEST} more" if len(value) > _LONGEST else ""
        return "[" + ", ".join(_short(inner) for inner in value[:_LONGEST]) + more + "]"
    return str(value)


def bars(values: Mapping[str, Any], label: str, title: str) -> Figure:
    """Plot figures as bars, each labelled with name and unit; non-numbers are left out."""
    known = {
        name: float(value)
        for name, value in values.items()
        if isinstance(value, int | float | np.number)
        and not isinstance(value, bool)
        and np.isfinite(value)
    }
    figure, (axes,) = new_figure(height=max(2.4, 0.3 * len(known)))
    axes.barh(list(known), list(known.values()))
    axes.invert_yaxis()
    if (
        len(known) > 1
        and min(known.values()) > 0.0
        and max(known.values()) > 100.0 * min(known.values())
    ):
        axes.set_xscale("log")
    axes.set(xlabel=label, title=title)
    return figure


@styled
def new_figure(
    rows: int = 1, width: float = 7.0, height: float = 3.2
) -> tuple[Figure, list[Any]]:
    """Return a figure of stacked panels in the project's style; sizes in inches.

    A notebook shows it.
    """
    from matplotlib.figure import Figure

    class Picture(Figure):
        def _repr_png_(self) -> bytes:
            stream = io.BytesIO()
            self.savefig(stream, format="png", dpi=96)
            return stream.getvalue()

    figure = Picture(figsize=(width, height * rows), layout="constrained")
    axes = figure.subplots(rows, 1, squeeze=False, sharex=True)
    return figure, [row[0] for row in axes]


def two_axes(ax: Sequence[Axes] | None, height: float = 2.4) -> tuple[Axes, Axes]:
    """Return two axes, one under the other: those given, or new ones."""
    if ax is None:
        top, below = new_figure(2, height=height)[1]
        return top, below
    if len(ax) != 2:
        raise ValueError(f"ax: {len(ax)} axes, expected two, one under the other")
    return ax[0], ax[1]


def figure_of(axes: Axes) -> Figure:
    """Return the figure of some axes."""
    figure = axes.get_figure(root=True)
    if figure is None:
        raise ValueError("ax: belongs to no figure")
    return figure


def overlay(
    results: Sequence[Result] | Mapping[str, Result], ax: Sequence[Axes] | None = None
) -> Figure:
    """Plot several results in common axes, each under its name.

    Parameters
    ----------
    results : sequence of Result, or mapping of str to Result
        Results whose plots show the same quantities; a mapping names them in the legend.
    ax : sequence of matplotlib.axes.Axes, optional
        Axes to draw in; by default those of a new figure.

    Returns
    -------
    matplotlib.figure.Figure
        The figure.

    Raises
    ------
    TypeError
        If the results have no axes in common, or there are none.
    """
    named: dict[Any, Result] = dict(
        results if isinstance(results, Mapping) else enumerate(results)
    )
    if not named:
        raise TypeError("nothing to plot: an empty list")
    for one in named.values():
        if "ax" not in inspect.signature(one.plot).parameters:
            raise TypeError(
                f"{type(one).__name__} has no plot that others can be drawn over"
            )
    kinds = {type(one): one for one in named.values()}
    panels = {_panels(one.plot()) for one in kinds.values()}
    if len(panels) > 1:
        raise TypeError(
            f"{', '.join(kind.__name__ for kind in kinds)}: no axes in common; plot results of one"
            " kind together"
        )
    count = len(panels.pop())
    axes = (
        list(ax)
        if ax is not None
        else new_figure(count, height=2.4 if count > 1 else 3.2)[1]
    )
    for name, one in named.items():
        before = [len(panel.lines) for panel in axes]
        drawn: Any = one
        drawn.plot(ax=axes if count > 1 else axes[0])
        for panel, seen in zip(axes, before, strict=True):
            _name_lines(panel.lines[seen:], name)
    axes[0].set_title("")
    for panel in axes:
        if panel.get_legend() is not None:
            panel.legend(frameon=False)
    return figure_of(axes[0])


def _name_lines(lines: Sequence[Any], name: Any) -> None:
    """Label new lines by the result's name; a result of a list keeps its own labels."""
    shown = [line for line in lines if not str(line.get_label()).startswith("_")]
    for line in shown if isinstance(name, str) else ():
        line.set_label(name if line is shown[0] else "_" + name)


def _panels(figure: Figure) -> tuple[str, ...]:
    """Return what the panels of a figure show: the first words of their axes' labels."""
    return tuple(axes.get_ylabel().partition(" ")[0] for axes in figure.axes)
