"""Two hands far apart: the stiffness that any two hands bear, and what is felt of each other, against the network's delay."""

import argparse
from dataclasses import asdict
from pathlib import Path
from typing import Any

from nodes.cli.quantities import declare, whole
from nodes.recording.figure_style import COLOURS, LINES, MARKERS, new_figure, save_figure, styled
from nodes.stability.plant import Plant
from sim.cli.answers import add_answer, report
from sim.experiments.hands_apart import HandsAtDelay, over_delay
from sim.results import fresh


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    declare(parser, mass=0.045, damping=1.0, gain=1.0, rate=500.0, stiffness=500.0)
    text = "longest one-way delay [ticks] (default: %(default)s)"
    parser.add_argument("--longest", type=whole(1, 1000), default=20, help=text)
    add_answer(parser, run)


def run(arguments: argparse.Namespace) -> int:
    """Compare, draw and print."""
    plant = Plant(1.0 / arguments.rate, arguments.mass, arguments.damping)
    steps = (0, 1, 2, 3, 5, 8, 12, 20, 35, 50, 100, 200, 350, 500, 1000)
    delays = sorted({*(step for step in steps if step <= arguments.longest), arguments.longest})
    rows = over_delay(plant, arguments.stiffness, arguments.gain, delays)
    head = [
        (
            "         stiffest spring that is passive for any two hands   of it is felt     guard,"
            f" K {arguments.stiffness:g} N/m"
        ),
        " delay   one law  a law each  with damper        K    N/m  drag N s/m     N/m  drag N s/m",
    ]
    lines = [_line(row, plant.period) for row in rows]
    plot = _draw(arguments, rows, plant.period)
    return report(arguments, {"rows": [asdict(row) for row in rows]}, [*head, *lines], plot=plot)


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
def _draw(arguments: argparse.Namespace, rows: list[HandsAtDelay], period: float) -> Path:
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
            f"guard at both ends, K = {arguments.stiffness:g} N/m",
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
            delays, [float("nan") if y is None else y for y in stiff], label=label, **look
        )
        if slow is not None:
            drag.plot(delays, [float("nan") if y is None else y for y in slow], **look)
    stiffness.set(yscale="log", ylabel="stiffness for any two hands  [N/m]")
    stiffness.legend()
    drag.set(xlabel="one-way delay  [ms]", ylabel="drag of a free partner  [N s/m]")
    return save_figure(figure, arguments.out / "hands.png", fresh)
