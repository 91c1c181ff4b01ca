"""Check this project's claims: the paper's figures, intervals, costs of laws, proxies."""

import argparse

from nodes.cli.dispatch import dispatch
from sim.cli.functions import declare


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the experiments."""
    dispatch(parser, "lab", "experiment", declare=declare)
