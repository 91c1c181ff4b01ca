"""Publish a recording again, at its pace or another."""

import argparse
import math
import signal
import sys
import time
from collections.abc import Iterable, Iterator

from messages.errors import UsageError
from messages.transport.open_port import OpenPort
from nodes.cli.bag_arguments import counted, opened
from nodes.cli.main import answer
from nodes.recording.reader import Recording


def play_recording(arguments: argparse.Namespace) -> int:
    """Publish a recording until its end or Ctrl-C, and count the messages."""
    from messages.transport.context import new_context
    from nodes.cli.relay import local_publisher
    from nodes.recording.play import length_of

    recording = opened(arguments.file)
    names = _remapped(recording, arguments.remap)
    if arguments.start_offset > (length := length_of(recording)):
        raise UsageError(
            f"--start-offset {arguments.start_offset:g}: it lasts {length:g} s"
        )
    counts: dict[str, int] = {}
    interrupts = []

    def interrupt(number: int, _: object) -> None:
        # One that is raised in a finaliser is lost: the loop looks for it, too.
        interrupts.append(number)
        raise KeyboardInterrupt

    context = new_context()
    try:
        publisher = local_publisher(context, arguments.endpoint)
    except UsageError:
        context.destroy(linger=0)
        raise
    before = signal.signal(signal.SIGINT, interrupt)
    try:
        print(
            f"publishing on {arguments.endpoint}; Ctrl-C ends",
            file=sys.stderr,
            flush=True,
        )
        while arguments.wait and not publisher.listeners():
            time.sleep(0.01)
        again = True
        while again:
            for topic in _round(arguments, recording, publisher, names):
                counts[topic] = counts.get(topic, 0) + 1
                if interrupts:
                    break
            again = bool(arguments.loop and counts and not interrupts)
    except KeyboardInterrupt:
        print(file=sys.stderr)
    finally:
        signal.signal(signal.SIGINT, before)
        publisher.close()
        context.destroy(linger=0)
    pace = (
        "without a pause"
        if math.isinf(arguments.rate)
        else f"at {arguments.rate:g} times the original pace"
    )
    return answer(
        arguments.json, {"published": counts}, f"published {pace}:\n{counted(counts)}"
    )


def _round(
    arguments: argparse.Namespace,
    recording: Recording,
    publisher: OpenPort,
    names: dict[str, str],
) -> Iterator[str]:
    """Publish a recording once; yield the topic of each message, as it is published."""
    from nodes.recording.play import play

    for entry in play(
        recording,
        publisher,
        rate=arguments.rate,
        topics=arguments.topics,
        offset=arguments.start_offset,
        remap=names,
    ):
        yield names.get(entry.topic, entry.topic)


def _remapped(recording: Recording, words: Iterable[str]) -> dict[str, str]:
    names = {}
    for word in words:
        old, sign, new = word.partition(":=")
        if not sign or not new.startswith("/"):
            raise UsageError(
                f"--remap {word}: expected OLD:=NEW, both with a leading slash"
            )
        if old not in recording.topics:
            raise UsageError(
                f"--remap {word}: no topic {old!r}; there are {', '.join(recording.topics)}"
            )
        names[old] = new
    return names
