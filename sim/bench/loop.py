"""The running loop against a bare pyzmq+msgpack loop: lockstep throughput, response, start-up, memory, CPU."""

from __future__ import annotations

import argparse
import contextlib
import statistics
from typing import Any

from nodes.base.realtime import awake, quietest_processor
from nodes.cli.main import answer
from nodes.launcher.launch_spec import AWAKE_RATE
from sim.measure.launches import bare_loop, fifo_granted, launch, machine
from sim.measure.stopwatch import Progress

RATES = (500, 2000, 4000)


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of this benchmark.
    """
    parser.add_argument("--rounds", type=int, default=5, help="interleaved rounds of each (default 5)")
    parser.add_argument("--ticks", type=int, default=20000, help="ticks of a lockstep round (default 20000)")
    parser.add_argument("--seconds", type=float, default=5.0, help="length of a real-time round (default 5 s)")
    parser.add_argument("--json", action="store_true", help="one JSON object on the last line")
    parser.set_defaults(run=run)


def lockstep(rounds: int, ticks: int, progress: Progress) -> dict[str, Any]:
    """Time lockstep against the bare loop, round by round.

    Parameters
    ----------
    rounds : int
        How many pairs.
    ticks : int
        Ticks of one run.
    progress : Progress
        Told after every run.

    Returns
    -------
    dict
        Medians, and the median of the ratios bare / ours pair by pair.
    """
    core = str(quietest_processor())
    ours, bare, ratios, last = [], [], [], {}
    for _ in range(rounds):
        bare.append(bare_loop(ticks, core)["ticks_per_s"])
        progress.step("bare lockstep")
        words = ("--without", "logger", "pace:=lockstep", f"duration:={ticks / 500.0}")
        last = launch("floor_drop", *words)
        ours.append(last["rate_hz"])
        ratios.append(bare[-1] / ours[-1])
        progress.step("lockstep")
    return {
        "lockstep_ticks_per_s": statistics.median(ours),
        "bare_ticks_per_s": statistics.median(bare),
        "ratio": statistics.median(ratios),
        "ratio_range": [min(ratios), max(ratios)],
    }


def realtime(rounds: int, seconds: float, progress: Progress) -> dict[str, Any]:
    """Measure response and missed ticks at several rates, interleaved with the bare loop.

    Parameters
    ----------
    rounds : int
        How many rounds.
    seconds : float
        Length of one run [s].
    progress : Progress
        Told after every run.

    Returns
    -------
    dict
        Per rate: median percentiles of the rounds, share of missed ticks; CPU and memory by node.
    """
    core = str(quietest_processor())
    fifo = 50 if fifo_granted() else 0
    found: dict[int, list[dict[str, Any]]] = {rate: [] for rate in RATES}
    yard: dict[int, list[dict[str, Any]]] = {rate: [] for rate in RATES}
    for _ in range(rounds):
        for rate in RATES:
            found[rate].append(launch("floor_drop", f"rate:={rate}", f"duration:={seconds}", "stiffness:=500"))
            progress.step(f"{rate} Hz")
            # Whatever the launch asks the machine for, the yardstick gets as well.
            with awake() if rate >= AWAKE_RATE else contextlib.nullcontext():
                yard[rate].append(bare_loop(round(seconds * rate), core, fifo, float(rate)))
            progress.step(f"bare {rate} Hz")
    names = ("p50", "p99", "p999", "max")
    figures: dict[str, Any] = {"response_us": {}, "bare_response_us": {}, "missed_share": {}, "bare_missed_share": {}}
    for rate in RATES:
        key = f"{rate}_hz"
        runs, bares = found[rate], yard[rate]
        figures["response_us"][key] = {n: statistics.median(r["response_us"][n] for r in runs) for n in names}
        figures["bare_response_us"][key] = {n: statistics.median(r["response_us"][n] for r in bares) for n in names}
        lost = sum(r["missed"] + r["overruns"] for r in runs)
        figures["missed_share"][key] = lost / max(1, sum(r["ticks"] for r in runs))
        figures["bare_missed_share"][key] = sum(r["missed"] for r in bares) / sum(r["ticks"] for r in bares)
    slow = found[RATES[0]]
    nodes = slow[0]["nodes"]
    figures["memory_mb"] = {n: statistics.median(r["nodes"][n]["memory"] for r in slow) / 1e6 for n in nodes}
    figures["cpu_share"] = {n: statistics.median(r["nodes"][n]["cpu"] for r in slow) / seconds for n in nodes}
    figures["startup_s"] = statistics.median(r["startup_s"] for r in slow)
    figures["rate_error"] = max(abs(r["rate_hz"] / RATES[0] - 1.0) for r in slow)
    figures["fifo"] = bool(fifo)
    return figures


def text(figures: dict[str, Any]) -> str:
    """Write the figures for people.

    Parameters
    ----------
    figures : dict
        As measured.

    Returns
    -------
    str
        Several lines.
    """
    low, high = figures["ratio_range"]
    lines = [
        figures["machine"] + (", SCHED_FIFO granted" if figures["fifo"] else ", no SCHED_FIFO"),
        f"lockstep   {figures['lockstep_ticks_per_s']:.0f} ticks/s, bare loop {figures['bare_ticks_per_s']:.0f} ticks/s: "
        f"bare/ours {figures['ratio']:.2f} ({low:.2f} to {high:.2f})",
        f"start-up   {figures['startup_s']:.2f} s from the command to the first tick; "
        f"mean rate at 500 Hz off by at most {figures['rate_error']:.1e}",
    ]
    for key, response in figures["response_us"].items():
        bare = figures["bare_response_us"][key]
        lines.append(
            f"{key.replace('_hz', ' Hz'):10} response p50 {response['p50']:.0f} µs, p99 {response['p99']:.0f} µs, "
            f"max {response['max']:.0f} µs, missed {figures['missed_share'][key]:.3%}; "
            f"bare p50 {bare['p50']:.0f} µs, p99 {bare['p99']:.0f} µs, missed {figures['bare_missed_share'][key]:.3%}"
        )
    memory = ", ".join(f"{name} {value:.0f} MB" for name, value in figures["memory_mb"].items())
    cpu = ", ".join(f"{name} {value:.1%}" for name, value in figures["cpu_share"].items())
    return "\n".join([*lines, f"memory     {memory}", f"CPU 500 Hz {cpu} of a core, start-up included"])


def run(arguments: argparse.Namespace) -> int:
    """Run the benchmark.

    Parameters
    ----------
    arguments : argparse.Namespace
        As declared by `add`.

    Returns
    -------
    int
        0.
    """
    rounds = arguments.rounds
    progress = Progress(2 * rounds + 2 * rounds * len(RATES))
    figures = lockstep(rounds, arguments.ticks, progress)
    figures.update(realtime(rounds, arguments.seconds, progress))
    figures["machine"] = machine()
    answer(arguments.json, figures, text(figures))
    return 0
