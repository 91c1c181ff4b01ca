"""Tune a law for the device at hand: identify it, design, predict, try it from far below up to its edge, and report."""

import argparse
import shlex
import sys
from dataclasses import replace

from sim.cli.functions import declare
from sim.tune.tune import TuneResult
from sim.tune.tune import tune as function
from sim.tune.tune_options import TuneOptions


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    declare(tune, parser)


def tune(options: TuneOptions) -> TuneResult:
    """Tune, with what was typed in the report."""
    return function(replace(options, command=shlex.join(["haptic", *sys.argv[1:]])))
