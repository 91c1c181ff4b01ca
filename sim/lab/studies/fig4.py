"""Plot the paper's figure 4, the stiffest settling drop over B, and judge its claims."""

from __future__ import annotations

import signal
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from messages.errors import UsageError
from nodes.parameters.options import FileOptions, option, quantity
from nodes.parameters.quantities import Interval, not_negative, positive, whole
from nodes.recording.figure_style import GREY, PAGE_WIDTH, new_figure, styled, threshold
from sim.measure.jobs import SweepRow, read_ledger, sweep
from sim.studies.law_looks import law_looks
from sim.studies.sweeps import SweepOptions, begun, executor

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sim.lab.paper.claims import PaperFigure
    from sim.lab.paper.fig4 import Curve, Setting


@dataclass(frozen=True, kw_only=True)
class Fig4Options(SweepOptions, FileOptions):
    """Options of `fig4`."""

    mass: float = quantity("mass", 0.1)
    damping: float = quantity("damping", 1.0)
    rate: float = quantity("rate", 500.0)
    gain: tuple[float, float] = quantity("gain", Interval(0.5, 60.0))
    points: int = option(
        default=24, type=whole(2, 100000), help="gains, in geometric steps"
    )
    resolution: float = option(
        default=2.3e-05, type=positive, help="Touch X's resolution [m]"
    )
    friction: float = option(
        default=0.06, type=not_negative, help="its friction [N], a remembered figure"
    )
    horizon: int = option(default=2500, type=whole(1, 10**8), help="of a drop [ticks]")


def _setting(options: Fig4Options) -> Setting:
    import numpy as np

    from sim.experiments.settling import Criterion
    from sim.lab.paper.fig4 import Setting

    low, high = options.gain
    if not 0.0 < low < high:
        raise UsageError(f"--gain {low:g}..{high:g}: needs 0 < LOW < HIGH")
    try:
        criterion = Criterion(options.horizon)
    except ValueError as error:
        raise UsageError(f"--horizon: {error}") from error
    gains = tuple(np.geomspace(low, high, options.points).tolist())
    device = options.mass, options.damping, 1.0 / options.rate
    return Setting(*device, gains, options.resolution, options.friction, criterion)


def fig4(options: Fig4Options) -> PaperFigure:
    """Run the drops, plot, and check the claims."""
    from sim.lab.paper.claims import save, table
    from sim.lab.paper.fig4 import (
        as_json,
        curves_of,
        designs,
        drops,
        point,
        spread_of_conventions,
    )
    from sim.lab.paper.fig4_claims import claims_4

    setting = _setting(options)
    ledger = begun(options, "fig4")
    first = designs(setting)
    # A design takes as long as some hundred points; the bar counts points.
    step = options.progress(
        len(first) + len(drops(setting, [job | {"taps": [0.0]} for job in first]))
    )
    jobs: list[SweepRow] = []
    complete = True
    try:
        with executor(options) as pool:
            jobs = drops(setting, sweep(point, first, pool, ledger, 1, step))
            sweep(point, jobs, pool, ledger, 4, step)
    except KeyboardInterrupt:
        complete = False
    everything = curves_of(jobs, read_ledger(ledger))
    curves = [curve for curve in everything if curve.convention == 0]
    claims = []
    if complete:
        try:
            claims = claims_4(
                setting, curves, spread_of_conventions(setting, everything)
            )
        except ValueError as error:
            raise UsageError(
                f"--horizon {options.horizon} --points {options.points}: too little settles to"
                f" judge the claims ({error}); give a longer horizon or more points"
            ) from error
    figures = as_json(setting, curves) | {"complete": complete, "ledger": str(ledger)}
    text = (
        table(claims)
        if claims
        else f"interrupted: what was found is in {ledger}, and the same command goes on there"
    )
    head = (
        f"figure 4: drop of {setting.mass:g} kg, {setting.damping:g} N s/m, {options.rate:g} Hz,"
        f" {options.points} gains B of {setting.gains[0]:g} to {setting.gains[-1]:g} N s/m,"
        f" {setting.criterion.ticks} ticks"
    )
    found = save(
        "fig4", [head, text], figures, claims, _draw(setting, curves), options.out
    )
    return replace(found, interrupted=0 if complete else signal.SIGINT)


@styled
def _draw(setting: Setting, curves: list[Curve]) -> Figure:
    from sim.axes import legend_below, plain_log
    from sim.lab.paper.fig4 import DELAYS, LAWS

    figure = new_figure(PAGE_WIDTH, 5.6)
    axes = figure.subplots(2, 2, sharex=True)
    looks = dict(zip(LAWS, law_looks(LAWS), strict=True))
    for column, delay in enumerate(DELAYS):
        stiffness, frequency = axes[0][column], axes[1][column]
        for curve in (c for c in curves if c.delay == delay):
            look, gains = looks[curve.law], setting.gains[: len(curve.found)]
            nominal, felt, swings = (
                [getattr(f, key) or float("nan") for f in curve.found]
                for key in ("k_max_n_per_m", "h1_max_n_per_m", "frequency_hz")
            )
            if curve.touch:
                stiffness.plot(
                    gains, felt, color=look.color, marker="x", ms=3.0, ls="none"
                )
                continue
            solid = look.points() | {"ls": "-", "ms": 3.0, "lw": 1.0}
            stiffness.plot(gains, nominal, **solid, label=curve.law)
            stiffness.plot(gains, felt, color=look.color, ls="--", lw=0.8)
            frequency.plot(gains, swings, **solid)
        stiffness.set(xscale="log", yscale="log", ylabel="stiffest that settles  [N/m]")
        stiffness.set_title(f"delay of {delay:g} tick{'' if delay == 1 else 's'}")
        edge = 2.0 * setting.damping / setting.period
        threshold(stiffness, edge, f"2b/T = {edge:.4g} N/m: passive for any hand")
        plain_log(stiffness.yaxis, *stiffness.get_ylim())
        plain_log(stiffness.xaxis, setting.gains[0], setting.gains[-1])
        frequency.set(xlabel="B  [N s/m]", ylabel="swing at the limit  [Hz]")
    # Label each law where it has the most curves, and explain full, dashed and ×.
    for text, line in (
        ("nominal K", {"ls": "-"}),
        ("felt, H(1)", {"ls": "--", "lw": 0.8}),
        ("felt with the Touch X's sensor", {"ls": "none", "marker": "x", "ms": 3.0}),
    ):
        axes[0][0].plot([], [], color=GREY, label=text, **line)
    legend_below(figure, axes[0])
    figure.suptitle(
        f"Drop of {setting.mass:g} kg, b = {setting.damping:g} N s/m, {1.0 / setting.period:g} Hz, "
        f"{setting.criterion.ticks} ticks, history = penetration, clamped",
        fontsize=10,
    )
    return figure
