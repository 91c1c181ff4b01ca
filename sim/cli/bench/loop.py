"""Measure the loop, plain and compiled, against bare loops: rate, response, memory, CPU.

Besides the ordinary launch, the cases of sim/lab/bench/bare.py run in turn with it: the cost of a
guard and of a cross-fade, and whether a device behind its own servo loop misses more ticks than the
virtual one.
"""

import argparse
import contextlib
import statistics
import sys
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from nodes.base.realtime import awake, quietest_processor
from nodes.base.setup import Tick
from nodes.compiled.choose_tick import choose
from nodes.launcher.launch_spec import AWAKE_RATE
from nodes.parameters.quantities import COUNT, ROUNDS, SECONDS, whole
from sim.cli.answers import add_answer, idle, report
from sim.lab.bench import bare
from sim.lab.bench.bare import BARE, bare_loop, c_loop
from sim.measure.measured_launch import fifo_granted, launch, machine
from sim.measure.stopwatch import Progress

RATES = (500, 4000, 8000)

# The loop with compiled ticks.
KERNELS = (
    "nodes.environment.kernel",
    "nodes.coupling.kernel",
    "nodes.driver.kernel",
    "sim.device.kernel",
)
# The compared loops; a bare loop has a logger if ours has one.
NAMES = {
    "compiled": "compiled",
    "plain": "plain",
    "bare": "bare pyzmq + msgpack",
    "c": "bare C",
    **{
        f"{tick} {case}": f"{tick}, {label}"
        for case, label in bare.CASES.items()
        for tick in ("compiled", "plain")
    },
}
# Arguments of each case and of the ordinary launch; see sim/lab/bench/bare.py.
Launches = Mapping[str, tuple[str, ...]]


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "--rounds",
        type=ROUNDS,
        default=3,
        help="interleaved rounds of each (default 3)",
    )
    parser.add_argument(
        "--ticks",
        type=whole(1, 10**8),
        default=20000,
        help="ticks of a lockstep round (default 20000)",
    )
    parser.add_argument(
        "--seconds",
        type=SECONDS,
        default=10.0,
        help="length of a real-time round (default 10 s)",
    )
    parser.add_argument(
        "--rates",
        type=COUNT,
        nargs="+",
        default=RATES,
        metavar="HZ",
        help="of the real-time rounds (default 500 4000 8000)",
    )
    parser.add_argument(
        "--cases",
        nargs="*",
        choices=bare.CASES,
        default=list(bare.CASES),
        help=(
            f"beside the ordinary launch (default all; stand_in at {bare.SERVO_RATE} Hz, where that"
            " is a rate)"
        ),
    )
    parser.add_argument(
        "--scenes",
        action="store_true",
        help=(
            "scenes in three axes against the floor at 500 Hz, in place of that: missed, response,"
            " the environment's time"
        ),
    )
    parser.add_argument(
        "--finest",
        type=whole(2, 7),
        default=7,
        help="of --scenes: a ball of 20·4ⁿ triangles (default 7)",
    )
    add_answer(parser, run, files=False)


def _loops(
    tick: Tick, launches: Launches
) -> dict[str, Callable[[int, str, bool], float]]:
    """Return the loops compared in lockstep, each a function that returns ticks per second."""

    def ours(tick: str, case: str = "") -> Callable[[int, str, bool], float]:
        def measure(ticks: int, _: str, logger: bool) -> float:
            words = [] if logger else ["--without", "logger"]
            words += ["pace:=lockstep", f"duration:={ticks / 500.0}", "--tick", tick]
            return float(launch(*launches[case], *words)["rate_hz"])

        return measure

    def bare(program: Sequence[str]) -> Callable[[int, str, bool], float]:
        return lambda ticks, core, logger: float(
            bare_loop(ticks, core, logger=logger, program=program)["ticks_per_s"]
        )

    loops = {"plain": ours("plain"), "bare": bare(BARE)}
    if tick == "compiled":
        loops["compiled"] = ours("compiled")
    in_c = c_loop()
    if in_c is not None:
        loops["c"] = bare(in_c)
    for case in launches.keys() - {"", "stand_in"}:
        loops |= {
            f"{one} {case}": ours(one, case) for one in dict.fromkeys(("plain", tick))
        }
    return loops


def _names(loops: Mapping[str, Any]) -> list[str]:
    """Return the rows of lockstep: each loop with and without a logger, cases without."""
    return [*loops, *(f"{name}_with_logger" for name in loops if " " not in name)]


