"""What the passivity guard makes safe and what it costs in rendered stiffness: drops on ever stiffer walls."""

import argparse
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from messages.errors import UsageError
from nodes.cli.quantities import SECONDS, declare, not_negative, positive, whole
from nodes.recording.figure_style import (
    COLOURS,
    GREY,
    LINES,
    MARKERS,
    new_figure,
    save_figure,
    styled,
    threshold,
)
from sim.cli.answers import add_answer, report
from sim.cli.sweeps import add_spread, spread
from sim.device.model import DeviceModel
from sim.experiments.guarded_drop import Drop, compare
from sim.results import fresh

LEAST = 1e-6  # where what is less is drawn, in mJ and mm: a nanojoule, a nanometre


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    declare(parser, mass=0.1, damping=1.0, gain=3.0, rate=500.0)
    parser.add_argument(
        "--height",
        type=positive,
        default=0.01,
        help="height of the drop [m] (default: %(default)s)",
    )
    parser.add_argument(
        "--next-tick", action="store_true", help="forces take effect one tick later"
    )
    parser.add_argument(
        "--guard-damping",
        type=not_negative,
        default=10.0,
        help="largest damper of the guard [N s/m] (default: %(default)s)",
    )
    parser.add_argument(
        "--low", type=positive, default=500.0, help="softest wall [N/m] (default: %(default)s)"
    )
    parser.add_argument(
        "--high", type=positive, default=16000.0, help="stiffest wall [N/m] (default: %(default)s)"
    )
    parser.add_argument(
        "--points",
        type=whole(1, 100_000),
        default=21,
        help="walls between them (default: %(default)s)",
    )
    parser.add_argument(
        "--duration", type=SECONDS, default=6.0, help="length of a drop [s] (default: %(default)s)"
    )
    add_spread(parser)
    add_answer(parser, run)


def run(arguments: argparse.Namespace) -> int:
    """Compare, draw and tell."""
    if arguments.points < 2 or not arguments.low < arguments.high:
        raise UsageError(
            f"--low {arguments.low:g} --high {arguments.high:g} --points {arguments.points}:"
            " expected a range and 2 points"
        )
    ratio = (arguments.high / arguments.low) ** (1.0 / (arguments.points - 1))
    walls = [arguments.low * ratio**i for i in range(arguments.points)]
    device = DeviceModel(
        mass=arguments.mass, damping=arguments.damping, gravity=9.81, position=arguments.height
    )
    told = (
        1.0 / arguments.rate,
        arguments.guard_damping,
        arguments.next_tick,
        round(arguments.duration * arguments.rate),
    )
    found = spread(
        arguments, [partial(compare, device, wall, arguments.gain, *told) for wall in walls]
    )
    drops = [drop for pair in found for drop in pair]
    lines = [
        "            ----- without the guard -----   ------ with the guard -------",
        "   K N/m    out mJ  unrest mm   felt N/m    out mJ  unrest mm   felt N/m",
    ]
    for bare, guarded in zip(drops[::2], drops[1::2], strict=True):
        cells = [
            f"{drop.energy_max_j * 1e3:9.3g} {drop.unrest_m * 1e3:10.3g} "
            f"{'-' if drop.felt_n_per_m is None else f'{drop.felt_n_per_m:.0f}':>10}"
            for drop in (bare, guarded)
        ]
        lines.append(f"{bare.stiffness:8.0f} {cells[0]} {cells[1]}")
    plot = _draw(arguments, drops)
    return report(arguments, {"drops": [asdict(drop) for drop in drops]}, lines, plot=plot)


@styled
def _draw(arguments: argparse.Namespace, drops: list[Drop]) -> Path:
    figure = new_figure(7.0, 7.5)
    panels = figure.subplots(3, 1, sharex=True)
    for guarded, i, label in ((False, 1, "without the guard"), (True, 0, "with the guard")):
        look: Any = {"color": COLOURS[i], "marker": MARKERS[i], "ls": LINES[i], "ms": 3.5}
        chosen = [drop for drop in drops if drop.guarded is guarded]
        stiffness = [drop.stiffness for drop in chosen]
        # Zero has no place on a logarithmic axis.
        panels[0].plot(
            stiffness, [max(drop.energy_max_j * 1e3, LEAST) for drop in chosen], label=label, **look
        )
        panels[1].plot(stiffness, [max(drop.unrest_m * 1e3, LEAST) for drop in chosen], **look)
        felt = [float("nan") if drop.felt_n_per_m is None else drop.felt_n_per_m for drop in chosen]
        panels[2].plot(stiffness, felt, **look)
    nominal = [drop.stiffness for drop in drops]
    panels[2].plot(nominal, nominal, ls=":", color=GREY, label="felt = nominal")
    for axes, label in zip(
        panels, ("given out  [mJ]", "unrest  [mm]", "felt stiffness  [N/m]"), strict=True
    ):
        axes.set(xscale="log", yscale="log", ylabel=label)
        if axes.get_legend_handles_labels()[0]:
            axes.legend()
    threshold(panels[0], LEAST, "nothing, or less")
    threshold(panels[1], LEAST, "at rest")
    panels[2].set_xlabel("nominal stiffness K  [N/m]")
    panels[0].set_title(
        f"Drop of {arguments.mass:g} kg from {arguments.height * 1e3:g} mm, PD with B ="
        f" {arguments.gain:g} N s/m, {arguments.rate:g} Hz, forces"
        f" {'at the next tick' if arguments.next_tick else 'on arrival'}"
    )
    return save_figure(figure, arguments.out / "guard.png", fresh)
