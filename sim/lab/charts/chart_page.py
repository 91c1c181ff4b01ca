"""The readable chart: figures as PNG, PDF and SVG, and one page that interprets them.

Every statement of the page is computed from the points, so it is valid on any machine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nodes.recording.figure_style import (
    COLOURS,
    GREY,
    INK,
    LINES,
    MARKERS,
    new_figure,
    save_figure,
    styled,
    typeset,
)
from sim.axes import name_points
from sim.lab.charts.derivative_errors import lengths_taken
from sim.lab.charts.derivatives import GAIN, PERIOD, STIFFNESS
from sim.lab.charts.points import Group, Point
from sim.results import fresh

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.transforms import BboxBase

FEWEST = (
    8  # minimum number of laws for a rank correlation: with fewer, chance dominates
)
CHANCE = 0.05  # p above which a rank correlation is not significant
_FLOOR = 1e-16
_FRONT, _REST, _SEED = COLOURS[0], "#B9BEC5", COLOURS[1]


@styled
def draw(group: Group, folder: Path) -> Path:
    """Draw one group: all points, the labelled front, and the paper's Grünwald–Letnikov."""
    figure = new_figure(7.2, 4.6)
    axes = figure.add_subplot()
    shown = [
        p for p in group.points if math.isfinite(p.error) and math.isfinite(p.cost)
    ]
    words = {
        "title": group.title,
        "xlabel": group.cost_label,
        "ylabel": group.error_label,
    }
    axes.set(xscale="log", **{place: typeset(told) for place, told in words.items()})
    lowest = min((p.error for p in shown if p.error > 0.0), default=1e-3)
    floor = max(_FLOOR, 0.3 * lowest) if any(p.error <= 0.0 for p in shown) else _FLOOR
    if group.linear:
        floor = 0.0
    else:
        axes.set_yscale("log")
    if group.families:
        _by_family(axes, shown, floor)
    kinds = ((False, _REST, 18, "beaten"), (True, _FRONT, 36, "Pareto front"))
    for front, colour, size, label in () if group.families else kinds:
        points = [p for p in shown if p.on_front is front and p.family != "gl"]
        axes.scatter(
            [p.cost for p in points],
            [max(p.error, floor) for p in points],
            s=size,
            c=colour,
            label=label,
            zorder=3,
        )
    classic = [p for p in shown if p.family == "gl"]
    if classic:
        look: dict[str, Any] = {
            "color": _SEED,
            "ms": 5,
            "lw": 1,
            "label": "GL (paper)",
            "zorder": 4,
        }
        axes.plot(
            [p.cost for p in classic],
            [max(p.error, floor) for p in classic],
            "s--",
            **look,
        )
    best = [p for p in shown if p.on_front]
    if not group.families:
        axes.step(
            [p.cost for p in best],
            [max(p.error, floor) for p in best],
            where="post",
            color=_FRONT,
            lw=1,
            alpha=0.6,
        )
    _ticks(axes, max(p.cost for p in shown) / min(p.cost for p in shown))
    legend = axes.legend()
    figure.draw_without_rendering()
    taken: list[BboxBase] = [legend.get_window_extent(), *_dots(axes, shown, floor)]
    named_ones = (
        ((shown, False, 7.0, INK),)
        if group.families
        else ((best, True, 7.0, _FRONT), (_beaten(shown), False, 6.0, GREY))
    )
    for some, must, letters, ink in named_ones:
        named = [
            (p.name if p.error > 0.0 else f"{p.name} (0)", p.cost, max(p.error, floor))
            for p in some
        ]
        name_points(axes, named, taken, must=must, size=letters, color=ink)
    return save_figure(figure, folder / f"chart_{group.name}.png", fresh)


def _by_family(axes: Axes, points: Sequence[Point], floor: float) -> None:
    """Draw each family as a line with its own colour, style and marker."""
    for i, family in enumerate(dict.fromkeys(p.family for p in points)):
        mine = [p for p in points if p.family == family]
        look: dict[str, Any] = {
            "color": COLOURS[i],
            "marker": MARKERS[i],
            "ls": LINES[i],
            "ms": 5,
            "lw": 1,
            "zorder": 3,
        }
        axes.plot(
            [p.cost for p in mine],
            [max(p.error, floor) for p in mine],
            label=family,
            **look,
        )


