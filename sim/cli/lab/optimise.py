"""Optimise a multi-term law: the paper's steepest descent and where it fails, then linear programmes over all orders."""

import argparse
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from messages.errors import UsageError
from nodes.cli.quantities import declare, interval, positive, whole
from nodes.laws import CompiledLaw
from nodes.laws.multi_term import MultiTerm, Term
from nodes.recording.figure_style import COLOURS, LINES, OMEGA, new_figure, save_figure, styled
from nodes.stability.k_max import k_max, without_spring
from sim.cli import arguments as shared
from sim.cli.answers import add_answer, report
from sim.cli.sweeps import add_spread, spread
from sim.lab.paper.descent import (
    Descent,
    Shaping,
    best_orders,
    cost,
    damping_curve,
    free_taps,
    measured,
    paper_targets,
    starting,
    steepest_descent,
)
from sim.lab.paper.fig2_fig3 import optimum_terms
from sim.results import fresh

OUTCOMES = ("converged", "slow", "out_of_range", "diverged")


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    declare(parser, taps=4, gain=3.0)
    parser.add_argument(
        "--terms", type=whole(1, 8), default=2, help="number of terms (default: %(default)s)"
    )
    parser.add_argument(
        "--at",
        type=positive,
        nargs="+",
        default=[0.1, 0.5],
        help="frequencies of the targets [ω_N]",
    )
    parser.add_argument(
        "--rates", type=positive, nargs="*", default=[0.003, 0.03, 0.3], help="of the descent"
    )
    parser.add_argument(
        "--steps", type=whole(1, 10**7), default=2000, help="of each descent (default: %(default)s)"
    )
    parser.add_argument(
        "--starts",
        type=whole(1, 1000),
        default=8,
        help="orders per axis to start from (default: %(default)s)",
    )
    parser.add_argument(
        "--band", type=interval, default=(0.02, 0.55), help="where f = -1 is wanted [ω_N]"
    )
    parser.add_argument(
        "--nyquist",
        type=positive,
        nargs="+",
        default=[1.0, 2.0, 3.05, 4.0],
        help="bounds on f at Nyquist",
    )
    shared.add_device(parser)
    add_spread(parser)
    add_answer(parser, run)


def run(arguments: argparse.Namespace) -> int:
    """Reproduce the descent, then do better."""
    if arguments.taps < 2 or arguments.terms < 1 or arguments.starts < arguments.terms:
        raise UsageError(
            "--taps must be at least 2, --terms at least 1 and --starts at least --terms"
        )
    if not all(0.0 < at < 1.0 for at in arguments.at) or arguments.band[1] >= 1.0:
        raise UsageError("--at and --band are fractions of ω_N: above 0 and below 1")
    targets = paper_targets(tuple(arguments.at))
    starts = starting(arguments.starts, arguments.terms)
    # The searches first: each takes as long as many descents.
    shape, bounds = (arguments.taps, arguments.band), arguments.nyquist
    jobs: list[partial[Any]] = [
        partial(best_orders, arguments.terms, arguments.band, one, arguments.taps) for one in bounds
    ]
    jobs += [partial(free_taps, *shape, bound) for bound in bounds]
    jobs += [
        partial(
            steepest_descent,
            np.ones(arguments.terms),
            orders,
            targets,
            arguments.taps,
            rate,
            arguments.steps,
        )
        for rate in arguments.rates
        for orders in starts
    ]
    try:
        done = spread(arguments, jobs)
    except ValueError as error:
        raise UsageError(str(error)) from error
    count = len(bounds)
    runs = done[2 * count :]
    descents = {
        rate: runs[i * len(starts) :][: len(starts)] for i, rate in enumerate(arguments.rates)
    }
    paper = measured(*optimum_terms(), arguments.band, 4)
    rows = [_row("paper_optimum", None, paper, arguments)] if arguments.terms == 2 else []
    for bound, (optimum, programmes), (taps, least) in zip(
        bounds, done[:count], done[count : 2 * count], strict=True
    ):
        rows.append(_row("best orders", bound, optimum, arguments) | {"programmes": programmes})
        rows.append(_free_row(bound, taps, least, arguments))
    figures = {
        "descent": [{"rate": rate, **_counts(runs)} for rate, runs in descents.items()],
        "paper_cost": cost(*optimum_terms(), targets, 4),
        "shapes": rows,
    }
    return report(arguments, figures, _text(figures), plot=_draw(arguments, descents, rows))


def _row(
    name: str, bound: float | None, shape: Shaping, arguments: argparse.Namespace
) -> dict[str, Any]:
    law = MultiTerm(
        stiffness=1.0,
        damping=arguments.gain,
        terms=tuple(
            Term(gain=a, order=o)
            for a, o in zip(shape.gains.tolist(), shape.orders.tolist(), strict=True)
        ),
        taps=4 if name == "paper_optimum" else arguments.taps,
        gains="paper",
    )
    return {
        "law": name,
        "nyquist_bound": bound,
        "gains": shape.gains.tolist(),
        "orders": shape.orders.tolist(),
        "ripple": shape.ripple,
        "f_nyquist": shape.nyquist,
        "h1_max_n_per_m": _stiffest(without_spring(law, 1.0 / arguments.rate), arguments),
    }


