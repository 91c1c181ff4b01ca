"""Measure simulated ticks per second: per core, on all cores, against a plain C loop."""

import argparse

from nodes.parameters.quantities import ROUNDS, whole
from sim.cli.answers import add_answer, report


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--rounds", type=ROUNDS, default=101, help="interleaved rounds")
    parser.add_argument(
        "--ticks", type=whole(100, 10**8), default=2500, help="length of a run"
    )
    add_answer(parser, run, files=False)


def run(arguments: argparse.Namespace) -> int:
    """Measure, and print the ratios within the run."""
    from sim.lab.bench.simulator_speed import FLAGS, measure
    from sim.measure.stopwatch import Progress, machine

    speed = measure(
        arguments.ticks, arguments.rounds, Progress(2 * arguments.rounds).step
    )
    lines = ["taps   ticks/s and core         plain C   ours/C"]
    points = []
    for taps, timing in speed.simulator.items():
        plain = speed.plain_c.get(taps)
        ratio = None if plain is None else plain.median / timing.median
        low, high = 1.0 / timing.high, 1.0 / timing.low
        point = {
            "taps": taps,
            "ticks_per_s": 1.0 / timing.median,
            "ticks_per_s_quartiles": [low, high],
            "ratio": ratio,
        }
        points.append(
            point | {"c_ticks_per_s": None if plain is None else 1.0 / plain.median}
        )
        beside = (
            f"{1e-6 / plain.median:12.1f} M   {ratio:6.2f}"
            if plain is not None
            else f"   no C: {speed.reason}"
        )
        lines.append(f"{taps:4d} {1e-6 / timing.median:15.1f} M {beside}")
    scaling = speed.one_core.median / speed.all_cores.median
    lines.append(
        f"many runs at once: {1e-6 / speed.one_core.median:.1f} M ticks/s on 1 core,"
        f" {1e-6 / speed.all_cores.median:.1f} M on {speed.cores}: {scaling:.2f} times"
    )
    here = machine()
    if here["load_1min"] is not None and here["load_1min"] > 0.5 * speed.cores:
        lines.append(
            f"others were at work here (load {here['load_1min']}): scaling over the cores cannot be"
            " trusted"
        )
    figures = {
        "points": points,
        "one_core_ticks_per_s": 1.0 / speed.one_core.median,
        "all_cores_ticks_per_s": 1.0 / speed.all_cores.median,
        "cores": speed.cores,
        "scaling": scaling,
        "no_c_because": speed.reason or None,
        "c_flags": list(FLAGS),
        "rounds": arguments.rounds,
        "machine": here,
    }
    return report(arguments, figures, lines)