def _ticks(axes: Axes, span: float) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter

    axes.xaxis.set_major_formatter("{x:g}")
    if span < 100.0:
        # Less than two decades have too few powers of ten as labels.
        axes.xaxis.set_minor_locator(LogLocator(subs=(2.0, 3.0, 5.0)))
        axes.xaxis.set_minor_formatter("{x:g}")
    else:
        axes.xaxis.set_minor_formatter(NullFormatter())


def _dots(axes: Axes, points: Sequence[Point], floor: float) -> list[BboxBase]:
    """Return the boxes of the dots [pixel], which labels avoid."""
    from matplotlib.transforms import Bbox

    found: list[BboxBase] = []
    for point in points:
        x, y = axes.transData.transform((point.cost, max(point.error, floor)))
        half = 4.0 if point.on_front else 2.0
        found.append(Bbox.from_extents(x - half, y - half, x + half, y + half))
    return found


def _beaten(points: Sequence[Point]) -> list[Point]:
    """Return the best member of every family that has none on the front."""
    ahead = {p.family for p in points if p.on_front}
    return [
        point for family, point in _best_members(points).items() if family not in ahead
    ]


def _best_members(points: Sequence[Point]) -> dict[str, Point]:
    best: dict[str, Point] = {}
    for point in points:
        if point.family not in best or point.error < best[point.family].error:
            best[point.family] = point
    return best


def conclusions(groups: Sequence[Group]) -> list[str]:
    """Return a few lines that summarise the points."""
    named = {group.name: group for group in groups}
    lines = [
        _derivatives(
            group, named.get(name.replace("time", "stiffness")), name.rpartition("_")[2]
        )
        for name, group in named.items()
        if name.startswith("derivative_time_")
    ]
    demands = [
        group for name, group in named.items() if name.startswith("equal_demand_")
    ]
    if demands:
        lines.append(_equal_demand(demands))
    if "integrator_trajectory" in named:
        lines.append(
            _integrators(named["integrator_trajectory"], named["integrator_k_max"])
        )
    ways = [group for name, group in named.items() if name.startswith("k_max_delay_")]
    if ways:
        lines.append(_kmax(ways))
    if "rate_force" in named:
        lines.append(_rates(named["rate_force"], named["rate_stiffness"]))
    if "proxy_error" in named:
        lines.append(_proxies(named["proxy_error"]))
    lines += [
        _loop(group)
        for name, group in named.items()
        if name.startswith("loop_impedance_")
    ]
    return lines


def _loop(group: Group) -> str:
    """Return a sentence on the loop: best point, cheapest within 10 % of it, first point."""
    best, first = _best(group.points), group.points[0]
    near = min(
        (p for p in group.points if p.error <= 1.1 * best.error), key=lambda p: p.cost
    )
    return (
        f"{group.title}: {best.name} errs least ({_figure(100 * best.error)} % over the band,"
        f" {_figure(best.cost)} µs); {near.name} comes within a tenth of that in"
        f" {_figure(near.cost)} µs, {first.name}, the cheapest, errs by"
        f" {_figure(100 * first.error)} % in {_figure(first.cost)} µs."
    )


def _best(points: Sequence[Point]) -> Point:
    return min(points, key=lambda p: (p.error, p.cost))


def _figure(value: float) -> str:
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"


def _find(group: Group, name: str) -> Point:
    return next(p for p in group.points if p.name == name)


def _number(point: Point, key: str) -> float:
    value = point.detail.get(key)
    return math.nan if value is None else float(value)


def _derivatives(time: Group, stiffness: Group | None, order: str) -> str:
    classic = [p for p in time.points if p.family == "gl"]
    long = max(classic, key=lambda p: p.cost)
    best = _best(time.points)
    matching = [
        p for p in time.points if p.error <= 1.05 * min(s.error for s in classic)
    ]
    cheapest = min(matching, key=lambda p: p.cost)
    text = (
        f"D^{order}: {best.name} is the most accurate ({100 * best.error:.2g} %, {best.cost:.2g}"
        f" µs); what GL needs {long.name.split()[-1]} taps and {long.cost:.2g} µs for"
        f" ({100 * min(s.error for s in classic):.2g} %), {cheapest.name} does in"
        f" {cheapest.cost:.2g} µs with {cheapest.detail['multiplies']} multiplies"
    )
    if stiffness is not None:
        stiffest = _best(stiffness.points)
        text += (
            f"; stiffest floor at one common gain and one tick of delay: {stiffest.name} with"
            f" {_number(stiffest, 'h1_max_n_per_m'):.0f} N/m, against"
            f" {_number(best, 'h1_max_n_per_m'):.0f} of {best.name}"
        )
    return text + "."


