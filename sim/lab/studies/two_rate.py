"""Compute how stiff a wall can be if the device's servo damps it at a higher rate."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from nodes.laws import CompiledLaw
from nodes.parameters.options import FileOptions, option, quantity
from nodes.parameters.quantities import not_negative, whole
from nodes.recording.figure_style import label_ends, new_figure, save_figure, styled
from sim.results import fresh
from sim.studies.result import Findings


@dataclass(frozen=True, kw_only=True)
class TwoRateOptions(FileOptions):
    """Options of `two_rate`."""

    mass: float = quantity("mass", 0.1)
    damping: float = quantity("damping", 1.0)
    delay: float = quantity("delay", 1.0)
    rate: float = quantity("rate", 500.0)
    servo: float = option(
        default=3.0, type=not_negative, help="damper of the servo [N s/m]"
    )
    ratios: list[int] = option(
        default=[1, 2, 4, 8],
        type=whole(1, 1000),
        nargs="+",
        help="servo ticks a tick of the loop",
    )


@dataclass(frozen=True)
class ServoRate:
    """K_max with a servo of one rate."""

    ratio: int  # servo ticks a tick of the loop
    servo_hz: float
    delay_ticks: float
    k_max_n_per_m: float | None  # None: no limit was found, or none is stable
    at_least_n_per_m: float | None  # where the search ended without a limit
    heavy_limit_n_per_m: float  # of a heavy device

    @property
    def line(self) -> str:
        """The figures in one line."""
        k, least = self.k_max_n_per_m, self.at_least_n_per_m
        found = "none" if k is None else f"{k:.5g} N/m"
        if least is not None:
            found = f"above {least:.5g} N/m, where the search ends"
        return (
            f"  servo {self.servo_hz:6g} Hz, delay {self.delay_ticks:.3g} ticks: K_max {found},"
            f" heavy device {self.heavy_limit_n_per_m:.5g} N/m"
        )


@dataclass(frozen=True, repr=False, kw_only=True)
class TwoRateFound(Findings):
    """K_max at each servo rate."""

    rate_hz: float
    rows: list[ServoRate]


def two_rate(options: TwoRateOptions) -> TwoRateFound:
    """Compare servo rates."""
    from sim.stability.two_rate import TwoRate, heavy_limit, two_rate_k_max

    period, rows = 1.0 / options.rate, []
    for ratio in options.ratios:
        late = math.ceil(options.delay * ratio - 1e-9)
        device = TwoRate(options.mass, options.damping, options.servo, ratio, late)
        found, heavy = (
            two_rate_k_max(CompiledLaw((0.0,)), period, device),
            heavy_limit(device, period),
        )
        endless = found == math.inf
        k, least = (None, 1e3 * heavy) if endless else (found, None)
        rows.append(
            ServoRate(ratio, ratio * options.rate, late / ratio, k, least, heavy)
        )
    head = (
        f"spring; {options.mass:g} kg, {options.damping:g} N s/m, servo damper"
        f" {options.servo:g} N s/m"
    )
    return TwoRateFound(
        lines=[head, *(row.line for row in rows)],
        rate_hz=options.rate,
        rows=rows,
        picture=draw(options.out / "two_rate.png", head, rows),
    )


@styled
def draw(path: Path, title: str, rows: Sequence[ServoRate]) -> Path:
    """Plot the largest stiffness over the servo's rate."""
    figure = new_figure(6.4, 4.0)
    axes = figure.add_subplot(
        xlabel="rate of the servo  [Hz]",
        ylabel="largest stiffness  [N/m]",
        title=title,
        xscale="log",
    )
    rates = [row.servo_hz for row in rows]
    for key, label, mark in (
        ("k_max_n_per_m", "$K_\\mathrm{max}$", "o"),
        ("heavy_limit_n_per_m", "of a heavy device", "s"),
    ):
        values = [
            math.nan if getattr(row, key) is None else getattr(row, key) for row in rows
        ]
        axes.plot(rates, values, marker=mark, label=label)
    axes.set_xticks(rates, [f"{rate:g}" for rate in rates], minor=False)
    axes.minorticks_off()
    axes.margins(y=0.3)
    label_ends(axes)
    return save_figure(figure, path, fresh)
