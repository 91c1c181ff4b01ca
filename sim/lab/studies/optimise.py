"""Optimise a multi-term law by the paper's steepest descent and by linear programmes."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from messages.errors import UsageError
from nodes.laws import CompiledLaw
from nodes.laws.multi_term import MultiTerm, Term
from nodes.parameters.options import FileOptions, option, quantity
from nodes.parameters.quantities import interval, positive, whole
from nodes.recording.figure_style import (
    COLOURS,
    LINES,
    OMEGA,
    PAGE_WIDTH,
    new_figure,
    save_figure,
    styled,
)
from nodes.stability.k_max import k_max, without_spring
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
from sim.lab.paper.fig3_claims import optimum_terms
from sim.results import fresh
from sim.studies import device_options as shared
from sim.studies.device_options import DeviceOptions
from sim.studies.law_looks import law_looks
from sim.studies.result import Findings
from sim.studies.sweeps import SpreadOptions, spread

OUTCOMES = ("converged", "slow", "out_of_range", "diverged")


@dataclass(frozen=True, kw_only=True)
class OptimiseOptions(DeviceOptions, SpreadOptions, FileOptions):
    """Options of `optimise`."""

    taps: int = quantity("taps", 4)
    gain: float = quantity("gain", 3.0)
    terms: int = option(default=2, type=whole(1, 8), help="number of terms")
    at: list[float] = option(
        default=[0.1, 0.5],
        type=positive,
        nargs="+",
        help="frequencies of the targets [ω_N]",
    )
    rates: list[float] = option(
        default=[0.003, 0.03, 0.3], type=positive, nargs="*", help="of the descent"
    )
    steps: int = option(default=2000, type=whole(1, 10**7), help="of each descent")
    starts: int = option(
        default=8, type=whole(1, 1000), help="orders per axis to start from"
    )
    band: tuple[float, float] = option(
        default=(0.02, 0.55), type=interval, help="where f = -1 is wanted [ω_N]"
    )
    nyquist: list[float] = option(
        default=[1.0, 2.0, 3.05, 4.0],
        type=positive,
        nargs="+",
        help="bounds on f at Nyquist",
    )


@dataclass(frozen=True)
class DescentCounts:
    """How the descents of one rate ended."""

    rate: float
    starts: int
    converged: int
    slow: int
    out_of_range: int
    diverged: int
    cost_best: float | None  # of those that converged or are slow; None: none did
    cost_median: float | None


@dataclass(frozen=True)
class LawShape:
    """A shape of f(ω) and the stiffest wall of its law."""

    law: str
    nyquist_bound: float | None
    ripple: float
    f_nyquist: float
    h1_max_n_per_m: float | None
    gains: Sequence[float] | None = None  # with orders; None for free taps
    orders: Sequence[float] | None = None
    taps: Sequence[float] | None = None  # of free taps
    programmes: int | None = None  # linear programmes that the search solved

    @property
    def line(self) -> str:
        """The figures in one line."""
        numbers = [
            one for one in (self.gains, self.orders, self.taps) if one is not None
        ]
        terms = "; ".join(" ".join(f"{value:.3f}" for value in one) for one in numbers)
        bound, h1 = self.nyquist_bound, self.h1_max_n_per_m
        return (
            f"{self.law:13} {'-' if bound is None else f'{bound:.3g}':>6}  {self.ripple:7.4f} "
            f" {self.f_nyquist:6.3f}  {'-' if h1 is None else f'{h1:.5g}':>8}  {terms}"
        )


@dataclass(frozen=True, repr=False, kw_only=True)
class OptimiseFound(Findings):
    """The paper's descent, and shapes by linear programmes."""

    descent: list[DescentCounts]
    paper_cost: float  # J of the paper's own optimum
    shapes: list[LawShape]


def optimise(options: OptimiseOptions) -> OptimiseFound:
    """Reproduce the descent, then solve linear programmes."""
    if options.taps < 2 or options.terms < 1 or options.starts < options.terms:
        raise UsageError(
            "--taps must be at least 2, --terms at least 1 and --starts at least --terms"
        )
    if not all(0.0 < at < 1.0 for at in options.at) or options.band[1] >= 1.0:
        raise UsageError("--at and --band are fractions of ω_N: above 0 and below 1")
    targets = paper_targets(tuple(options.at))
    starts = starting(options.starts, options.terms)
    # The searches first: each takes as long as many descents.
    shape, bounds = (options.taps, options.band), options.nyquist
    jobs: list[partial[Any]] = [
        partial(best_orders, options.terms, options.band, one, options.taps)
        for one in bounds
    ]
    jobs += [partial(free_taps, *shape, bound) for bound in bounds]
    jobs += [
        partial(
            steepest_descent,
            np.ones(options.terms),
            orders,
            targets,
            options.taps,
            rate,
            options.steps,
        )
        for rate in options.rates
        for orders in starts
    ]
    try:
        done = spread(options, jobs)
    except ValueError as error:
        raise UsageError(str(error)) from error
    count = len(bounds)
    runs = done[2 * count :]
    descents = {
        rate: runs[i * len(starts) :][: len(starts)]
        for i, rate in enumerate(options.rates)
    }
    paper = measured(*optimum_terms(), options.band, 4)
    rows = [_shape("paper_optimum", None, paper, options)] if options.terms == 2 else []
    for bound, (optimum, programmes), (taps, least) in zip(
        bounds, done[:count], done[count : 2 * count], strict=True
    ):
        rows.append(_shape("best orders", bound, optimum, options, programmes))
        rows.append(_free(bound, taps, least, options))
    counts = [_counts(rate, runs) for rate, runs in descents.items()]
    own = cost(*optimum_terms(), targets, 4)
    return OptimiseFound(
        lines=_text(counts, own, rows),
        descent=counts,
        paper_cost=own,
        shapes=rows,
        picture=_draw(options, descents, rows),
    )


