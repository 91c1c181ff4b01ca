"""Report of a tuning on one HTML page: verdict, device, law, predictions, measurements."""

from __future__ import annotations

import base64
import html
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from messages.errors import HapticError
from nodes.recording.figure_style import (
    COLOURS,
    GREY,
    LINES,
    MARKERS,
    new_figure,
    styled,
    threshold,
)
from sim.identify.identified_text import ROWS
from sim.tune.knocking import LEFT
from sim.tune.tuning_text import TextRow, number, sections

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sim.tune.record import TuneRecord


STYLE = (
    ":root{color-scheme:light dark}body{font:15px/1.5"
    " system-ui,sans-serif;max-width:56rem;margin:2rem auto;padding:0 1rem}"
    "table{border-collapse:collapse}td,th{padding:.15rem .8rem .15rem"
    " 0;text-align:left;border-bottom:1px solid #8884;"
    "vertical-align:top}img{max-width:100%}.verdict{font-size:1.2rem;border-left:.4rem solid"
    " #c33;padding-left:.8rem}"
    ".holds{border-color:#393}.by{opacity:.75}img{border-radius:.4rem;margin:.6rem 0}"
    # With a dark colour scheme the background of a picture is dark too; its colours keep their hue.
    "@media(prefers-color-scheme:dark){img{filter:invert(.9) hue-rotate(180deg)}}"
)

# Display unit of small lengths and times, and its number per SI unit.
READ_IN = {"m": ("µm", 1e6), "s": ("ms", 1e3)}


def page(record: TuneRecord) -> str:
    """Return a tuning as a self-contained HTML page."""
    holds = " holds" if record.verified is not None and record.verified.holds else ""
    parts = [
        "<h1>From a device to its law</h1><p"
        f' class="verdict{holds}"><b>{_plain(record.headline)}</b></p>'
    ]
    by = [("device", record.device), ("date", record.date), ("command", record.command)]
    parts.append(
        '<p class="by">'
        + "<br>".join(f"{name}: {_plain(value)}" for name, value in by if value)
        + "</p>"
    )
    if record.interrupted:
        parts.append(
            f"<p><b>Interrupted during {_plain(record.interrupted)}</b>: the report covers "
            "the steps done.</p>"
        )
    if record.not_put_back:
        parts.append(f"<p><b>Not restored</b>: {_plain(record.not_put_back)}</p>")
    if record.identified is not None:
        parts += ["<h2>The device</h2>", _device(record.identified.as_json())]
    for title, rows in sections(record):
        parts += [f"<h2>{title}</h2>", _table(rows)]
    parts += [
        f'<img alt="{name}" src="data:image/png;base64,{picture}">'
        for name, picture in pictures(record)
    ]
    seen = (
        '<meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
    )
    head = f"{seen}<title>haptic tune</title><style>{STYLE}</style>"
    body = "".join(parts)
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{body}</body></html>\n'


def _plain(value: object) -> str:
    return html.escape(str(value))


def _table(rows: Sequence[TextRow]) -> str:
    lines = "".join(
        f"<tr><td>{_plain(name)}</td><td>{_plain(value)}</td></tr>"
        for name, value in rows
    )
    return f"<table>{lines}</table>"


def _interval(low: float, high: float) -> str:
    if math.isclose(low, high, rel_tol=1e-12):
        return "exact"
    # An interval narrower than three digits is shown as a half-width.
    ends = number(low), number(high)
    return (
        f"± {number((high - low) / 2.0)}"
        if ends[0] == ends[1]
        else f"{ends[0]} to {ends[1]}"
    )


def _device(record: Mapping[str, Any]) -> str:
    lines = ["<tr><th></th><th>value</th><th>95 % interval</th><th></th></tr>"]
    for key, _, name, unit in ROWS:
        one = record.get(key)
        # Most sensors do not average.
        if one is None or (key == "sensor_average" and not one["value"]):
            continue
        if one["value"] is None:
            lines.append(
                f"<tr><td>{name}</td><td colspan=3>unknown: {_plain(one['why'])}</td></tr>"
            )
        else:
            shown, factor = READ_IN.get(unit, (unit, 1.0))
            value, low, high = (factor * one[end] for end in ("value", "low", "high"))
            lines.append(
                f"<tr><td>{name}</td><td>{number(value)}</td><td>{_interval(low, high)}</td>"
                f"<td>{shown}</td></tr>"
            )
    refuted = (
        f"<p><b>The recording refutes this model: {_plain(record['why'])}</b></p>"
        if record.get("refuted")
        else ""
    )
    steps = record["residual_steps"]
    ended = f"The push ended: {_plain(record['stopped'])}. "
    residual = f"Residual {number(steps)} encoder steps; rounding alone leaves 0.29."
    left = record.get("remainder") or {}
    if left.get("cause") and not record.get("refuted"):
        share = 100.0 * (left["k_max_change"] or 0.0)
        refuted = (
            f"<p>The recording also shows {_plain(left['cause'])}: it may change K_max by"
            f" {share:.2g} %.</p>"
        )
    return f"{refuted}<table>{''.join(lines)}</table><p>{ended}{residual}</p>"


WINDOWS = 8  # windows of the recording in the picture of the fit
FALL = 0.8  # drawn duration of a fall on the wall [s]