def _free_row(
    bound: float, taps: Any, ripple: float, arguments: argparse.Namespace
) -> dict[str, Any]:
    # T = 2 in the programme: at the loop's own period a derivative part is 2/T times as large per N
    # s/m.
    scale = 2.0 * arguments.rate * arguments.gain
    derivative = CompiledLaw(tuple((scale * taps).tolist()))
    nyquist = float(np.dot(taps, (-1.0) ** np.arange(len(taps))))
    return {
        "law": "any taps",
        "nyquist_bound": bound,
        "taps": taps.tolist(),
        "ripple": ripple,
        "f_nyquist": nyquist,
        "h1_max_n_per_m": _stiffest(derivative, arguments),
    }


def _stiffest(derivative: CompiledLaw, arguments: argparse.Namespace) -> float | None:
    return k_max(derivative, shared.device(arguments)).h1_max_n_per_m


def _counts(runs: list[Descent]) -> dict[str, Any]:
    counts = Counter(run.outcome for run in runs)
    ends = sorted(float(run.cost[-1]) for run in runs if run.outcome in ("converged", "slow"))
    return {
        "starts": len(runs),
        **{outcome: counts[outcome] for outcome in OUTCOMES},
        "cost_best": ends[0] if ends else None,
        "cost_median": ends[len(ends) // 2] if ends else None,
    }


def _text(figures: dict[str, Any]) -> list[str]:
    lines = [
        "steepest descent (13)-(15)",
        "     rate  starts  converged  slow  left 0<α<4  diverged  best J     median J",
    ]
    for row in figures["descent"]:
        best, median = row["cost_best"], row["cost_median"]
        lines.append(
            f"{row['rate']:9.4g}  {row['starts']:6d}  {row['converged']:9d}  {row['slow']:4d} "
            f" {row['out_of_range']:10d}  {row['diverged']:8d} "
            f" {'-' if best is None else f'{best:.2e}':9} "
            f" {'-' if median is None else f'{median:.2e}'}"
        )
    lines.append(f"the paper's own optimum has J = {figures['paper_cost']:.3g} by its eq. (13)")
    lines.append("\nlaw            bound   ripple  f(ω_N)  H(1)_max  gains; orders")
    for row in figures["shapes"]:
        bound, h1 = row["nyquist_bound"], row["h1_max_n_per_m"]
        terms = "; ".join(
            " ".join(f"{value:.3f}" for value in row[key])
            for key in ("gains", "orders", "taps")
            if key in row
        )
        lines.append(
            f"{row['law']:13} {'-' if bound is None else f'{bound:.3g}':>6}  {row['ripple']:7.4f} "
            f" {row['f_nyquist']:6.3f}  {'-' if h1 is None else f'{h1:.5g}':>8}  {terms}"
        )
    return lines


@styled
def _draw(
    arguments: argparse.Namespace, descents: dict[float, list[Descent]], rows: list[dict[str, Any]]
) -> Path:
    figure = new_figure(10.0, 4.0)
    left, right = figure.subplots(1, 2)
    for k, (rate, runs) in enumerate(descents.items()):
        for i, one in enumerate(runs):
            look: Any = {"color": COLOURS[k % len(COLOURS)], "lw": 0.6, "ls": LINES[k % len(LINES)]}
            left.loglog(
                np.arange(1, one.cost.size + 1),
                one.cost,
                **look,
                label=f"rate {rate:g}" if i == 0 else None,
            )
    left.set(
        xlabel="step  [1]",
        ylabel="J, eq. (13)  [1]",
        title="steepest descent from a grid of orders",
        ylim=(1e-7, 1e6),
    )
    if descents:
        left.legend(title="of descent", title_fontsize=8.0)
    theta = np.linspace(0.0, np.pi, 401)
    for row in rows:
        if "orders" in row:
            curve = damping_curve(
                theta, np.array(row["gains"]), np.array(row["orders"]), arguments.taps, leak=False
            )
            bound = row["nyquist_bound"]
            label = (
                row["law"]
                if bound is None
                else rf"best orders, $f(\omega_\mathrm{{N}}) \leq {bound:g}$"
            )
            right.plot(
                theta / np.pi,
                curve,
                label=label,
                **({"color": "k", "ls": "-"} if bound is None else {}),
            )
    right.set(xlabel=OMEGA, ylabel="f over the spring as H(1)  [1]", title="shapes of f")
    if rows:
        right.legend()
    return save_figure(figure, arguments.out / "optimise.png", fresh)