def _shape(
    name: str,
    bound: float | None,
    shape: Shaping,
    options: OptimiseOptions,
    programmes: int | None = None,
) -> LawShape:
    gains, orders = shape.gains.tolist(), shape.orders.tolist()
    law = MultiTerm(
        stiffness=1.0,
        damping=options.gain,
        terms=tuple(Term(gain=a, order=o) for a, o in zip(gains, orders, strict=True)),
        taps=4 if name == "paper_optimum" else options.taps,
        gains="paper",
    )
    stiffest = _stiffest(without_spring(law, 1.0 / options.rate), options)
    figures = (bound, shape.ripple, shape.nyquist, stiffest)
    return LawShape(name, *figures, gains=gains, orders=orders, programmes=programmes)


def _free(bound: float, taps: Any, ripple: float, options: OptimiseOptions) -> LawShape:
    # The programme has T = 2: at the loop's own period a derivative part is 2/T times as
    # large per N s/m.
    scale = 2.0 * options.rate * options.gain
    derivative = CompiledLaw(tuple((scale * taps).tolist()))
    nyquist = float(np.dot(taps, (-1.0) ** np.arange(len(taps))))
    figures = (bound, ripple, nyquist, _stiffest(derivative, options))
    return LawShape("any taps", *figures, taps=taps.tolist())


def _stiffest(derivative: CompiledLaw, options: OptimiseOptions) -> float | None:
    return k_max(derivative, shared.device(options)).h1_max_n_per_m


def _counts(rate: float, runs: list[Descent]) -> DescentCounts:
    counts = Counter(run.outcome for run in runs)
    ends = sorted(
        float(run.cost[-1]) for run in runs if run.outcome in ("converged", "slow")
    )
    best, median = (ends[0], ends[len(ends) // 2]) if ends else (None, None)
    converged, slow, out, diverged = (counts[one] for one in OUTCOMES)
    return DescentCounts(rate, len(runs), converged, slow, out, diverged, best, median)


def _text(
    descent: list[DescentCounts], paper_cost: float, shapes: list[LawShape]
) -> list[str]:
    lines = [
        "steepest descent (13)-(15)",
        "     rate  starts  converged  slow  left 0<α<4  diverged  best J     median J",
    ]
    for row in descent:
        best, median = row.cost_best, row.cost_median
        lines.append(
            f"{row.rate:9.4g}  {row.starts:6d}  {row.converged:9d}  {row.slow:4d} "
            f" {row.out_of_range:10d}  {row.diverged:8d} "
            f" {'-' if best is None else f'{best:.2e}':9} "
            f" {'-' if median is None else f'{median:.2e}'}"
        )
    lines.append(f"the paper's own optimum has J = {paper_cost:.3g} by its eq. (13)")
    lines.append("\nlaw            bound   ripple  f(ω_N)  H(1)_max  gains; orders")
    return [*lines, *(one.line for one in shapes)]


@styled
def _draw(
    options: OptimiseOptions, descents: dict[float, list[Descent]], rows: list[LawShape]
) -> Path:
    figure = new_figure(PAGE_WIDTH, 3.4)
    left, right = figure.subplots(1, 2)
    for k, (rate, runs) in enumerate(descents.items()):
        for i, one in enumerate(runs):
            thin: Any = {
                "color": COLOURS[k % len(COLOURS)],
                "lw": 0.6,
                "ls": LINES[k % len(LINES)],
            }
            left.loglog(
                np.arange(1, one.cost.size + 1),
                one.cost,
                **thin,
                label=f"{rate:g}" if i == 0 else None,
            )
    low, high = left.get_ylim()
    left.set(
        xlabel="step  [1]",
        ylabel="J, eq. (13)  [1]",
        title="steepest descent from a grid of orders",
        # Below the first is rounding, above the second what diverged.
        ylim=(max(1e-7, low), min(1e6, 3.0 * high)),
    )
    if descents:
        left.legend(title="rate of descent", title_fontsize=8.0)
    theta = np.linspace(0.0, np.pi, 401)
    shaped = [row for row in rows if row.gains is not None and row.orders is not None]
    looks = law_looks(
        "paper_optimum" if row.nyquist_bound is None else f"bound_{row.nyquist_bound:g}"
        for row in shaped
    )
    for row, look in zip(shaped, looks, strict=True):
        terms = np.array(row.gains), np.array(row.orders)
        curve = damping_curve(theta, *terms, options.taps, leak=False)
        bound = row.nyquist_bound
        named = rf"best orders, $f(\omega_\mathrm{{N}}) \leq {bound or 0.0:g}$"
        label = row.law if bound is None else named
        right.plot(theta / np.pi, curve, label=label, **look.curve())
    right.set(
        xlabel=OMEGA, ylabel="f over the spring as H(1)  [1]", title="shapes of f"
    )
    if rows:
        right.legend()
    return save_figure(figure, options.out / "optimise.png", fresh)
