"""Chart speed against accuracy: realisations of D^α, also at equal demand, integrators, K_max, rates, proxies, the loop."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.errors import UsageError
from sim.cli.answers import add_answer, report
from sim.cli.sweeps import add_spread, spread
from sim.measure.jobs import Runner
from sim.results import fresh

if TYPE_CHECKING:
    from sim.lab.charts.points import Group
    from sim.measure.stopwatch import Progress

PARTS = ("derivatives", "demand", "integrators", "kmax", "rates", "proxies", "loop")


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "--parts",
        default=",".join(PARTS),
        help=(
            "which comparisons, separated by commas (default: %(default)s); rates starts real"
            " processes"
        ),
    )
    parser.add_argument(
        "--quick", action="store_true", help="fewer lengths, rates and rounds: a first look"
    )
    add_spread(parser, "none; times are of this machine in any case")
    add_answer(parser, run)


def run(arguments: argparse.Namespace) -> int:
    """Measure, save and draw the chart."""
    parts = [part for part in arguments.parts.split(",") if part]
    for part in parts:
        if part not in PARTS:
            raise UsageError(f"--parts {part}: no such part; choose from {', '.join(PARTS)}")
    from sim.lab.charts.chart_page import conclusions, draw, page
    from sim.lab.charts.points import as_json, save
    from sim.measure.stopwatch import machine

    start = time.monotonic()
    # What is done of a run that is stopped; figures of time are of one machine, so a finished run
    # leaves none.
    diary = arguments.out / ("chart.quick.part" if arguments.quick else "chart.part")

    def beside(jobs: list[Callable[[], Any]], step: Callable[[str, int], None]) -> list[Any]:
        return spread(arguments, jobs, step=step)

    groups, failures = _measured(parts, arguments.quick, diary, beside)
    seconds, where = time.monotonic() - start, machine()
    files = [
        *save(groups, where, seconds, arguments.out),
        *(draw(group, arguments.out) for group in groups),
    ]
    read = fresh(arguments.out / "chart.md")
    read.write_text(page(groups, where, seconds))
    lines = conclusions(groups)
    figures = as_json(groups, where, seconds) | {
        "conclusions": lines,
        "page": str(read),
        "failures": failures,
    }
    figures["files"] = [*map(str, files)]
    return report(
        arguments, figures, [*lines, *failures, f"{read} ({seconds:.0f} s)"], held=not failures
    )


def _measured(
    parts: list[str], quick: bool, diary: Path, beside: Runner
) -> tuple[list[Group], list[str]]:
    """Measure each part, or take it from the diary of a run that was stopped; and say which parts are missing."""
    from sim.lab.charts.derivatives import derivative_groups, derivative_steps
    from sim.lab.charts.equal_demand import demand_groups, demand_steps
    from sim.lab.charts.integrators import integrator_groups, integrator_steps
    from sim.lab.charts.k_max_ways import kmax_groups, kmax_steps
    from sim.lab.charts.loop_panel import loop_groups, loop_steps
    from sim.lab.charts.points import keep, kept, with_front
    from sim.lab.charts.proxies_panel import proxy_groups, proxy_steps
    from sim.lab.charts.rates import rate_groups, rate_steps
    from sim.measure.measured_launch import MeasurementError
    from sim.measure.stopwatch import Progress

    makers: dict[
        str, tuple[Callable[[Callable[[str], None], bool], list[Group]], Callable[[bool], int], int]
    ] = {
        # The weight is about how many tenths of a second one step takes, so that the bar moves
        # evenly.
        "derivatives": (partial(derivative_groups, spread=beside), derivative_steps, 1),
        "demand": (partial(demand_groups, spread=beside), demand_steps, 1),
        "integrators": (integrator_groups, integrator_steps, 1),
        "kmax": (kmax_groups, kmax_steps, 1),
        "rates": (rate_groups, rate_steps, 30),
        "proxies": (proxy_groups, proxy_steps, 20),
        "loop": (loop_groups, loop_steps, 1),
    }
    progress = Progress(sum(makers[part][1](quick) * makers[part][2] for part in parts))
    groups: list[Group] = []
    failures: list[str] = []
    for part in parts:
        make, steps, weight = makers[part]
        try:
            found = kept(diary, part)
            if found is None:
                advance = partial(_advance, progress, weight)
                found = [with_front(group) for group in make(advance, quick)]
                keep(diary, part, found)
            else:
                progress.step(f"{part}: done before", steps(quick) * weight)
            groups += found
        except MeasurementError as error:
            # The other parts are worth keeping; the exit code shows that one is missing.
            failures.append(f"{part}: {error}")
        except KeyboardInterrupt:
            failures.append(f"{part}: interrupted; the same command goes on here")
            break
    else:
        diary.unlink(missing_ok=True)
    return groups, failures


def _advance(progress: Progress, weight: int, what: str) -> None:
    progress.step(what, weight)