def pictures(record: TuneRecord) -> list[tuple[str, str]]:
    """Draw the pictures of a record; return title and base64 PNG of each."""
    drawn = {
        "the model against the recording": _fit,
        "the rendered wall": _felt,
        "motion left after each knock": _knocks,
    }
    found = [(name, draw(record)) for name, draw in drawn.items()]
    return [(name, _encoded(figure)) for name, figure in found if figure is not None]


def _encoded(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=110, format="png")
    return base64.b64encode(buffer.getvalue()).decode("ascii")


@styled
def _fit(record: TuneRecord) -> Figure | None:
    """Draw the first windows of the recording, the model from each start, and the residual."""
    identified = record.identified
    if identified is None or identified.found.mass.value is None:
        return None
    from sim.identify.experiment import read
    from sim.identify.identify import followed

    try:
        experiment = read(Path(identified.recording), identified.found.axis)
    except (HapticError, ValueError, OSError):
        # Removed or moved since: the report covers what still exists.
        return None
    starts, positions = followed(experiment, identified.found.anyway(), WINDOWS)
    figure = new_figure(8.0, 4.4)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.0, 1.0))
    for k, (start, modelled) in enumerate(zip(starts.tolist(), positions, strict=True)):
        time = (start + np.arange(len(modelled))) * experiment.period
        recorded = experiment.position[start : start + len(modelled)]
        named = (
            {"recorded": "recorded", "model": "model"}
            if k == 0
            else {"recorded": "_", "model": "_"}
        )
        top.plot(
            time,
            1e3 * recorded,
            color=GREY,
            ls="-",
            lw=3.0,
            alpha=0.6,
            label=named["recorded"],
        )
        top.plot(
            time, 1e3 * modelled, color=COLOURS[0], ls="-", lw=1.0, label=named["model"]
        )
        bottom.plot(time, 1e6 * (recorded - modelled), color=COLOURS[1], ls="-", lw=0.8)
    top.set(
        ylabel="position  [mm]",
        title="the model against the recording, window by window",
    )
    bottom.set(ylabel="residual  [µm]", xlabel="time  [s]")
    step = identified.found.encoder.value
    if step:
        low, high = bottom.get_ylim()
        bottom.set_ylim(min(low, -0.8e6 * step), max(high, 1.2e6 * step))
        threshold(bottom, 0.5e6 * step, "half an encoder step")
        threshold(bottom, -0.5e6 * step, "")
    top.legend()
    return figure


@styled
def _felt(record: TuneRecord) -> Figure | None:
    """Draw force over depth for a drop of the identified device, and the static stiffness."""
    if record.designed is None or record.identified is None:
        return None
    from nodes.laws import CompiledLaw
    from sim.design.fall import fallen
    from sim.design.landing import HEIGHTS

    designed = record.designed
    found = record.identified.found.anyway()
    if None in (found.mass.value, found.damping.value, found.delay.value):
        return None
    # The dropped device is not held.
    plant = replace(found.plant(), stiffness=0.0)
    ticks = round(FALL / found.period)
    law = CompiledLaw(designed.taps_n_per_m)
    position, force = fallen(plant, found.period, law, HEIGHTS[0], ticks)
    depth = -1e3 * position
    figure = new_figure(8.0, 3.6)
    axes = figure.subplots()
    axes.plot(depth, force, color=COLOURS[0], ls="-", lw=1.0, label="a fall from 10 mm")
    most = max(float(depth.max()), 0.1)
    h1 = designed.h1_n_per_m
    axes.plot(
        [0.0, most],
        [0.0, 1e-3 * most * h1],
        color=COLOURS[1],
        ls="--",
        label=f"at rest: {number(h1, 'N/m')}",
    )
    axes.set_xlim(-0.25 * most, 1.05 * most)
    threshold(axes, 0.0, "surface", vertical=True)
    axes.set(
        xlabel="depth  [mm]",
        ylabel="force  [N]",
        title="the rendered wall on the identified device",
    )
    axes.legend(loc="upper left", bbox_to_anchor=(0.02, 0.85))
    return figure


@styled
def _knocks(record: TuneRecord) -> Figure | None:
    """Draw the motion left after each knock over the stiffness; None without knocks."""
    if record.predicted is None or record.predicted_steps is None:
        return None
    h1 = record.predicted.h1_n_per_m
    figure = new_figure(8.0, 3.6)
    axes = figure.subplots()
    runs = (
        ("predicted", record.predicted_steps.steps),
        ("measured", () if record.verified is None else record.verified.steps),
    )
    for k, (name, steps) in enumerate(runs):
        if steps:
            stiffness = [h1 * step.factor for step in steps]
            look: Any = {
                "color": COLOURS[k],
                "ls": LINES[k],
                "marker": MARKERS[k],
                "label": name,
            }
            axes.plot(stiffness, [max(step.left, 1e-3) for step in steps], **look)
    axes.set(
        yscale="log", xlabel="stiffness H(1)  [N/m]", ylabel="motion left / knock  [1]"
    )
    axes.set_title("motion left after each knock's window")
    edge = record.predicted.edge_linear_h1_n_per_m
    low, high = axes.get_xlim()
    axes.set_xlim(min(low, 0.8 * h1), 1.25 * max(high, edge))
    # An edge is never below the law, so the labels do not overlap.
    threshold(axes, h1, "the law", vertical=True, before=True)
    threshold(axes, edge, "pole on the unit circle", vertical=True)
    threshold(axes, LEFT, f"{LEFT:g}: above, not at rest")
    if any(steps for _, steps in runs):
        axes.legend(loc="best")
    return figure
