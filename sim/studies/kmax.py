"""Largest stable stiffness of a law on a known device, at one gain or over a range."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from messages.errors import UsageError
from nodes.laws import Law
from nodes.parameters.options import FileOptions, option, quantity, silent
from nodes.parameters.quantities import Interval, whole
from nodes.recording.figure_style import label_ends, new_figure, save_figure, styled
from nodes.stability.k_max import KMax, k_max, without_spring
from nodes.stability.plant import Plant
from sim.device.hand import Hand
from sim.device.model import DeviceModel
from sim.results import fresh
from sim.studies import device_options as shared
from sim.studies.device_options import DeviceOptions, LawOptions, grasp_option
from sim.studies.kmax_found import (
    KMaxBoundary,
    KMaxFound,
    KMaxLaunched,
    KMaxPoint,
    SearchedKMax,
    bounded,
    nothing_found,
)
from sim.studies.result import StudyResult
from sim.studies.sweeps import SPREAD, SpreadOptions, spread

if TYPE_CHECKING:
    from sim.design.hand_box import HandBox
    from sim.play.one_axis_inputs import Scene

_PRESSING = 100.0  # default stiffness of the pressing hand [N/m]


@dataclass(frozen=True, kw_only=True)
class KMaxOptions(LawOptions, DeviceOptions, SpreadOptions, FileOptions):
    """Options of `kmax`."""

    law: str = option(default="pd", help="kind, preset or YAML mapping")
    gain: tuple[float, float] | None = quantity("gain", Interval())
    points: int = option(default=41, type=whole(2, 100000), help="of a range of gains")
    method: str | None = option(
        choices=("closed_form", "pole_radius", "simulation", "lockstep"),
        help=(
            "default: the closed form where there is one, else the pole radius; lockstep drops it"
            " through real processes"
        ),
    )
    scene: str = option(
        default="drop",
        choices=("drop", "press", "free"),
        help="what is played (default: %(default)s); who presses has 100 N/m, or --hand",
    )
    history: str = option(
        default="penetration",
        choices=("penetration", "position"),
        help="what feeds the law outside contact in a simulated drop",
    )
    horizon: int = option(
        default=2500, type=whole(1, 10**8), help="ticks of a simulated run"
    )
    grid: int = option(
        default=257,
        type=whole(2, 10**6),
        help="stiffnesses that lockstep bisects, K_max/2 to 2 K_max",
    )
    grasp: HandBox | None = grasp_option("K_max in the worst grasp of a box too")


def kmax(options: KMaxOptions) -> StudyResult:
    """Find K_max, or its boundary over a range of gains.

    Parameters
    ----------
    options : KMaxOptions
        The law, its gain or a range of gains [N s/m], the device and its loop, the method.

    Returns
    -------
    KMaxFound, KMaxBoundary or KMaxLaunched
        K_max of one gain; at each gain of a range; by launches and in one process.

    Raises
    ------
    messages.errors.UsageError
        For incompatible options, or a law that the method cannot judge.
    """
    device = shared.device(options)
    if options.scene == "press" and device.stiffness == 0.0:
        # The pressing hand is part of the loop.
        device = replace(device, stiffness=_PRESSING)
    several = options.gain is not None and options.gain[0] < options.gain[1]
    if several and options.method == "lockstep":
        raise UsageError(
            "--method lockstep: one --gain at a time, every stiffness takes a launch"
        )
    _refuse_idle(options, several)
    if several and options.gain is not None:
        return _boundary(options, options.gain, device)
    gain = None if options.gain is None else options.gain[0]
    if options.method == "lockstep":
        return _lockstep(options, gain, device)
    law = shared.law(options, options.law, gain)
    found = KMaxFound(_loop(options, gain, device), _found(options, law, device))
    if options.grasp is None:
        return found
    limit = _grasped(options.grasp, law, device, found.found)
    return replace(found, grasp=options.grasp, k_max_grasp_n_per_m=limit)


def _grasped(grasp: HandBox, law: Law, device: Plant, found: KMax) -> float | None:
    """Compute K_max in the worst grasp of a box, by poles; at most 10 times the bare K_max."""
    from nodes.stability.k_max import with_spring
    from sim.design.hands import k_max_over
    from sim.experiments.k_max_simulated import SEARCHED

    derivative = without_spring(law, device.period)
    top = bounded(found.k_max_n_per_m) or SEARCHED[1] * device.mass / device.period**2
    return k_max_over(lambda k: with_spring(derivative, k), device, grasp, 10.0 * top)


def _refuse_idle(options: KMaxOptions, several: bool) -> None:
    if several or options.method == "lockstep":
        options.refuse_unused("a grasp is judged for one gain, by poles", "grasp")
    options.refuse_unused("K is what is looked for", "stiffness")
    if options.method not in ("simulation", "lockstep"):
        options.refuse_unused(
            "nothing is played; add --method simulation", "scene", "history", "horizon"
        )
    if options.scene == "free":
        options.refuse_unused("--scene free is in contact all the time", "history")
    if options.method != "lockstep":
        options.refuse_unused("it is of --method lockstep", "grid")
    if not several:
        options.refuse_unused("it is of a range, --gain LOW..HIGH", "points", *SPREAD)


def _loop(
    options: KMaxOptions, gain: float | None, device: Plant, gains: str = ""
) -> str:
    """Return the description of law, device and loop, without K, the unknown."""
    law = shared.law(options, options.law, gain)
    return shared.head(law, device, gains or f"B {getattr(law, 'damping', 0.0):g}")


def _found(options: KMaxOptions, law: Law, device: Plant) -> KMax:
    try:
        if options.method == "simulation":
            return _simulated(options, law, device)
        return k_max(without_spring(law, device.period), device, options.method)
    except ValueError as error:
        raise UsageError(str(error)) from error


def _lockstep(options: KMaxOptions, gain: float | None, device: Plant) -> KMaxLaunched:
    """Bisect one grid twice, by launches and in one process, around the simulation's K_max."""
    from sim.experiments.k_max_launched import same_k_max
    from sim.experiments.settling import Criterion
    from sim.measure.haptic_commands import MeasurementError

    law = shared.law(options, options.law, gain)
    try:
        guess = _simulated(options, law, device).k_max_n_per_m
        if guess is None or not math.isfinite(guess):
            raise UsageError(
                "--method lockstep: the simulation found no K_max to look around"
            )
        steps = np.geomspace(0.5, 2.0, options.grid)
        # The guess itself is not on the grid, so that the runs decide the result.
        grid = (guess * steps * (steps[1] / steps[0]) ** (1 / 3)).tolist()
        step = options.progress(2 + math.ceil(math.log2(options.grid - 1)))
        found = same_k_max(
            law, _scene(options, device), Criterion(ticks=options.horizon), grid, step
        )
    except (ValueError, MeasurementError) as error:
        raise UsageError(str(error)) from error
    return KMaxLaunched(
        loop=_loop(options, gain, device),
        found=found,
        grid=(grid[0], grid[1], grid[-1]),
    )