def _correlation(errors: Sequence[float], stiffnesses: Sequence[float]) -> str:
    """Return the rank correlation of error and stiffness with n and p.

    A verdict is added only if neither is due to chance.
    """
    from scipy.stats import spearmanr

    if len(errors) < FEWEST:
        return (
            f"{len(errors)} laws, too few for a rank correlation of error and stiffness"
        )
    found = spearmanr(errors, stiffnesses)
    ranks, p = float(found.statistic), float(found.pvalue)
    word = "accuracy is not seen to matter"
    if p < CHANCE:
        word = (
            "accuracy costs stiffness" if ranks > 0.0 else "accuracy brings stiffness"
        )
    return (
        f"{word}: rank correlation of error and stiffness {ranks:+.2f}, n = {len(errors)}, p ="
        f" {p:.2g}"
    )


def _equal_demand(groups: Sequence[Group]) -> str:
    """Return how much stiffness accuracy gains if all laws meet one demand."""
    parts = []
    for group in groups:
        kept = [p for p in group.points if _number(p, "h1_tuned_n_per_m") > 0.0]
        if len(kept) < 3:
            continue
        stiff, exact = (
            min(kept, key=lambda p: p.error),
            min(kept, key=lambda p: (p.cost, p.error)),
        )
        told = _correlation(
            [p.cost for p in kept], [_number(p, "h1_tuned_n_per_m") for p in kept]
        )
        parts.append(
            f"{group.title.partition(':')[0]}{group.title.rpartition(',')[2]}: {told} ({len(kept)}"
            f" of {len(group.points)} keep the demand); the stiffest, {stiff.name}, has"
            f" {_number(stiff, 'h1_tuned_n_per_m'):.0f} N/m and errs by {_figure(100 * stiff.cost)}"
            f" %, the most accurate, {exact.name}, {_number(exact, 'h1_tuned_n_per_m'):.0f} N/m and"
            f" {_figure(100 * exact.cost)} %"
        )
    return "At equal demand, each at its own best gain. " + "; ".join(parts) + "."


def _integrators(path: Group, limit: Group) -> str:
    exact, euler = _find(path, "exact map"), _find(path, "semi-implicit Euler 10")
    right = [p for p in limit.points if p.error < 1e-3 and p.name != exact.name]
    nearest = min(right, key=lambda p: p.cost)
    return (
        f"Integrators: the exact map costs {exact.cost:.2g} µs per tick and errs by"
        f" {exact.error:.1g};"
        f" semi-implicit Euler with 10 sub-steps costs {euler.cost / exact.cost:.1f} times that and"
        f" misses K_max by {100 * _find(limit, euler.name).error:.0f} %; the next cheapest with"
        f" K_max right to 0.1 % is {nearest.name} at {nearest.cost / exact.cost:.1f} times the"
        " cost."
    )


def _kmax(groups: Sequence[Group]) -> str:
    parts = []
    for group in groups:
        pole = _find(group, "pole radius 0.001")
        played = [p for p in group.points if p.family in ("drop", "release")]
        longest = max((p for p in played if p.family == "drop"), key=lambda p: p.cost)
        formula = min(
            (p for p in group.points if p.name.startswith("closed form")),
            key=lambda p: p.error,
        )
        parts.append(
            f"{group.title.rpartition(', ')[2]}: pole radius {_figure(pole.cost)} ms and"
            f" {100 * pole.error:.1g} % off, best formula {_figure(formula.cost)} ms and"
            f" {100 * formula.error:.0f} % off, {longest.name} {_figure(longest.cost)} ms and"
            f" {100 * longest.error:.0f} % off"
        )
    return "K_max: " + "; ".join(parts) + "."


def _rates(force: Group, stiffness: Group) -> str:
    kept = [
        p for p in force.points if _number(p, "missed") <= 0.02 * _number(p, "ticks")
    ]
    best = _best(kept or force.points)
    slow = min(kept or force.points, key=lambda p: (p.cost, p.error))
    held = {p.name for p in kept}
    stiffest = _best(
        [p for p in stiffness.points if p.name in held] or stiffness.points
    )
    lost = sorted({p.cost for p in force.points} - {p.cost for p in kept})
    text = (
        f"Loop rate, through the processes: from {slow.name} to {best.name} the force error falls"
        f" from {100 * slow.error:.2g} to {100 * best.error:.2g} %; the stiffest floor that settled"
        f" was {_number(stiffest, 'k_settled_n_per_m'):.0f} N/m at {stiffest.name}"
    )
    if lost:
        text += (
            f"; more than 2 % of the ticks were missed at {', '.join(f'{rate:g}' for rate in lost)}"
            " Hz on this machine"
        )
    return text + "."


