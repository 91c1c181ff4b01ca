"""How stiff a wall gets when the device's own servo damps it faster than the loop runs."""

import argparse
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from nodes.cli.quantities import declare, not_negative, whole
from nodes.laws import CompiledLaw
from nodes.recording.figure_style import label_ends, new_figure, save_figure, styled
from sim.cli.answers import add_answer, report
from sim.results import fresh


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    declare(parser, mass=0.1, damping=1.0, delay=1.0, rate=500.0)
    parser.add_argument(
        "--servo", type=not_negative, default=3.0, help="damper of the servo [N s/m] (default: 3)"
    )
    parser.add_argument(
        "--ratios",
        type=whole(1, 1000),
        nargs="+",
        default=[1, 2, 4, 8],
        help="servo ticks a tick of the loop",
    )
    add_answer(parser, run)


def run(arguments: argparse.Namespace) -> int:
    """Compare servo rates."""
    from nodes.stability.two_rate import TwoRate, heavy_limit, two_rate_k_max

    period = 1.0 / arguments.rate
    rows = []
    for ratio in arguments.ratios:
        device = TwoRate(
            arguments.mass,
            arguments.damping,
            arguments.servo,
            ratio,
            math.ceil(arguments.delay * ratio - 1e-9),
        )
        found = two_rate_k_max(CompiledLaw((0.0,)), period, device)
        rows.append(
            {
                "ratio": ratio,
                "servo_hz": ratio * arguments.rate,
                "delay_ticks": device.delay / ratio,
                "k_max_n_per_m": None if found == math.inf else found,
                "at_least_n_per_m": (
                    heavy_limit(device, period) * 1e3 if found == math.inf else None
                ),
                "heavy_limit_n_per_m": heavy_limit(device, period),
            }
        )
    lines = [
        f"spring; {arguments.mass:g} kg, {arguments.damping:g} N s/m, servo damper"
        f" {arguments.servo:g} N s/m"
    ]
    for row in rows:
        k, least = row["k_max_n_per_m"], row["at_least_n_per_m"]
        lines.append(
            f"  servo {row['servo_hz']:6g} Hz, delay {row['delay_ticks']:.3g} ticks: K_max "
            + (
                f"above {least:.5g} N/m, where the search ends"
                if least
                else "none"
                if k is None
                else f"{k:.5g} N/m"
            )
            + f", heavy device {row['heavy_limit_n_per_m']:.5g} N/m"
        )
    picture = draw(arguments.out / "two_rate.png", lines[0], rows)
    return report(arguments, {"rate_hz": arguments.rate, "rows": rows}, lines, plot=picture)


@styled
def draw(path: Path, title: str, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Draw the largest stiffness over the servo's rate."""
    figure = new_figure(6.4, 4.0)
    axes = figure.add_subplot(
        xlabel="rate of the servo  [Hz]",
        ylabel="largest stiffness  [N/m]",
        title=title,
        xscale="log",
    )
    rates = [row["servo_hz"] for row in rows]
    for key, label, mark in (
        ("k_max_n_per_m", "$K_\\mathrm{max}$", "o"),
        ("heavy_limit_n_per_m", "of a heavy device", "s"),
    ):
        values = [float("nan") if row[key] is None else row[key] for row in rows]
        axes.plot(rates, values, marker=mark, label=label)
    axes.set_xticks(rates, [f"{rate:g}" for rate in rates], minor=False)
    axes.minorticks_off()
    axes.margins(y=0.3)
    label_ends(axes)
    return save_figure(figure, path, fresh)
