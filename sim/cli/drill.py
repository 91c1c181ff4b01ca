"""Inject faults into a real launch, one at a time, and report the outcome."""

import argparse
import signal
import sys
import time

import msgspec

from messages.errors import UsageError
from nodes.cli.main import coloured
from nodes.parameters.quantities import not_negative, positive, whole
from sim.cli.answers import add_answer, report
from sim.drill.drill import HOLD, LIMIT, RATE, DrillOutcome, drill
from sim.drill.faults import faults
from sim.drill.random_launches import LaunchOutcome, launch_many
from sim.drill.random_launches import text as text_of_launches
from sim.drill.soak import MISS_LIMIT, soak, text


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "faults",
        nargs="*",
        help=(
            'faults by name, e.g. "kill coupling"; all when left out; soak: a long run under use;'
            " random: launches under random stalls, kills, swaps, moves, re-centres and faults,"
            " each force judged from the device's own log"
        ),
    )
    parser.add_argument(
        "--launches", type=whole(1, 100_000), default=20, help="how many of random"
    )
    parser.add_argument(
        "--seed",
        default="",
        help="what random draws from (default: the time, which is printed)",
    )
    parser.add_argument(
        "--minutes", type=positive, default=10.0, help="length of a soak [min]"
    )
    parser.add_argument(
        "--miss-limit",
        type=not_negative,
        default=MISS_LIMIT,
        help="share of ticks that a soak may miss",
    )
    parser.add_argument("--list", action="store_true", help="list the faults")
    parser.add_argument(
        "--markdown",
        action="store_true",
        help="write the table as Markdown, for a page",
    )
    add_answer(parser, run, files=False)


def run(arguments: argparse.Namespace) -> int:
    """Run the drills."""
    # On SIGTERM, end the launch first, as after Ctrl-C.
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
    if arguments.faults == ["soak"]:
        return _soak(arguments)
    if arguments.faults == ["random"]:
        return _random(arguments)
    known = {fault.name: fault for fault in faults()}
    if arguments.list:
        figures = {name: fault.what for name, fault in known.items()}
        return report(
            arguments,
            {"faults": figures},
            [f"{name:18} {what}" for name, what in figures.items()],
        )
    unknown = [name for name in arguments.faults if name not in known]
    if unknown:
        raise UsageError(
            f"no fault is named {unknown[0]!r}; available: {', '.join(known)}"
        )
    outcomes = []
    for name in arguments.faults or known:
        print(f"[drill] {name}", file=sys.stderr, flush=True)
        outcomes.append(drill(known[name]))
    passed = all(outcome.passed or outcome.skipped for outcome in outcomes)
    figures_all = {
        "limit_ticks": LIMIT,
        "rate_hz": RATE,
        "passed": passed,
        "drills": msgspec.to_builtins(outcomes),
    }
    return report(
        arguments, figures_all, table(outcomes, arguments.markdown), held=passed
    )


def _soak(arguments: argparse.Namespace) -> int:
    seconds = arguments.minutes * 60.0
    if not seconds >= 10.0:
        raise UsageError(
            f"--minutes {arguments.minutes:g}: a soak takes at least 10 s, --minutes 0.17"
        )
    found = soak(seconds, min(60.0, seconds / 3.0), arguments.miss_limit)
    return report(arguments, msgspec.to_builtins(found), text(found), held=found.passed)


def _random(arguments: argparse.Namespace) -> int:
    seed = arguments.seed or time.strftime("%Y%m%d-%H%M%S")

    def show(one: LaunchOutcome) -> None:
        result = "FAILED" if one.reasons else "passed"
        print(
            f"[drill] {seed}:{one.number} {one.what}: {one.forces} forces, {result}",
            file=sys.stderr,
            flush=True,
        )

    found = launch_many(arguments.launches, seed, shown=show)
    return report(
        arguments,
        msgspec.to_builtins(found),
        text_of_launches(found),
        held=found.passed,
    )


# Columns of the table; columns three to five are numbers.
HEADS = (
    "fault",
    "what was done",
    "safe after [ticks]",
    "ticks lost",
    "given out [mJ]",
    "recovered",
    "result",
)


def table(outcomes: list[DrillOutcome], markdown: bool = False) -> str:
    """Format the outcomes of a drill as a table."""
    rows = [HEADS, *map(_row, outcomes)]
    if markdown:
        lines = [f"| {' | '.join(row)} |" for row in rows]
        lines.insert(1, "| --- | --- | ---: | ---: | ---: | --- | --- |")
    else:
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = [_laid_out(row, widths) for row in rows]
    lines.append(
        f"safe after: longest time for which an old force or damping acted, limit {LIMIT} ticks of"
        f" {1e3 / RATE:g} ms (the device itself lets go after {HOLD * 1e3:g} ms)"
    )
    for one in outcomes:
        lines += [f"{one.fault}: skipped: {one.skipped}"] if one.skipped else []
        lines += (
            [f"{one.fault}: {reason}" for reason in one.reasons]
            if not (one.passed or one.skipped)
            else []
        )
    return "\n".join(lines)


def _row(one: DrillOutcome) -> tuple[str, ...]:
    if one.skipped:
        return (one.fault, one.what, "", "", "", "", "skipped")
    lost, given_out = (
        f"{one.lost_ticks} of {one.window_ticks}",
        f"{one.energy_j * 1e3:.2f}",
    )
    came_back, result = (
        "yes" if one.recovered else "no",
        "passed" if one.passed else "FAILED",
    )
    return (
        one.fault,
        one.what,
        str(one.safe_ticks),
        lost,
        given_out,
        came_back,
        result,
    )


def _laid_out(row: tuple[str, ...], widths: list[int]) -> str:
    sides = [str.rjust if 2 <= i <= 4 else str.ljust for i in range(len(row))]
    cells = [
        side(cell, width) for side, cell, width in zip(sides, row, widths, strict=True)
    ]
    if color := {"passed": "green", "FAILED": "red"}.get(row[-1]):
        cells[-1] = coloured(cells[-1], color, sys.stdout)
    return "  ".join(cells).rstrip()
