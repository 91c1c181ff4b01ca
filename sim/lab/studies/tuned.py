"""Tune many random devices end to end and check that no unstable law is delivered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nodes.parameters.options import FileOptions, option, quantity
from nodes.parameters.quantities import COUNT, SECONDS, SEED, positive
from nodes.recording.figure_style import (
    BAD,
    COLOURS,
    MARKERS,
    legend_above,
    new_figure,
    save_figure,
    styled,
    threshold,
)
from sim.results import fresh
from sim.studies.result import Findings, at_top
from sim.studies.sweeps import SweepOptions, swept

if TYPE_CHECKING:
    from sim.lab.monte_carlo.tuned import TunedPopulation
    from sim.measure.jobs import SweepRow


@dataclass(frozen=True, kw_only=True)
class TunedOptions(SweepOptions, FileOptions):
    """Options of `tuned`."""

    devices: int = option(default=40, type=COUNT, help="how many, half of them inside")
    seconds: float = option(default=8.0, type=SECONDS, help="of each push")
    rate: float = quantity("rate", 500.0)
    taps: int = quantity("taps", 4)
    seed: int = option(default=1, type=SEED, help="of the population")
    nyquist: float = option(
        default=10000.0, type=positive, help="|H(-1)| allowed [N/m]"
    )
    land: bool = option(
        default=True,
        action="on_off",
        help="demand that every drop settles too; without it a device takes seconds in place"
        " of a minute",
    )
    refuted: bool = option(
        action="store_true",
        help="design on refuted models too: what the knocks alone keep from delivery",
    )


@dataclass(frozen=True, repr=False, kw_only=True)
class TunedFound(Findings):
    """Laws tuned for random devices, judged by their true poles."""

    found: TunedPopulation = at_top()
    rows: list[SweepRow]  # of the ledger, one per device


def tuned(options: TunedOptions) -> TunedFound:
    """Sweep over the devices."""
    from sim.lab.monte_carlo.tuned import INSIDE, summary, tune_device
    from sim.lab.monte_carlo.virtual import KINDS

    outside = list(KINDS)
    told = options.chosen(
        "seed", "seconds", "rate", "taps", "nyquist", "land", "refuted"
    )
    kind = [
        INSIDE if number % 2 == 0 else outside[number // 2 % len(outside)]
        for number in range(options.devices)
    ]
    jobs = [{"number": number, "kind": one, **told} for number, one in enumerate(kind)]
    rows, ledger = swept(options, tune_device, jobs, "tuned")
    found = summary(rows)
    return TunedFound(
        lines=_text(found, rows),
        held=found.held,
        found=found,
        rows=rows,
        ledger=ledger,
        picture=draw(options.out / "tuned.png", rows),
    )


def _text(found: TunedPopulation, rows: Sequence[Mapping[str, Any]]) -> list[str]:
    lines = [
        f"{'device':20} {'law [N/m]':>10} {'edge told':>22} {'true edge':>10} {'true radius':>11} "
        " outcome"
    ]
    for row in rows:
        if row["holds"] is None:
            lines.append(f"{row['kind']:20} {'':55}  no law: {row['stopped'][:70]}")
            continue
        outcome = "delivered" if row["delivered"] else f"not delivered: {row['ended']}"
        lines.append(
            f"{row['kind']:20} {row['h1_n_per_m']:10.0f} {_outcome(row):>22}"
            f" {_shown(row['true_edge_n_per_m'])} {row['true_radius']:11.4f}  {outcome}"
        )
    worst = found.edge_error_largest
    lines.append(
        f"{found.devices} devices: {found.refused} refuted, {found.tried} laws tried"
        f" ({found.unstable_laws_designed} of them unstable on the true device),"
        f" {found.delivered} delivered, {found.delivered_unstable} of these unstable;"
        f" {found.edges_within_5_percent} of {found.edges} edges within 5 %"
        + ("" if worst is None else f", the worst {100 * worst:.1f} % off")
        + f"; {found.intervals_that_hold_the_edge} of {found.intervals} intervals hold the edge"
    )
    return lines


def _outcome(row: Mapping[str, Any]) -> str:
    """Return the reported limit: a value or an interval."""
    if row["edge_n_per_m"]:
        return f"{row['edge_n_per_m']:.0f}"
    ends = row["edge_between_n_per_m"]
    return f"{ends[0]:.0f} to {ends[1]:.0f}" if ends else "none"


def _shown(value: float | None) -> str:
    return f"{'none':>10}" if value is None else f"{value:10.0f}"


@styled
def draw(path: Path, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Plot the reported limit over the true one, and each law's distance from it."""
    figure = new_figure(6.8, 5.4)
    told, radius = figure.subplots(2, 1, sharex=True)
    tried = [
        row for row in rows if row["holds"] is not None and row["true_edge_n_per_m"]
    ]
    for name, delivered, unstable, colour, mark in (
        ("delivered, and stable", True, (False,), COLOURS[0], MARKERS[0]),
        ("not delivered", False, (False, True), COLOURS[1], MARKERS[1]),
        ("delivered, and unstable", True, (True,), BAD, "X"),
    ):
        mine = [
            row
            for row in tried
            if row["delivered"] == delivered and (row["true_radius"] >= 1.0) in unstable
        ]
        for row in mine:
            true, ends = row["true_edge_n_per_m"], row["edge_between_n_per_m"]
            if row["edge_n_per_m"]:
                told.plot(true, row["edge_n_per_m"] / true, mark, color=colour)
            elif ends:
                told.plot(
                    [true, true],
                    [end / true for end in ends],
                    marker="_",
                    ms=7,
                    color=colour,
                    ls="-",
                )
        if mine:
            places = (
                [row["true_edge_n_per_m"] for row in mine],
                [row["true_radius"] for row in mine],
            )
            radius.plot(*places, mark, color=colour, label=name)
    title = f"{len(rows)} devices tuned end to end, {len(tried)} laws tried"
    told.set(ylabel="edge told / true edge  [1]", xscale="log", title=title)
    radius.set(
        xlabel="true edge of the device with its law, H(1)  [N/m]",
        ylabel="true pole radius  [1]",
    )
    for value, name in ((0.95, "−5 %"), (1.0, "true"), (1.05, "+5 %")):
        threshold(told, value, name)
    threshold(radius, 1.0, "unstable from 1")
    if tried:
        legend_above(radius, 3)
    return save_figure(figure, path, fresh)
