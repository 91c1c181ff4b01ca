"""Measure the project's speed: one sub-verb per question, ratios taken in one run."""

from __future__ import annotations

import argparse

from nodes.cli.dispatch import dispatch


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the benchmarks."""
    dispatch(parser, "bench", "benchmark")
