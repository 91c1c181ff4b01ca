"""Asking the nodes of a running launch, for the verbs: nodes/client, with exit codes in place of its errors."""

from __future__ import annotations

import argparse
from typing import Any

from messages.transport.requests import ControlError
from nodes.cli.main import RefusedError, UsageError, add_json, add_run_name
from nodes.client import launches
from nodes.client.launches import NoSuchNameError
from nodes.launcher.runs import RunError, RunInfo


def add_run(parser: argparse.ArgumentParser) -> None:
    """Declare --run and --json."""
    add_run_name(parser)
    add_json(parser)


def chosen_run(arguments: argparse.Namespace) -> RunInfo:
    """Find the run that is meant: by --run, else by the variable HAPTIC_RUN, else the only one."""
    try:
        return launches.find(arguments.run_name)
    except RunError as error:
        raise UsageError(str(error)) from error


def chosen_chain(arguments: argparse.Namespace) -> RunInfo:
    """Find the chain that is meant: as `chosen_run`, and of a run with several one has to be named."""
    try:
        return chosen_run(arguments).only_chain()
    except RunError as error:
        raise UsageError(str(error)) from error


def node_name(run: RunInfo, name: str) -> str:
    """Find a node by name, with or without the leading slash."""
    try:
        return launches.node_name(run, name)
    except NoSuchNameError as error:
        raise UsageError(str(error)) from error


def known_topic(run: RunInfo, topic: str) -> str:
    """Check that a topic is published in a run; names are whole names."""
    try:
        return launches.known_topic(run, topic)
    except NoSuchNameError as error:
        raise UsageError(str(error)) from error


def ask(run: RunInfo, node: str, op: str, **args: Any) -> Any:
    """Ask one node."""
    try:
        return launches.ask(run, node, op, **args)
    except ControlError as error:
        raise RefusedError(str(error)) from error
