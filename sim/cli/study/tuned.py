"""Tune many random devices from end to end, inside the model and outside: whether anything unstable is delivered."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from typing import Any

from messages.errors import UsageError
from nodes.cli.main import answer
from nodes.cli.quantities import declare, positive
from sim.cli import arguments as shared
from sim.cli.sweeps import add_sweep, swept


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--devices", type=int, default=40, help="how many, half of them inside (default: %(default)s)")
    parser.add_argument("--seconds", type=positive, default=8.0, help="of each push (default: %(default)s)")
    declare(parser, rate=500.0, taps=4)
    parser.add_argument("--seed", type=int, default=1, help="of the population (default: %(default)s)")
    parser.add_argument("--nyquist", type=positive, default=1e4, help="|H(-1)| allowed [N/m] (default: %(default)g)")
    parser.add_argument(
        "--land",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="demand that every drop settles too; without it a device takes seconds in place of a minute",
    )
    parser.add_argument(
        "--refuted", action="store_true", help="design on refuted models too: what the knocks alone keep from delivery"
    )
    add_sweep(parser)
    shared.add_answer(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Sweep over the devices."""
    from sim.population.tuned import kinds, summary, tune_device

    if not 1 <= arguments.devices <= 100_000:
        raise UsageError(f"--devices {arguments.devices}: between 1 and 100000")
    inside, *outside = kinds()
    jobs: list[dict[str, Any]] = [
        {
            "number": number,
            "kind": inside if number % 2 == 0 else outside[number // 2 % len(outside)],
            "seed": arguments.seed,
            "seconds": arguments.seconds,
            "rate": arguments.rate,
            "taps": arguments.taps,
            "nyquist": arguments.nyquist,
            "land": arguments.land,
            "refuted": arguments.refuted,
        }
        for number in range(arguments.devices)
    ]
    rows, ledger = swept(arguments, tune_device, jobs, "tuned")
    found = summary(rows)
    answer(arguments.json, found | {"rows": rows, "ledger": str(ledger)}, _text(found, rows, str(ledger)))
    missed = (
        found["edges"] - found["edges_within_5_percent"] + found["intervals"] - found["intervals_that_hold_the_edge"]
    )
    return 1 if found["delivered_unstable"] or missed else 0


def _text(found: Mapping[str, Any], rows: Sequence[Mapping[str, Any]], ledger: str) -> str:
    lines = [f"{'device':20} {'law [N/m]':>10} {'edge told':>22} {'true edge':>10} {'true radius':>11}  outcome"]
    for row in rows:
        if row["holds"] is None:
            lines.append(f"{row['kind']:20} {'':55}  no law: {row['stopped'][:70]}")
            continue
        outcome = "delivered" if row["delivered"] else f"not delivered: {row['ended']}"
        lines.append(
            f"{row['kind']:20} {row['h1_n_per_m']:10.0f} {_outcome(row):>22} {_shown(row['true_edge_n_per_m'])} "
            f"{row['true_radius']:11.4f}  {outcome}"
        )
    worst = found["edge_error_largest"]
    lines.append(
        f"{found['devices']} devices: {found['refused']} refuted, {found['tried']} laws tried "
        f"({found['unstable_laws_designed']} of them unstable on the true device), {found['delivered']} delivered, "
        f"{found['delivered_unstable']} of these unstable; {found['edges_within_5_percent']} of {found['edges']} edges "
        "within 5 %"
        + ("" if worst is None else f", the worst {100 * worst:.1f} % off")
        + f"; {found['intervals_that_hold_the_edge']} of {found['intervals']} intervals hold the edge"
    )
    return "\n".join([*lines, ledger])


def _outcome(row: Mapping[str, Any]) -> str:
    """Show the edge that was told: one figure, or the interval."""
    if row["edge_n_per_m"]:
        return f"{row['edge_n_per_m']:.0f}"
    ends = row["edge_between_n_per_m"]
    return f"{ends[0]:.0f} to {ends[1]:.0f}" if ends else "none"


def _shown(value: float | None) -> str:
    return f"{'none':>10}" if value is None else f"{value:10.0f}"
