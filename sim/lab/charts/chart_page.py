"""The readable chart: figures as PNG, PDF and SVG, and one page that interprets them.

Every statement of the page is computed from the points, so it is valid on any machine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nodes.recording.figure_style import (
    COLOURS,
    GREY,
    INK,
    LINES,
    MARKERS,
    new_figure,
    save_figure,
    styled,
    typeset,
)
from sim.axes import name_points
from sim.lab.charts.conclusions import best_members, conclusions, realisations
from sim.lab.charts.points import Group, Point
from sim.results import fresh

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.transforms import BboxBase

_FLOOR = 1e-16
_FRONT, _REST, _SEED = COLOURS[0], "#B9BEC5", COLOURS[1]


@styled
def draw(group: Group, folder: Path) -> Path:
    """Draw one group: all points, the labelled front, and the paper's Grünwald–Letnikov."""
    figure = new_figure(7.2, 4.6)
    axes = figure.add_subplot()
    shown = [
        p for p in group.points if math.isfinite(p.error) and math.isfinite(p.cost)
    ]
    words = {
        "title": group.title,
        "xlabel": group.cost_label,
        "ylabel": group.error_label,
    }
    axes.set(xscale="log", **{place: typeset(told) for place, told in words.items()})
    lowest = min((p.error for p in shown if p.error > 0.0), default=1e-3)
    floor = max(_FLOOR, 0.3 * lowest) if any(p.error <= 0.0 for p in shown) else _FLOOR
    if group.linear:
        floor = 0.0
    else:
        axes.set_yscale("log")
    if group.families:
        _by_family(axes, shown, floor)
    kinds = ((False, _REST, 18, "beaten"), (True, _FRONT, 36, "Pareto front"))
    for front, colour, size, label in () if group.families else kinds:
        points = [p for p in shown if p.on_front is front and p.family != "gl"]
        axes.scatter(
            [p.cost for p in points],
            [max(p.error, floor) for p in points],
            s=size,
            c=colour,
            label=label,
            zorder=3,
        )
    classic = [p for p in shown if p.family == "gl"]
    if classic:
        look: dict[str, Any] = {
            "color": _SEED,
            "ms": 5,
            "lw": 1,
            "label": "GL (paper)",
            "zorder": 4,
        }
        axes.plot(
            [p.cost for p in classic],
            [max(p.error, floor) for p in classic],
            "s--",
            **look,
        )
    best = [p for p in shown if p.on_front]
    if not group.families:
        axes.step(
            [p.cost for p in best],
            [max(p.error, floor) for p in best],
            where="post",
            color=_FRONT,
            lw=1,
            alpha=0.6,
        )
    _ticks(axes, max(p.cost for p in shown) / min(p.cost for p in shown))
    legend = axes.legend()
    figure.draw_without_rendering()
    taken: list[BboxBase] = [legend.get_window_extent(), *_dots(axes, shown, floor)]
    named_ones = (
        ((shown, False, 7.0, INK),)
        if group.families
        else ((best, True, 7.0, _FRONT), (_beaten(shown), False, 6.0, GREY))
    )
    for some, must, letters, ink in named_ones:
        named = [
            (p.name if p.error > 0.0 else f"{p.name} (0)", p.cost, max(p.error, floor))
            for p in some
        ]
        name_points(axes, named, taken, must=must, size=letters, color=ink)
    return save_figure(figure, folder / f"chart_{group.name}.png", fresh)


def _by_family(axes: Axes, points: Sequence[Point], floor: float) -> None:
    """Draw each family as a line with its own colour, style and marker."""
    for i, family in enumerate(dict.fromkeys(p.family for p in points)):
        mine = [p for p in points if p.family == family]
        look: dict[str, Any] = {
            "color": COLOURS[i],
            "marker": MARKERS[i],
            "ls": LINES[i],
            "ms": 5,
            "lw": 1,
            "zorder": 3,
        }
        axes.plot(
            [p.cost for p in mine],
            [max(p.error, floor) for p in mine],
            label=family,
            **look,
        )


def _ticks(axes: Axes, span: float) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter

    axes.xaxis.set_major_formatter("{x:g}")
    if span < 100.0:
        # Less than two decades have too few powers of ten as labels.
        axes.xaxis.set_minor_locator(LogLocator(subs=(2.0, 3.0, 5.0)))
        axes.xaxis.set_minor_formatter("{x:g}")
    else:
        axes.xaxis.set_minor_formatter(NullFormatter())


def _dots(axes: Axes, points: Sequence[Point], floor: float) -> list[BboxBase]:
    """Return the boxes of the dots [pixel], which labels avoid."""
    from matplotlib.transforms import Bbox

    found: list[BboxBase] = []
    for point in points:
        x, y = axes.transData.transform((point.cost, max(point.error, floor)))
        half = 4.0 if point.on_front else 2.0
        found.append(Bbox.from_extents(x - half, y - half, x + half, y + half))
    return found


def _beaten(points: Sequence[Point]) -> list[Point]:
    """Return the best member of every family that has none on the front."""
    ahead = {p.family for p in points if p.on_front}
    return [
        point for family, point in best_members(points).items() if family not in ahead
    ]


def page(groups: Sequence[Group], machine: dict[str, Any], seconds: float) -> str:
    """Return the page that interprets the chart."""
    text = [
        "# Speed against accuracy",
        "",
        (
            "Every choice is a dot: to the left is cheaper, down is better. The joined, named dots"
            " are the Pareto front; each other dot is worse than one of them in both respects."
            " Redraw it with `haptic study chart`."
        ),
        "",
        "## In short",
        "",
        *[f"{i}. {line}" for i, line in enumerate(conclusions(groups), 1)],
        "",
        (
            f"Measured on {machine['cpu']} ({machine['cores']} cores, {machine['system']}, Python"
            f" {machine['python']}, numpy {machine['numpy']}, numba {machine['numba']}, load"
            f" {machine['load_1min']}) in {seconds:.0f} s. Times are medians of interleaved rounds;"
            " the quartiles are in `chart.csv`."
        ),
    ]
    text += realisations(groups)
    for group in groups:
        text += [
            "",
            f"## {group.title}",
            "",
            f"![{group.title}](chart_{group.name}.png)",
            "",
            group.note,
            "",
        ]
        text += [
            f"| on the front | {group.cost_label} | {group.error_label} |",
            "| --- | --- | --- |",
        ]
        text += [
            f"| {p.name} | {p.cost:.3g} | {p.error:.3g} |"
            for p in group.points
            if p.on_front
        ]
    return "\n".join(text) + "\n"
