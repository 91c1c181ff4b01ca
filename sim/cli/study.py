"""Study stability and designs: one sub-verb per study (haptic lab checks what this project claims)."""

import argparse

from nodes.cli.dispatch import dispatch
from sim.cli.functions import declare

_LAB = (
    "coverage curved fig2 fig3 fig4 optimise price proxies relatives tuned two_rate"  # no studies
)


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the studies."""
    moved = {name: f"lab {name}" for name in _LAB.split()}
    dispatch(parser, "study", "study", moved, declare)
