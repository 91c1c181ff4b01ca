"""How stiff a wall gets when the device's own servo damps it faster than the loop runs."""

from __future__ import annotations

import argparse

from messages.errors import UsageError
from nodes.cli.main import add_json, answer
from nodes.cli.quantities import declare, not_negative


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    declare(parser, mass=0.1, damping=1.0, delay=1.0, rate=500.0)
    parser.add_argument("--servo", type=not_negative, default=3.0, help="damper of the servo [N s/m] (default: 3)")
    parser.add_argument("--ratios", type=int, nargs="+", default=[1, 2, 4, 8], help="servo ticks per tick of the loop")
    add_json(parser)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Compare servo rates."""
    from nodes.laws import CompiledLaw
    from nodes.stability.two_rate import TwoRate, heavy_limit, two_rate_k_max

    if min(arguments.ratios) < 1:
        raise UsageError(f"--ratios {min(arguments.ratios)}: at least 1")
    period = 1.0 / arguments.rate
    rows = []
    for ratio in arguments.ratios:
        device = TwoRate(arguments.mass, arguments.damping, arguments.servo, ratio, round(arguments.delay * ratio))
        rows.append(
            {
                "ratio": ratio,
                "servo_hz": ratio * arguments.rate,
                "delay_ticks": device.delay / ratio,
                "k_max_n_per_m": two_rate_k_max(CompiledLaw((0.0,)), period, device),
                "heavy_limit_n_per_m": heavy_limit(device, period),
            }
        )
    lines = [f"spring; {arguments.mass:g} kg, {arguments.damping:g} N s/m, servo damper {arguments.servo:g} N s/m"]
    for row in rows:
        k = row["k_max_n_per_m"]
        lines.append(
            f"  servo {row['servo_hz']:6g} Hz, delay {row['delay_ticks']:.3g} ticks: K_max "
            + ("none" if k is None else f"{k:.5g} N/m")
            + f", heavy device {row['heavy_limit_n_per_m']:.5g} N/m"
        )
    answer(arguments.json, {"rate_hz": arguments.rate, "rows": rows}, "\n".join(lines))
    return 0
