"""Figure of a run: position and proxy, force, energy, response time, and law changes.

Time is the message stamp from the first tick on: the host's clock in real time, simulated time in
lockstep. If a run ends at rest, position and force are shown until shortly after it came to rest;
the response time is always shown in full.
"""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nodes.base.printable import printable
from nodes.recording.accounts import completeness
from nodes.recording.figure_style import COLOURS, settle_layout
from nodes.recording.reader import Recording
from nodes.recording.series import Line, Lines
from nodes.recording.summary import Summary, summarise
from nodes.recording.writer import RecordError, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLORS = {
    "device": "#0072B2",
    "asked": "#D55E00",
    "surface": "#8a8f98",
    "late": "#c0262d",
    "switch": "#009E73",
    "mark": "#7b3294",
}
"""Colour of each curve of a plot."""

FORMATS = ("png", "svg", "pdf")

DPI = 120

_SAFETY = {
    "ramp": "#e8d9a0",
    "damping": "#f2b48a",
    "zero": "#e58c8c",
    "fault": "#c0262d",
    "stopped": "#7a1620",
}

_ROWS = 3


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
    low, high = float(np.nanmin(shown)), float(np.nanmax(shown))
    if len(time):
        surface = proxy[:, 3 + axis] * 1e3
        faced = ~np.isnan(surface)
        if faced.any():
            at, level = time[faced] - lines.begin, surface[faced]
            axes.plot(at, level, color=COLORS["surface"], lw=1.5, label="surface")
            reach = math.copysign(high - low + 1.0, lines.normal[axis])
            axes.fill_between(
                at, level, level - reach, color=COLORS["surface"], alpha=0.18, lw=0
            )
        _line(
            axes, lines.proxy, axis, lines.begin, 1e3, COLORS["asked"], "proxy", ls="--"
        )
    _line(axes, lines.position, axis, lines.begin, 1e3, COLORS["device"], "device")
    margin = 0.06 * (high - low) or 1.0
    axes.set_ylim(low - margin, high + margin)
    axes.set_ylabel(f"position {'xyz'[axis]} [mm]")


def _draw_positions(axes: Axes, lines: Lines, drawn: Sequence[int]) -> None:
    """Draw position and proxy of several axes; a curved surface has no place in such a panel."""
    for axis in drawn:
        color, name = COLOURS[axis], "xyz"[axis]
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


def _draw_force(axes: Axes, lines: Lines, drawn: Sequence[int]) -> None:
    """Draw the force handed over along the axes; of a single one also the law's."""
    begin, alone = lines.begin, len(drawn) == 1
    for axis in drawn:
        color, label = COLOURS[axis], f"after limits {'xyz'[axis]}"
        if alone:
            _line(axes, lines.asked, axis, begin, 1.0, COLORS["asked"], "law", lw=0.9)
            color, label = COLORS["device"], "after limits"
        _line(axes, lines.force, axis, begin, 1.0, color, label, drawstyle="steps-post")
    axes.set_ylabel(f"force {'xyz'[drawn[0]]} [N]" if alone else "force [N]")
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


def _draw_energy(axes: Axes, lines: Lines, guard: bool) -> None:
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


def _draw_response(axes: Axes, lines: Lines, summary: Summary, realtime: bool) -> None:
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
    at, values = [dot[0] for dot in dots], [dot[1] for dot in dots]
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


def _draw_receipts(panels: list[Axes], lines: Lines) -> None:
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


def end_of(summary: Summary, axes: Sequence[int]) -> str:
    """Return where the device ends, and under which force."""
    place, force = (
        ", ".join(f"{values[axis] * scale:.3f}" for axis in axes)
        for values, scale in ((summary.position_m, 1e3), (summary.force_n, 1.0))
    )
    several = f" ({', '.join('xyz'[axis] for axis in axes)})" if len(axes) > 1 else ""
    return f"ends at {place} mm, {force} N{several}".replace("-", "−")


def _subtitle(
    recording: Recording,
    summary: Summary,
    lines: Lines,
    axes: Sequence[int],
    shown: str,
) -> str:
    """Return two lines of facts: how the run went, and its result."""
    pace = recording.manifest.get("pace", "")
    share = 100.0 * (summary.missed or 0) / summary.ticks if summary.ticks else 0.0
    how_it_went = [
        f"{summary.ticks} ticks at {summary.rate_hz:.6g} Hz"
        + (f", {pace[:20]}" if pace else ""),
        f"missed {summary.missed} ({share:.2g} %)"
        + (f", left out {summary.overruns}" if summary.overruns else ""),
        f"recording {completeness(recording).text}",
    ]
    what_came_of_it = [
        *(["law " + ", ".join(lines.laws)[:50]] if lines.laws else []),
        end_of(summary, axes),
        *([shown] if shown else []),
    ]
    return "\n".join("  ·  ".join(parts) for parts in (how_it_went, what_came_of_it))


