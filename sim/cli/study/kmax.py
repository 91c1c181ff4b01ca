"""Largest stable stiffness of a law on a known device: closed form, pole radius, simulation or real launches; or its chart."""

from __future__ import annotations

import argparse
import math
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from messages.errors import UsageError
from nodes.cli.quantities import Interval, declare, declare_law, whole
from nodes.laws import Law
from nodes.recording.figure_style import label_ends, new_figure, save_figure, styled
from nodes.stability.k_max import KMax, k_max, without_spring
from nodes.stability.plant import Plant
from sim.cli import arguments as shared
from sim.cli.answers import add_answer, given, idle, report
from sim.cli.sweeps import SPREAD, add_spread, spread
from sim.device.model import DeviceModel, Hand
from sim.results import fresh

if TYPE_CHECKING:
    from sim.play.one_axis import Scene

_PRESSING = 100.0  # stiffness of the hand that presses where none is given [N/m]


@dataclass(frozen=True)
class _Found(KMax):
    """What a simulation found."""

    # softest and stiffest K that were tried [N/m]
    searched: tuple[float, float] = (math.nan, math.nan)


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "--law", default="pd", help="kind, preset or YAML mapping (default: %(default)s)"
    )
    declare(parser, gain=Interval())
    parser.add_argument(
        "--points",
        type=whole(2, 100_000),
        default=41,
        help="of a range of gains (default: %(default)s)",
    )
    parser.add_argument(
        "--method",
        choices=("closed_form", "pole_radius", "simulation", "lockstep"),
        help=(
            "default: the closed form where there is one, else the pole radius; lockstep drops it"
            " through real processes"
        ),
    )
    parser.add_argument(
        "--scene",
        choices=("drop", "press", "free"),
        default="drop",
        help="what is played (default: %(default)s); who presses has 100 N/m, or --hand",
    )
    parser.add_argument(
        "--history",
        choices=("penetration", "position"),
        default="penetration",
        help="what feeds the law outside contact in a simulated drop (default: %(default)s)",
    )
    parser.add_argument(
        "--horizon",
        type=whole(1, 10**8),
        default=2500,
        help="ticks of a simulated run (default: %(default)s)",
    )
    parser.add_argument(
        "--grid",
        type=whole(2, 10**6),
        default=257,
        help="stiffnesses that lockstep bisects, K_max/2 to 2 K_max (default: 257)",
    )
    declare_law(parser)
    shared.add_device(parser)
    shared.add_grasp(parser, "K_max in the worst grasp of a box too")
    add_spread(parser)
    add_answer(parser, run)


def run(arguments: argparse.Namespace) -> int:
    """Find K_max, or its boundary over a range of gains."""
    device = shared.device(arguments)
    if arguments.scene == "press" and device.stiffness == 0.0:
        # Somebody has to press, and is in the loop.
        device = replace(device, stiffness=_PRESSING)
    several = arguments.gain is not None and arguments.gain[0] < arguments.gain[1]
    if several and arguments.method == "lockstep":
        raise UsageError("--method lockstep: one --gain at a time, every stiffness takes a launch")
    _refuse_idle(arguments, several)
    if several:
        return _boundary(arguments, device)
    gain = None if arguments.gain is None else arguments.gain[0]
    if arguments.method == "lockstep":
        return _lockstep(arguments, gain, device)
    loop = _loop(arguments, gain, device)
    found = _found(_method(arguments), shared.law(arguments, arguments.law, gain), device)
    stable = [[low, high if math.isfinite(high) else None] for low, high in found.stable]
    if found.k_max_n_per_m is None:
        text = f"{_nothing(found)}: lower the gain, the delay or the order"
    elif not math.isfinite(found.k_max_n_per_m):
        text = "stable however stiff: no K_max"
        if isinstance(found, _Found):
            text = f"K_max    above {found.searched[1]:.6g} N/m (nominal), where the search ends"
    else:
        felt = (
            f"{found.h1_max_n_per_m:.6g} N/m (felt)"
            if found.h1_max_n_per_m is not None
            else "none: the law is not linear"
        )
        text = (
            f"K_max    {found.k_max_n_per_m:.6g} N/m (nominal)\nH(1)_max {felt}\nmethod  "
            f" {found.method}"
        )
    figures = {"loop": loop} | _figures(found) | {"stable_n_per_m": stable}
    lines = [loop, text]
    if arguments.grasp is not None:
        grasped, line = _grasped(
            arguments, shared.law(arguments, arguments.law, gain), device, found
        )
        figures |= grasped
        lines.append(line)
    return report(arguments, figures, lines, held=found.k_max_n_per_m is not None)


