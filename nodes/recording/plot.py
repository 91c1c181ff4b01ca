"""A picture of a run from its recording: position and proxy, force, response time, and when the law changed.

Time is the stamp of the messages from the first tick on: the host's clock in real time, simulated time in lockstep.
"""

from __future__ import annotations

import io
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.topics import DEVICE_STATE, FORCE, PROXY, RECEIPT
from nodes.recording.reader import Recording
from nodes.recording.summary import Summary, summarise
from nodes.recording.writer import RecordError, save

if TYPE_CHECKING:
    import numpy as np
    from matplotlib.axes import Axes

    Array = np.ndarray[Any, Any]
    Arrays = dict[str, Array]

POINTS = 4000
"""Longest line that is drawn as it is; longer ones keep the extremes of each stretch."""

COLORS = {
    "device": "#1f5fa8",
    "asked": "#d9730d",
    "surface": "#8a8f98",
    "late": "#c0262d",
    "switch": "#2b8a57",
}
"""What each colour of a plot stands for."""

_SAFETY = {"ramp": "#e8d9a0", "damping": "#f2b48a", "zero": "#e58c8c", "fault": "#c0262d"}


def thin(time: Array, value: Array) -> tuple[Array, Array]:
    """Keep the smallest and the largest value of each stretch of a long line, so that no spike is lost.

    Parameters
    ----------
    time, value : numpy.ndarray, shape (N,)
        The line.

    Returns
    -------
    tuple of numpy.ndarray
        At most POINTS of its points, in their order.
    """
    import numpy as np

    if len(value) <= POINTS:
        return time, value
    edges = np.linspace(0, len(value), POINTS // 2 + 1).astype(int)
    stretches = [value[low:high] for low, high in pairwise(edges)]
    picked = [low + find(part) for low, part in zip(edges, stretches, strict=False) for find in (np.argmin, np.argmax)]
    index = np.unique(picked)
    return time[index], value[index]


def main_axis(proxy: Arrays | None, position: Array) -> int:
    """Choose the axis to draw: the one that the surface faces, or else the one with the largest motion.

    Parameters
    ----------
    proxy : dict of str to numpy.ndarray or None
        Arrays of the proxy topic.
    position : numpy.ndarray, shape (N, 3)
        Device positions [m].

    Returns
    -------
    int
        0, 1 or 2 for x, y, z.
    """
    import numpy as np

    if proxy is not None and np.any(proxy["normal"]):
        return int(np.argmax(np.abs(proxy["normal"]).max(axis=0)))
    motion = np.ptp(position, axis=0)
    return int(np.argmax(motion)) if motion.any() else 2


def _line(axes: Axes, time: Array, value: Array, color: str, label: str, **style: Any) -> None:
    axes.plot(*thin(time, value), color=color, label=label, **{"lw": 1.2, **style})


def _draw_position(axes: Axes, state: Arrays, proxy: Arrays | None, axis: int, start: float) -> None:
    import numpy as np

    if proxy is not None:
        time = proxy["stamp"] - start
        normal = proxy["normal"][:, axis]
        faced = normal != 0.0
        if faced.any():
            surface = (proxy["position"][:, axis] - proxy["distance"] * normal)[faced] * 1e3
            at, level = thin(time[faced], surface)
            axes.plot(at, level, color=COLORS["surface"], lw=1.5, label="surface")
            reach = np.ptp(state["position"][:, axis]) * 1e3 + 1e-3
            axes.fill_between(at, level, level - normal[faced][0] * reach, color=COLORS["surface"], alpha=0.18, lw=0)
        _line(axes, time, proxy["proxy"][:, axis] * 1e3, COLORS["asked"], "proxy", ls="--")
    position = state["position"][:, axis] * 1e3
    _line(axes, state["stamp"] - start, position, COLORS["device"], "device")
    margin = 0.06 * float(np.ptp(position)) or 1.0
    axes.set_ylim(float(position.min()) - margin, float(position.max()) + margin)
    axes.set_ylabel(f"position {'xyz'[axis]} [mm]")


def _draw_force(axes: Axes, state: Arrays, force: Arrays | None, axis: int, start: float) -> None:
    if force is not None:
        _line(axes, force["stamp"] - start, force["force"][:, axis], COLORS["asked"], "law", lw=0.9)
    # A state tells the force handed over when the tick before it closed.
    handed = state["force"][1:, axis]
    _line(axes, state["stamp"][:-1] - start, handed, COLORS["device"], "after limits", drawstyle="steps-post")
    axes.set_ylabel(f"force {'xyz'[axis]} [N]")
    time = state["stamp"] - start
    safety = state["safety"]
    changes = [0, *((safety[1:] != safety[:-1]).nonzero()[0] + 1).tolist(), len(safety)]
    named: set[str] = set()
    for low, high in pairwise(changes):
        kind = str(safety[low])
        # Waiting for the first force is how every run begins.
        if kind in ("active", "waiting"):
            continue
        label = None if kind in named else f"safety: {kind}"
        named.add(kind)
        end = time[min(high, len(time) - 1)]
        axes.axvspan(time[low], end, color=_SAFETY.get(kind, COLORS["surface"]), alpha=0.4, lw=0, label=label)


def _draw_energy(axes: Axes, state: Arrays, start: float) -> None:
    axes.axhline(0.0, color=COLORS["surface"], lw=0.8)
    _line(axes, state["stamp"] - start, state["energy"] * 1e3, COLORS["device"], "given out by the virtual side")
    if state["guard"].any():
        guarded = state["guard"] * 1e3
        _line(axes, state["stamp"] - start, guarded, COLORS["asked"], "passivity guard: owed (+), in store (−)")
    axes.set_ylabel("energy [mJ]")


def _draw_response(axes: Axes, state: Arrays, summary: Summary, realtime: bool, start: float) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    # Each state tells how the tick before it went.
    time = state["stamp"][:-1] - start
    response = state["response"][1:] * 1e6
    answered = response > 0.0
    told = summary.response_us
    label = f"p50 {told['p50']:.0f}, p99 {told['p99']:.0f}, max {told['max']:.0f} µs" if told else "no tick answered"
    axes.plot(time[answered], response[answered], ".", ms=1.6, color=COLORS["device"], label=label, rasterized=True)
    axes.set_ylabel("response [µs]")
    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    period = 1e6 / summary.rate_hz if realtime and summary.rate_hz > 0.0 else 0.0
    shown = [*response[answered].tolist(), *([period] if period else [])]
    if shown:
        axes.set_ylim(0.7 * min(shown), 1.4 * max(shown))
    if not period:
        return
    axes.axhline(period, color=COLORS["late"], lw=1.0, ls="--", label=f"period {period:.0f} µs")
    late = (state["missed"][1:] > state["missed"][:-1]).nonzero()[0]
    if len(late):
        axes.plot(time[late], [period] * len(late), "v", ms=5, color=COLORS["late"], label=f"missed ({summary.missed})")


def _draw_receipts(panels: list[Axes], recording: Recording, force: Arrays | None, start: float) -> None:
    """Mark each change of law or parameters in all panels, and name the first ones above the topmost."""
    import numpy as np

    for number, receipt in enumerate(recording.messages(RECEIPT)):
        color = {"switch": COLORS["switch"], "fallback": COLORS["late"]}.get(receipt.action, COLORS["surface"])
        for axes in panels:
            axes.axvline(receipt.stamp - start, color=color, lw=1.0, ls=":")
        name = receipt.action
        if force is not None and receipt.action != "set":
            name = (
                str(force["law"][min(int(np.searchsorted(force["seq"], receipt.seq)), len(force["law"]) - 1)]) or name
            )
        if number < 12:
            panels[0].annotate(
                name,
                (receipt.stamp - start, 0.97 - 0.09 * (number % 3)),
                xycoords=("data", "axes fraction"),
                xytext=(3, 0),
                textcoords="offset points",
                va="top",
                fontsize=8,
                color=color,
                parse_math=False,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8},
            )