def _programs() -> dict[str, Sequence[str]]:
    """Return the commands of the bare loops."""
    in_c = c_loop()
    return {"bare": BARE} if in_c is None else {"bare": BARE, "c": in_c}


def _rows(
    rates: Sequence[int], tick: Tick, launches: Launches
) -> list[tuple[str, int]]:
    """Return the realtime rows with their rates [Hz]; a case has only one rate."""
    ours = tuple(dict.fromkeys(("plain", tick)))
    found = [(name, rate) for rate in rates for name in (*ours, *_programs())]
    for case in bare.CASES.keys() & launches.keys():
        rate = bare.SERVO_RATE if case == "stand_in" else rates[0]
        if rate in rates:
            found += [
                (f"{one} {case}", rate)
                for one in (ours if case != "stand_in" else (tick,))
            ]
    return found


def lockstep(
    rounds: int,
    ticks: int,
    loops: Mapping[str, Callable[[int, str, bool], float]],
    tick: Tick,
    progress: Progress,
) -> dict[str, Any]:
    """Time lockstep against the bare loops, round by round."""
    core = str(quietest_processor())
    names = _names(loops)
    found: dict[str, list[float]] = {name: [] for name in names}
    for k in range(rounds):
        # The order rotates, because the machine drifts.
        for name in names[k % len(names) :] + names[: k % len(names)]:
            loop, _, logger = name.partition("_")
            found[name].append(loops[loop](ticks, core, bool(logger)))
            progress.step(f"lockstep, {name.replace('_', ' ')}")
    figures: dict[str, Any] = {
        f"{name}_ticks_per_s": statistics.median(rates) for name, rates in found.items()
    }
    ratios = [
        bare / ours for bare, ours in zip(found["bare"], found[tick], strict=True)
    ]
    figures["lockstep_ticks_per_s"] = figures[f"{tick}_ticks_per_s"]
    figures["ratio"] = statistics.median(ratios)
    figures["ratio_range"] = [min(ratios), max(ratios)]
    return figures


def realtime(
    rounds: int,
    seconds: float,
    rates: Sequence[int],
    tick: Tick,
    launches: Launches,
    progress: Progress,
) -> dict[str, Any]:
    """Measure response and missed ticks at several rates, interleaved with the bare loops."""
    core = str(quietest_processor())
    fifo = 50 if fifo_granted() else 0
    programs = _programs()
    found: dict[tuple[str, int], list[dict[str, Any]]] = {
        row: [] for row in _rows(rates, tick, launches)
    }
    pairs = list(found)
    for k in range(rounds):
        for name, rate in pairs[k % len(pairs) :] + pairs[: k % len(pairs)]:
            if name in programs:
                # The bare loop gets the same machine settings as the launch.
                ticks = round(seconds * rate)
                program = programs[name]
                with awake() if rate >= AWAKE_RATE else contextlib.nullcontext():
                    run = bare_loop(ticks, core, fifo, float(rate), True, program)
            else:
                one, _, case = name.partition(" ")
                words = (f"rate:={rate}", f"duration:={seconds}", "stiffness:=500")
                run = launch(*launches[case], *words, "--tick", one)
            found[name, rate].append(run)
            progress.step(f"{rate} Hz, {name}")
    figures = _responses(found, tick)
    slow = found[tick, rates[0]]
    nodes = slow[0]["nodes"]
    figures["memory_mb"] = {
        n: statistics.median(r["nodes"][n]["memory"] for r in slow) / 1e6 for n in nodes
    }
    figures["cpu_share"] = {
        n: statistics.median(r["nodes"][n]["cpu"] for r in slow) / seconds
        for n in nodes
    }
    figures["startup_s"] = statistics.median(r["startup_s"] for r in slow)
    figures["rate_error"] = max(abs(r["rate_hz"] / rates[0] - 1.0) for r in slow)
    figures["rates_hz"] = list(rates)
    figures["fifo"] = bool(fifo)
    return figures


def _responses(
    found: dict[tuple[str, int], list[dict[str, Any]]], tick: Tick
) -> dict[str, Any]:
    """Return response and share of missed ticks by kind and rate; those of `tick` first."""
    figures: dict[str, Any] = {}
    for (name, rate), runs in found.items():
        key = f"{rate}_hz"
        response = {
            quantile: statistics.median(run["response_us"][quantile] for run in runs)
            for quantile in ("p50", "p99", "p999", "max")
        }
        left_out = sum(run.get("overruns", 0) for run in runs)
        missed = sum(run["missed"] for run in runs)
        ticks = sum(run["ticks"] for run in runs)
        share = (missed + left_out) / max(1, ticks + left_out)
        for prefix in (f"{name}_", *([""] if name == tick else [])):
            figures.setdefault(f"{prefix}response_us", {})[key] = response
            figures.setdefault(f"{prefix}missed_share", {})[key] = share
    return figures


