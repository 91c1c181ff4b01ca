"""List, show, measure and publish topics of a launch, with the options of ``ros2 topic``."""

from __future__ import annotations

import argparse
import json
import math
import signal
import time
from collections import deque
from collections.abc import Iterator
from functools import partial
from typing import TYPE_CHECKING, Any

import msgspec

from messages.errors import UsageError
from messages.schema import schema
from messages.topics import LOOP, message_type
from nodes.base.printable import printable
from nodes.cli.ask import chosen_run, sub_verb
from nodes.cli.main import answer, heeding
from nodes.cli.publish import add as add_publish
from nodes.cli.publish import publish
from nodes.client.launches import known_topic
from nodes.parameters.quantities import above_zero

if TYPE_CHECKING:
    from nodes.client.listen import Heard
    from nodes.launcher.runs import RunInfo

REPORT_PERIOD = 1.0  # time between interim results of hz, bw and delay [s]


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-verbs."""
    measured: tuple[tuple[str, type[_Measure], str], ...] = (
        ("hz", _Measure, "Measure rate and intervals of a topic, as received."),
        ("bw", _Bandwidth, "Measure the bandwidth of a topic."),
        (
            "delay",
            _Delay,
            "Measure the time from a message's stamp to its receipt (realtime runs).",
        ),
    )
    sub = parser.add_subparsers(
        dest="chosen", metavar="list|info|echo|hz|bw|delay|pub", required=True
    )
    declare = partial(sub_verb, sub)
    listing = declare("list", _list, "List the topics with their types and publishers.")
    listing.add_argument(
        "--show-types",
        "-t",
        action="store_true",
        help="print name and [type] only, as ROS 2 does",
    )
    declare(
        "info", _info, "Show a topic's type, fields with units, and publisher."
    ).add_argument("topic")
    text = "Print the messages of a topic (with --json: one JSON object per line)."
    echo = declare("echo", _echo, text)
    echo.add_argument(
        "--once", action="store_true", help="print one message, then exit (-n 1)"
    )
    echo.add_argument(
        "--field",
        metavar="NAME",
        help="print only this field, e.g. position or position[2]",
    )
    text = "Publish an external force or hand target, within the driver's limits."
    add_publish(declare("pub", publish, text))
    figures = [
        declare(name, partial(_measure, measure), text)
        for name, measure, text in measured
    ]
    for own in figures:
        own.add_argument(
            "--window",
            "-w",
            type=_count,
            default=0,
            metavar="N",
            help="measure only the last N messages (default: all)",
        )
    for own in (echo, *figures):
        _add_ends(own)


def _add_ends(own: argparse.ArgumentParser) -> None:
    """Declare a topic, and when to stop listening to it."""
    own.add_argument("topic")
    own.add_argument(
        "--count",
        "-n",
        type=_count,
        default=0,
        metavar="N",
        help="exit after N messages",
    )
    own.add_argument(
        "--duration",
        type=above_zero,
        default=0.0,
        metavar="S",
        help="exit after S seconds",
    )


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} must be at least 1")
    return value


def _published(run: RunInfo) -> dict[str, str]:
    """Return the publishing node of each topic."""
    nodes = {endpoint: name for name, endpoint in run.publishers().items()}
    return {topic: nodes[endpoint] for topic, endpoint in run.endpoints().items()}


def _type_name(topic: str) -> str:
    kind = message_type(topic)
    return kind.__name__ if kind is not None else "unknown"


def _list(arguments: argparse.Namespace) -> int:
    run = chosen_run(arguments)
    found = {
        topic: {"type": _type_name(topic), "node": node}
        for topic, node in _published(run).items()
    }
    width = max(map(len, found))
    if arguments.show_types:
        lines = [f"{topic} [haptic.{shown['type']}]" for topic, shown in found.items()]
    else:
        lines = [
            f"{topic:{width}}  {shown['type']:12} {shown['node']}"
            for topic, shown in found.items()
        ]
    return answer(arguments.json, {"run": run.run, "topics": found}, "\n".join(lines))


def _info(arguments: argparse.Namespace) -> int:
    run = chosen_run(arguments)
    topic = arguments.topic
    known_topic(run, topic)
    kind = message_type(topic)
    shown: dict[str, Any] = schema(kind) if kind is not None else {"properties": {}}
    figures = {
        "topic": topic,
        "type": _type_name(topic),
        "node": _published(run)[topic],
        "endpoint": run.endpoints()[topic],
        "per_tick": topic in LOOP,
        "schema": shown,
    }
    lines = [
        f"{topic}  {figures['type']}",
        f"  published by {figures['node']} on {figures['endpoint']}"
        + (", once per tick" if topic in LOOP else ""),
    ]
    width = max(map(len, shown["properties"]), default=0)
    lines += [
        f"  {name:{width}}  {field['type']:8} {field['description']}"
        for name, field in shown["properties"].items()
    ]
    return answer(arguments.json, figures, "\n".join(lines))


def _heard(arguments: argparse.Namespace, run: RunInfo) -> Iterator[Heard | None]:
    """Yield the messages of the chosen topic until count, duration, signal or the run's end."""
    from nodes.client.listen import listen

    # On a signal, the results so far are still printed and sockets closed.
    ended: list[int] = []
    left = 1 if getattr(arguments, "once", False) else arguments.count or -1
    with heeding(ended.append, (signal.SIGINT, signal.SIGTERM)):
        for heard in listen(run, [arguments.topic], arguments.duration):
            yield heard
            left -= heard is not None
            if left == 0 or ended:
                return


