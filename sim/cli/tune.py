"""Tune a law for a device: identify, design, predict, verify up to its edge, report."""

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
    """Run `haptic tune` with the command line in its report."""
    return function(replace(options, command=shlex.join(["haptic", *sys.argv[1:]])))
