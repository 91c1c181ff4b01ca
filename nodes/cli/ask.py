"""Find the running launch, node or chain that a verb addresses."""

from __future__ import annotations

import argparse
from collections.abc import Callable

from nodes.cli.main import add_json, add_run_name
from nodes.client import launches
from nodes.launcher.runs import RunInfo


def add_run(parser: argparse.ArgumentParser) -> None:
    """Declare --run and --json."""
    add_run_name(parser)
    add_json(parser)


def sub_verb(
    sub: argparse._SubParsersAction[argparse.ArgumentParser],
    name: str,
    run: Callable[[argparse.Namespace], int],
    text: str,
) -> argparse.ArgumentParser:
    """Declare a sub-verb that talks to a running launch; `text` is its help."""
    own = sub.add_parser(name, help=text, description=text)
    own.set_defaults(run=run)
    add_run(own)
    return own


def chosen_run(arguments: argparse.Namespace) -> RunInfo:
    """Return the run given by --run, else by the variable HAPTIC_RUN, else the only one."""
    return launches.find(arguments.run_name)


def chosen_node(arguments: argparse.Namespace) -> tuple[RunInfo, str]:
    """Return the run and the full name of the node given by the argument ``node``."""
    run = chosen_run(arguments)
    return run, launches.node_name(run, arguments.node)


def chosen_chain(arguments: argparse.Namespace) -> RunInfo:
    """Return the chain given by --run as `chosen_run`; of several, one must be named."""
    return chosen_run(arguments).only_chain()