def _field(value: Any, path: str) -> Any:
    """Return a field of a decoded message, or an element of it."""
    name, _, index = path.partition("[")
    try:
        found = value[name]
        return found[int(index.rstrip("]"))] if index else found
    except (KeyError, IndexError, ValueError, TypeError) as error:
        raise UsageError(
            f"--field {path}: no such field; there are {', '.join(value)}"
        ) from error


def _echo(arguments: argparse.Namespace) -> int:
    run = chosen_run(arguments)
    known_topic(run, arguments.topic)
    count = 0
    for heard in _heard(arguments, run):
        if heard is None or heard.message is None:
            continue
        count += 1
        value = msgspec.to_builtins(heard.message)
        if arguments.field:
            value = _field(value, arguments.field)
        if arguments.json:
            print(json.dumps(value), flush=True)
        elif isinstance(value, dict):
            print(
                printable(
                    "\n".join(
                        f"{name}: {json.dumps(item, ensure_ascii=False)}"
                        for name, item in value.items()
                    )
                )
            )
            print("---", flush=True)
        else:
            print(printable(json.dumps(value, ensure_ascii=False)), flush=True)
    return 0 if count else 1


class Spread:
    """Running count, mean and standard deviation of numbers (Welford 1962); 0 without values."""

    def __init__(self) -> None:
        self.count = 0
        self.mean = self.low = self.high = 0.0
        self._squares = 0.0

    def add(self, value: float) -> None:
        """Add a value."""
        self.count += 1
        first = self.count == 1
        self.low, self.high = (
            (value, value) if first else (min(self.low, value), max(self.high, value))
        )
        off = value - self.mean
        self.mean += off / self.count
        self._squares += off * (value - self.mean)

    @property
    def deviation(self) -> float:
        """Return the population standard deviation."""
        return math.sqrt(self._squares / self.count) if self.count else 0.0

    def figures(self) -> dict[str, float]:
        """Return mean, minimum, maximum and standard deviation."""
        return {
            "mean": self.mean,
            "min": self.low,
            "max": self.high,
            "std": self.deviation,
        }


