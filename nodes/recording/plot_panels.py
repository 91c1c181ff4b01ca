"""Panels of the figure of a run: position, force, energy, response time, receipts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from nodes.base.printable import printable
from nodes.recording.figure_style import COLOURS
from nodes.recording.series import Line, Lines
from nodes.recording.summary import Summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes


COLORS = {
    "device": "#0072B2",
    "asked": "#D55E00",
    "surface": "#8a8f98",
    "late": "#c0262d",
    "switch": "#009E73",
    "mark": "#7b3294",
}
"""Colour of each curve of a plot."""
DPI = 120
_SAFETY = {
    "ramp": "#e8d9a0",
    "damping": "#f2b48a",
    "zero": "#e58c8c",
    "fault": "#c0262d",
    "stopped": "#7a1620",
}
_ROWS = 3
STILL_MM = 1e-6  # a position that changes by less is drawn at rest [mm]
STILL_N = 1e-6  # the same of a force [N]


def _line(
    axes: Axes,
    line: Line,
    column: int,
    begin: float,
    scale: float,
    color: str,
    label: str,
    **style: Any,
) -> None:
    time, values = line.arrays()
    if len(time):
        axes.plot(
            time - begin,
            values[:, column] * scale,
            color=color,
            label=label,
            **{"lw": 1.2, **style},
        )


def draw_position(axes: Axes, lines: Lines, axis: int) -> None:
    """Draw position, proxy and surface of one axis; nothing of them lies beyond the frame."""
    import numpy as np

    time, proxy = lines.proxy.arrays()
    position = lines.position.arrays()[1][:, axis] * 1e3
    shown = np.concatenate((position, proxy[:, axis] * 1e3))
    low = float(np.nanmin(shown))
    high = float(np.nanmax(shown))
    if len(time):
        surface = proxy[:, 3 + axis] * 1e3
        faced = ~np.isnan(surface)
        if faced.any():
            at = time[faced] - lines.begin
            level = surface[faced]
            axes.plot(at, level, color=COLORS["surface"], lw=1.5, label="surface")
            reach = math.copysign(high - low + 1.0, lines.normal[axis])
            axes.fill_between(
                at, level, level - reach, color=COLORS["surface"], alpha=0.18, lw=0
            )
        _line(
            axes, lines.proxy, axis, lines.begin, 1e3, COLORS["asked"], "proxy", ls="--"
        )
    _line(axes, lines.position, axis, lines.begin, 1e3, COLORS["device"], "device")
    margin = 0.06 * (high - low) if high - low > STILL_MM else 1.0
    axes.set_ylim(low - margin, high + margin)
    axes.set_ylabel(f"position {'xyz'[axis]} [mm]")


def draw_positions(axes: Axes, lines: Lines, drawn: Sequence[int]) -> None:
    """Draw position and proxy of several axes; a curved surface has no place in such a panel."""
    for axis in drawn:
        color = COLOURS[axis]
        name = "xyz"[axis]
        _line(
            axes,
            lines.proxy,
            axis,
            lines.begin,
            1e3,
            color,
            f"proxy {name}",
            ls="--",
            lw=0.9,
        )
        _line(axes, lines.position, axis, lines.begin, 1e3, color, f"device {name}")
    axes.set_ylabel("position [mm]")
    widen(axes, up=STILL_MM)


def draw_force(axes: Axes, lines: Lines, drawn: Sequence[int]) -> None:
    """Draw the force handed over along the axes; of a single one also the law's."""
    begin = lines.begin
    alone = len(drawn) == 1
    for axis in drawn:
        color = COLOURS[axis]
        label = f"after limits {'xyz'[axis]}"
        if alone:
            _line(axes, lines.asked, axis, begin, 1.0, COLORS["asked"], "law", lw=0.9)
            color = COLORS["device"]
            label = "after limits"
        _line(axes, lines.force, axis, begin, 1.0, color, label, drawstyle="steps-post")
    axes.set_ylabel(f"force {'xyz'[drawn[0]]} [N]" if alone else "force [N]")
    widen(axes, up=STILL_N)
    _draw_safety(axes, lines)


def _draw_safety(axes: Axes, lines: Lines) -> None:
    named: set[str] = set()
    for kind, low, high in lines.safety.spans():
        label = None if kind in named else f"safety: {kind}"
        named.add(kind)
        color = _SAFETY.get(kind, COLORS["surface"])
        axes.axvspan(
            low - lines.begin,
            high - lines.begin,
            color=color,
            alpha=0.4,
            lw=0,
            label=label,
        )


