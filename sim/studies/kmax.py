"""Largest stable stiffness of a law on a known device, at one gain or over a range."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from messages.errors import UsageError
from nodes.laws import Law
from nodes.parameters.options import FileOptions, option, quantity, silent
from nodes.parameters.quantities import Interval, whole
from nodes.recording.figure_style import label_ends, new_figure, save_figure, styled
from nodes.stability.k_max import KMax, k_max, without_spring
from nodes.stability.plant import Plant
from sim.device.model import DeviceModel, Hand
from sim.results import fresh
from sim.studies import device_options as shared
from sim.studies.device_options import DeviceOptions, LawOptions, grasp_option
from sim.studies.result import Findings, StudyResult
from sim.studies.sweeps import SPREAD, SpreadOptions, spread

if TYPE_CHECKING:
    from sim.design.hands import HandBox
    from sim.experiments.k_max_launched import SameKMax
    from sim.play.one_axis import Scene

_PRESSING = 100.0  # default stiffness of the pressing hand [N/m]


@dataclass(frozen=True)
class _Found(KMax):
    """Result of a simulation."""

    # softest and stiffest tried K [N/m]
    searched: tuple[float, float] = (math.nan, math.nan)


@dataclass(frozen=True, kw_only=True)
class KMaxOptions(LawOptions, DeviceOptions, SpreadOptions, FileOptions):
    """Options of `kmax`."""

    law: str = option(
        default="pd", help="kind, preset or YAML mapping (default: %(default)s)"
    )
    gain: tuple[float, float] | None = quantity("gain", Interval())
    points: int = option(
        default=41,
        type=whole(2, 100000),
        help="of a range of gains (default: %(default)s)",
    )
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
        help="what feeds the law outside contact in a simulated drop (default: %(default)s)",
    )
    horizon: int = option(
        default=2500,
        type=whole(1, 10**8),
        help="ticks of a simulated run (default: %(default)s)",
    )
    grid: int = option(
        default=257,
        type=whole(2, 10**6),
        help="stiffnesses that lockstep bisects, K_max/2 to 2 K_max (default: 257)",
    )
    grasp: HandBox | None = grasp_option("K_max in the worst grasp of a box too")


@dataclass(frozen=True, repr=False)
class KMaxFound(StudyResult):
    """K_max of one law at one gain, optionally by launches too."""

    loop: str  # law, device and loop
    found: KMax
    grasp: HandBox | None = None
    # in the worst grasp of the box; None: no stable stiffness
    k_max_grasp_n_per_m: float | None = None

    @property
    def k_max_n_per_m(self) -> float | None:
        """Largest stable nominal stiffness [N/m]; None if none is stable or no limit was found."""
        return _bounded(self.found.k_max_n_per_m)

    @property
    def held(self) -> bool:
        """Whether any stiffness is stable."""
        return self.found.k_max_n_per_m is not None

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name."""
        stable = [
            [low, high if math.isfinite(high) else None]
            for low, high in self.found.stable
        ]
        figures = (
            {"loop": self.loop} | _figures(self.found) | {"stable_n_per_m": stable}
        )
        if self.grasp is not None:
            figures["k_max_grasp_n_per_m"] = self.k_max_grasp_n_per_m
            figures["grasp"] = asdict(self.grasp)
        return figures

    @property
    def text(self) -> str:
        """Text for the terminal."""
        lines, limit = [self.loop, _said(self.found)], self.k_max_grasp_n_per_m
        if self.grasp is not None:
            text = (
                "no stiffness is stable"
                if limit is None
                else f"{limit:.6g} N/m (nominal)"
            )
            lines.append(f"K_max    {text} in the worst {self.grasp.text()}")
        return "\n".join(lines)