class _Measure:
    """Measurement of ``hz``, and base of ``bw`` and ``delay``."""

    def __init__(self) -> None:
        # messages, malformed ones, missing seq
        self.count = self.refused = self._gaps = 0
        self._first = self._last = 0.0
        self._seq: int | None = None
        self._spread = Spread()

    def take(self, heard: Heard) -> None:
        if (value := self._value(heard)) is not None:
            self._spread.add(value)
        if heard.message is None:
            self.refused += 1
            return
        self._first = self._first if self.count else heard.time
        self.count += 1
        self._last = heard.time
        if self._seq is not None and heard.topic in LOOP:
            self._gaps += max(heard.message.seq - self._seq - 1, 0)
        self._seq = heard.message.seq

    def _value(self, heard: Heard) -> float | None:
        """Return the measured value of a message, if it has one."""
        return (
            heard.time - self._last
            if self.count and heard.message is not None
            else None
        )

    def figures(self) -> dict[str, Any]:
        span = self._last - self._first
        rate = (self.count - 1) / span if span > 0.0 else 0.0
        return {
            "messages": self.count,
            "refused": self.refused,
            "gaps": self._gaps,
            "rate_hz": rate,
            **self._own(rate),
        }

    def _own(self, rate: float) -> dict[str, Any]:
        del rate
        return {"interval_s": self._spread.figures()}

    def line(self) -> str:
        spread = self._spread
        return (
            f"average rate: {self.figures()['rate_hz']:.3f} Hz   interval min"
            f" {spread.low * 1e3:.3f}, max {spread.high * 1e3:.3f}, std"
            f" {spread.deviation * 1e3:.3f} ms   window: {self.count}, gaps: {self._gaps}"
        )


class _Bandwidth(_Measure):
    def _value(self, heard: Heard) -> float:
        return heard.size

    def _own(self, rate: float) -> dict[str, Any]:
        size = self._spread
        shown = {"mean": size.mean, "min": size.low, "max": size.high}
        return {"bandwidth_bytes_per_s": rate * size.mean, "size_bytes": shown}

    def line(self) -> str:
        bandwidth = self.figures()["bandwidth_bytes_per_s"]
        size = self._spread
        return (
            f"{bandwidth / 1e3:.2f} kB/s from {self.count} messages"
            f"   size mean {size.mean:.0f}, min {size.low:.0f}, max {size.high:.0f} B"
        )


class _Delay(_Measure):
    def __init__(self) -> None:
        from nodes.driver.response_times import ResponseTimes

        super().__init__()
        self._times = ResponseTimes()

    def _value(self, heard: Heard) -> float | None:
        if heard.message is None:
            return None
        delay = heard.time - heard.message.stamp
        self._times.add(max(delay, 0.0))
        return delay

    def _own(self, rate: float) -> dict[str, Any]:
        del rate
        shares = dict(
            zip(("p50", "p99"), self._times.percentiles(0.5, 0.99), strict=True)
        )
        return {"delay_s": self._spread.figures() | shares}

    def line(self) -> str:
        shown = {
            name: f"{value * 1e6:.0f}"
            for name, value in self.figures()["delay_s"].items()
        }
        return (
            f"average delay: {shown['mean']} µs   min {shown['min']}, p50 {shown['p50']}, p99"
            f" {shown['p99']}, max {shown['max']}, std {shown['std']} µs   window: {self.count}"
        )


def _measure(kind: type[_Measure], arguments: argparse.Namespace) -> int:
    run = chosen_run(arguments)
    if kind is _Delay and any(setup.pace == "lockstep" for setup in run.nodes.values()):
        raise UsageError(
            f"{run.run}: in lockstep stamps are simulated time, so there is no delay to measure;"
            " use pace:=realtime"
        )
    known_topic(run, arguments.topic)
    measure = kind()
    window: deque[Heard] = deque(maxlen=arguments.window)

    def now() -> _Measure:
        if not arguments.window:
            return measure
        newest = kind()
        for heard in window:
            newest.take(heard)
        return newest

    following = time.monotonic() + REPORT_PERIOD
    shown = -1
    for heard in _heard(arguments, run):
        if heard is not None:
            measure.take(heard)
            window.append(heard)
        if not arguments.json and time.monotonic() >= following:
            following += REPORT_PERIOD
            print(
                now().line() if measure.count != shown else "no new messages",
                flush=True,
            )
            shown = measure.count
    answer(arguments.json, {"topic": arguments.topic, **now().figures()}, now().line())
    return 0 if measure.count else 1
