"""Measure the cost of a ROS 2 graph: launches with and without the node ros2, in one run."""

import argparse
import statistics
from typing import Any

from nodes.parameters.quantities import ROUNDS, SECONDS
from sim.cli.answers import add_answer, report
from sim.measure.measured_launch import launch, machine
from sim.measure.stopwatch import Progress

WITH, WITHOUT = "with", "without"


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "--rounds",
        type=ROUNDS,
        default=5,
        help="rounds of with and without (default 5)",
    )
    parser.add_argument(
        "--seconds",
        type=SECONDS,
        default=4.0,
        help="length of each launch (default 4 s)",
    )
    add_answer(parser, run, files=False)


def measure(rounds: int, seconds: float, progress: Progress) -> dict[str, Any]:
    """Launch with and without in turn; the order alternates, because the machine drifts."""
    found: dict[str, list[dict[str, Any]]] = {WITH: [], WITHOUT: []}
    for i in range(rounds):
        for half in (WITH, WITHOUT) if i % 2 else (WITHOUT, WITH):
            words = ("--without", "ros2") if half == WITHOUT else ()
            found[half].append(launch("ros2_wall", f"duration:={seconds}", *words))
            progress.step(f"{half} ROS 2")
    figures: dict[str, Any] = {
        half: (
            {
                name: statistics.median(one["response_us"][name] for one in runs)
                for name in ("p50", "p99")
            }
            | {"missed": sum(one["missed"] + one["overruns"] for one in runs)}
        )
        for half, runs in found.items()
    }
    for name in ("p50", "p99"):
        pairs = zip(found[WITH], found[WITHOUT], strict=True)
        ratios = [
            one["response_us"][name] / other["response_us"][name]
            for one, other in pairs
        ]
        figures[f"{name}_ratio"] = statistics.median(ratios)
        figures[f"{name}_ratio_range"] = [min(ratios), max(ratios)]
    return figures


def run(arguments: argparse.Namespace) -> int:
    """Run the benchmark."""
    figures = measure(
        arguments.rounds, arguments.seconds, Progress(2 * arguments.rounds)
    )
    figures["machine"] = machine()
    lines = [figures["machine"]]
    for half in (WITHOUT, WITH):
        own = figures[half]
        lines.append(
            f"response {half:7} p50 {own['p50']:.0f} µs, p99 {own['p99']:.0f} µs, missed"
            f" {own['missed']} ticks"
        )
    for name in ("p50", "p99"):
        low, high = figures[f"{name}_ratio_range"]
        lines.append(
            f"{name} with/without {figures[f'{name}_ratio']:.2f} ({low:.2f} to {high:.2f})"
        )
    return report(arguments, figures, lines)