def draw_energy(axes: Axes, lines: Lines, guard: bool) -> None:
    """Draw the energy that the virtual side gave out, and that of the guard."""
    axes.axhline(0.0, color=COLORS["surface"], lw=0.8)
    _line(
        axes,
        lines.energy,
        0,
        lines.begin,
        1e3,
        COLORS["device"],
        "given out by the virtual side",
    )
    if guard:
        _line(
            axes,
            lines.energy,
            1,
            lines.begin,
            1e3,
            COLORS["asked"],
            "passivity guard: owed (+), in store (−)",
        )
    axes.set_ylabel("energy [mJ]")


def draw_response(axes: Axes, lines: Lines, summary: Summary, realtime: bool) -> None:
    """Draw response times over time, with the period and the missed ticks."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    quantiles = summary.response_us
    label = (
        "p50 {p50:.0f}, p99 {p99:.0f}, max {max:.0f} µs".format(**quantiles)
        if quantiles
        else "no tick answered"
    )
    time, extremes = lines.response.arrays()
    dots = [(at - lines.begin, value * 1e6) for at, value in lines.sampled]
    dots += zip(
        (time - lines.begin).tolist(), (extremes[:, 0] * 1e6).tolist(), strict=True
    )
    at = [dot[0] for dot in dots]
    values = [dot[1] for dot in dots]
    axes.plot(
        at, values, ".", ms=1.6, color=COLORS["device"], label=label, rasterized=True
    )
    axes.set_ylabel("response [µs]")
    axes.set_yscale("log")
    period = 1e6 / summary.rate_hz if realtime and summary.rate_hz > 0.0 else 0.0
    shown = [*values, *([period] if period else [])] or [1.0]
    axes.set_ylim(0.7 * min(shown), 1.4 * max(shown))
    # Over many decades, labels at 2 and 5 would overlap.
    subs = (1.0, 2.0, 5.0) if max(shown) < 200.0 * min(shown) else (1.0,)
    axes.yaxis.set_major_locator(LogLocator(subs=subs, numticks=9))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    if not period:
        return
    axes.axhline(
        period, color=COLORS["late"], lw=1.0, ls="--", label=f"period {period:.0f} µs"
    )
    late = [(low + high) / 2.0 - lines.begin for _, low, high in lines.missed.spans()]
    if late:
        axes.plot(
            late,
            [period] * len(late),
            "v",
            ms=5,
            color=COLORS["late"],
            label=f"missed ({summary.missed})",
        )


def draw_receipts(panels: list[Axes], lines: Lines) -> None:
    """Draw changes of law or parameters and marks; name each on top where there is room."""
    low, high = panels[0].get_xlim()
    taken = [-math.inf] * _ROWS
    colors = {
        "switch": COLORS["switch"],
        "fallback": COLORS["late"],
        "mark": COLORS["mark"],
    }
    marks = [(stamp, "mark", text) for stamp, text in lines.marks]
    for stamp, action, law in sorted([*lines.receipts, *marks], key=lambda one: one[0]):
        color = colors.get(action, COLORS["surface"])
        at = stamp - lines.begin
        for axes in panels:
            axes.axvline(at, color=color, lw=1.0, ls=":")
        name = (law if law and action != "set" else action)[:24]
        # Estimated width of the name on the time axis, at this font size.
        width = (8 * len(name) + 12) / (DPI * 8.6) * (high - low)
        row = next((row for row, end in enumerate(taken) if at >= end), None)
        if row is None or at + width > high:
            continue
        taken[row] = at + width
        place: Any = {
            "xycoords": ("data", "axes fraction"),
            "xytext": (3, 0),
            "textcoords": "offset points",
            "va": "top",
        }
        box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8}
        panels[0].annotate(
            printable(name),
            (at, 0.97 - 0.1 * row),
            fontsize=8,
            color=color,
            parse_math=False,
            bbox=box,
            **place,
        )


def widen(axes: Axes, across: float = 0.0, up: float = 0.0) -> None:
    """Widen limits that span less than `across` and `up`: rounding is drawn as rest."""
    for least, limits, change in (
        (across, axes.get_xlim(), axes.set_xlim),
        (up, axes.get_ylim(), axes.set_ylim),
    ):
        low, high = limits
        if high - low < least:
            middle = 0.5 * (low + high)
            # so wide that its numbers need no power of ten
            change(middle - 1e3 * least, middle + 1e3 * least)


def style(axes: Axes) -> None:
    """Apply grid and margins to a panel and hide unused spines."""
    axes.grid(True, color="#e3e5e8", lw=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.01)
