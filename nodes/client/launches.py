"""Find a running launch and its driver, environment and coupling; send requests.

Used by the command line, the studies and Python programs.
"""

import functools
import os
import time
from typing import Any

from messages import topics
from messages.errors import UsageError
from messages.transport.context import new_context
from messages.transport.requests import Connection, ControlError
from nodes.client.moved_device import is_moved, set_moved
from nodes.launcher.runs import RunError, RunInfo, alive, find_run, runs
from nodes.parameters.nearest import nearest

TIMEOUT = 10.0  # longest wait for an answer [s]: judging a law of thousands of taps takes seconds
FIND_TIMEOUT = 2.0  # longest wait for a launch that has just been started [s]

_PUBLISHES = {
    "driver": topics.DEVICE_STATE,
    "environment": topics.PROXY,
    "coupling": topics.FORCE,
}


class NoSuchNameError(UsageError):
    """A launch has no node or topic of that name; the text names the existing ones."""


def find(name: str | None = None, patience: float = FIND_TIMEOUT) -> RunInfo:
    """Return the launch named by run or scenario, by HAPTIC_RUN, or else the only one running.

    ``NAME/left`` or ``/left`` means only its chain in the namespace ``left``. `patience` is how
    long to wait while nothing runs [s], because a launch that has just been started takes time to
    appear.
    """
    wanted = os.environ.get("HAPTIC_RUN") or None
    until = time.monotonic() + patience
    while not runs() and time.monotonic() < until:
        time.sleep(0.05)
    try:
        chosen, _, namespace = (name or wanted or "").partition("/")
        found = find_run(chosen or None)
        return found.within(namespace) if namespace else found
    except RunError as error:
        source = f" (HAPTIC_RUN is {wanted!r})" if wanted and not name else ""
        raise RunError(f"{error}{source}") from error


def node_name(run: RunInfo, name: str) -> str:
    """Return a node's full name, given with or without slash; the error has the nearest name."""
    plain = name.removeprefix("/")
    if plain in run.nodes:
        return plain
    within = [node for node in run.nodes if node.rpartition("/")[2] == plain]
    if len(within) == 1:
        return within[0]
    if within:
        raise NoSuchNameError(
            f"{run.run}: several nodes are named {plain!r}: {', '.join(within)}; name one whole, or"
            f" choose its chain with --run /{within[0].rpartition('/')[0]}"
        )
    raise NoSuchNameError(
        f"{run.run}: no node is named {name!r}; {_hint(plain, list(run.nodes), 'available:')}"
    )


def known_topic(run: RunInfo, topic: str) -> str:
    """Check that a topic (full name) is published in a run; the error has the nearest name."""
    known = list(run.endpoints())
    if topic not in known:
        raise NoSuchNameError(
            f"{run.run}: no topic {topic!r}; {_hint(topic, known, 'there are')}"
        )
    return topic


def _hint(name: str, known: list[str], otherwise: str) -> str:
    meant = nearest(name, known)
    return f"did you mean {meant}?" if meant else f"{otherwise} {', '.join(known)}"


def roles(run: RunInfo) -> dict[str, str]:
    """Return the names of ``driver``, ``environment`` and ``coupling`` of the only chain.

    A node's role follows from what it publishes.
    """
    from nodes.base.node_kinds import load

    run.only_chain()
    published = {
        name: load(setup.factory).publishes for name, setup in run.nodes.items()
    }
    return {
        role: name
        for role, topic in _PUBLISHES.items()
        for name, mine in published.items()
        if topic in mine
    }


def ask(run: RunInfo, node: str, op: str, timeout: float = TIMEOUT, **args: Any) -> Any:
    """Send the request `op` to a node and return its answer (messages/PROTOCOL.md).

    Raises ControlError if the node refuses, does not answer, or cannot be reached.
    """
    node = node_name(run, node)
    if op == "param.set" and is_moved(run, node, args.get("values")):
        return set_moved(
            run,
            node,
            args["values"],
            functools.partial(_ask, run, timeout),
            bool(args.get("force")),
        )
    return _ask(run, timeout, node, op, **args)


def _ask(run: RunInfo, timeout: float, node: str, op: str, /, **args: Any) -> Any:
    def watch() -> None:
        if not alive(run.launcher, run.launcher_started):
            raise ControlError(f"{run.run} has ended, and nobody answers {op} any more")

    context = new_context()
    try:
        line = Connection(context, run.nodes[node].control, watch)
        return line.call(op, timeout, **args)
    except (ValueError, OverflowError, TypeError) as error:
        # an unusable endpoint or key, or a value that no message can carry
        raise ControlError(str(error)) from error
    finally:
        # includes sockets left open by an interrupt, for which term() alone would wait for ever
        context.destroy(linger=0)
