"""The price of not knowing: how stiff a law may be, against how well joint, hand and mass of the device are known."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from nodes.cli.main import answer
from nodes.recording.figure_style import save_figure, styled
from sim.measure.sweep import add_cluster
from sim.results import fresh
from sim.studies import arguments as shared

SPREADS = (1.0, 1.05, 1.2, 1.5)
"""Factors by which the frequency of the joint may be off in either direction."""
HAND = 500.0
"""Stiffest hand [N/m]."""


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--mass", type=shared.positive, default=0.1, help="of the device [kg] (default: %(default)s)")
    parser.add_argument(
        "--damping", type=shared.positive, default=1.0, help="of the device [N s/m] (default: %(default)s)"
    )
    parser.add_argument(
        "--delay", type=shared.not_negative, default=1.2, help="of the loop [ticks] (default: %(default)s)"
    )
    parser.add_argument(
        "--share", type=shared.positive, default=0.3, help="of the mass behind the joint (default: %(default)s)"
    )
    parser.add_argument(
        "--frequency", type=shared.positive, default=40.0, help="of the joint [Hz] (default: %(default)s)"
    )
    parser.add_argument(
        "--loss", type=shared.positive, default=0.03, help="damping ratio of the joint (default: %(default)s)"
    )
    parser.add_argument("--taps", type=int, default=3, help="of the law (default: %(default)s)")
    parser.add_argument("--rate", type=shared.positive, default=500.0, help="of the loop [Hz] (default: %(default)s)")
    parser.add_argument("--fresh", action="store_true", help="begin anew instead of going on where it stopped")
    add_cluster(parser)
    shared.add_answer(parser)
    parser.set_defaults(run=run)


def study_price(job: Mapping[str, Any]) -> dict[str, Any]:
    """Design for what is known, and try the law on the device that it is for."""
    from nodes.stability.flexible import FlexiblePlant, flexible_radius
    from sim.design.demand import Demand
    from sim.design.families import designed

    period, frequency, spread = 1.0 / job["rate"], job["frequency"], job["spread"]
    joints = (
        ()
        if spread is None
        else tuple(
            (0.0, job["share"], one, job["loss"]) for one in sorted({frequency / spread, frequency, frequency * spread})
        )
    )
    asked = Demand(
        mass=(job["mass"] / 1.1, job["mass"] * 1.1),
        damping=job["damping"],
        delay=(job["delay"], job["delay"]),
        period=period,
        radius=0.99,
        nyquist=1e4,
        stiffness=(0.0, job["hand"]),
        beyond=joints,
    )
    found = designed(asked, job["taps"]).found
    if found is None:
        return {"h1_n_per_m": None, "radius": None}
    plant = FlexiblePlant(
        job["mass"], job["damping"], job["delay"], share=job["share"], frequency=frequency, loss=job["loss"]
    )
    return {"h1_n_per_m": found.h1_n_per_m, "radius": flexible_radius(found.law, period, plant)}


def run(arguments: argparse.Namespace) -> int:
    """Design for less and less that is known."""
    from sim.measure.stopwatch import Progress
    from sim.measure.sweep import executor, sweep

    given = ("mass", "damping", "delay", "share", "frequency", "loss", "taps", "rate")
    device = {name: getattr(arguments, name) for name in given}
    jobs: list[dict[str, Any]] = [
        {**device, "hand": hand, "spread": spread} for hand in (0.0, HAND) for spread in (None, *SPREADS)
    ]
    ledger = arguments.out / "price.jsonl"
    if arguments.fresh:
        ledger.unlink(missing_ok=True)
    with executor(arguments) as pool:
        rows = sweep(study_price, jobs, pool, ledger, 1, Progress(len(jobs)).step)
    told = [{**job, **row} for job, row in zip(jobs, rows, strict=True)]
    picture = arguments.out / "price.png"
    draw(picture, told)
    lines = [
        f"{arguments.mass:g} kg, joint of {arguments.frequency:g} Hz, {arguments.taps} taps, pole radius at most 0.99"
    ]
    for one in told:
        known = "believed rigid" if one["spread"] is None else f"joint known to {100 * (one['spread'] - 1):.0f} %"
        hand = "no hand" if one["hand"] == 0.0 else f"hands of 0 to {one['hand']:g} N/m"
        if one["h1_n_per_m"] is None:
            lines.append(f"  {known:22} {hand:24} no law")
            continue
        verdict = "" if one["radius"] < 1.0 else f"  UNSTABLE on the device (pole radius {one['radius']:.3f})"
        lines.append(f"  {known:22} {hand:24} H(1) {one['h1_n_per_m']:8.5g} N/m{verdict}")
    lines.append("delay constant: no certificate for sequences of delays with a joint, and no landing is asked for")
    answer(
        arguments.json,
        {"rows": told, "every_delay_certified": None, "ledger": str(ledger), "plot": str(picture)},
        "\n".join([*lines, str(ledger), str(picture)]),
    )
    return 0


@styled
def draw(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Draw H(1) against what is known of the joint."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.subplots()
    for hand, style in ((0.0, "o-"), (HAND, "s--")):
        known = [row for row in rows if row["hand"] == hand and row["spread"] is not None]
        axes.plot(
            [100.0 * (row["spread"] - 1.0) for row in known],
            [row["h1_n_per_m"] if row["h1_n_per_m"] is not None else math.nan for row in known],
            style,
            label="no hand" if hand == 0.0 else f"hands of 0 to {hand:g} N/m",
        )
    axes.set(xlabel="frequency of the joint known to ± [%]", ylabel="H(1) of the designed law [N/m]", ylim=(0.0, None))
    axes.grid(alpha=0.3)
    axes.legend()
    save_figure(figure, path, fresh)
