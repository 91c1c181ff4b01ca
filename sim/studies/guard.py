"""Measure safety and cost in stiffness of the passivity guard: drops on stiffer walls."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from messages.errors import UsageError
from nodes.parameters.options import FileOptions, option, quantity
from nodes.parameters.quantities import SECONDS, not_negative, positive, whole
from nodes.recording.figure_style import (
    COLOURS,
    GREY,
    LINES,
    MARKERS,
    PAGE_WIDTH,
    new_figure,
    save_figure,
    styled,
    threshold,
)
from sim.axes import plain_log
from sim.device.model import DeviceModel
from sim.experiments.guarded_drop import Drop, compare
from sim.results import fresh
from sim.studies.result import Findings
from sim.studies.sweeps import SpreadOptions, spread

LEAST = 1e-6  # the plots are linear below it, in mJ and mm: a nanojoule, a nanometre


@dataclass(frozen=True, kw_only=True)
class GuardOptions(SpreadOptions, FileOptions):
    """Options of `guard`."""

    mass: float = quantity("mass", 0.1)
    damping: float = quantity("damping", 1.0)
    gain: float = quantity("gain", 3.0)
    rate: float = quantity("rate", 500.0)
    height: float = option(default=0.01, type=positive, help="height of the drop [m]")
    next_tick: bool = option(
        action="store_true", help="forces take effect one tick later"
    )
    guard_damping: float = option(
        default=10.0, type=not_negative, help="largest damper of the guard [N s/m]"
    )
    low: float = option(default=500.0, type=positive, help="softest wall [N/m]")
    high: float = option(default=16000.0, type=positive, help="stiffest wall [N/m]")
    points: int = option(default=21, type=whole(1, 100000), help="walls between them")
    duration: float = option(default=6.0, type=SECONDS, help="length of a drop [s]")


@dataclass(frozen=True, repr=False, kw_only=True)
class GuardFound(Findings):
    """Drops on each wall, without and with the guard."""

    drops: list[Drop]


def guard(options: GuardOptions) -> GuardFound:
    """Compare drops with and without the guard, and plot them."""
    if options.points < 2 or not options.low < options.high:
        raise UsageError(
            f"--low {options.low:g} --high {options.high:g} --points {options.points}:"
            " expected a range and 2 points"
        )
    ratio = (options.high / options.low) ** (1.0 / (options.points - 1))
    walls = [options.low * ratio**i for i in range(options.points)]
    device = DeviceModel(
        mass=options.mass,
        damping=options.damping,
        gravity=9.81,
        position=options.height,
    )
    told = (
        1.0 / options.rate,
        options.guard_damping,
        options.next_tick,
        round(options.duration * options.rate),
    )
    found = spread(
        options, [partial(compare, device, wall, options.gain, *told) for wall in walls]
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
    return GuardFound(lines=lines, drops=drops, picture=_draw(options, drops))


@styled
def _draw(options: GuardOptions, drops: list[Drop]) -> Path:
    figure = new_figure(PAGE_WIDTH, 6.4)
    panels = figure.subplots(3, 1, sharex=True)
    for guarded, i, label in (
        (False, 1, "without the guard"),
        (True, 0, "with the guard"),
    ):
        look: Any = {
            "color": COLOURS[i],
            "marker": MARKERS[i],
            "ls": LINES[i],
            "ms": 3.5,
        }
        chosen = [drop for drop in drops if drop.guarded is guarded]
        stiffness = [drop.stiffness for drop in chosen]
        given = [max(drop.energy_max_j * 1e3, 0.0) for drop in chosen]
        panels[0].plot(stiffness, given, label=label, **look)
        panels[1].plot(stiffness, [drop.unrest_m * 1e3 for drop in chosen], **look)
        felt = [
            float("nan") if drop.felt_n_per_m is None else drop.felt_n_per_m
            for drop in chosen
        ]
        panels[2].plot(stiffness, felt, **look)
    nominal = [drop.stiffness for drop in drops]
    panels[2].plot(nominal, nominal, ls=":", color=GREY, label="felt = nominal")
    for axes, label in zip(
        panels,
        ("given out  [mJ]", "unrest  [mm]", "felt stiffness  [N/m]"),
        strict=True,
    ):
        axes.set(xscale="log", yscale="log", ylabel=label)
        if axes.get_legend_handles_labels()[0]:
            axes.legend()
    for axes, name in ((panels[0], "nothing, or less"), (panels[1], "at rest")):
        axes.set_yscale("symlog", linthresh=LEAST)
        axes.set_ylim(bottom=-LEAST)
        axes.set_yticks([0.0, *(10.0**power for power in (-6, -4, -2, 0, 2))])
        axes.set_ylim(
            top=2.0 * max(line.get_ydata().max() for line in axes.get_lines())
        )
        threshold(axes, 0.0, name)
    plain_log(panels[2].yaxis, *panels[2].get_ylim())
    plain_log(panels[2].xaxis, *panels[2].get_xlim())
    panels[2].set_xlabel("nominal stiffness K  [N/m]")
    panels[0].set_title(
        f"Drop of {options.mass:g} kg from {options.height * 1e3:g} mm, PD with B ="
        f" {options.gain:g} N s/m, {options.rate:g} Hz, forces"
        f" {'at the next tick' if options.next_tick else 'on arrival'}"
    )
    return save_figure(figure, options.out / "guard.png", fresh)
