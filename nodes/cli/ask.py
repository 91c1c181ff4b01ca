"""Asking the nodes of a running launch, for the verbs: which run, which node, and refusals as exit codes."""

from __future__ import annotations

import argparse
import difflib
import os
from typing import Any

from messages.transport.requests import ControlError, call
from messages.transport.sockets import new_context
from nodes.cli.main import RefusedError, UsageError, add_json, add_run_name
from nodes.launcher.runs import RunError, RunInfo, find_run

TIMEOUT = 10.0
"""Longest wait for an answer [s]: judging a law of thousands of taps takes seconds."""


def add_run(parser: argparse.ArgumentParser) -> None:
    """Declare --run and --json."""
    add_run_name(parser)
    add_json(parser)


def chosen_run(arguments: argparse.Namespace) -> RunInfo:
    """Find the run that is meant: by --run, else by the variable HAPTIC_RUN, else the only one."""
    told = os.environ.get("HAPTIC_RUN") or None
    try:
        return find_run(arguments.run_name or told)
    except RunError as error:
        source = f" (HAPTIC_RUN is {told!r})" if told and not arguments.run_name else ""
        raise UsageError(f"{error}{source}") from error


def node_name(run: RunInfo, name: str) -> str:
    """Find a node by name, with or without the leading slash."""
    plain = name.removeprefix("/")
    if plain in run.nodes:
        return plain
    close = difflib.get_close_matches(plain, run.nodes, 1)
    hint = f"did you mean {close[0]}?" if close else f"there is: {', '.join(run.nodes)}"
    raise UsageError(f"{run.run}: no node is named {name!r}; {hint}")


def known_topic(run: RunInfo, topic: str) -> str:
    """Check that a topic is published in a run; names are whole names."""
    known = list(run.endpoints())
    if topic not in known:
        close = difflib.get_close_matches(topic, known, 1)
        hint = f"did you mean {close[0]}?" if close else f"there are {', '.join(known)}"
        raise UsageError(f"{run.run}: no topic {topic!r}; {hint}")
    return topic


def ask(run: RunInfo, node: str, op: str, **args: object) -> Any:
    """Ask one node."""
    context = new_context()
    try:
        return call(context, run.nodes[node].control, op, timeout=TIMEOUT, **args)
    except (ControlError, ValueError, OverflowError, TypeError) as error:
        # Beside refusals: an endpoint or key that cannot be used, a value that no message can carry.
        raise RefusedError(str(error)) from error
    finally:
        context.term()
