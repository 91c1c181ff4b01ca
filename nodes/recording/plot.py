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
from nodes.recording.figure_style import settle_layout
from nodes.recording.plot_panels import (
    DPI,
    draw_energy,
    draw_force,
    draw_position,
    draw_positions,
    draw_receipts,
    draw_response,
    style,
)
from nodes.recording.reader import Recording
from nodes.recording.series import Lines
from nodes.recording.summary import Summary, summarise
from nodes.recording.writer import IMPORTED_COLUMNS, MANIFEST, RecordError, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


FORMATS = ("png", "svg", "pdf")


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


def new_figure(height: float, width: float = 10.0) -> Figure:
    """Create an empty figure without a window; sizes in inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def figure_of(
    recording: Recording, start: float | None = None, stop: float | None = None
) -> Figure:
    """Draw a run."""
    whole = Lines(recording, start or 0.0, math.inf if stop is None else stop)
    summary = summarise(recording)
    lines = whole
    shown = ""
    if start is None and stop is None:
        length = whole.stop - whole.begin
        rest = whole.rest()
        if 0.0 < rest < 0.4 * length:
            lines = Lines(recording, 0.0, 1.25 * rest)
            shown = f"at rest from {rest:.3g} s on: {1.25 * rest:.3g} of {length:.4g} s shown"
    axis = whole.axis
    energy, guard = (
        bool((abs(whole.energy.arrays()[1][:, column]) > 0.0).any())
        for column in (0, 1)
    )
    imported = recording.facts(MANIFEST, IMPORTED_COLUMNS, dict[str, str])
    # A table may have no forces, and those of other programs have no response times.
    force = not imported or "force" in imported
    response = not imported or bool(summary.response_us)
    heights = [1.25, *([1.0] * force), *([0.7] * energy), *([0.9] * response)]
    figure = new_figure(1.0 + 2.1 * sum(heights))
    grid = figure.subplots(len(heights), 1, height_ratios=heights, squeeze=False)
    panels = list(grid[:, 0])
    left = iter(panels)
    shared = panels[:-1] if response and lines is not whole else panels
    for axes in shared[1:]:
        axes.sharex(shared[0])
    for axes in shared[:-1]:
        axes.tick_params(labelbottom=False)
    if len(drawn := whole.axes) > 1:
        draw_positions(next(left), lines, drawn)
    else:
        draw_position(next(left), lines, axis)
        drawn = [axis]
    if force:
        draw_force(next(left), lines, drawn)
    if energy:
        draw_energy(next(left), lines, guard)
    realtime = recording.manifest.get("pace") != "lockstep"
    if response:
        draw_response(next(left), whole, summary, realtime)
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
    draw_receipts(shared, lines)
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
