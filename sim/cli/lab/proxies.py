"""Compare proxies on shapes with closed forms: error of the force, noise, drag on closed ways, a thin plate, µs a call."""

import argparse
from dataclasses import asdict
from functools import partial
from typing import Any

from messages.errors import UsageError
from nodes.cli.quantities import SEED, declare, not_negative, positive, whole
from sim.cli.answers import add_answer, report
from sim.cli.sweeps import add_spread, spread

_MOST = 7


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "--finest",
        type=whole(2, _MOST),
        default=5,
        help="finest mesh: 20·4ⁿ triangles (default: 5, 20 480)",
    )
    parser.add_argument(
        "--ticks",
        type=whole(100, 10_000_000),
        default=5000,
        help="length of each way (default: 5000)",
    )
    declare(parser, stiffness=500.0, rate=1000.0)
    parser.add_argument(
        "--depth", type=positive, default=0.004, help="below the surface [m] (default: 0.004)"
    )
    parser.add_argument(
        "--speed", type=positive, default=0.2, help="along the surface [m/s] (default: 0.2)"
    )
    parser.add_argument(
        "--tool", type=not_negative, default=0.0, help="radius of the tool [m] (default: 0)"
    )
    parser.add_argument(
        "--steps",
        type=whole(1, 10**9),
        default=1_000_000,
        help="random steps through the plate (default: 10⁶)",
    )
    parser.add_argument("--seed", type=SEED, default=0, help="of the random steps (default: 0)")
    add_spread(parser)
    add_answer(parser, run, files=False)


def run(arguments: argparse.Namespace) -> int:
    """Compare, and fail when a proxy changed sides."""
    if arguments.depth > 0.01:
        raise UsageError(f"--depth {arguments.depth}: at most 0.01 m, in a sphere of 0.05 m")
    from sim.lab.proxies import PLATE, Way, compared, count, timed, wrong_sides

    period, step = 1.0 / arguments.rate, 2.0 / arguments.rate
    led = (arguments.ticks, arguments.depth, arguments.speed, period, arguments.tool)
    ways = [Way(number, *led) for number in range(count(arguments.finest))]
    # The finest mesh takes longest, and goes first; times are of this machine, wherever the rest
    # was worked out.
    jobs: list[partial[Any]] = [
        partial(compared, way, arguments.stiffness) for way in reversed(ways)
    ]
    jobs.append(partial(wrong_sides, arguments.steps, step, arguments.seed, arguments.tool))
    *rows, (wrong, aside) = spread(arguments, jobs)
    found = [timed(row, way) for row, way in zip(reversed(rows), ways, strict=True)]
    lines = [
        (
            f"{'':28}{'force error [mN]':>24}{'':>12}{'proxy [µm] off':>24}{'drag':>10}{'µs a call':>18}"
        ),
        (
            f"{'':28}{'rms':>12}{'max':>12}{'noise':>12}{'closed form':>12}{'triangles':>12}{'':>10}{'median':>9}{'p99':>9}"
        ),
    ]
    lines += [
        f"{row.name:28}{1e3 * row.rms_n:12.4g}{1e3 * row.max_n:12.4g}{1e3 * row.noise_n:12.4g}{row.proxy_um:12.4g}"
        f"{'' if row.polyhedron_um is None else format(row.polyhedron_um, '.2g'):>12}"
        f"{row.drag:10.2g}{row.call_us:9.3g}{row.call_p99_us:9.3g}"
        for row in found
    ]
    lines.append(
        f"plate of {1e3 * PLATE[2]:g} mm, {arguments.steps} random steps of up to {1e3 * step:g}"
        f" mm: {wrong} on the wrong side, at most {1e6 * aside:.3g} µm beside the device"
    )
    plate = {"steps": arguments.steps, "step_m": step, "wrong_side": wrong, "aside_max_m": aside}
    return report(
        arguments, {"rows": [asdict(row) for row in found], "plate": plate}, lines, held=not wrong
    )