def _title(
    recording: Recording, summary: Summary, state: Arrays, proxy: Arrays | None, force: Arrays | None
) -> tuple[str, str]:
    """Name the scenario, and tell the run in two lines."""
    pace = recording.manifest.get("pace", "")
    share = 100.0 * summary.missed / summary.ticks if summary.ticks else 0.0
    axis = main_axis(proxy, state["position"])
    # Ticks that the driver left out are gaps, but no losses.
    lost = sum(max(figures.gaps - summary.overruns, 0) for figures in recording.topics.values())
    laws = [] if force is None else [name for name in dict.fromkeys(force["law"].tolist()) if name]
    how_it_went = [
        f"{summary.ticks} ticks at {summary.rate_hz:.6g} Hz" + (f", {pace[:20]}" if pace else ""),
        f"missed {summary.missed} ({share:.2g} %)" + (f", left out {summary.overruns}" if summary.overruns else ""),
        f"recording {'complete' if recording.complete else 'cut'}, {lost} messages lost",
    ]
    what_came_of_it = [
        *(["law " + ", ".join(laws)[:70]] if laws else []),
        f"ends at {summary.position_m[axis] * 1e3:.3f} mm, {summary.force_n[axis]:.3f} N".replace("-", "−"),
    ]
    lines = "\n".join("  ·  ".join(parts) for parts in (how_it_went, what_came_of_it))
    return recording.manifest.get("scenario", recording.path.stem)[:70], lines