def style(axes: Axes) -> None:
    """Apply grid and margins to a panel and hide unused spines."""
    axes.grid(True, color="#e3e5e8", lw=0.7)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    axes.margins(x=0.01)


def head(axes: Axes, title: str, text: str, room: int = 21) -> None:
    """Write title and facts above the topmost panel."""
    pad = room + 14 * len(text.splitlines()) + 5
    axes.set_title(
        printable(title[:70]),
        fontsize=14,
        fontweight="bold",
        loc="left",
        pad=pad,
        parse_math=False,
    )
    place: Any = {
        "xycoords": "axes fraction",
        "xytext": (0, room),
        "textcoords": "offset points",
        "color": "#444a52",
    }
    axes.annotate(
        printable(text),
        (0.0, 1.0),
        fontsize=9,
        linespacing=1.35,
        parse_math=False,
        **place,
    )


def new_figure(height: float) -> Figure:
    """Create an empty figure without a window; `height` in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.0, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def figure_of(
    recording: Recording, start: float | None = None, stop: float | None = None
) -> Figure:
    """Draw a run."""
    whole = Lines(recording, start or 0.0, math.inf if stop is None else stop)
    summary = summarise(recording)
    lines, shown = whole, ""
    if start is None and stop is None:
        length, rest = whole.stop - whole.begin, whole.rest()
        if 0.0 < rest < 0.4 * length:
            lines = Lines(recording, 0.0, 1.25 * rest)
            shown = f"at rest from {rest:.3g} s on: {1.25 * rest:.3g} of {length:.4g} s shown"
    axis = whole.axis
    energy, guard = (
        bool((abs(whole.energy.arrays()[1][:, column]) > 0.0).any())
        for column in (0, 1)
    )
    heights = [1.25, 1.0, *([0.7] if energy else []), 0.9]
    figure = new_figure(1.0 + 2.1 * sum(heights))
    panels = list(figure.subplots(len(heights), 1, height_ratios=heights))
    shared = panels if lines is whole else panels[:-1]
    for axes in shared[1:]:
        axes.sharex(shared[0])
    for axes in shared[:-1]:
        axes.tick_params(labelbottom=False)
    if len(drawn := whole.axes) > 1:
        _draw_positions(panels[0], lines, drawn)
    else:
        draw_position(panels[0], lines, axis)
        drawn = [axis]
    _draw_force(panels[1], lines, drawn)
    if energy:
        _draw_energy(panels[2], lines, guard)
    realtime = recording.manifest.get("pace") != "lockstep"
    _draw_response(panels[-1], whole, summary, realtime)
    for axes in panels:
        style(axes)
        if not axes.get_legend_handles_labels()[0]:
            continue  # nothing is drawn if stamps go backwards
        axes.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 0.99),
            borderaxespad=0.0,
            fontsize=8,
            frameon=False,
            ncols=6,
        )
    _draw_receipts(shared, lines)
    for axes in {shared[-1], panels[-1]}:
        axes.set_xlabel("time [s]" if realtime else "simulated time [s]")
    figure.align_ylabels(panels)
    scenario = recording.manifest.get("scenario", recording.path.stem)
    head(panels[0], scenario, _subtitle(recording, summary, lines, drawn, shown))
    return figure


def render(figure: Figure, form: str) -> bytes:
    """Return a figure as the bytes of a file; this fixes its layout."""
    settle_layout(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format=form)
    return buffer.getvalue()


def form_of(out: Path) -> str:
    """Return the file format from the suffix of a picture's name."""
    form = out.suffix.lower().removeprefix(".") or "png"
    if form not in FORMATS:
        raise RecordError(
            f"{out}: {out.suffix} is not a plot format: .{', .'.join(FORMATS)}"
        )
    return form


def plot(
    recording: Recording,
    out: str | Path,
    *,
    start: float | None = None,
    stop: float | None = None,
    overwrite: bool = False,
) -> Path:
    """Draw a run into a file."""
    form = form_of(Path(out))
    save(Path(out), render(figure_of(recording, start, stop), form), overwrite)
    return Path(out)
