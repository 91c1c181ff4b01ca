"""Measure the cost of listeners to the loop: unruly loggers, or a Python stream.

Four more loggers, of which one is stopped and one killed; with --stream one program that reads all
ticks by ``run.stream``.
"""

import argparse
import signal
import statistics
import subprocess
import sys
import time
from typing import Any

from messages.topics import DEVICE_STATE
from nodes.parameters.quantities import ROUNDS, SECONDS, declare
from nodes.recording.accounts import overruns
from nodes.recording.reader import Recording
from sim.cli.answers import add_answer, report
from sim.measure.haptic_commands import HAPTIC, MeasurementError, wait_for
from sim.measure.measured_launch import Running, machine, responses_in
from sim.measure.stopwatch import Progress

LISTENERS = 4
FIRST = 100  # messages after which a stream counts as attached
# As a notebook does: every message of the loop, until it is killed.
STREAM = f"""
import haptic, itertools
run = haptic.connect()
messages = iter(run.stream("/device/state", "/environment/proxy", "/coupling/force"))
for received in itertools.islice(messages, {FIRST}):
    pass
print("attached", flush=True)
for received in messages:
    pass
"""


WORDS = {False: "with four loggers, one stopped, one killed", True: "with run.stream"}


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "--rounds",
        type=ROUNDS,
        default=5,
        help="rounds of without and with (default 5)",
    )
    parser.add_argument(
        "--seconds",
        type=SECONDS,
        default=4.0,
        help="length of each half of a round (default 4 s)",
    )
    declare(parser, rate=500.0)
    parser.add_argument(
        "--stream",
        action="store_true",
        help="a Python program with run.stream in place of the loggers",
    )
    add_answer(parser, run, files=False)


def _listen(launch: Running, count: int, label: str) -> list[subprocess.Popen[bytes]]:
    """Attach loggers; wait until the file of each grows."""
    paths = [launch.folder / f"{label}-{i}.mcap" for i in range(count)]
    listeners = [
        subprocess.Popen(
            [*HAPTIC, "bag", "record", "--out", str(path)],
            cwd=launch.folder,
            env=launch.environment,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        for path in paths
    ]
    for path in paths:
        wait_for(
            lambda path=path: path.exists() and path.stat().st_size > 20_000,  # type: ignore[misc]
            f"{path.name} grows",
            30.0,
        )
    return listeners


def _stream(launch: Running) -> list[subprocess.Popen[bytes]]:
    """Attach a Python program that streams; wait until messages come."""
    streamer = subprocess.Popen(
        [sys.executable, "-c", STREAM],
        cwd=launch.folder,
        env=launch.environment,
        stdout=subprocess.PIPE,
    )
    assert streamer.stdout is not None  # noqa: S101  # it is a pipe
    if streamer.stdout.readline() != b"attached\n":
        raise MeasurementError("bench listeners: the stream ended before its messages")
    return [streamer]


def _attach(launch: Running, stream: bool, label: str) -> list[subprocess.Popen[bytes]]:
    if stream:
        return _stream(launch)
    listeners = _listen(launch, LISTENERS, label)
    listeners[0].send_signal(signal.SIGSTOP)
    listeners[1].kill()
    return listeners


def measure(
    rounds: int, seconds: float, rate: float, stream: bool, progress: Progress
) -> dict[str, Any]:
    """Run one launch and attach listeners in every second half of a round."""
    halves: dict[str, list[tuple[float, float]]] = {"without": [], "with": []}
    with Running(
        "floor_drop", "duration:=0", f"rate:={rate}", "stiffness:=500"
    ) as launch:
        listeners: list[subprocess.Popen[bytes]] = []
        try:
            for i in range(rounds):
                began = time.monotonic()
                time.sleep(seconds)
                halves["without"].append((began, time.monotonic()))
                progress.step("without listeners")
                listeners = _attach(launch, stream, f"round{i}")
                began = time.monotonic()
                time.sleep(seconds)
                halves["with"].append((began, time.monotonic()))
                progress.step(WORDS[stream])
                for listener in listeners:
                    listener.kill()
                    listener.wait()
            figures = launch.finish(signal.SIGINT)
        finally:
            for listener in listeners:
                listener.kill()
                listener.wait()
        recording = Recording(launch.folder / figures["recording"])
        states = recording.messages(DEVICE_STATE)
        gaps = recording.topics[DEVICE_STATE].gaps - (overruns(recording) or 0)
    found = {label: responses_in(states, spans) for label, spans in halves.items()}
    middle: dict[str, Any] = {
        f"{label}_us": {
            name: statistics.median(one[f"{name}_us"]) for name in ("p50", "p99")
        }
        for label, one in found.items()
    }
    for name in ("p50", "p99"):
        quiet, busy = found["without"][f"{name}_us"], found["with"][f"{name}_us"]
        pairs = zip(busy, quiet, strict=True)
        middle[f"{name}_ratio"] = statistics.median(a / b for a, b in pairs)
        middle[f"{name}_spread"] = max(quiet) / min(quiet)
    return middle | {
        "missed": {label: one["missed"] for label, one in found.items()},
        "lost_by_own_logger": gaps,
    }


def run(arguments: argparse.Namespace) -> int:
    """Run the benchmark."""
    progress = Progress(2 * arguments.rounds)
    figures = measure(
        arguments.rounds, arguments.seconds, arguments.rate, arguments.stream, progress
    )
    figures["machine"] = machine()
    without, with_ = figures["without_us"], figures["with_us"]
    lines = [
        figures["machine"],
        f"response without listeners p50 {without['p50']:.0f} µs, p99 {without['p99']:.0f} µs;"
        f" {WORDS[arguments.stream]} p50 {with_['p50']:.0f} µs, p99 {with_['p99']:.0f} µs",
    ]
    lines += [
        f"{name} with/without {figures[f'{name}_ratio']:.2f}; rounds without listeners differ by"
        f" {figures[f'{name}_spread']:.2f}"
        for name in ("p50", "p99")
    ]
    missed = figures["missed"]
    lines.append(
        f"missed {missed['without']} without, {missed['with']} with; lost by the launch's own"
        f" logger {figures['lost_by_own_logger']}"
    )
    return report(arguments, figures, lines)
