"""Compute how stiff a wall can be if the device's servo damps it at a higher rate."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from nodes.laws import CompiledLaw
from nodes.parameters.options import FileOptions, option, quantity
from nodes.parameters.quantities import not_negative, whole
from nodes.recording.figure_style import label_ends, new_figure, save_figure, styled
from sim.results import fresh
from sim.studies.result import Answer, answered


@dataclass(frozen=True, kw_only=True)
class TwoRateOptions(FileOptions):
    """Options of `two_rate`."""

    mass: float = quantity("mass", 0.1)
    damping: float = quantity("damping", 1.0)
    delay: float = quantity("delay", 1.0)
    rate: float = quantity("rate", 500.0)
    servo: float = option(
        default=3.0, type=not_negative, help="damper of the servo [N s/m] (default: 3)"
    )
    ratios: list[int] = option(
        default=[1, 2, 4, 8], type=whole(1, 1000), nargs="+", help="servo ticks a tick of the loop"
    )


def two_rate(options: TwoRateOptions) -> Answer:
    """Compare servo rates."""
    from nodes.stability.two_rate import TwoRate, heavy_limit, two_rate_k_max

    period = 1.0 / options.rate
    rows = []
    for ratio in options.ratios:
        device = TwoRate(
            options.mass,
            options.damping,
            options.servo,
            ratio,
            math.ceil(options.delay * ratio - 1e-9),
        )
        found = two_rate_k_max(CompiledLaw((0.0,)), period, device)
        rows.append(
            {
                "ratio": ratio,
                "servo_hz": ratio * options.rate,
                "delay_ticks": device.delay / ratio,
                "k_max_n_per_m": None if found == math.inf else found,
                "at_least_n_per_m": (
                    heavy_limit(device, period) * 1e3 if found == math.inf else None
                ),
                "heavy_limit_n_per_m": heavy_limit(device, period),
            }
        )
    lines = [
        f"spring; {options.mass:g} kg, {options.damping:g} N s/m, servo damper"
        f" {options.servo:g} N s/m"
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
    picture = draw(options.out / "two_rate.png", lines[0], rows)
    return answered({"rate_hz": options.rate, "rows": rows}, lines, plot=picture)


@styled
def draw(path: Path, title: str, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Plot the largest stiffness over the servo's rate."""
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
