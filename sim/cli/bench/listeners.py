"""Measure the cost of listeners: four more loggers, one stopped, one killed, against none."""

import argparse
import signal
import statistics
import subprocess
import time
from typing import Any

from messages.topics import DEVICE_STATE
from nodes.parameters.quantities import ROUNDS, SECONDS, declare
from nodes.recording.accounts import overruns
from nodes.recording.reader import Recording
from sim.cli.answers import add_answer, report
from sim.measure.haptic_commands import HAPTIC, wait_for
from sim.measure.measured_launch import Running, machine, responses_in
from sim.measure.stopwatch import Progress

LISTENERS = 4


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


def measure(
    rounds: int, seconds: float, rate: float, progress: Progress
) -> dict[str, Any]:
    """Run one launch and attach loggers in every second half of a round."""
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
                listeners = _listen(launch, LISTENERS, f"round{i}")
                listeners[0].send_signal(signal.SIGSTOP)
                listeners[1].kill()
                began = time.monotonic()
                time.sleep(seconds)
                halves["with"].append((began, time.monotonic()))
                progress.step("with four, one stopped, one killed")
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
    quiet, busy = found["without"]["p99_us"], found["with"]["p99_us"]
    middle = {
        f"{label}_us": {
            name: statistics.median(one[f"{name}_us"]) for name in ("p50", "p99")
        }
        for label, one in found.items()
    }
    return middle | {
        "p99_ratio": statistics.median(
            with_ / without for with_, without in zip(busy, quiet, strict=True)
        ),
        "spread_without": max(quiet) / min(quiet),
        "missed": {label: one["missed"] for label, one in found.items()},
        "lost_by_own_logger": gaps,
    }


def run(arguments: argparse.Namespace) -> int:
    """Run the benchmark."""
    progress = Progress(2 * arguments.rounds)
    figures = measure(arguments.rounds, arguments.seconds, arguments.rate, progress)
    figures["machine"] = machine()
    without, with_ = figures["without_us"], figures["with_us"]
    text = (
        f"{figures['machine']}\nresponse without listeners p50 {without['p50']:.0f} µs, p99"
        f" {without['p99']:.0f} µs; with four extra loggers, one stopped and one killed, p50"
        f" {with_['p50']:.0f} µs, p99 {with_['p99']:.0f} µs\np99 with/without"
        f" {figures['p99_ratio']:.2f}; rounds without listeners differ by"
        f" {figures['spread_without']:.2f}; missed {figures['missed']['without']} without,"
        f" {figures['missed']['with']} with; lost by the launch's own logger"
        f" {figures['lost_by_own_logger']}"
    )
    return report(arguments, figures, text)
