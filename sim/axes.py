"""Axes of the studies' figures: labels that are readable and do not overlap."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from nodes.recording.figure_style import keep_best

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure
    from matplotlib.patheffects import AbstractPathEffect
    from matplotlib.text import Annotation
    from matplotlib.transforms import BboxBase

# Positions tried for a label relative to its point [points], and its alignment there.
_NEAR = (
    (6, 4, "left"),
    (6, -10, "left"),
    (-6, 4, "right"),
    (-6, -10, "right"),
    (0, 8, "center"),
    (0, -14, "center"),
)
# The same positions farther off, with a line to the point.
_FAR = tuple(
    (distance * x, distance * y, side)
    for distance in (18, 30, 44, 60)
    for x, side in ((1.0, "left"), (-1.0, "right"), (0.0, "center"))
    for y in (1.0, -1.0)
)


def name_points(
    axes: Axes,
    named: Iterable[tuple[str, float, float]],
    taken: list[BboxBase],
    *,
    must: bool,
    size: float,
    color: str,
) -> None:
    """Label points so that no label overlaps another."""
    from matplotlib.patheffects import withStroke
    from matplotlib.text import Text

    inside = axes.get_window_extent()
    # A line that passes behind a label must not cross it out.
    outline: list[AbstractPathEffect] = [withStroke(linewidth=2.5, foreground="white")]
    leader = {"arrowstyle": "-", "color": color, "lw": 0.4}

    def box_of(note: Annotation) -> BboxBase:
        # Places the text; the line to the point is not part of its box.
        note.get_window_extent()
        return Text.get_window_extent(note)

    def cost(note: Annotation) -> float:
        box = box_of(note)
        within = inside.x0 <= box.x0 and box.x1 <= inside.x1
        within = within and inside.y0 <= box.y0 and box.y1 <= inside.y1
        free = within and not any(box.overlaps(other) for other in taken)
        return 0.0 if free else math.inf

    def write(text: str, x: float, y: float) -> Iterator[Annotation]:
        for dx, dy, side in _NEAR + (_FAR if must else ()):
            note = axes.annotate(
                text,
                (x, y),
                xytext=(dx, dy),
                textcoords="offset points",
                ha=side,
                fontsize=size,
                color=color,
                arrowprops=leader if (dx, dy, side) in _FAR else None,
            )
            note.set_in_layout(False)
            note.set_path_effects(outline)
            yield note

    for text, x, y in named:
        note = keep_best(write(text, x, y), cost)
        if note is not None:
            taken.append(box_of(note))


def plain_log(axis: Axis, low: float, high: float) -> None:
    """Label a logarithmic axis with plain numbers 1, 2, 5 of each decade.

    Matplotlib's powers of ten overlap.
    """
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axis.set_major_locator(
        LogLocator(subs=(1.0, 2.0, 5.0) if high < 300.0 * low else (1.0,), numticks=12)
    )
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def legend_below(figure: Figure, panels: Iterable[Axes], columns: int = 5) -> None:
    """Place one legend for all panels below them, each entry once."""
    named: dict[str, Artist] = {}
    for axes in panels:
        for handle, label in zip(*axes.get_legend_handles_labels(), strict=True):
            named.setdefault(label, handle)
    if named:
        figure.legend(
            named.values(),
            named.keys(),
            loc="outside lower center",
            ncols=columns,
            fontsize=8,
            frameon=False,
        )
