"""Two hands far apart: stable stiffness and mutual feel over the network's delay."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nodes.parameters.options import FileOptions, option, quantity
from nodes.parameters.quantities import whole
from nodes.recording.figure_style import (
    COLOURS,
    LINES,
    MARKERS,
    new_figure,
    save_figure,
    styled,
)
from nodes.stability.plant import Plant
from sim.experiments.hands_apart import HandsAtDelay, over_delay
from sim.results import fresh
from sim.studies.result import Findings


@dataclass(frozen=True, kw_only=True)
class HandsOptions(FileOptions):
    """Options of `hands`."""

    mass: float = quantity("mass", 0.045)
    damping: float = quantity("damping", 1.0)
    gain: float = quantity("gain", 1.0)
    rate: float = quantity("rate", 500.0)
    stiffness: float = quantity("stiffness", 500.0)
    longest: int = option(
        default=20, type=whole(1, 1000), help="longest one-way delay [ticks]"
    )


@dataclass(frozen=True, repr=False, kw_only=True)
class HandsFound(Findings):
    """Stable and felt stiffness at each delay of the network."""

    rows: list[HandsAtDelay]


def hands(options: HandsOptions) -> HandsFound:
    """Compare the couplings of two hands, and plot them."""
    plant = Plant(1.0 / options.rate, options.mass, options.damping)
    steps = (0, 1, 2, 3, 5, 8, 12, 20, 35, 50, 100, 200, 350, 500, 1000)
    delays = sorted(
        {*(step for step in steps if step <= options.longest), options.longest}
    )
    rows = over_delay(plant, options.stiffness, options.gain, delays)
    head = [
        (
            "         stiffest spring that is passive for any two hands   of it is felt     guard,"
            f" K {options.stiffness:g} N/m"
        ),
        " delay   one law  a law each  with damper        K    N/m  drag N s/m     N/m  drag N s/m",
    ]
    lines = [*head, *(_line(row, plant.period) for row in rows)]
    return HandsFound(
        lines=lines, rows=rows, picture=_draw(options, rows, plant.period)
    )


def _line(row: HandsAtDelay, period: float) -> str:
    def cell(value: float | None, width: int, digits: str = ".0f") -> str:
        return f"{'-' if value is None else format(value, digits):>{width}}"

    linear = row.linear
    return (
        f"{1e3 * row.delay_ticks * period:4.0f}"
        f" ms{cell(row.one_law_n_per_m, 10)}{cell(row.law_each_n_per_m, 12)}"
        f"{cell(row.damper_n_s_per_m, 13, '.2f')}{cell(row.damped_n_per_m, 9)}"
        f"{cell(linear.stiffness_n_per_m if linear else None, 7)}"
        f"{cell(linear.drag_n_s_per_m if linear else None, 12, '.2f')}"
        f"{cell(row.guarded.stiffness_n_per_m, 8)}{cell(row.guarded.drag_n_s_per_m, 12, '.2f')}"
    )


@styled
def _draw(options: HandsOptions, rows: list[HandsAtDelay], period: float) -> Path:
    figure = new_figure(7.0, 5.5)
    stiffness, drag = figure.subplots(2, 1, sharex=True)
    delays = [1e3 * row.delay_ticks * period for row in rows]
    curves: tuple[tuple[str, list[float | None], list[float | None] | None], ...] = (
        ("one law", [row.one_law_n_per_m for row in rows], None),
        ("a law each", [row.law_each_n_per_m for row in rows], None),
        (
            "a law each, best damper",
            [row.damped_n_per_m for row in rows],
            [row.linear.drag_n_s_per_m if row.linear else None for row in rows],
        ),
        (
            f"guard at both ends, K = {options.stiffness:g} N/m",
            [row.guarded.stiffness_n_per_m for row in rows],
            [row.guarded.drag_n_s_per_m for row in rows],
        ),
    )
    for i, (label, stiff, slow) in enumerate(curves):
        look: Any = {
            "color": COLOURS[i],
            "marker": MARKERS[i],
            "ls": LINES[i % len(LINES)],
            "ms": 3.5,
        }
        stiffness.plot(
            delays,
            [float("nan") if y is None else y for y in stiff],
            label=label,
            **look,
        )
        if slow is not None:
            drag.plot(delays, [float("nan") if y is None else y for y in slow], **look)
    stiffness.set(yscale="log", ylabel="stiffness for any two hands  [N/m]")
    stiffness.legend()
    drag.set(xlabel="one-way delay  [ms]", ylabel="drag of a free partner  [N s/m]")
    return save_figure(figure, options.out / "hands.png", fresh)
