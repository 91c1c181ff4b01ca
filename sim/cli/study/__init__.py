"""Study stability, designs and the paper's figures: one sub-verb per study."""

import argparse

from nodes.cli.dispatch import dispatch


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the studies."""
    dispatch(parser, "study", "study")
