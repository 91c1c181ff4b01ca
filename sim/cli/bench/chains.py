"""Largest number of chains per machine: launch more and more until one loses ticks."""

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from nodes.base.setup import Tick
from nodes.compiled.choose_tick import choose
from nodes.launcher import launch_file
from nodes.launcher.wiring import kernel_modules
from nodes.parameters.quantities import SECONDS, declare, whole
from sim.cli.answers import add_answer, report
from sim.measure.measured_launch import launch, machine
from sim.measure.stopwatch import Progress

LIMIT = 0.01  # largest share of lost ticks of a launch that counts as carried


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "--scenario", default="floor_drop", help="launch file of one chain"
    )
    parser.add_argument(
        "--most", type=whole(1, 64), default=16, help="most chains that are tried"
    )
    parser.add_argument(
        "--seconds",
        type=SECONDS,
        default=3.0,
        help="length of each launch (default: %(default)s s)",
    )
    declare(parser, rate=500.0)
    add_answer(parser, run, files=False)


def counts(most: int) -> list[int]:
    """Return the numbers of chains to try, each about 1.5 times the previous one."""
    found = [1]
    while found[-1] < most:
        found.append(min(most, max(found[-1] + 1, found[-1] * 3 // 2)))
    return found


def several(scenario: str, chains: int, folder: Path) -> str:
    """Write a launch file of several chains without loggers; return its path."""
    spec = launch_file.read(scenario, {})
    loggers = [name for name, node in spec.nodes.items() if node.kind == "logger"]
    path = folder / f"chains_{chains}.yaml"
    included = [
        {"launch": scenario, "namespace": f"c{i}", "without": loggers}
        for i in range(chains)
    ]
    path.write_text(
        json.dumps({"summary": f"{chains} chains", "include": included}),
        encoding="utf-8",
    )
    return str(path)


def measure(
    scenario: str,
    most: int,
    seconds: float,
    rate: float,
    tick: Tick,
    progress: Progress,
) -> list[dict[str, Any]]:
    """Launch more and more chains; return a row per launch."""
    rows = []
    with tempfile.TemporaryDirectory(prefix="haptic-") as name:
        for chains in counts(most):
            words = (
                f"run.duration:={seconds}",
                f"run.rate:={rate}",
                "run.pace:=realtime",
                "--tick",
                tick,
            )
            figures = launch(several(scenario, chains, Path(name)), *words)
            load = figures["load"] or {}
            rows.append(
                {
                    "chains": chains,
                    **{
                        key: load.get(key)
                        for key in ("lost", "busy", "tick_cost_us", "cause")
                    },
                }
            )
            progress.step(f"{chains} chains")
    return rows


def run(arguments: argparse.Namespace) -> int:
    """Run the benchmark."""
    path, rate = arguments.scenario, arguments.rate
    tick = choose(
        "compiled",
        kernel_modules(launch_file.read(path, {})),
        lambda text: print(text, file=sys.stderr),
    )
    rows = measure(
        path,
        arguments.most,
        arguments.seconds,
        rate,
        tick,
        Progress(len(counts(arguments.most))),
    )
    carried = max(
        (
            row["chains"]
            for row in rows
            if row["lost"] is not None and row["lost"] <= LIMIT
        ),
        default=0,
    )
    figures = {
        "machine": machine(),
        "scenario": path,
        "rate_hz": rate,
        "tick": tick,
        "carried": carried,
        "rows": rows,
    }
    lines = [
        figures["machine"],
        (
            f"{path}, {rate:g} Hz, {tick} tick: carries {carried} chains (up to {LIMIT:.0%} of"
            " ticks lost)"
        ),
    ]
    for row in rows:
        lost, busy, cost = (row[key] or 0.0 for key in ("lost", "busy", "tick_cost_us"))
        lines.append(
            f"{row['chains']:4} chains  {lost:7.2%} lost  {busy:4.0%} of their processors "
            f" {cost:5.0f} µs a tick"
        )
    return report(arguments, figures, lines)
