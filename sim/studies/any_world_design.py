"""`haptic study design --for any_hand | any_world`: stiffest law of each family."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from messages.errors import UsageError
from nodes.recording.figure_style import new_figure, save_figure, styled
from sim.design.any_world import Surroundings
from sim.design.any_world_families import (
    Member,
    fractional_gain,
    margin_figures,
    stiffest_members,
    stiffness,
)
from sim.results import fresh
from sim.studies.design_options import DesignOptions
from sim.studies.result import Answer, answered

WORDS = {
    "any_hand": "any hand, of any mass, and any passive world that answers within the tick",
    "any_world": "the device as given and any passive world that answers within the tick",
}
FAMILIES = {
    "pd": "PD",
    "pd_alpha": "best PDα",
    "paper_optimum": "the paper's optimum",
    "taps": "free taps",
    "one_pole": "two taps over a pole",
    "taps_over_pole": "free taps over a pole",
    "two_poles": "taps over two poles",
}


def run(options: DesignOptions) -> Answer:
    """Design at one delay, or compare the families over several delays."""
    if options.sections and options.world != "any_hand":
        raise UsageError("--sections: with --for any_hand, where a linear programme bounds them")
    if options.compare:
        found = [(delay, _members(options, (delay, delay))) for delay in options.delays]
        rows = [
            row for delay, members in found for row in [_figures(options, (delay, delay), members)]
        ]
        lines = [line for row in rows for line in _lines(options, row)]
        plot = draw_delays(options.out / f"design_{options.world}.png", rows, options)
        return answered({"for": options.world, "cases": rows}, lines, plot=plot)
    delay = options.delay or (1.0, 1.0)
    members = _members(options, delay)
    row = _figures(options, delay, members)
    lines = _lines(options, row)
    best = max(members, key=stiffness)
    if best.law is None:
        lines.append("no law of these families is stable for every world")
        return answered({"for": options.world, **row, "yaml": None}, lines, held=False)
    from sim.design.families import to_yaml

    path = fresh(options.out / f"{options.world}.yaml")
    path.write_text(
        to_yaml(best.law, options.world, comment="\n".join(lines[:1])), encoding="utf-8"
    )
    lines.append(f"haptic param load coupling {path}")
    return answered({"for": options.world, **row, "yaml": str(path)}, lines)


def _members(options: DesignOptions, delay: tuple[float, float]) -> list[Member]:
    mass = options.mass if options.world == "any_world" else None
    try:
        surroundings = Surroundings(
            1.0 / (options.rate or 500.0), options.damping[0], delay, options.nyquist, mass
        )
    except ValueError as error:
        raise UsageError(f"--{error}") from error
    members, step = [], options.progress(len(FAMILIES))
    for member in stiffest_members(surroundings, options.taps, options.sections):
        step(f"{FAMILIES[member.family]}, delay {delay[1]:g}", 1)
        members.append(member)
    return members


def _figures(
    options: DesignOptions, delay: tuple[float, float], members: Sequence[Member]
) -> dict[str, Any]:
    rate = options.rate or 500.0
    laws = [
        {"family": member.family, "law": member.law}
        | ({"h1_n_per_m": None} if member.design is None else margin_figures(member.design))
        for member in members
    ]
    return {
        "delay_ticks": list(delay),
        "rate_hz": rate,
        "damping_n_s_per_m": options.damping[0],
        "mass_kg": list(options.mass) if options.world == "any_world" else None,
        "h_nyquist_limit_n_per_m": options.nyquist,
        "closed_limit_n_per_m": 2.0 * options.damping[0] * rate / (1.0 + delay[1]),
        "laws": laws,
        "fractional_gain": fractional_gain(list(members)),
    }


def _lines(options: DesignOptions, row: Mapping[str, Any]) -> list[str]:
    low, high = row["delay_ticks"]
    device = (
        "" if row["mass_kg"] is None else f"m {row['mass_kg'][0]:g}..{row['mass_kg'][1]:g} kg, "
    )
    lines = [
        f"stable for {WORDS[options.world]}: {device}b {row['damping_n_s_per_m']:g} N s/m, delay"
        f" {low:g}..{high:g} ticks at {row['rate_hz']:g} Hz, |H(-1)| <="
        f" {row['h_nyquist_limit_n_per_m']:g} N/m"
    ]
    for law in row["laws"]:
        if law["h1_n_per_m"] is None:
            lines.append(f"  {FAMILIES[law['family']]:21} none")
            continue
        proof = (
            "proven at every frequency" if law["proven"] else "NOT proven between the frequencies"
        )
        taps = ", ".join(f"{tap:.6g}" for tap in law["taps_n_per_m"])
        sections = (
            f"; section {', '.join(f'{c:.6g}' for c in law['sections'][0])}"
            if law["sections"]
            else ""
        )
        lines.append(
            f"  {FAMILIES[law['family']]:21} H(1) {law['h1_n_per_m']:8.1f} N/m  H(-1)"
            f" {law['h_nyquist_n_per_m']:8.1f} N/m  {proof}  taps {taps}{sections}"
        )
    if options.world == "any_hand":
        lines.append(
            "  no causal linear law has more than 2b/(T(1 + d)) ="
            f" {row['closed_limit_n_per_m']:.1f} N/m (THEORY.md §20)"
        )
    else:
        lines.append(
            "  H(1) has no bound for a known device: it is |H(-1)| and the number of taps that"
            " limit these"
        )
    found = {law["family"]: law["h1_n_per_m"] or 0.0 for law in row["laws"]}
    if "two_poles" in found:
        best = max(found["one_pole"], found["taps_over_pole"], found["two_poles"])
        lines.append(
            f"  sections buy {100.0 * (best / found['taps'] - 1.0):+.1f} % over free taps, and no"
            f" law more than {100.0 * (row['closed_limit_n_per_m'] / found['taps'] - 1.0):+.1f} %"
        )
    gain = row["fractional_gain"]
    if gain is not None:
        bought = f"{100.0 * (gain - 1.0):+.1f} % over PD" if gain > 1.001 else "nothing over PD"
        lines.append(f"  a fractional term buys {bought}")
    return lines


@styled
def draw_delays(path: Path, rows: Sequence[Mapping[str, Any]], options: DesignOptions) -> Path:
    """Plot H(1) of each family over the delay, with the closed-form limit for any hand."""
    figure = new_figure(6.4, 4.2)
    axes = figure.add_subplot(xlabel="delay of the loop  [ticks]", ylabel="H(1)  [N/m]")
    delays = [row["delay_ticks"][1] for row in rows]
    for family, name in FAMILIES.items():
        felt = [law["h1_n_per_m"] for row in rows for law in row["laws"] if law["family"] == family]
        axes.plot(
            delays, [float("nan") if one is None else one for one in felt], marker="o", label=name
        )
    if options.world == "any_hand":
        axes.plot(
            delays,
            [row["closed_limit_n_per_m"] for row in rows],
            ls="--",
            color="0.4",
            label="2b/(T(1 + d))",
        )
    axes.set(
        title=(f"Stable for {options.world.replace('_', ' ')}, |H(−1)| ≤ {options.nyquist:g} N/m"),
        ylim=(0.0, None),
    )
    axes.grid(alpha=0.3)
    axes.legend()
    return save_figure(figure, path, fresh)
