"""Measure the project's speed: one sub-verb per question, ratios taken in one run.

A benchmark is a module of sim.bench with the same shape as a verb: its docstring's first line is its help, ``add(parser)``
declares its arguments and sets ``run``. Only the one asked for is imported.
"""

from __future__ import annotations

import argparse

from nodes.cli.dispatch import dispatch

BENCHMARKS: dict[str, str] = {
    "curve": "sim.bench.curve",
    "loop": "sim.bench.loop",
    "listeners": "sim.bench.listeners",
    "ros2": "sim.bench.ros2",
    "swaps": "sim.bench.swaps",
    "simulator": "sim.bench.simulator",
    "taps": "sim.bench.taps",
    "view": "sim.bench.view",
}


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the benchmarks."""
    dispatch(parser, BENCHMARKS, "benchmark")
