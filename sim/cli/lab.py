"""Check what this project claims: the paper's figures, counted intervals, the price of a law, proxies."""

import argparse

from nodes.cli.dispatch import dispatch
from sim.cli.functions import declare


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the experiments."""
    dispatch(parser, "lab", "experiment", declare=declare)
