"""Chart speed against accuracy: derivatives, integrators, K_max, rates, proxies and loop."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.errors import UsageError
from nodes.parameters.options import FileOptions, ProgressStep, option
from sim.measure.jobs import Runner
from sim.results import fresh
from sim.studies.result import Findings
from sim.studies.sweeps import SpreadOptions, spread

if TYPE_CHECKING:
    from sim.lab.charts.points import Group

PARTS = ("derivatives", "demand", "integrators", "kmax", "rates", "proxies", "loop")


@dataclass(frozen=True, kw_only=True)
class ChartOptions(SpreadOptions, FileOptions):
    """Options of `chart`."""

    parts: str = option(
        default=",".join(PARTS),
        help=(
            "which comparisons, separated by commas (default: %(default)s); rates starts real"
            " processes"
        ),
    )
    quick: bool = option(
        action="store_true", help="fewer lengths, rates and rounds: a first look"
    )


@dataclass(frozen=True, repr=False, kw_only=True)
class ChartFound(Findings):
    """Speed against accuracy: groups of points, conclusions and files."""

    groups: list[Group]
    machine: dict[str, Any]
    duration_s: float
    conclusions: list[str]
    page: Path
    failures: list[str]  # parts that are missing, and why
    files: list[Path]

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name, all points in one table."""
        from sim.lab.charts.points import as_json

        return super().answer | as_json(self.groups, self.machine, self.duration_s)


def chart(options: ChartOptions) -> ChartFound:
    """Measure, save and draw the chart."""
    parts = [part for part in options.parts.split(",") if part]
    for part in parts:
        if part not in PARTS:
            raise UsageError(
                f"--parts {part}: no such part; choose from {', '.join(PARTS)}"
            )
    from sim.lab.charts.chart_page import draw, page
    from sim.lab.charts.conclusions import conclusions
    from sim.lab.charts.points import save
    from sim.measure.stopwatch import machine

    start = time.monotonic()
    # An interrupted run stores its results; times are of one machine, so a finished run
    # deletes them.
    diary = options.out / ("chart.quick.part" if options.quick else "chart.part")

    def beside(
        jobs: list[Callable[[], Any]], step: Callable[[str, int], None]
    ) -> list[Any]:
        return spread(options, jobs, step=step)

    groups, failures = _measured(options, parts, diary, beside)
    seconds, where = time.monotonic() - start, machine()
    files = [
        *save(groups, where, seconds, options.out),
        *(draw(group, options.out) for group in groups),
    ]
    read = fresh(options.out / "chart.md")
    read.write_text(page(groups, where, seconds))
    lines = conclusions(groups)
    return ChartFound(
        lines=[*lines, *failures, f"{read} ({seconds:.0f} s)"],
        held=not failures,
        groups=groups,
        machine=where,
        duration_s=round(seconds, 1),
        conclusions=lines,
        page=read,
        failures=failures,
        files=files,
    )


def _measured(
    options: ChartOptions, parts: list[str], diary: Path, beside: Runner
) -> tuple[list[Group], list[str]]:
    """Measure each part, or read it from an interrupted run; return missing parts too."""
    from sim.lab.charts.derivatives import derivative_groups, derivative_steps
    from sim.lab.charts.equal_demand import demand_groups, demand_steps
    from sim.lab.charts.integrators import integrator_groups, integrator_steps
    from sim.lab.charts.k_max_ways import kmax_groups, kmax_steps
    from sim.lab.charts.loop_panel import loop_groups, loop_steps
    from sim.lab.charts.points import keep, kept, with_front
    from sim.lab.charts.proxies_panel import proxy_groups, proxy_steps
    from sim.lab.charts.rates import rate_groups, rate_steps
    from sim.measure.haptic_commands import MeasurementError

    makers: dict[
        str,
        tuple[
            Callable[[Callable[[str], None], bool], list[Group]],
            Callable[[bool], int],
            int,
        ],
    ] = {
        # The weight is the approximate duration of a step [0.1 s], so that the bar moves
        # evenly.
        "derivatives": (partial(derivative_groups, spread=beside), derivative_steps, 1),
        "demand": (partial(demand_groups, spread=beside), demand_steps, 1),
        "integrators": (integrator_groups, integrator_steps, 1),
        "kmax": (kmax_groups, kmax_steps, 1),
        "rates": (rate_groups, rate_steps, 30),
        "proxies": (proxy_groups, proxy_steps, 20),
        "loop": (loop_groups, loop_steps, 1),
    }
    quick = options.quick
    step = options.progress(
        sum(makers[part][1](quick) * makers[part][2] for part in parts)
    )
    groups: list[Group] = []
    failures: list[str] = []
    for part in parts:
        make, steps, weight = makers[part]
        try:
            found = kept(diary, part)
            if found is None:
                advance = partial(_advance, step, weight)
                found = [with_front(group) for group in make(advance, quick)]
                keep(diary, part, found)
            else:
                step(f"{part}: done before", steps(quick) * weight)
            groups += found
        except MeasurementError as error:
            # The other parts are still valid; the exit code reports the missing one.
            failures.append(f"{part}: {error}")
        except KeyboardInterrupt:
            failures.append(f"{part}: interrupted; the same command goes on here")
            break
    else:
        diary.unlink(missing_ok=True)
    return groups, failures


def _advance(step: ProgressStep, weight: int, what: str) -> None:
    step(what, weight)