def _scene(options: KMaxOptions, device: Plant) -> Scene:
    """Build the scene; a hand's target is at the floor, or behind the wall to press."""
    from sim.experiments.drop import drop_scene, free_scene, held, press_scene

    raw = options.history == "position"
    if options.scene == "press":
        pressed = DeviceModel(
            mass=device.mass, damping=device.damping, delay=device.delay
        )
        grip = Hand(stiffness=device.stiffness, path=[(0.0, -0.01)])
        return press_scene(pressed, device.period, raw=raw, clamp=True, hand=grip)
    if options.scene == "free":
        return free_scene(held(device), device.period)
    return drop_scene(held(device), device.period, raw=raw, clamp=True)


def _simulated(options: KMaxOptions, law: Law, device: Plant) -> SearchedKMax:
    """Raise K until the drop no longer settles."""
    from sim.experiments.k_max_simulated import at_stiffness, simulated_k_max
    from sim.experiments.settling import Criterion

    scene = _scene(options, device)
    found = simulated_k_max(
        at_stiffness(law, device.period), scene, Criterion(ticks=options.horizon)
    )
    return SearchedKMax(
        found.k_max_n_per_m,
        found.h1_max_n_per_m,
        "simulation",
        (),
        found.searched_n_per_m,
    )


def _boundary(
    options: KMaxOptions, span: tuple[float, float], device: Plant
) -> KMaxBoundary:
    low, high = span
    gains = [
        low + (high - low) * i / (options.points - 1) for i in range(options.points)
    ]
    laws = [shared.law(options, options.law, gain) for gain in gains]
    # A worker shows no progress of its own.
    asked = replace(options, progress=silent)
    found = spread(options, [partial(_found, asked, law, device) for law in laws])
    points = [KMaxPoint(gain, one) for gain, one in zip(gains, found, strict=True)]
    loop = _loop(options, low, device, f"B {low:g} .. {high:g}")
    if not any(one.endless or one.k is not None for one in points):
        text = f"{nothing_found(found[0])} anywhere in this range"
        return KMaxBoundary(lines=[text], held=False, loop=loop, points=points)
    lines = [
        loop,
        "      gain     K_max N/m   H(1)_max N/m",
        *(one.line for one in points),
    ]
    result = KMaxBoundary(
        lines=lines, loop=loop, points=points, picture=_draw(options, points)
    )
    if (best := result.best) is None:
        endless = sum(one.endless for one in points)
        last = f"no end was found at {endless} of {len(points)} gains: the stiffest is not known"
    else:
        named = f"K_max {best.k:.6g}" if best.h1 is None else f"H(1) {best.h1:.6g}"
        last = f"stiffest: gain {best.gain:.4g}, {named} N/m"
    return replace(result, lines=[*lines, last])


@styled
def _draw(options: KMaxOptions, points: list[KMaxPoint]) -> Path:
    figure = new_figure(6.4, 4.0)
    axes = figure.add_subplot(xlabel="gain B  [N s/m]", ylabel="stiffness  [N/m]")
    gains = [point.gain for point in points]
    for key, label, style in (("k", "nominal K", "--"), ("h1", "felt, H(1)", "-")):
        values = [getattr(point, key) for point in points]
        shown = [math.nan if value is None else value for value in values]
        axes.plot(gains, shown, ls=style, label=label)
    axes.set_title(
        f"Stability boundary: {options.law}, m = {options.mass:g} kg, b = {options.damping:g}"
        f" N s/m, d = {options.delay:g}, {options.rate:g} Hz"
    )
    label_ends(axes)
    return save_figure(figure, options.out / "kmax.png", fresh)
