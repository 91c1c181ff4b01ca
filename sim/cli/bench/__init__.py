"""Measure the project's speed: one sub-verb per question, ratios taken in one run."""

import argparse

from nodes.cli.dispatch import dispatch


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the benchmarks."""
    dispatch(parser, "bench", "benchmark")
