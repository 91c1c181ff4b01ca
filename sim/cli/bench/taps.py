"""Time a tick over the number of taps: plain loop, unrolled, numpy and numba."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from nodes.cli.main import add_json
from nodes.parameters.quantities import ROUNDS
from nodes.recording.figure_style import new_figure, save_figure, styled, threshold
from sim.cli.answers import report
from sim.results import fresh


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("--rounds", type=ROUNDS, default=25, help="interleaved rounds")
    parser.add_argument(
        "--taps",
        type=_lengths,
        help="numbers of taps, separated by commas (default: 4 to 2000)",
    )
    add_json(parser)
    parser.add_argument(
        "--out",
        type=Path,
        help="also write bench_taps.json, .png, .pdf and .svg to this directory",
    )
    parser.set_defaults(run=run)


def _lengths(text: str) -> tuple[int, ...]:
    try:
        values = tuple(sorted({int(part) for part in text.split(",")}))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r}: expected whole numbers separated by commas"
        ) from None
    if values[0] < 2:
        raise argparse.ArgumentTypeError(
            f"{values[0]}: a derivative needs at least 2 taps"
        )
    return values


def run(arguments: argparse.Namespace) -> int:
    """Measure, and report the fastest way for each range of taps."""
    from sim.lab.bench.tap_timing import (
        LENGTHS,
        WAYS,
        as_json,
        time_laws,
        time_taps,
        time_turning,
    )
    from sim.measure.stopwatch import Progress, machine

    found = time_taps(
        arguments.taps or LENGTHS, arguments.rounds, Progress(arguments.rounds).step
    )
    laws = time_laws(arguments.rounds, lambda _: None)
    figures = as_json(found, machine())
    figures["laws_us"] = {name: 1e6 * timing.median for name, timing in laws.items()}
    turning = time_turning(arguments.rounds, lambda _: None)
    figures["turning_ns"] = {
        frame: 1e9 * timing.median for frame, timing in turning.items()
    }
    figures["turning_ns_per_axis"] = (
        figures["turning_ns"]["surface"] - figures["turning_ns"]["world"]
    ) / 3.0
    if arguments.out is not None:
        figures["files"] = [str(path) for path in _write(figures, arguments.out)]
    return report(arguments, figures, _lines(figures, WAYS))


def _lines(figures: dict[str, Any], ways: Sequence[str]) -> list[str]:
    """Return the figures as text."""
    lines = [
        "   taps"
        + "".join(f"{way:>12}" for way in ways)
        + "   fastest with the kernel's bits   [µs per tick]"
    ]
    for point in figures["points"]:
        cells = "".join(f"{point[f'{way}_us']:12.3g}" for way in ways)
        lines.append(
            f"{point['taps']:7d}{cells}   {figures['fastest'][str(point['taps'])]}"
        )
    for pair, taps in figures["crossover_taps"].items():
        lines.append(
            f"{pair.replace('_', ' ')}: {'never' if taps is None else f'from {taps:.0f} taps on'}"
        )
    lines.append(
        "a tick of "
        + ", ".join(f"{name} {us:.3g} µs" for name, us in figures["laws_us"].items())
    )
    lines.append(
        "a compiled tick of pd on three axes, in ns: "
        + ", ".join(
            f"history in the axes of the {frame} {ns:.3g}"
            for frame, ns in figures["turning_ns"].items()
        )
        + f"; turning with the surface costs {figures['turning_ns_per_axis']:.3g} ns per tick and"
        " axis"
    )
    cost = figures["import_s"]
    lines.append(
        f"the coupling changes from the written-out sum to numpy beyond {figures['unrolled_taps']}"
        f" taps; importing numpy costs {cost['numpy']:.2f} s at its start, numba"
        f" {cost['numba']:.2f} s"
    )
    lines.append(
        f"same bits: {'yes' if figures['same_bits'] else 'NO'}; {figures['machine']['cpu']}"
    )
    return lines


@styled
def _write(figures: dict[str, Any], folder: Path) -> list[Path]:
    import json

    figure = new_figure(6.4, 4.0)
    axes = figure.add_subplot(
        xlabel="taps  [1]", ylabel="time per tick  [µs]", xscale="log", yscale="log"
    )
    taps = [point["taps"] for point in figures["points"]]
    for way, mark in (
        ("plain", "o"),
        ("unrolled", "v"),
        ("numpy", "s"),
        ("numba", "^"),
        ("numpy_dot", ""),
    ):
        label = "numpy dot (other bits)" if way == "numpy_dot" else way
        axes.plot(
            taps,
            [point[f"{way}_us"] for point in figures["points"]],
            marker=mark,
            label=label,
        )
        low, high = (
            [point[f"{way}_us_{end}"] for point in figures["points"]]
            for end in ("low", "high")
        )
        axes.fill_between(taps, low, high, alpha=0.15)
    threshold(
        axes,
        figures["unrolled_taps"],
        f"numpy beyond {figures['unrolled_taps']} taps",
        vertical=True,
    )
    axes.set_title(f"Adding n taps, {figures['machine']['cpu']}")
    axes.legend()
    json_path = fresh(folder / "bench_taps.json")
    json_path.write_text(json.dumps(figures, indent=1) + "\n")
    return [json_path, save_figure(figure, folder / "bench_taps.png", fresh)]
