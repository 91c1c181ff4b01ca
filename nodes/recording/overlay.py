"""Figures of several runs: position and force over time, or force over position.

A run is drawn along its own axes only: along another it would be a line that nobody measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from messages.topics import DEVICE_STATE
from messages.types import DeviceState
from nodes.base.printable import printable
from nodes.recording.difference import difference
from nodes.recording.figure_style import COLOURS, LINES, PAGE_WIDTH
from nodes.recording.plot import end_of, form_of, head, new_figure, render
from nodes.recording.plot_panels import COLORS, STILL_MM, STILL_N, style, widen
from nodes.recording.reader import Recording
from nodes.recording.series import Line, Lines
from nodes.recording.summary import summarise
from nodes.recording.table import rows
from nodes.recording.writer import RecordError, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RUNS = 10  # limit of runs in one figure, set by distinguishable line styles
_CELLS = 2000
_ZOOMED = "shown: where a force acts"
# Least force that is shown as felt, of the largest: damping of a stop far from a wall is less.
_FELT = 0.02
# Size of letters [pt] and columns of a legend, until one is no wider than the figure.
_LEGENDS = ((9.0, 2), (9.0, 1), (8.0, 1), (7.0, 1), (6.0, 1))
_SMALLEST = _LEGENDS[-1][0]


def _labels(recordings: Sequence[Recording], lines: Sequence[Lines]) -> list[str]:
    """Return labels for the runs: scenario and law if these differ, else the file name."""
    facts = [
        printable(
            f"{recording.manifest.get('scenario', recording.path.stem)[:24]}, law"
            f" {', '.join(line.laws)[:30] or 'unknown'}"
        )
        for recording, line in zip(recordings, lines, strict=True)
    ]
    if len(set(facts)) == len(facts):
        return facts
    return [
        f"{text}  ({recording.path.stem[-40:]})"
        for text, recording in zip(facts, recordings, strict=True)
    ]


def _look(number: int, count: int) -> dict[str, Any]:
    """Return a unique colour, dash style and width; the first line is the widest."""
    style = LINES[(number + number // len(COLOURS)) % len(LINES)]
    return {
        "color": COLOURS[number % len(COLOURS)],
        "ls": style,
        "lw": 1.0 + 2.5 * (count - 1 - number) / RUNS,
    }


def _legend(figure: Figure, panels: Iterable[Axes], labels: Sequence[str]) -> None:
    """Draw one entry per run, whichever panel it is in."""
    handles: dict[str, Any] = {}
    for axes in panels:
        drawn, names = axes.get_legend_handles_labels()
        handles |= dict(zip(names, drawn, strict=True))
    shown = [label for label in labels if label in handles]
    for size, columns in _LEGENDS:
        if columns > max(1, len(shown)):
            continue
        legend = figure.legend(
            [handles[label] for label in shown],
            shown,
            fontsize=size,
            ncols=columns,
            loc="outside lower left",
            borderaxespad=0.5,
            frameon=False,
        )
        for text in legend.get_texts():
            text.set_parse_math(False)
        if size == _SMALLEST or legend.get_window_extent().width <= figure.bbox.width:
            return
        legend.remove()


def _checked(recordings: Sequence[Recording]) -> None:
    if not 1 <= len(recordings) <= RUNS:
        raise RecordError(
            f"{len(recordings)} recordings; one picture shows 1 to {RUNS}"
        )


def overlay(
    recordings: Sequence[Recording],
    start: float | None = None,
    stop: float | None = None,
) -> Figure:
    """Draw position and force of several runs, each from its first state on."""
    _checked(recordings)
    lines = [
        Lines(recording, start or 0.0, math.inf if stop is None else stop)
        for recording in recordings
    ]
    if start is None and stop is None:
        rest = 1.25 * max(one.rest() for one in lines)
        if 0.0 < rest < 0.5 * max(one.stop - one.begin for one in lines):
            lines = [Lines(recording, 0.0, rest) for recording in recordings]
    drawn = sorted({axis for one in lines for axis in one.axes})
    first = set(lines[0].axes)
    compared = [n for n, one in enumerate(lines) if n and first & set(one.axes)]
    rows = 3 if compared else 2
    figure = new_figure(2.3 * rows + 0.12 * len(recordings), PAGE_WIDTH)
    grid = figure.subplots(rows, len(drawn), sharex=True, squeeze=False)
    labels = _labels(recordings, lines)
    for column, axis in enumerate(drawn):
        _draw_runs(list(grid[:, column]), lines, labels, axis)
    if compared:
        _draw_differences(grid[2], recordings, lines, compared, drawn)
    for panels in grid.T:
        for axes in panels:
            style(axes)
        # A label that is wider than its panel would be cut at the frame.
        panels[-1].set_xlabel(
            "time from the first tick [s]" if len(drawn) == 1 else "time [s]"
        )
    figure.align_ylabels(list(grid[:, 0]))
    _legend(figure, grid[0], labels)
    levels = _levels(lines, drawn[0]) if len(drawn) == 1 else []
    head(grid[0][0], f"{len(recordings)} runs", _facts(levels), 7)
    return figure


def _draw_runs(
    panels: Sequence[Axes], lines: Sequence[Lines], labels: Sequence[str], axis: int
) -> None:
    """Draw position and force along one axis, of the runs that have it."""
    for number, (one, label) in enumerate(zip(lines, labels, strict=True)):
        if axis not in one.axes:
            continue
        for axes, line, scale in (
            (panels[0], one.position, 1e3),
            (panels[1], one.force, 1.0),
        ):
            time, values = line.arrays()
            axes.plot(
                time - one.begin,
                values[:, axis] * scale,
                label=label,
                **_look(number, len(lines)),
            )
    for level in _levels(lines, axis):
        panels[0].axhline(level, color=COLORS["surface"], lw=1.2, ls="--", zorder=1)
    panels[0].set_ylabel(f"position {'xyz'[axis]} [mm]")
    panels[1].set_ylabel(f"force {'xyz'[axis]} [N]")
    widen(panels[0], up=STILL_MM)
    widen(panels[1], up=STILL_N)


def _draw_differences(
    panels: Sequence[Axes],
    recordings: Sequence[Recording],
    lines: Sequence[Lines],
    compared: Sequence[int],
    drawn: Sequence[int],
) -> None:
    """Draw how far runs are from the first, along the axes of both, in µm or mm."""
    first = recordings[0]
    found = {n: difference(recordings[n], lines[n], first).arrays() for n in compared}
    far = max(
        (np.nanmax(np.abs(x[:, drawn]), initial=0.0) for _, x in found.values()),
        default=0.0,
    )
    unit, scale = ("mm", 1e3) if far >= 1e-3 else ("µm", 1e6)
    for axes, axis in zip(panels, drawn, strict=True):
        axes.set_ylabel(f"{'xyz'[axis]} minus the first [{unit}]")
        for number, (time, values) in found.items():
            if axis in lines[0].axes and axis in lines[number].axes:
                axes.plot(
                    time - lines[number].begin,
                    values[:, axis] * scale,
                    **_look(number, len(lines)),
                )
        _end_difference(axes, scale)


def _end_difference(axes: Axes, scale: float) -> None:
    """Write into a panel without a difference why it has none; show no rounding in others."""
    if axes.lines:
        widen(axes, up=STILL_MM * 1e-3 * scale)
        return
    axes.set_yticks([])
    place: Any = {"ha": "center", "va": "center", "color": "#444a52", "fontsize": 9}
    axes.text(
        0.5, 0.5, "none but one run\nhas this axis", transform=axes.transAxes, **place
    )


def _levels(lines: Sequence[Lines], axis: int) -> list[float]:
    """Return the positions of flat surfaces across an axis [mm], each once."""
    found = [one.level(axis) for one in lines if axis in one.axes]
    return sorted({round(level * 1e3, 6) for level in found if level is not None})


def _facts(levels: Sequence[float]) -> str:
    if not levels:
        return ""
    places = ", ".join(f"{level:.4g}" for level in levels)
    return f"dashed: the surface, at {places} mm".replace("-", "−")


def _pairs(
    recording: Recording, start: float, stop: float
) -> Iterator[tuple[DeviceState, DeviceState]]:
    """Yield each state with the next one, which holds the force handed over at this tick."""
    before: DeviceState | None = None
    begin = recording.topics[DEVICE_STATE].first_stamp
    for entry in recording.entries([DEVICE_STATE]):
        state = entry.message
        if not isinstance(state, DeviceState):
            continue
        if (
            before is not None
            and state.seq == before.seq + 1
            and start <= before.stamp - begin <= stop
        ):
            yield before, state
        before = state


def _trace(
    recording: Recording, lines: Lines, axis: int, start: float, stop: float
) -> tuple[list[float], list[float]]:
    """Return position [mm] and force [N], drawing each move between grid cells once.

    So an hour at rest is one point.
    """
    cell = [
        _extent(line, axis) / _CELLS or 1.0 for line in (lines.position, lines.force)
    ]
    x: list[float] = []
    y: list[float] = []
    seen: set[tuple[int, int, int, int]] = set()
    at: tuple[int, int] | None = None
    drawing = False
    last = (math.nan, math.nan)
    for state, following in _pairs(recording, start, stop):
        point = (state.position[axis], following.force[axis])
        here = (int(point[0] / cell[0]), int(point[1] / cell[1]))
        way = (*(at or here), *here)
        if way not in seen:
            seen.add(way)
            if not drawing:
                x += [math.nan, last[0] * 1e3]
                y += [math.nan, last[1]]
            x.append(point[0] * 1e3)
            y.append(point[1])
        drawing = x[-1:] == [point[0] * 1e3]
        at, last = here, point
    return x, y


def sight_of(
    traces: Sequence[tuple[Sequence[float], Sequence[float]]],
) -> tuple[float, float] | None:
    """Return the positions [mm] where forces act, with a margin; None if that is most of all.

    The way to a wall is no part of what is felt there, and often twenty times as long.
    """
    places = [x for xs, _ in traces for x in xs if math.isfinite(x)]
    every = [abs(y) for _, ys in traces for y in ys if math.isfinite(y)]
    least = _FELT * max(every, default=0.0)
    felt = [
        x
        for xs, ys in traces
        for x, y in zip(xs, ys, strict=True)
        if math.isfinite(x) and abs(y) > least
    ]
    if not felt:
        return None
    low = min(felt)
    high = max(felt)
    margin = 0.25 * (high - low)
    if high - low + 2.0 * margin >= 0.6 * (max(places) - min(places)):
        return None
    return low - margin, high + margin


def _show_where_felt(
    axes: Axes, traces: Sequence[tuple[Sequence[float], Sequence[float]]]
) -> bool:
    """Limit a panel to where forces act. Return whether that is a part of it."""
    sight = sight_of(traces)
    if sight is not None:
        axes.set_xlim(*sight)
    return sight is not None


def _extent(line: Line, axis: int) -> float:
    values = line.arrays()[1][:, axis]
    return float(np.ptp(values)) if len(values) else 0.0


def force_over_position(
    recordings: Sequence[Recording],
    start: float | None = None,
    stop: float | None = None,
) -> Figure:
    """Draw the force handed to the device over the position at the same tick."""
    _checked(recordings)
    ends = start or 0.0, math.inf if stop is None else stop
    lines = [Lines(recording, *ends) for recording in recordings]
    labels = _labels(recordings, lines)
    figure = new_figure(4.6 + 0.12 * len(recordings), PAGE_WIDTH)
    drawn = sorted({axis for one in lines for axis in one.axes})
    if any(len(one.axes) > 1 for one in lines) and all(
        any(one.normal) for one in lines
    ):
        grid = [figure.subplots()]
        traces = []
        for number, (recording, one) in enumerate(zip(recordings, lines, strict=True)):
            traces.append(_along_the_normal(recording, *ends, one.begin))
            look = _look(number, len(lines))
            grid[0].plot(*traces[-1], label=labels[number], **look)
        zoomed = _show_where_felt(grid[0], traces)
        grid[0].axvline(0.0, color=COLORS["surface"], lw=1.2, ls="--", zorder=1)
        grid[0].set_xlabel("distance along the normal [mm]")
        grid[0].set_ylabel("force along the normal [N]")
        facts = ["dashed: the surface", "only ticks at which a surface was near"]
        facts += [_ZOOMED] if zoomed else []
    else:
        grid = list(figure.subplots(1, len(drawn), squeeze=False)[0])
        zoomed = False
        for axes, axis in zip(grid, drawn, strict=True):
            traces = []
            for number, (recording, one) in enumerate(
                zip(recordings, lines, strict=True)
            ):
                if axis in one.axes:
                    traces.append(_trace(recording, one, axis, *ends))
                    look = _look(number, len(lines))
                    axes.plot(*traces[-1], label=labels[number], **look)
            zoomed |= _show_where_felt(axes, traces)
            for level in _levels(lines, axis):
                axes.axvline(level, color=COLORS["surface"], lw=1.2, ls="--", zorder=1)
            axes.set_xlabel(f"position {'xyz'[axis]} [mm]")
            axes.set_ylabel(f"force {'xyz'[axis]} [N]")
            widen(axes, STILL_MM, STILL_N)
            if len(drawn) > 1:
                axes.locator_params(axis="x", nbins=6 - len(drawn))
        levels = _levels(lines, drawn[0]) if len(drawn) == 1 else []
        facts = [_facts(levels)] if levels else []
        if zoomed:
            facts.append(_ZOOMED)
        if len(recordings) == len(drawn) == 1:
            facts.append(end_of(summarise(recordings[0]), drawn))
    for axes in grid:
        style(axes)
    _legend(figure, grid, labels)
    head(grid[0], "Force over position", "  ·  ".join(facts), 7)
    return figure


def _along_the_normal(
    recording: Recording, start: float, stop: float, begin: float
) -> tuple[list[float], list[float]]:
    """Return distance [mm] and force [N] along the normal of each tick, NaN without one."""
    x: list[float] = []
    y: list[float] = []
    for state, following, proxy, _ in rows(recording):
        if not start <= state.stamp - begin <= stop:
            continue
        if following is None or proxy is None or not any(proxy.normal):
            point = (math.nan, math.nan)
        else:
            force = math.fsum(
                f * n for f, n in zip(following.force, proxy.normal, strict=True)
            )
            point = (proxy.distance * 1e3, force)
        # At rest, and off any surface, every tick is the same point.
        if x:
            same = point == (x[-1], y[-1])
            away = math.isnan(point[0]) and math.isnan(x[-1])
            if same or away:
                continue
        x.append(point[0])
        y.append(point[1])
    return x, y


def plot_several(
    recordings: Sequence[Recording],
    out: str | Path,
    *,
    over_position: bool = False,
    start: float | None = None,
    stop: float | None = None,
    overwrite: bool = False,
) -> Path:
    """Draw several runs into one file."""
    form = form_of(Path(out))
    draw = force_over_position if over_position else overlay
    save(Path(out), render(draw(recordings, start, stop), form), overwrite)
    return Path(out)