def _grasped(
    arguments: argparse.Namespace, law: Law, device: Plant, found: KMax
) -> tuple[dict[str, Any], str]:
    """Find K_max in the worst grasp of a box, by poles, up to ten times the one without a hand."""
    from nodes.stability.k_max import with_spring
    from sim.design.hands import k_max_over
    from sim.experiments.k_max_simulated import SEARCHED

    derivative = without_spring(law, device.period)
    top = (
        found.k_max_n_per_m
        if found.k_max_n_per_m and math.isfinite(found.k_max_n_per_m)
        else SEARCHED[1] * device.mass / device.period**2
    )
    limit = k_max_over(lambda k: with_spring(derivative, k), device, arguments.grasp, 10.0 * top)
    box = arguments.grasp
    text = "no stiffness is stable" if limit is None else f"{limit:.6g} N/m (nominal)"
    return {
        "k_max_grasp_n_per_m": limit,
        "grasp": asdict(box),
    }, f"K_max    {text} in the worst {box.text()}"


def _refuse_idle(arguments: argparse.Namespace, several: bool) -> None:
    if several or arguments.method == "lockstep":
        idle(arguments, "a grasp is judged for one gain, by poles", "grasp")
    idle(arguments, "K is what is looked for", "stiffness")
    if arguments.method not in ("simulation", "lockstep"):
        idle(arguments, "nothing is played; add --method simulation", "scene", "history", "horizon")
    if arguments.scene == "free":
        idle(arguments, "--scene free is in contact all the time", "history")
    if arguments.method != "lockstep":
        idle(arguments, "it is of --method lockstep", "grid")
    if not several:
        idle(arguments, "it is of a range, --gain LOW..HIGH", "points", *SPREAD)


def _loop(arguments: argparse.Namespace, gain: float | None, device: Plant, gains: str = "") -> str:
    """Name what is looked at; K is what is looked for."""
    law = shared.law(arguments, arguments.law, gain)
    return shared.head(law, device, gains or f"B {getattr(law, 'damping', 0.0):g}")


def _method(arguments: argparse.Namespace) -> argparse.Namespace:
    """Take of the arguments what a worker needs."""
    return argparse.Namespace(**given(arguments, "method", "scene", "history", "horizon"))


def _found(method: argparse.Namespace, law: Law, device: Plant) -> KMax:
    try:
        if method.method == "simulation":
            return _simulated(method, law, device)
        return k_max(without_spring(law, device.period), device, method.method)
    except ValueError as error:
        raise UsageError(str(error)) from error


def _lockstep(arguments: argparse.Namespace, gain: float | None, device: Plant) -> int:
    """Bisect one grid twice, by launches and in one process; around what the simulation found."""
    from sim.experiments.drop import Criterion
    from sim.experiments.k_max_launched import same_k_max
    from sim.measure.measured_launch import MeasurementError
    from sim.measure.stopwatch import Progress

    law = shared.law(arguments, arguments.law, gain)
    try:
        guess = _simulated(arguments, law, device).k_max_n_per_m
        if guess is None or not math.isfinite(guess):
            raise UsageError("--method lockstep: the simulation found no K_max to look around")
        steps = np.geomspace(0.5, 2.0, arguments.grid)
        # Not at the guess itself: what is found must be decided by the runs.
        grid = (guess * steps * (steps[1] / steps[0]) ** (1 / 3)).tolist()
        bar = Progress(2 + math.ceil(math.log2(arguments.grid - 1)))
        found = same_k_max(
            law, _scene(arguments, device), Criterion(ticks=arguments.horizon), grid, bar.step
        )
    except (ValueError, MeasurementError) as error:
        raise UsageError(str(error)) from error
    both = found.launched_n_per_m, found.one_process_n_per_m
    same = both[0] == both[1]
    ratio, loop = grid[1] / grid[0], _loop(arguments, gain, device)
    launched, alone = (k if k is not None and math.isfinite(k) else None for k in both)
    figures: dict[str, Any] = {
        "loop": loop,
        "k_max_n_per_m": launched,
        "h1_max_n_per_m": found.h1_n_per_m,
        "method": "lockstep",
        "one_process_n_per_m": alone,
        "searched_n_per_m": [grid[0], grid[-1]],
        "same": same,
        "launches": found.launches,
        "grid_ratio": ratio,
    }
    # Beyond the ends of the grid nothing was tried.
    ends = {0.0: f"below {grid[0]:.6g} N/m", math.inf: f"above {grid[-1]:.6g} N/m"}
    said = [ends.get(k or 0.0, f"{k or 0.0:.6g} N/m") for k in both]
    lines = [
        loop,
        f"K_max    {said[0]} (nominal), by {found.launches} launches in lockstep",
        (
            f"         {said[1]} in one process: {'the same' if same else 'NOT the same'}, on steps"
            f" of {ratio - 1.0:.2%}"
        ),
    ]
    return report(arguments, figures, lines, held=same and launched is not None)