def _proxies(group: Group) -> str:
    ball = _find(group, "sphere")
    meshes = [p for p in group.points if p.family == "mesh"]
    bodies = [p for p in group.points if p.family == "body"]
    coarse, fine = (
        way(meshes, key=lambda p: _number(p, "triangles")) for way in (min, max)
    )
    text = (
        f"Proxy on a sphere: the closed form is {_figure(1e3 * ball.error)} nm off in"
        f" {ball.cost:.2g} µs a call; {_number(coarse, 'triangles'):.0f} triangles"
        f" {_figure(coarse.error)} µm in {coarse.cost:.2g} µs, {_number(fine, 'triangles'):.0f}"
        f" {_figure(fine.error)} µm in {fine.cost:.2g} µs"
    )
    if bodies:
        best = _best(bodies)
        text += (
            f"; a tool that is a body {_figure(best.error)} µm at best, in {best.cost:.2g} µs"
            f" ({best.name})"
        )
    return text + "."


def _realisations(groups: Sequence[Group]) -> list[str]:
    """Return a table of the best member of every family: cost, error and limits."""
    text: list[str] = []
    for group in groups:
        if not group.name.startswith("derivative_time_"):
            continue
        order = float(group.name.rpartition("_")[2])
        text += [
            "",
            f"## Every realisation of D^{order:g}, at its best",
            "",
            (
                "| realisation | multiplies | states | error raw | delay removed | delay [ticks] |"
                " leak D(1)·T^α | gain at Nyquist (GL: 1) | largest pole | H(1) max [N/m] | gain"
                " max [N s/m] | lengths taken |"
            ),
            "| --- " * 12 + "|",
        ]
        for family, p in sorted(_best_members(group.points).items()):
            lengths = lengths_taken(family, order, PERIOD)
            span = (
                "none"
                if lengths is None
                else f"{lengths[0]} to {lengths[1]}{' and more' if lengths[1] == 2000 else ''}"
            )
            d = {key: _number(p, key) for key in p.detail}
            text.append(
                f"| {p.name} | {d['multiplies']:.0f} | {d['states']:.0f} | {d['error_raw']:.2g} |"
                f" {p.error:.2g} | {d['delay_ticks']:.3f} | {d['leak']:.2g} |"
                f" {d['nyquist_gain']:.3g} | {d['largest_pole']:.6g} | {d['h1_max_n_per_m']:.0f} |"
                f" {d['gain_max_n_s_per_m']:.3g} | {span} |"
            )
        text += [
            "",
            (
                f"The last columns: stiffness left at the common gain {GAIN:g} N s/m, gain left at"
                f" {STIFFNESS:g} N/m."
            ),
        ]
    return text


def page(groups: Sequence[Group], machine: dict[str, Any], seconds: float) -> str:
    """Return the page that interprets the chart."""
    text = [
        "# Speed against accuracy",
        "",
        (
            "Every choice is a dot: to the left is cheaper, down is better. The joined, named dots"
            " are the Pareto front; each other dot is worse than one of them in both respects."
            " Redraw it with `haptic study chart`."
        ),
        "",
        "## In short",
        "",
        *[f"{i}. {line}" for i, line in enumerate(conclusions(groups), 1)],
        "",
        (
            f"Measured on {machine['cpu']} ({machine['cores']} cores, {machine['system']}, Python"
            f" {machine['python']}, numpy {machine['numpy']}, numba {machine['numba']}, load"
            f" {machine['load_1min']}) in {seconds:.0f} s. Times are medians of interleaved rounds;"
            " the quartiles are in `chart.csv`."
        ),
    ]
    text += _realisations(groups)
    for group in groups:
        text += [
            "",
            f"## {group.title}",
            "",
            f"![{group.title}](chart_{group.name}.png)",
            "",
            group.note,
            "",
        ]
        text += [
            f"| on the front | {group.cost_label} | {group.error_label} |",
            "| --- | --- | --- |",
        ]
        text += [
            f"| {p.name} | {p.cost:.3g} | {p.error:.3g} |"
            for p in group.points
            if p.on_front
        ]
    return "\n".join(text) + "\n"