def draw(recording: Recording) -> bytes:
    """Draw a run.

    Parameters
    ----------
    recording : Recording
        A recording with at least two messages on ``/device/state``.

    Returns
    -------
    bytes
        A PNG.

    Raises
    ------
    RecordError
        When there are not two states to draw, or a message does not fit its type.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    summary = summarise(recording)
    if summary.ticks < 1:
        raise RecordError(f"{recording.path}: fewer than two messages on {DEVICE_STATE}; a plot needs at least two")
    state = recording.arrays(DEVICE_STATE)
    proxy = recording.arrays(PROXY) if PROXY in recording.topics else None
    force = recording.arrays(FORCE) if FORCE in recording.topics else None
    axis = main_axis(proxy, state["position"])
    start = float(state["stamp"][0])
    with_energy = bool(state["energy"].any())
    heights = [1.25, 1.0, *([0.7] if with_energy else []), 0.9]
    figure = Figure(figsize=(10.0, 1.0 + 2.1 * sum(heights)), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    panels = list(figure.subplots(len(heights), 1, sharex=True, height_ratios=heights))
    _draw_position(panels[0], state, proxy, axis, start)
    _draw_force(panels[1], state, force, axis, start)
    if with_energy:
        _draw_energy(panels[2], state, start)
    realtime = recording.manifest.get("pace") != "lockstep"
    _draw_response(panels[-1], state, summary, realtime, start)
    _draw_receipts(panels, recording, force, start)
    for axes in panels:
        axes.grid(True, color="#e3e5e8", lw=0.7)
        axes.set_axisbelow(True)
        axes.spines[["top", "right"]].set_visible(False)
        axes.legend(
            loc="lower right", bbox_to_anchor=(1.0, 0.99), borderaxespad=0.0, fontsize=8, frameon=False, ncols=6
        )
        axes.margins(x=0.01)
    panels[-1].set_xlabel("time [s]" if realtime else "simulated time [s]")
    figure.align_ylabels(panels)
    scenario, lines = _title(recording, summary, state, proxy, force)
    # Texts of a file are texts: a $ in a scenario's name is no formula.
    panels[0].set_title(scenario, fontsize=14, fontweight="bold", loc="left", pad=48, parse_math=False)
    panels[0].annotate(
        lines,
        (0.0, 1.0),
        xycoords="axes fraction",
        xytext=(0, 20),
        textcoords="offset points",
        fontsize=9,
        linespacing=1.35,
        color="#444a52",
        parse_math=False,
    )
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def plot(recording: Recording, out: str | Path, *, overwrite: bool = False) -> Path:
    """Draw a run into a file.

    Parameters
    ----------
    recording : Recording
        A recording with at least two messages on ``/device/state``.
    out : str or Path
        The PNG to write.
    overwrite : bool, optional
        Whether an existing file may be replaced.

    Returns
    -------
    Path
        The file written.

    Raises
    ------
    RecordError
        When there is nothing to draw, the file exists already or cannot be written.
    """
    save(Path(out), draw(recording), overwrite)
    return Path(out)
