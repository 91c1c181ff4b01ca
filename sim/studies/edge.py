"""Find the ringing frequency at the edge of stability, and K_max from a recorded swing.

K_max follows from Colgate's condition at that frequency alone.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.errors import UsageError
from nodes.laws.parse import parse_law
from nodes.parameters.options import FileOptions, argument, option, quantity
from nodes.parameters.quantities import COUNT, Interval, not_negative, whole
from nodes.recording.figure_style import (
    INK,
    PAGE_WIDTH,
    new_figure,
    save_figure,
    styled,
)
from nodes.recording.writer import RecordError
from nodes.stability.k_max import edge_of, k_max, without_spring
from nodes.stability.plant import Plant
from sim.axes import plain_log
from sim.studies import device_options as shared
from sim.studies.device_options import DeviceOptions
from sim.studies.law_looks import law_looks
from sim.studies.result import Findings, StudyResult, at_top
from sim.studies.sweeps import SPREAD, SpreadOptions, spread

if TYPE_CHECKING:
    from nodes.stability.occurring import Edge
    from sim.identify.swing import Swing
    from sim.identify.swing_drops import DroppedSwing, SwingCount

# The compared laws.
LAWS: dict[str, dict[str, Any]] = {
    "pd": {"kind": "pd", "stiffness": 1.0},
    "pd_filtered 100 Hz": {"kind": "pd_filtered", "stiffness": 1.0, "cutoff": 100.0},
    "pd_alpha 0.5": {
        "kind": "pd_alpha",
        "stiffness": 1.0,
        "order": 0.5,
        "taps": 20,
        "gains": "paper",
    },
    "pd_alpha 1.5": {
        "kind": "pd_alpha",
        "stiffness": 1.0,
        "order": 1.5,
        "taps": 4,
        "gains": "paper",
    },
    "paper_optimum": {"kind": "paper_optimum"},
}


@dataclass(frozen=True, kw_only=True)
class EdgeOptions(DeviceOptions, SpreadOptions, FileOptions):
    """Options of `edge`."""

    recording: Path | None = argument(
        default=None,
        type=Path,
        help="predict an interval of K_max from the swing of its longest contact, no mass known",
    )
    gain: tuple[float, float] = quantity("gain", Interval(1.0, 40.0))
    drops: int | None = option(
        type=COUNT,
        help="of random devices instead: how often the interval of a swing holds the true K_max",
    )
    points: int = option(
        default=24, type=whole(2, 100000), help="gains, in geometric steps"
    )
    device_damping: float | None = option(
        type=not_negative,
        help="of the recorded device and its hand, when it is real [N s/m]; narrows the interval",
    )


@dataclass(frozen=True)
class RingingLoop:
    """A loop of one law at its edge of stability."""

    law: str
    gain: float
    k_max_n_per_m: float
    edge: Edge

    def as_json(self) -> dict[str, Any]:
        """Return the figures, those of the edge at the top level."""
        figures = vars(self) | vars(self.edge)
        return {name: one for name, one in figures.items() if name != "edge"}


@dataclass(frozen=True, repr=False, kw_only=True)
class EdgesFound(Findings):
    """Loops at their edges, and how far Colgate's condition at ω_c is from K_max."""

    points: list[RingingLoop]

    @property
    def ratios(self) -> list[float]:
        """2(b − f(ω_c))/T over K_max, of each loop."""
        return [one.edge.k_simple_n_per_m / one.k_max_n_per_m for one in self.points]

    @property
    def exact_error(self) -> float:
        """Largest relative error of 2(b R − f(ω_c))/T."""
        return max(
            abs(one.edge.k_exact_n_per_m / one.k_max_n_per_m - 1.0)
            for one in self.points
        )

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name."""
        return super().answer | {
            "ratio_min": min(self.ratios),
            "ratio_max": max(self.ratios),
            "exact_error": self.exact_error,
        }


@dataclass(frozen=True, repr=False, kw_only=True)
class SwingsCounted(Findings):
    """How often the interval of a swing holds K_max, over random devices."""

    all: SwingCount = at_top()
    laws: dict[str, SwingCount]
    rows: list[DroppedSwing]


def edge(options: EdgeOptions) -> StudyResult:
    """Compare laws, or predict from a recording."""
    if options.recording is not None:
        options.refuse_unused("the recording tells it", "gain", "mass", "delay", "rate")
        options.refuse_unused("the device's damping is --device-damping", "damping")
        options.refuse_unused("one recording is looked at", "drops", "points", *SPREAD)
        return _predict(options, options.recording)
    options.refuse_unused(
        "there is no RECORDING; the device's damping is --damping", "device_damping"
    )
    if options.drops is not None:
        drawn = ("gain", "points", "mass", "damping", "delay", "hand")
        options.refuse_unused("--drops draws its devices and gains at random", *drawn)
        return _drops(options, options.drops)
    low, high = options.gain
    if not 0.0 < low < high:
        raise UsageError(f"--gain {low:g}..{high:g}: needs 0 < LOW < HIGH")
    return _edges(options, low, high)


def _edges(options: EdgeOptions, low: float, high: float) -> EdgesFound:
    """Compare laws at their edges over a range of gains."""
    device, period = shared.device(options), 1.0 / options.rate
    gains = [
        low * (high / low) ** (i / (options.points - 1)) for i in range(options.points)
    ]
    jobs = [partial(_ring, name, gain, device) for name in LAWS for gain in gains]
    rows = [row for row in spread(options, jobs, 4) if row is not None]
    if not rows:
        raise UsageError(
            f"--gain {low:g}..{high:g}: no law rings at a limit here; take lower gains"
        )
    found = EdgesFound(
        lines=(), points=rows, picture=_draw(options, rows, device.damping, period)
    )
    lines = [
        f"m {device.mass:g} kg, b {device.damping:g} N s/m, hand {device.stiffness:g} N/m, delay"
        f" {device.delay:g} ticks, {options.rate:g} Hz; B {low:g} .. {high:g}",
        f"K_max = 2(b R - f(w_c))/T to {found.exact_error:.1e} over {len(rows)} loops; without R"
        f" the ratio is {min(found.ratios):.3f} .. {max(found.ratios):.3f} (THEORY.md §9)",
        "pd_windowed is left out: no taps, so no f(w); its K_max is by drops (study kmax --method"
        " simulation)",
    ]
    return replace(found, lines=lines)


def _ring(name: str, gain: float, device: Plant) -> RingingLoop | None:
    """Find the ringing frequency of a law on a device; None if stable at any stiffness."""
    derivative = without_spring(
        parse_law({**LAWS[name], "damping": gain}), device.period
    )
    limit, edge = k_max(derivative, device).k_max_n_per_m, edge_of(derivative, device)
    return (
        None if limit is None or edge is None else RingingLoop(name, gain, limit, edge)
    )


def _drops(options: EdgeOptions, drops: int) -> SwingsCounted:
    from sim.identify.swing_drops import counted, dropped

    named = [list(LAWS)[number % len(LAWS)] for number in range(drops)]
    jobs = [
        partial(dropped, number, name, LAWS[name], 1.0 / options.rate)
        for number, name in enumerate(named)
    ]
    rows = spread(options, jobs)
    laws = {name: counted([row for row in rows if row.law == name]) for name in LAWS}
    total = counted(rows)
    lines = [
        f"{'law':20} {'drops':>6} {'told':>6} {'hold K_max':>11} {'worst miss':>11}"
        f" {'median width':>13}"
    ]
    lines += [
        f"{name:20} {one.drops:6d} {one.told:6d} {one.hold:11d}"
        f" {100.0 * (one.worst_miss or 0.0):9.2f} % {100.0 * (one.median_width or 0.0):11.2f} %"
        for name, one in {**laws, "all": total}.items()
        if one.told
    ]
    return SwingsCounted(lines=lines, all=total, laws=laws, rows=rows)


@dataclass(frozen=True, repr=False)
class SwingFound(StudyResult):
    """K_max from the swing of a recorded contact."""

    swing: Swing
    held: bool = True

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name."""
        return asdict(self.swing)

    @property
    def text(self) -> str:
        """Text for the terminal."""
        swing = self.swing
        low, high = swing.k_max_n_per_m
        mass, damping, k = (
            swing.mass_kg,
            swing.damping_n_s_per_m,
            swing.stiffness_n_per_m,
        )
        known = (
            f"with the damping of {damping[0]:g} N s/m"
            if damping[0] == damping[1]
            else (
                f"with a damping between none and the {damping[1]:.3g} N s/m that the decay shows"
                " (--device-damping narrows it)"
            )
        )
        hand = swing.hand_n_per_m
        held = (
            f"held by a hand of {hand:g} N/m"
            if hand
            else "with no hand on it (--hand tells one)"
        )
        return (
            f"K_max {low:.5g} .. {high:.5g} N/m: the swing's mass is {mass[0]:.4g} .."
            f" {mass[1]:.4g} kg,"
            f" {known}, {held} (THEORY.md §9)\nmeasured at K = {k:.6g} N/m,"
            f" {100.0 * k / high:.0f} to"
            f" {100.0 * k / low if low else math.inf:.0f} % of it: swings at"
            f" {swing.omega_rad_per_s / (2.0 * math.pi):.5g} Hz,"
            f" x {swing.decay_per_tick:.5f} per tick;"
            f" rings at {swing.edge.omega_rad_per_s / (2.0 * math.pi):.5g} Hz at the edge"
        )


