"""Publish the topics of running launches on one fixed endpoint, e.g. for PlotJuggler.

Example: ``haptic relay tcp:

127.0.0.1:9872``. A launch's own endpoints are files of its run, one per node. PlotJuggler (3.10 or
later) connects one SUB socket to one address, ``tcp:

localhost:9872`` by default, and reads the relay's two frames: topic and MessagePack map.
"""

import argparse
import os
import sys
import time
from collections import Counter

import zmq

from messages.errors import UsageError
from messages.transport.context import new_context
from messages.transport.endpoints import Context
from messages.transport.open_port import OpenPort
from nodes.cli.ask import chosen_run
from nodes.cli.main import add_json, add_run_name, answer
from nodes.client.launches import known_topic
from nodes.client.listen import QUIET_MS, listening
from nodes.launcher.runs import RunInfo, alive, runs

# Default endpoint of PlotJuggler's ZeroMQ subscriber.
ENDPOINT = "tcp://127.0.0.1:9872"

_LOCAL = ("tcp://127.0.0.1:", "tcp://localhost:", "tcp://[::1]:", "ipc://")


def local_publisher(context: Context, endpoint: str) -> OpenPort:
    """Bind a publisher for subscribers of this machine, of any user; it receives nothing."""
    if not endpoint.startswith(_LOCAL):
        raise UsageError(
            f"{endpoint}: must begin with {', '.join(_LOCAL)}; a relay serves this machine only"
        )
    try:
        return OpenPort(context, endpoint, _say)
    except (ValueError, zmq.ZMQError) as error:
        raise UsageError(str(error)) from error


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "endpoint", nargs="?", default=ENDPOINT, help="endpoint to publish on"
    )
    parser.add_argument(
        "--topics",
        nargs="+",
        metavar="TOPIC",
        default=[],
        help="full topic names (default: all)",
    )
    add_run_name(parser)
    parser.add_argument(
        "--once",
        action="store_true",
        help="exit with the launch instead of waiting for the next one",
    )
    add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Relay one launch after the other, until Ctrl-C."""
    relayed: Counter[str] = Counter()
    names: list[str] = []
    context = new_context()
    try:
        publisher = local_publisher(context, arguments.endpoint)
        try:
            _say(f"publishing on {arguments.endpoint}; Ctrl-C ends")
            while True:
                found = (
                    chosen_run(arguments) if arguments.once else _next(arguments, names)
                )
                names.append(found.run)
                _say(f"relaying {found.run}")
                _relay(found, arguments.topics, publisher, relayed)
                if arguments.once:
                    break
        except KeyboardInterrupt:
            print(file=sys.stderr)
        finally:
            publisher.close()
    finally:
        context.destroy(linger=0)
    counted = "".join(f"\n  {topic}: {count}" for topic, count in relayed.items())
    figures = {"endpoint": arguments.endpoint, "runs": names, "relayed": dict(relayed)}
    return answer(
        arguments.json, figures, f"relayed {', '.join(names) or 'nothing'}{counted}"
    )


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _next(arguments: argparse.Namespace, before: list[str]) -> RunInfo:
    """Wait for a launch that was not relayed before."""
    wanted = arguments.run_name or os.environ.get("HAPTIC_RUN")
    waiting = False
    while True:
        found = [
            one
            for one in runs().values()
            if one.run not in before and wanted in (None, "", one.run, one.scenario)
        ]
        if len(found) > 1:
            raise UsageError(
                f"several runs: {', '.join(one.run for one in found)}; choose one with --run NAME"
            )
        if found:
            return found[0]
        if not waiting:
            _say("waiting for a launch")
            waiting = True
        time.sleep(0.1)


def _relay(
    found: RunInfo, topics: list[str], publisher: OpenPort, relayed: Counter[str]
) -> None:
    known = found.endpoints()
    wanted = {known_topic(found, topic).encode(): topic for topic in topics or known}
    places = {known[topic] for topic in wanted.values()}
    with listening(found, places, wanted.values(), say=_say) as (inbox, links):
        while True:
            frames = inbox.receive(QUIET_MS)
            links.keep()
            publisher.keep()
            if frames is None:
                # The launcher has ended and no message is in flight.
                if not alive(found.launcher):
                    return
            elif frames[0] in wanted:
                publisher.send(*frames)
                relayed[wanted[frames[0]]] += 1
