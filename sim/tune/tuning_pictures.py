"""The pictures of a tuning: how well the model follows the recording, the wall that is felt, and what is left of each knock."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from messages.errors import HapticError
from nodes.recording.figure_style import COLOURS, GREY, LINES, MARKERS, styled, threshold
from sim.tune.knocking import LEFT
from sim.tune.tuning_text import number

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WINDOWS = 8
"""Windows of the recording that the picture of the fit shows."""

FALL = 0.8
"""How much of a fall on the wall is drawn [s]."""


def pictures(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Draw what is known: of each picture what it shows, and its PNG in base64."""
    found = [("the model against the recording", _fit(record)), ("the wall that is felt", _felt(record))]
    found.append(("what is left of each knock", _knocks(record)))
    return [(name, _encoded(figure)) for name, figure in found if figure is not None]


def _encoded(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, dpi=110, format="png")
    return base64.b64encode(buffer.getvalue()).decode("ascii")


@styled
def _fit(record: Mapping[str, Any]) -> Figure | None:
    """Draw the first windows of the recording, the model's motion from each one's beginning, and what is left between them."""
    identified = record.get("identified")
    if identified is None or identified["mass_kg"]["value"] is None:
        return None
    from matplotlib.figure import Figure

    from sim.identify.experiment import read
    from sim.identify.identified_text import from_figures
    from sim.identify.identify import followed

    try:
        experiment = read(Path(identified["recording"]), identified["axis"])
    except (HapticError, ValueError, OSError):
        # Removed since, or moved: the report is of what is still there.
        return None
    found = from_figures(identified).anyway()
    starts, positions = followed(experiment, found, WINDOWS)
    figure = Figure(figsize=(8.0, 4.4), layout="constrained")
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=(2.0, 1.0))
    for k, (start, modelled) in enumerate(zip(starts.tolist(), positions, strict=True)):
        time = (start + np.arange(len(modelled))) * experiment.period
        recorded = experiment.position[start : start + len(modelled)]
        named = {"recorded": "recorded", "model": "model"} if k == 0 else {"recorded": "_", "model": "_"}
        top.plot(time, 1e3 * recorded, color=GREY, ls="-", lw=3.0, alpha=0.6, label=named["recorded"])
        top.plot(time, 1e3 * modelled, color=COLOURS[0], ls="-", lw=1.0, label=named["model"])
        bottom.plot(time, 1e6 * (recorded - modelled), color=COLOURS[1], ls="-", lw=0.8)
    top.set(ylabel="position  [mm]", title="the model against the recording, window by window")
    bottom.set(ylabel="left  [µm]", xlabel="time  [s]")
    step = identified["encoder_m"]["value"]
    if step:
        low, high = bottom.get_ylim()
        bottom.set_ylim(min(low, -0.8e6 * step), max(high, 1.2e6 * step))
        threshold(bottom, 0.5e6 * step, "half an encoder step")
        threshold(bottom, -0.5e6 * step, "")
    top.legend()
    return figure


@styled
def _felt(record: Mapping[str, Any]) -> Figure | None:
    """Draw force over depth as the identified device falls on the wall of the law, beside the stiffness felt at rest."""
    if "designed" not in record or "identified" not in record:
        return None
    from matplotlib.figure import Figure

    from sim.design.fall import fallen
    from sim.design.landing import HEIGHTS
    from sim.identify.identified_text import from_figures

    designed, found = record["designed"], from_figures(record["identified"]).anyway()
    if None in (found.mass.value, found.damping.value, found.delay.value):
        return None
    # Nobody holds what falls.
    plant = replace(found.plant(), stiffness=0.0)
    ticks = round(FALL / found.period)
    position, force = fallen(plant, found.period, designed["taps_n_per_m"], HEIGHTS[0], ticks)
    depth = -1e3 * position
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    axes = figure.subplots()
    axes.plot(depth, force, color=COLOURS[0], ls="-", lw=1.0, label="a fall from 10 mm")
    most = max(float(depth.max()), 0.1)
    h1 = designed["h1_n_per_m"]
    axes.plot([0.0, most], [0.0, 1e-3 * most * h1], color=COLOURS[1], ls="--", label=f"at rest: {number(h1, 'N/m')}")
    axes.set_xlim(-0.25 * most, 1.05 * most)
    threshold(axes, 0.0, "surface", vertical=True)
    axes.set(xlabel="depth  [mm]", ylabel="force  [N]", title="the wall that is felt, on the identified device")
    axes.legend(loc="upper left", bbox_to_anchor=(0.02, 0.85))
    return figure


@styled
def _knocks(record: Mapping[str, Any]) -> Figure | None:
    """Draw what is left of each knock against the stiffness; nothing before anything was knocked on."""
    if "predicted" not in record:
        return None
    from matplotlib.figure import Figure

    h1 = record["predicted"]["h1_n_per_m"]
    figure = Figure(figsize=(8.0, 3.6), layout="constrained")
    axes = figure.subplots()
    runs = (
        ("predicted", record["predicted_steps"]["steps"]),
        ("measured", record.get("verified", {}).get("steps")),
    )
    for k, (name, steps) in enumerate(runs):
        if steps:
            stiffness = [h1 * step["factor"] for step in steps]
            look: Any = {"color": COLOURS[k], "ls": LINES[k], "marker": MARKERS[k], "label": name}
            axes.plot(stiffness, [max(step["left"], 1e-3) for step in steps], **look)
    axes.set(
        yscale="log",
        xlabel="stiffness H(1)  [N/m]",
        ylabel="left of a knock  [1]",
        title="what is left of each knock after its window",
    )
    edge = record["predicted"]["edge_linear_h1_n_per_m"]
    axes.set_xlim(right=1.25 * max(axes.get_xlim()[1], edge))
    threshold(axes, LEFT, f"{LEFT:g}: more is no rest")
    threshold(axes, h1, "the law", vertical=True)
    threshold(axes, edge, "pole on the unit circle", vertical=True)
    axes.legend(loc="center left")
    return figure