def _speeds(figures: dict[str, Any], names: Sequence[str], key: str = "") -> str:
    """Return the ticks per second of the kinds that were measured, as text."""
    return ", ".join(
        f"{NAMES[name]} {rate:.0f}"
        for name in names
        if (rate := figures.get(f"{name}{key}_ticks_per_s")) is not None
    )


def text(figures: dict[str, Any]) -> str:
    """Format the figures as text."""
    low, high = figures["ratio_range"]
    lines = [
        figures["machine"]
        + (", SCHED_FIFO granted" if figures["fifo"] else ", no SCHED_FIFO")
    ]
    alone = [name for name in NAMES if " " not in name]
    for key, label in (("", "without a logger"), ("_with_logger", "with one")):
        lines.append(f"lockstep   {label}, ticks/s: {_speeds(figures, alone, key)}")
    if found := _speeds(figures, [name for name in NAMES if " " in name]):
        lines.append(f"           without a logger, ticks/s: {found}")
    lines += [
        f"           bare/ours {figures['ratio']:.2f} ({low:.2f} to {high:.2f})",
        (
            f"start-up   {figures['startup_s']:.2f} s from the command to the first tick; "
            f"mean rate at {figures['rates_hz'][0]} Hz off by at most {figures['rate_error']:.1e}"
        ),
    ]
    for rate in figures["rates_hz"]:
        key = f"{rate}_hz"
        for name, label in NAMES.items():
            if key in figures.get(f"{name}_response_us", {}):
                response = figures[f"{name}_response_us"][key]
                missed = figures[f"{name}_missed_share"][key]
                lines.append(
                    f"{rate:5} Hz   {label:32} response p50 {response['p50']:4.0f} µs, p99"
                    f" {response['p99']:4.0f} µs, max {response['max']:5.0f} µs, missed"
                    f" {missed:.3%}"
                )
    memory = ", ".join(
        f"{name} {value:.0f} MB" for name, value in figures["memory_mb"].items()
    )
    cpu = ", ".join(
        f"{name} {value:.1%}" for name, value in figures["cpu_share"].items()
    )
    return "\n".join(
        [
            *lines,
            f"memory     {memory}",
            f"CPU {figures['rates_hz'][0]} Hz {cpu} of a core, start-up included",
        ]
    )


def run(arguments: argparse.Namespace) -> int:
    """Run the benchmark."""
    if arguments.scenes:
        idle(
            arguments,
            "--scenes are launched at 500 Hz, without lockstep rounds and cases",
            "ticks",
            "rates",
            "cases",
        )
        return _run_scenes(arguments)
    idle(arguments, "it is of --scenes", "finest")
    rounds = arguments.rounds
    tick = choose("compiled", KERNELS, lambda text: print(text, file=sys.stderr))
    # Like the bare loop in C, the emulator needs a compiler.
    stands_in = bare.SERVO_RATE in arguments.rates and c_loop() is not None
    with bare.launches(
        [case for case in arguments.cases if case != "stand_in" or stands_in]
    ) as launches:
        loops = _loops(tick, launches)
        progress = Progress(
            rounds * (len(_names(loops)) + len(_rows(arguments.rates, tick, launches)))
        )
        figures = lockstep(rounds, arguments.ticks, loops, tick, progress)
        figures.update(
            realtime(
                rounds, arguments.seconds, arguments.rates, tick, launches, progress
            )
        )
    figures["machine"] = machine()
    return report(arguments, figures, text(figures))


def _run_scenes(arguments: argparse.Namespace) -> int:
    """Compare scenes with the floor."""
    from sim.lab.bench.scene_costs import compare_scenes
    from sim.lab.bench.scene_costs import text as scenes_text

    kernels = (*KERNELS, "nodes.environment.shapes.kernel")
    tick = choose("compiled", kernels, lambda text: print(text, file=sys.stderr))
    figures = compare_scenes(
        arguments.rounds, arguments.seconds, arguments.finest, tick
    )
    return report(
        arguments, figures, [figures["machine"], *scenes_text(figures["rows"])]
    )
