"""Study stability and designs: one sub-verb per study (haptic lab checks the claims)."""

import argparse

from nodes.cli.dispatch import dispatch
from sim.cli.functions import declare

_LAB = (
    # moved to haptic lab
    "coverage curved fig2 fig3 fig4 optimise price proxies relatives tuned two_rate"
)


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the studies."""
    moved = {name: f"lab {name}" for name in _LAB.split()}
    dispatch(parser, "study", "study", moved, declare)