@dataclass(frozen=True, repr=False, kw_only=True)
class KMaxLaunched(StudyResult):
    """K_max on a grid of stiffnesses, by launches in lockstep and in one process."""

    loop: str
    found: SameKMax
    grid: tuple[float, float, float]  # softest, next and stiffest K [N/m]

    @property
    def same(self) -> bool:
        """Whether both found the same stiffness."""
        return self.found.launched_n_per_m == self.found.one_process_n_per_m

    @property
    def held(self) -> bool:
        """Whether they did, and it lies on the grid."""
        return self.same and _bounded(self.found.launched_n_per_m) is not None

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name."""
        return {
            "loop": self.loop,
            "k_max_n_per_m": _bounded(self.found.launched_n_per_m),
            "h1_max_n_per_m": self.found.h1_n_per_m,
            "method": "lockstep",
            "one_process_n_per_m": _bounded(self.found.one_process_n_per_m),
            "searched_n_per_m": [self.grid[0], self.grid[2]],
            "same": self.same,
            "launches": self.found.launches,
            "grid_ratio": self.grid[1] / self.grid[0],
        }

    @property
    def text(self) -> str:
        """Text for the terminal."""
        # Beyond the ends of the grid nothing was tried.
        ends = {
            0.0: f"below {self.grid[0]:.6g} N/m",
            math.inf: f"above {self.grid[2]:.6g} N/m",
        }
        both = self.found.launched_n_per_m, self.found.one_process_n_per_m
        launched, alone = (ends.get(k or 0.0, f"{k or 0.0:.6g} N/m") for k in both)
        verdict, step = (
            "the same" if self.same else "NOT the same",
            self.grid[1] / self.grid[0],
        )
        return (
            f"{self.loop}\nK_max    {launched} (nominal), by {self.found.launches} launches in"
            f" lockstep\n         {alone} in one process: {verdict}, on steps of {step - 1.0:.2%}"
        )


@dataclass(frozen=True)
class KMaxPoint:
    """K_max at one gain."""

    gain: float
    found: KMax

    @property
    def k(self) -> float | None:
        """Largest stable nominal stiffness [N/m]; None if none is stable or no limit was found."""
        return _bounded(self.found.k_max_n_per_m)

    @property
    def h1(self) -> float | None:
        """The felt one [N/m]; None for a law that is not linear too."""
        return None if self.k is None else self.found.h1_max_n_per_m

    @property
    def endless(self) -> bool:
        """Whether no limit was found."""
        return self.found.k_max_n_per_m == math.inf

    @property
    def line(self) -> str:
        """The point as a line of a table."""
        least = _figures(self.found).get("at_least_n_per_m")
        end = "no limit" if least is None else f"> {least:.6g}"
        missing = end if self.endless else "-"
        return (
            f"{self.gain:10.4g}  {missing if self.k is None else f'{self.k:.6g}':>12} "
            f" {'-' if self.h1 is None else f'{self.h1:.6g}':>12}"
        )

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name."""
        return {"gain": self.gain, **_figures(self.found)}


@dataclass(frozen=True, repr=False, kw_only=True)
class KMaxBoundary(Findings):
    """K_max over a range of gains."""

    loop: str
    points: list[KMaxPoint]

    @property
    def best(self) -> KMaxPoint | None:
        """The stiffest gain; None if none is stable, or a limit is missing."""
        if any(one.endless for one in self.points):
            return None
        stable = [one for one in self.points if one.k is not None]
        felt = all(one.h1 is not None for one in stable)
        return max(
            stable, key=lambda one: (one.h1 if felt else one.k) or 0.0, default=None
        )

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name, those of the stiffest gain at the top level."""
        return {**({} if self.best is None else self.best.as_json()), **super().answer}


def _said(found: KMax) -> str:
    if found.k_max_n_per_m is None:
        return f"{_nothing(found)}: lower the gain, the delay or the order"
    if not math.isfinite(found.k_max_n_per_m):
        if isinstance(found, _Found):
            return f"K_max    above {found.searched[1]:.6g} N/m (nominal), where the search ends"
        return "stable however stiff: no K_max"
    felt = (
        f"{found.h1_max_n_per_m:.6g} N/m (felt)"
        if found.h1_max_n_per_m is not None
        else "none: the law is not linear"
    )
    return (
        f"K_max    {found.k_max_n_per_m:.6g} N/m (nominal)\nH(1)_max {felt}\nmethod  "
        f" {found.method}"
    )


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
    top = _bounded(found.k_max_n_per_m) or SEARCHED[1] * device.mass / device.period**2
    return k_max_over(lambda k: with_spring(derivative, k), device, grasp, 10.0 * top)


def _bounded(k: float | None) -> float | None:
    """Return a finite limit, else None."""
    return k if k is not None and math.isfinite(k) else None


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
    from sim.experiments.drop import Criterion
    from sim.experiments.k_max_launched import same_k_max
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


def _simulated(options: KMaxOptions, law: Law, device: Plant) -> _Found:
    """Raise K until the drop no longer settles."""
    from sim.experiments.drop import Criterion
    from sim.experiments.k_max_simulated import at_stiffness, simulated_k_max

    scene = _scene(options, device)
    found = simulated_k_max(
        at_stiffness(law, device.period), scene, Criterion(ticks=options.horizon)
    )
    return _Found(
        found.k_max_n_per_m,
        found.h1_max_n_per_m,
        "simulation",
        (),
        found.searched_n_per_m,
    )


def _nothing(found: KMax) -> str:
    if not isinstance(found, _Found):
        return "no stiffness is stable"
    return (
        f"nothing from {found.searched[0]:.4g} to {found.searched[1]:.4g} N/m settles"
    )


def _figures(found: KMax) -> dict[str, Any]:
    # JSON has no infinity: without a limit the figure is null, and the stable interval is open.
    limit = _bounded(found.k_max_n_per_m)
    figures = {
        "k_max_n_per_m": limit,
        "h1_max_n_per_m": None if limit is None else found.h1_max_n_per_m,
        "method": found.method,
    }
    if found.k_max_n_per_m == math.inf:
        figures["at_least_n_per_m"] = (
            found.searched[1] if isinstance(found, _Found) else None
        )
    return figures


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
        text = f"{_nothing(found[0])} anywhere in this range"
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
