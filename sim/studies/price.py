"""The price of not knowing: how stiff a law may be, against how well joint, hand and mass of the device are known."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
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
    parser.add_argument(
        "--jitter", type=shared.not_negative, default=0.2, help="of the delay, above it [ticks] (default: %(default)s)"
    )
    parser.add_argument("--taps", type=int, default=2, help="of the law (default: %(default)s)")
    parser.add_argument("--rate", type=shared.positive, default=500.0, help="of the loop [Hz] (default: %(default)s)")
    parser.add_argument("--fresh", action="store_true", help="begin anew instead of going on where it stopped")
    add_cluster(parser)
    shared.add_answer(parser)
    parser.set_defaults(run=run)


def study_price(job: Mapping[str, Any]) -> dict[str, Any]:
    """Design for what is known, and try the law on the device that it is for.

    By poles alone, or landing too and with a certificate for every sequence of the delays.
    """
    from nodes.stability.flexible import FlexiblePlant, flexible_radius
    from sim.design.demand import CONVENTIONS, Demand
    from sim.design.families import certificate, certified, designed
    from sim.design.landing import drops

    period, frequency, spread = 1.0 / job["rate"], job["frequency"], job["spread"]
    known = () if spread is None else sorted({frequency / spread, frequency, frequency * spread})
    asked = Demand(
        mass=(job["mass"] / 1.1, job["mass"] * 1.1),
        damping=job["damping"],
        delay=(job["delay"], job["delay"] + job["jitter"]),
        period=period,
        radius=0.99,
        nyquist=1e4,
        stiffness=(0.0, job["hand"]),
        beyond=tuple((0.0, job["share"], one, job["loss"]) for one in known),
        lands=CONVENTIONS if job["lands"] else (),
    )

    def free(wanted: Demand) -> Any:
        return designed(wanted, job["taps"])

    found = (certified(free, asked) if job["lands"] else free(asked)).found
    if found is None:
        return {"h1_n_per_m": None, "radius": None, "drops_settled": None, "certified": None}
    truth = (0.0, job["share"], frequency, job["loss"])
    plant = FlexiblePlant(job["mass"], job["damping"], asked.delay[1], 0.0, *truth)
    real = replace(asked, beyond=(truth,))
    settled = drops(found.law, real)
    return {
        "h1_n_per_m": found.h1_n_per_m,
        "radius": flexible_radius(found.law, period, plant),
        "drops_settled": f"{sum(settled.values())} of {len(settled)}",
        "certified": certificate(found.law, real) is True,
    }


def run(arguments: argparse.Namespace) -> int:
    """Design for less and less that is known."""
    from sim.measure.stopwatch import Progress
    from sim.measure.sweep import executor, sweep

    given = ("mass", "damping", "delay", "jitter", "share", "frequency", "loss", "taps", "rate")
    device = {name: getattr(arguments, name) for name in given}
    jobs: list[dict[str, Any]] = [
        {**device, "hand": hand, "spread": spread, "lands": lands}
        for lands in (False, True)
        for hand in (0.0, HAND)
        for spread in (None, *SPREADS)
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
        f"{arguments.mass:g} kg, joint of {arguments.frequency:g} Hz with {100 * arguments.share:g} % of it, delay "
        f"{arguments.delay:g} to {arguments.delay + arguments.jitter:g} ticks, {arguments.taps} taps, pole radius at most 0.99",
        f"{'known':22} {'hand':24} {'asked':22} {'H(1) [N/m]':>10}  on the device",
    ]
    for one in told:
        known = "believed rigid" if one["spread"] is None else f"joint to {100 * (one['spread'] - 1):.0f} %"
        hand = "no hand" if one["hand"] == 0.0 else f"hands of 0 to {one['hand']:g} N/m"
        asked = "lands, every sequence" if one["lands"] else "poles alone"
        if one["h1_n_per_m"] is None:
            lines.append(f"{known:22} {hand:24} {asked:22} {'no law':>10}")
            continue
        verdict = "stable" if one["radius"] < 1.0 else f"UNSTABLE, pole radius {one['radius']:.3f}"
        proof = "" if one["certified"] else ", NOT certified for every sequence of delays"
        lines.append(
            f"{known:22} {hand:24} {asked:22} {one['h1_n_per_m']:10.5g}  {verdict}, {one['drops_settled']} drops settle{proof}"
        )
    answer(
        arguments.json,
        {"rows": told, "ledger": str(ledger), "plot": str(picture)},
        "\n".join([*lines, str(ledger), str(picture)]),
    )
    return 0


@styled
def draw(path: Path, rows: Sequence[Mapping[str, Any]]) -> None:
    """Draw H(1) against what is known of the joint."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.0, 4.0), layout="constrained")
    axes = figure.subplots()
    for lands in (False, True):
        for hand, mark in ((0.0, "o"), (HAND, "s")):
            known = [row for row in rows if (row["hand"], row["lands"]) == (hand, lands) and row["spread"] is not None]
            held = "no hand" if hand == 0.0 else f"hands of 0 to {hand:g} N/m"
            axes.plot(
                [100.0 * (row["spread"] - 1.0) for row in known],
                [row["h1_n_per_m"] if row["h1_n_per_m"] is not None else math.nan for row in known],
                marker=mark,
                ls="-" if lands else ":",
                label=f"{held}, {'lands, every sequence of delays' if lands else 'poles alone'}",
            )
    axes.set(xlabel="frequency of the joint known to ± [%]", ylabel="H(1) of the designed law [N/m]", ylim=(0.0, None))
    axes.grid(alpha=0.3)
    axes.legend()
    save_figure(figure, path, fresh)