@dataclass(frozen=True, repr=False, kw_only=True)
class NoSwing(Findings):
    """Why a recording tells no K_max."""

    k_max_n_per_m: None = None
    why: str


def _predict(options: EdgeOptions, recording: Path) -> StudyResult:
    from sim.identify.swing import CannotTellError, recorded_swing

    try:
        swing = recorded_swing(recording, options.device_damping, options.hand or None)
    except CannotTellError as error:
        return NoSwing(lines=[f"unknown: {error}"], held=False, why=str(error))
    except (RecordError, ValueError, OSError) as error:
        raise UsageError(str(error)) from error
    return SwingFound(swing)


@styled
def _draw(
    options: EdgeOptions, rows: list[RingingLoop], damping: float, period: float
) -> Path:
    figure = new_figure(PAGE_WIDTH, 3.4)
    left, right = figure.subplots(1, 2)
    for name, look in zip(LAWS, law_looks(LAWS), strict=True):
        mine = [row for row in rows if row.law == name]
        k = [row.k_max_n_per_m for row in mine]
        left.plot(
            [row.edge.f_n_s_per_m for row in mine], k, **look.points(), label=name
        )
        hertz = [row.edge.omega_rad_per_s / (2.0 * math.pi) for row in mine]
        off = [
            100.0 * abs(1.0 - row.edge.k_simple_n_per_m / row.k_max_n_per_m)
            for row in mine
        ]
        right.semilogy(hertz, off, **look.points())
    span = sorted(row.edge.f_n_s_per_m for row in rows)
    left.plot(
        span,
        [2.0 * (damping - f) / period for f in span],
        color=INK,
        ls="-",
        lw=0.8,
        label="$2(b-f)/T$",
    )
    left.set(
        xlabel=r"$f(\omega_c)$  [N s/m]",
        ylabel=r"$K_\mathrm{max}$  [N/m]",
        title="each loop where it rings",
    )
    right.set(
        xlabel=r"$\omega_c/2\pi$  [Hz]",
        ylabel=r"$2(b-f)/T$ differs from $K_\mathrm{max}$ by  [%]",
        title=r"Colgate at $\omega_c$ alone, without R",
    )
    plain_log(right.yaxis, *right.get_ylim())
    left.legend()
    figure.suptitle(
        f"m = {options.mass:g} kg, b = {damping:g} N s/m, d = {options.delay:g},"
        f" {options.rate:g} Hz",
        fontsize=9,
    )
    return save_figure(figure, options.out / "edge.png")
