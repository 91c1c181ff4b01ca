"""What a chart says in words: one paragraph per panel, from its points."""

from __future__ import annotations

import math
from collections.abc import Sequence

from sim.lab.charts.derivative_errors import lengths_taken
from sim.lab.charts.derivatives import GAIN, PERIOD, STIFFNESS
from sim.lab.charts.points import Group, Point

# minimum number of laws for a rank correlation: with fewer, chance dominates
FEWEST = 8
CHANCE = 0.05  # p above which a rank correlation is not significant


def best_members(points: Sequence[Point]) -> dict[str, Point]:
    """Return the most exact point of each family."""
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


def realisations(groups: Sequence[Group]) -> list[str]:
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
        for family, p in sorted(best_members(group.points).items()):
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
