"""The running launch that a verb means."""

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
    """Declare a sub-verb that speaks to a running launch; the text is its help."""
    own = sub.add_parser(name, help=text, description=text)
    own.set_defaults(run=run)
    add_run(own)
    return own


def chosen_run(arguments: argparse.Namespace) -> RunInfo:
    """Find the run that is meant: by --run, else by the variable HAPTIC_RUN, else the only one."""
    return launches.find(arguments.run_name)


def chosen_node(arguments: argparse.Namespace) -> tuple[RunInfo, str]:
    """Find the run and, by the argument ``node``, the name of the node that are meant."""
    run = chosen_run(arguments)
    return run, launches.node_name(run, arguments.node)


def chosen_chain(arguments: argparse.Namespace) -> RunInfo:
    """Find the chain that is meant: as `chosen_run`, and of a run with several one has to be named."""
    return chosen_run(arguments).only_chain()