def _scene(arguments: argparse.Namespace, device: Plant) -> Scene:
    """Set up the experiment; a grip is held where the floor is, and behind the wall to press."""
    from sim.experiments.drop import drop_scene, free_scene, held, press_scene

    raw = arguments.history == "position"
    if arguments.scene == "press":
        pressed = DeviceModel(mass=device.mass, damping=device.damping, delay=device.delay)
        grip = Hand(stiffness=device.stiffness, path=[(0.0, -0.01)])
        return press_scene(pressed, device.period, raw=raw, clamp=True, hand=grip)
    if arguments.scene == "free":
        return free_scene(held(device), device.period)
    return drop_scene(held(device), device.period, raw=raw, clamp=True)


def _simulated(arguments: argparse.Namespace, law: Law, device: Plant) -> _Found:
    """Raise K until the drop no longer settles."""
    from sim.experiments.drop import Criterion
    from sim.experiments.k_max_simulated import at_stiffness, simulated_k_max

    scene = _scene(arguments, device)
    found = simulated_k_max(
        at_stiffness(law, device.period), scene, Criterion(ticks=arguments.horizon)
    )
    return _Found(
        found.k_max_n_per_m, found.h1_max_n_per_m, "simulation", (), found.searched_n_per_m
    )


def _nothing(found: KMax) -> str:
    if not isinstance(found, _Found):
        return "no stiffness is stable"
    return f"nothing from {found.searched[0]:.4g} to {found.searched[1]:.4g} N/m settles"


def _figures(found: KMax) -> dict[str, Any]:
    # JSON has no infinity: without a limit the figure is null, and the stable interval is open.
    bounded = found.k_max_n_per_m is not None and math.isfinite(found.k_max_n_per_m)
    figures = {
        "k_max_n_per_m": found.k_max_n_per_m if bounded else None,
        "h1_max_n_per_m": found.h1_max_n_per_m if bounded else None,
        "method": found.method,
    }
    if found.k_max_n_per_m == math.inf:
        figures["at_least_n_per_m"] = found.searched[1] if isinstance(found, _Found) else None
    return figures


def _boundary(arguments: argparse.Namespace, device: Plant) -> int:
    low, high = arguments.gain
    gains = [low + (high - low) * i / (arguments.points - 1) for i in range(arguments.points)]
    laws = [shared.law(arguments, arguments.law, gain) for gain in gains]
    found = spread(arguments, [partial(_found, _method(arguments), law, device) for law in laws])
    points = [{"gain": gain, **_figures(one)} for gain, one in zip(gains, found, strict=True)]
    stable = [point for point in points if point["k_max_n_per_m"] is not None]
    without_end = [point for point in points if "at_least_n_per_m" in point]
    if not stable and not without_end:
        text = f"{_nothing(found[0])} anywhere in this range"
        return report(arguments, {"points": points, "plot": None}, text, held=False)
    loop = _loop(arguments, low, device, f"B {low:g} .. {high:g}")
    lines = [loop, "      gain     K_max N/m   H(1)_max N/m"]
    for point in points:
        k, h1 = point["k_max_n_per_m"], point["h1_max_n_per_m"]
        least = point.get("at_least_n_per_m")
        missing = (
            "-"
            if "at_least_n_per_m" not in point
            else "no limit"
            if least is None
            else f"> {least:.6g}"
        )
        lines.append(
            f"{point['gain']:10.4g}  {missing if k is None else f'{k:.6g}':>12} "
            f" {'-' if h1 is None else f'{h1:.6g}':>12}"
        )
    figures: dict[str, Any] = {"loop": loop}
    if without_end:
        lines.append(
            f"no end was found at {len(without_end)} of {len(points)} gains: the stiffest is not"
            " known"
        )
    else:
        felt = all(point["h1_max_n_per_m"] is not None for point in stable)
        key, name = ("h1_max_n_per_m", "H(1)") if felt else ("k_max_n_per_m", "K_max")
        best = max(stable, key=lambda point: float(point[key]))
        lines.append(f"stiffest: gain {best['gain']:.4g}, {name} {best[key]:.6g} N/m")
        figures |= best
    return report(arguments, figures | {"points": points}, lines, plot=_draw(arguments, points))


@styled
def _draw(arguments: argparse.Namespace, points: list[dict[str, Any]]) -> Path:
    figure = new_figure(6.4, 4.0)
    axes = figure.add_subplot(xlabel="gain B  [N s/m]", ylabel="stiffness  [N/m]")
    gains = [point["gain"] for point in points]
    for key, label, style in (
        ("k_max_n_per_m", "nominal K", "--"),
        ("h1_max_n_per_m", "felt, H(1)", "-"),
    ):
        axes.plot(
            gains,
            [float("nan") if point[key] is None else point[key] for point in points],
            ls=style,
            label=label,
        )
    axes.set_title(
        f"Stability boundary: {arguments.law}, m = {arguments.mass:g} kg, b = {arguments.damping:g}"
        f" N s/m, d = {arguments.delay:g}, {arguments.rate:g} Hz"
    )
    label_ends(axes)
    return save_figure(figure, arguments.out / "kmax.png", fresh)
