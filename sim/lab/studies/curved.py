"""Measure a law on curved surfaces in both frames: energy, force steps, sliding K_max."""

from __future__ import annotations

import math
from argparse import ArgumentTypeError
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from messages.errors import UsageError
from nodes.launcher import launch_file
from nodes.laws.pd import PD
from nodes.laws.pd_alpha import PDAlpha
from nodes.parameters.options import FileOptions, option, quantity
from nodes.parameters.quantities import not_negative, positive
from nodes.recording import figure_style as style
from sim.results import fresh
from sim.studies.result import Findings
from sim.studies.sweeps import SpreadOptions, spread

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from sim.lab.curved import AlongTheWay


@dataclass(frozen=True, kw_only=True)
class CurvedOptions(SpreadOptions, FileOptions):
    """Options of `curved`."""

    stiffness: float = quantity("stiffness", 800.0)
    gain: float = quantity("gain", 2.0)
    rate: float = quantity("rate", 500.0)
    depth: float = option(default=0.002, type=positive, help="below the surface [m]")
    speed: float = option(default=0.2, type=positive, help="along the surface [m/s]")
    slides: str = option(
        default="0,0.02,0.04",
        help="speeds of the sliding contact [m/s] (default: 0,0.02,0.04)",
    )


@dataclass(frozen=True)
class SlidingLimit:
    """K_max of a sliding contact."""

    speed_m_per_s: float
    frame: str
    k_max_n_per_m: float | None = None
    over: float | None = None  # over that of one axis
    beyond: str | None = None  # end of the search without a limit

    @property
    def line(self) -> str:
        """The figures in one line."""
        at = f"at {self.speed_m_per_s:g} m/s, {self.frame:8}"
        if self.beyond is not None:
            return f"{at} {self.beyond} of it, where the search ends"
        return f"{at}{self.k_max_n_per_m:10.5g} N/m, {self.over:.4f} of it"


@dataclass(frozen=True, repr=False, kw_only=True)
class CurvedFound(Findings):
    """Laws along curved ways, and K_max of a sliding contact."""

    ways: list[AlongTheWay]
    one_axis_n_per_m: float
    edges: list[SlidingLimit]


def curved(options: CurvedOptions) -> CurvedFound:
    """Move laws along surfaces, then search the stability limit while sliding."""
    if options.depth > 0.005:
        raise UsageError(
            f"--depth {options.depth:g}: at most 0.005 m, in a rod of 0.006 m"
        )
    try:
        slides = [not_negative(text) for text in options.slides.split(",") if text]
    except ArgumentTypeError as error:
        raise UsageError(f"--slides {options.slides}: {error}") from error
    from sim.lab.curved import along_ways, theory

    period, k, b = 1.0 / options.rate, options.stiffness, options.gain
    alpha = PDAlpha(stiffness=k, damping=b, order=1.2, taps=10, gains="physical")
    laws = [
        ("pd", PD(stiffness=k, damping=b).compile(period)),
        ("pd_alpha", alpha.compile(period)),
    ]
    found = along_ways(laws, period, options.speed, options.depth)
    one_axis = theory(period)
    edges = _edges(options, slides, one_axis)
    lines = [
        f"{'surface':26}{'law':10}{'frame':9}{'given out':>12}{'kicks [mN]':>12}"
        f"{'off a spring [mN]':>19}"
    ]
    lines += [
        f"{row.surface:26}{row.law:10}{row.frame:9}{100.0 * row.given_out:10.3f}"
        f" %{1e3 * row.kicks_n:12.3f}{1e3 * row.largest_n:19.3f}"
        for row in found
    ]
    lines += [
        "",
        f"K_max of a contact that slides over a sphere of 35 mm; in one axis {one_axis:.5g} N/m",
        *(edge.line for edge in edges),
    ]
    return CurvedFound(
        lines=lines,
        ways=found,
        one_axis_n_per_m=one_axis,
        edges=edges,
        picture=draw(options.out / "curved.png", found, edges),
    )


def _edges(
    options: CurvedOptions, slides: list[float], one_axis: float
) -> list[SlidingLimit]:
    """Search the limit at each speed in both frames."""
    from sim.lab.curved import FRAMES, SEARCHED, sliding_k_max

    launch = launch_file.read("sphere_feel", {"rate": options.rate, "pace": "lockstep"})
    ways = [(speed, frame) for speed in slides for frame in FRAMES]
    limits = spread(options, [partial(sliding_k_max, launch, *way) for way in ways])
    edges = []
    for (speed, frame), edge in zip(ways, limits, strict=True):
        if edge in (0.0, math.inf):
            end = f"below {SEARCHED[0]:g}" if edge == 0.0 else f"above {SEARCHED[1]:g}"
            edges.append(SlidingLimit(speed, frame, beyond=end))
        else:
            edges.append(SlidingLimit(speed, frame, edge, edge / one_axis))
    return edges


@style.styled
def draw(
    path: Path, ways: Sequence[AlongTheWay], edges: Sequence[SlidingLimit]
) -> Path:
    """Plot the energy along closed paths and the shift of the limit while sliding.

    Both in world axes and in turning axes.
    """
    surfaces, frames, laws = (
        list(dict.fromkeys(getattr(row, key) for row in ways))
        for key in ("surface", "frame", "law")
    )
    figure = style.new_figure(9.4, 1.6 + 0.36 * len(surfaces))
    # Without slides there is no limit to show.
    panels = figure.subplots(
        1, 1 + bool(edges), width_ratios=(1.4, 1.0)[: 1 + bool(edges)], squeeze=False
    )
    energy = panels[0, 0]
    style.name_rows(energy, surfaces)
    for number, (frame, law) in enumerate(
        (frame, law) for frame in frames for law in laws
    ):
        mine = [row for row in ways if (row.frame, row.law) == (frame, law)]
        rows = [surfaces.index(row.surface) + 0.16 * (number - 1.5) for row in mine]
        mark = {
            "marker": style.MARKERS[number],
            "color": style.COLOURS[frames.index(frame)],
            "ls": "",
        }
        energy.plot(
            [100.0 * row.given_out for row in mine],
            rows,
            **mark,
            label=f"{law}, axes of the {frame}",
        )
    energy.set_xlabel("energy given out, of force times way, there and back  [%]")
    style.threshold(energy, 0.0, "gives out nothing", vertical=True)
    style.legend_above(energy)
    if edges:
        _draw_edges(panels[0, 1], edges)
    return style.save_figure(figure, path, fresh)


def _draw_edges(limit: Axes, edges: Sequence[SlidingLimit]) -> None:
    for number, frame in enumerate(dict.fromkeys(row.frame for row in edges)):
        found = [
            (row.speed_m_per_s, row.over)
            for row in edges
            if row.frame == frame and row.over is not None
        ]
        places = [speed for speed, _ in found], [over for _, over in found]
        limit.plot(*places, marker=style.MARKERS[number], label=f"axes of the {frame}")
    limit.set_xlabel("speed of a slide over a sphere of 35 mm  [m/s]")
    limit.set_ylabel(r"$K_\mathrm{max}$ over that of one axis  [1]")
    limit.set_ylim(
        0.99 * min(limit.get_ylim()[0], 1.0), 1.01 * max(limit.get_ylim()[1], 1.0)
    )
    limit.locator_params(nbins=5)
    style.legend_above(limit)
