"""Figures of several runs: position and force over time, or force over position."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from messages.topics import DEVICE_STATE
from messages.types import DeviceState
from nodes.base.printable import printable
from nodes.recording.figure_style import COLOURS, LINES
from nodes.recording.plot import COLORS, form_of, head, new_figure, render, style
from nodes.recording.reader import Recording
from nodes.recording.series import Line, Lines
from nodes.recording.summary import summarise
from nodes.recording.writer import RecordError, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

RUNS = 10  # limit of runs in one figure, set by distinguishable line styles
_CELLS = 2000


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


def _legend(figure: Figure, axes: Axes, labels: Sequence[str]) -> None:
    handles = axes.get_legend_handles_labels()[0][: len(labels)]
    columns = 2 if len(labels) > 1 and max(map(len, labels)) <= 60 else 1
    place: Any = {"loc": "outside lower left", "ncols": columns, "borderaxespad": 0.5}
    legend = figure.legend(handles, list(labels), fontsize=9, frameon=False, **place)
    legend.set_in_layout(True)
    for text in legend.get_texts():
        text.set_parse_math(False)


def _checked(recordings: Sequence[Recording]) -> None:
    if not 1 <= len(recordings) <= RUNS:
        raise RecordError(f"{len(recordings)} recordings; one picture shows 1 to {RUNS}")


def overlay(
    recordings: Sequence[Recording], start: float | None = None, stop: float | None = None
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
    axis = lines[0].axis
    figure = new_figure(6.6 + 0.12 * len(recordings))
    panels = list(figure.subplots(2, 1, sharex=True))
    labels = _labels(recordings, lines)
    for number, (one, label) in enumerate(zip(lines, labels, strict=True)):
        for axes, line, scale in ((panels[0], one.position, 1e3), (panels[1], one.force, 1.0)):
            time, values = line.arrays()
            axes.plot(
                time - one.begin, values[:, axis] * scale, label=label, **_look(number, len(lines))
            )
    level = _surface(lines[0], axis)
    if level is not None:
        panels[0].axhline(level, color=COLORS["surface"], lw=1.2, ls="--", zorder=1)
    for axes, name in zip(panels, ("position {} [mm]", "force {} [N]"), strict=True):
        axes.set_ylabel(name.format("xyz"[axis]))
        style(axes)
    panels[-1].set_xlabel("time from the first tick [s]")
    figure.align_ylabels(panels)
    _legend(figure, panels[0], labels)
    head(panels[0], f"{len(recordings)} runs", _facts(level), 7)
    return figure


def _surface(lines: Lines, axis: int) -> float | None:
    """Return the first recorded position of the surface [mm]; None without one."""
    values = lines.proxy.arrays()[1][:, 3 + axis]
    seen = values[~np.isnan(values)]
    return float(seen[0]) * 1e3 if len(seen) else None


def _facts(level: float | None) -> str:
    return "" if level is None else f"dashed: the surface, at {level:.4g} mm".replace("-", "−")


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
    cell = [_extent(line, axis) / _CELLS or 1.0 for line in (lines.position, lines.force)]
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


def _extent(line: Line, axis: int) -> float:
    values = line.arrays()[1][:, axis]
    return float(np.ptp(values)) if len(values) else 0.0


def force_over_position(
    recordings: Sequence[Recording], start: float | None = None, stop: float | None = None
) -> Figure:
    """Draw the force handed to the device over the position at the same tick."""
    _checked(recordings)
    ends = start or 0.0, math.inf if stop is None else stop
    lines = [Lines(recording, *ends) for recording in recordings]
    axis = lines[0].axis
    figure = new_figure(6.6 + 0.12 * len(recordings))
    axes = figure.subplots()
    labels = _labels(recordings, lines)
    for number, (recording, one, label) in enumerate(zip(recordings, lines, labels, strict=True)):
        axes.plot(*_trace(recording, one, axis, *ends), label=label, **_look(number, len(lines)))
    level = _surface(lines[0], axis)
    if level is not None:
        axes.axvline(level, color=COLORS["surface"], lw=1.2, ls="--", zorder=1)
    axes.set_xlabel(f"position {'xyz'[axis]} [mm]")
    axes.set_ylabel(f"force {'xyz'[axis]} [N]")
    style(axes)
    _legend(figure, axes, labels)
    facts = [_facts(level)] if level is not None else []
    if len(recordings) == 1:
        end = summarise(recordings[0])
        facts.append(f"ends at {end.position_m[axis] * 1e3:.3f} mm, {end.force_n[axis]:.3f} N")
    head(axes, "Force over position", "  ·  ".join(facts).replace("-", "−"), 7)
    return figure


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
