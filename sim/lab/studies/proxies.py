"""Compare proxies on analytic shapes: force error, noise, drag, thin plate, call time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from messages.errors import UsageError
from nodes.parameters.options import FileOptions, option, quantity
from nodes.parameters.quantities import SEED, not_negative, positive, whole
from nodes.recording.figure_style import (
    COLOURS,
    INK,
    LINES,
    MARKERS,
    PAGE_WIDTH,
    new_figure,
    save_figure,
    styled,
)
from sim.axes import name_points, plain_log
from sim.results import fresh
from sim.studies.result import Findings
from sim.studies.sweeps import SpreadOptions, spread

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from matplotlib.transforms import BboxBase

    from sim.lab.proxies import ProxyError

_MOST = 7


@dataclass(frozen=True, kw_only=True)
class ProxiesOptions(SpreadOptions, FileOptions):
    """Options of `proxies`."""

    finest: int = option(
        default=5,
        type=whole(2, _MOST),
        help="finest mesh: 20·4ⁿ triangles (default: 5, 20 480)",
    )
    ticks: int = option(
        default=5000, type=whole(100, 10000000), help="length of each way"
    )
    stiffness: float = quantity("stiffness", 500.0)
    rate: float = quantity("rate", 1000.0)
    depth: float = option(default=0.004, type=positive, help="below the surface [m]")
    speed: float = option(default=0.2, type=positive, help="along the surface [m/s]")
    tool: float = option(
        default=0.0, type=not_negative, help="radius of the tool [m] (default: 0)"
    )
    steps: int = option(
        default=1000000,
        type=whole(1, 10**9),
        help="random steps through the plate (default: 10⁶)",
    )
    seed: int = option(default=0, type=SEED, help="of the random steps (default: 0)")


@dataclass(frozen=True)
class PlateCrossed:
    """Random steps through a thin plate."""

    steps: int
    step_m: float  # longest step
    wrong_side: int  # ticks with the proxy on the wrong side
    aside_max_m: float  # largest distance of the proxy beside the device


@dataclass(frozen=True, repr=False, kw_only=True)
class ProxiesFound(Findings):
    """Errors of the proxies on each shape."""

    rows: list[ProxyError]
    plate: PlateCrossed


def proxies(options: ProxiesOptions) -> ProxiesFound:
    """Compare the proxies; fail if a proxy changed sides."""
    if options.depth > 0.01:
        raise UsageError(
            f"--depth {options.depth}: at most 0.01 m, in a sphere of 0.05 m"
        )
    from sim.lab.proxies import PLATE, Way, compared, count, timed, wrong_sides

    period, step = 1.0 / options.rate, 2.0 / options.rate
    led = (options.ticks, options.depth, options.speed, period, options.tool)
    ways = [Way(number, *led) for number in range(count(options.finest))]
    # The finest mesh takes longest and runs first; times are of this machine, the rest may be
    # computed elsewhere.
    jobs: list[partial[Any]] = [
        partial(compared, way, options.stiffness) for way in reversed(ways)
    ]
    jobs.append(partial(wrong_sides, options.steps, step, options.seed, options.tool))
    *rows, (wrong, aside) = spread(options, jobs)
    found = [timed(row, way) for row, way in zip(reversed(rows), ways, strict=True)]
    lines = [
        (
            f"{'':28}{'force error [mN]':>24}{'':>12}{'proxy [µm] off':>24}"
            f"{'drag':>10}{'µs a call':>18}"
        ),
        (
            f"{'':28}{'rms':>12}{'max':>12}{'noise':>12}{'closed form':>12}{'triangles':>12}"
            f"{'':>10}{'median':>9}{'p99':>9}"
        ),
    ]
    lines += [
        f"{row.name:28}{1e3 * row.rms_n:12.4g}{1e3 * row.max_n:12.4g}{1e3 * row.noise_n:12.4g}"
        f"{row.proxy_um:12.4g}"
        f"{'' if row.polyhedron_um is None else format(row.polyhedron_um, '.2g'):>12}"
        f"{row.drag:10.2g}{row.call_us:9.3g}{row.call_p99_us:9.3g}"
        for row in found
    ]
    lines.append(
        f"plate of {1e3 * PLATE[2]:g} mm, {options.steps} random steps of up to {1e3 * step:g}"
        f" mm: {wrong} on the wrong side, at most {1e6 * aside:.3g} µm beside the device"
    )
    plate = PlateCrossed(options.steps, step, wrong, aside)
    picture = save_figure(errors_over_time(found), options.out / "proxies.png", fresh)
    return ProxiesFound(
        lines=lines, picture=picture, held=not wrong, rows=found, plate=plate
    )


@styled
def errors_over_time(found: Sequence[ProxyError]) -> Figure:
    """Plot the largest error and the noise of the force over the time of a call."""
    from matplotlib.transforms import Bbox

    figure = new_figure(PAGE_WIDTH, 3.4)
    panels = figure.subplots(1, 2)
    kinds = ("closed form", "mesh")
    labels = ("closed form", "mesh of a sphere, by its triangles")
    for axes, key, scale, title in (
        (panels[0], "max_n", 1e3, "largest force error  [mN]"),
        (panels[1], "noise_n", 1e3, "noise of the force  [mN]"),
    ):
        shown = [row for row in found if getattr(row, key) > 0.0]
        for i, kind in enumerate(kinds):
            mine = [row for row in shown if (kinds[row.triangles > 0]) == kind]
            axes.loglog(
                [row.call_us for row in mine],
                [scale * getattr(row, key) for row in mine],
                color=COLOURS[i],
                marker=MARKERS[i],
                ls="none" if kind == "closed form" else LINES[i],
                lw=0.8,
                label=labels[i],
            )
        axes.set(xlabel="time of a call, median  [µs]", title=title)
        axes.margins(0.15)
        plain_log(axes.xaxis, *axes.get_xlim())
        named = [
            (str(row.triangles or row.name), row.call_us, scale * getattr(row, key))
            for row in shown
        ]
        # No name covers a marker.
        taken: list[BboxBase] = [
            Bbox.from_bounds(x - 3.0, y - 3.0, 6.0, 6.0)
            for x, y in axes.transData.transform([point[1:] for point in named])
        ]
        name_points(axes, named, taken, must=True, size=6.5, color=INK)
    panels[0].legend()
    return figure
