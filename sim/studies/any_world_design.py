"""`haptic study design --for any_hand | any_world`: stiffest law of each family."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from messages.errors import UsageError
from nodes.recording.figure_style import new_figure, save_figure, styled
from sim.design.any_world_families import (
    FELT_AT,
    Member,
    felt_stiffness,
    fractional_gain,
    margin_figures,
    stiffest_members,
    stiffness,
)
from sim.design.surroundings import Surroundings
from sim.results import fresh
from sim.studies.design_options import DesignOptions
from sim.studies.result import Findings

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


@dataclass(frozen=True)
class WorldCase:
    """Stiffest law of each family at one delay."""

    world: str  # any_hand or any_world
    delay_ticks: tuple[float, float]
    rate_hz: float
    damping_n_s_per_m: float
    mass_kg: tuple[float, float] | None  # None: any hand, so any mass
    h_nyquist_limit_n_per_m: float
    members: Sequence[Member]

    @property
    def closed_limit_n_per_m(self) -> float:
        """2b/(T(1 + d)): no causal linear law for any hand has more."""
        return 2.0 * self.damping_n_s_per_m * self.rate_hz / (1.0 + self.delay_ticks[1])

    def felt(self, family: str) -> float | None:
        """Return H(1) of a family [N/m]; None without a law."""
        found = next((one for one in self.members if one.family == family), None)
        return (
            None if found is None or found.design is None else found.design.h1_n_per_m
        )

    def moved(self, member: Member) -> float:
        """Return the stiffness that a motion of `FELT_AT` meets [N/m]; 0 without a law."""
        if member.design is None:
            return 0.0
        return felt_stiffness(member.design.law, 1.0 / self.rate_hz)

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name."""
        figures = {
            name: one for name, one in vars(self).items() if name not in _NAMED_ABOVE
        }
        laws = [
            {"family": one.family, "law": one.law}
            | (
                {"h1_n_per_m": None}
                if one.design is None
                else margin_figures(one.design, 1.0 / self.rate_hz)
            )
            for one in self.members
        ]
        return figures | {
            "closed_limit_n_per_m": self.closed_limit_n_per_m,
            "laws": laws,
            "fractional_gain": fractional_gain(list(self.members)),
        }

    @property
    def lines(self) -> list[str]:
        """The figures as lines."""
        (low, high), mass = self.delay_ticks, self.mass_kg
        device = "" if mass is None else f"m {mass[0]:g}..{mass[1]:g} kg, "
        lines = [
            f"stable for {WORDS[self.world]}: {device}b {self.damping_n_s_per_m:g} N s/m, delay"
            f" {low:g}..{high:g} ticks at {self.rate_hz:g} Hz, |H(-1)| <="
            f" {self.h_nyquist_limit_n_per_m:g} N/m",
            *map(_member_line, self.members),
        ]
        lines.append(
            "  no causal linear law has more than 2b/(T(1 + d)) ="
            f" {self.closed_limit_n_per_m:.1f} N/m (THEORY.md §20)"
            if self.world == "any_hand"
            else "  H(1) has no bound for a known device: it is |H(-1)| and the number of taps that"
            " limit these"
        )
        if any(one.family == "two_poles" for one in self.members):
            lines.append(self._bought())
        if (gain := fractional_gain(list(self.members))) is not None:
            bought = (
                f"{100.0 * (gain - 1.0):+.1f} % over PD"
                if gain > 1.001
                else "nothing over PD"
            )
            lines.append(f"  a fractional term buys {bought}")
        return lines

    def _bought(self) -> str:
        """Return what sections buy over free taps."""
        if self.world == "any_world":
            moved = {one.family: self.moved(one) for one in self.members}
            best, taps = max(moved[name] for name in _BEHIND), moved["taps"] or math.nan
            return (
                "  a slow pole buys static stiffness without bound, which a held push meets only"
                f" after the pole's own time; at {FELT_AT:g} Hz sections buy"
                f" {100.0 * (best / taps - 1.0):+.1f} % over free taps (Re H {best:.1f} and"
                f" {taps:.1f} N/m; THEORY.md §20)"
            )
        best, taps = (
            max(self.felt(one) or 0.0 for one in _BEHIND),
            self.felt("taps") or math.nan,
        )
        return (
            f"  sections buy {100.0 * (best / taps - 1.0):+.1f} % over free taps, and no"
            f" law more than {100.0 * (self.closed_limit_n_per_m / taps - 1.0):+.1f} %"
        )


_BEHIND = ("one_pole", "taps_over_pole", "two_poles")
_NAMED_ABOVE = ("world", "members")


def _member_line(one: Member) -> str:
    if one.design is None:
        return f"  {FAMILIES[one.family]:21} none"
    found = one.design
    proof = (
        "proven at every frequency"
        if found.proven
        else "NOT proven between the frequencies"
    )
    taps = ", ".join(f"{tap:.6g}" for tap in found.law.taps)
    sections = "".join(
        f"; section {', '.join(f'{c:.6g}' for c in section)}"
        for section in found.law.sections[:1]
    )
    return (
        f"  {FAMILIES[one.family]:21} H(1) {found.h1_n_per_m:8.1f} N/m  H(-1)"
        f" {found.h_nyquist_n_per_m:8.1f} N/m  {proof}  taps {taps}{sections}"
    )


@dataclass(frozen=True, repr=False, kw_only=True)
class StiffestForWorld(Findings):
    """Stiffest laws for any hand or any world: at one delay, or compared over several."""

    world: str
    cases: Sequence[WorldCase]
    yaml: Path | None = None  # of the stiffest; None: no law, or several delays

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name, those of a single delay at the top level."""
        figures = super().answer
        world, cases, yaml = (figures.pop(name) for name in ("world", "cases", "yaml"))
        several = self.picture is not None
        rest = {"cases": cases} if several else cases[0] | {"yaml": yaml}
        return {"for": world} | rest | figures


def run(options: DesignOptions) -> StiffestForWorld:
    """Design at one delay, or compare the families over several delays."""
    world = options.world
    if options.sections and world == "wall":
        raise UsageError("--sections: with --for any_hand or any_world")
    if options.compare:
        cases = [_case(options, (delay, delay)) for delay in options.delays]
        lines = [line for case in cases for line in case.lines]
        plot = draw_delays(options.out / f"design_{world}.png", cases, options)
        return StiffestForWorld(lines=lines, world=world, cases=cases, picture=plot)
    case = _case(options, options.delay or (1.0, 1.0))
    # With sections H(1) has no bound for a known device.
    slow = world == "any_world" and options.sections
    best = max(case.members, key=case.moved if slow else stiffness)
    if best.law is None:
        lines = [*case.lines, "no law of these families is stable for every world"]
        return StiffestForWorld(lines=lines, held=False, world=world, cases=[case])
    from sim.design.families import to_yaml

    path = fresh(options.out / f"{world}.yaml")
    path.write_text(to_yaml(best.law, world, comment=case.lines[0]), encoding="utf-8")
    lines = [*case.lines, f"haptic param load coupling {path}"]
    return StiffestForWorld(lines=lines, world=world, cases=[case], yaml=path)


def _case(options: DesignOptions, delay: tuple[float, float]) -> WorldCase:
    mass, rate = (
        options.mass if options.world == "any_world" else None,
        options.rate or 500.0,
    )
    try:
        surroundings = Surroundings(
            1.0 / rate, options.damping[0], delay, options.nyquist, mass
        )
    except ValueError as error:
        raise UsageError(f"--{error}") from error
    members, step = [], options.progress(len(FAMILIES))
    for member in stiffest_members(surroundings, options.taps, options.sections):
        step(f"{FAMILIES[member.family]}, delay {delay[1]:g}", 1)
        members.append(member)
    device = (rate, options.damping[0], mass, options.nyquist)
    return WorldCase(options.world, delay, *device, members)


@styled
def draw_delays(path: Path, cases: Sequence[WorldCase], options: DesignOptions) -> Path:
    """Plot H(1) of each family over the delay, with the closed-form limit for any hand."""
    figure = new_figure(6.4, 4.2)
    axes = figure.add_subplot(xlabel="delay of the loop  [ticks]", ylabel="H(1)  [N/m]")
    delays = [case.delay_ticks[1] for case in cases]
    for family, name in FAMILIES.items():
        found = [case.felt(family) for case in cases]
        felt = [math.nan if one is None else one for one in found]
        if any(one.family == family for one in cases[0].members):
            axes.plot(delays, felt, marker="o", label=name)
    if options.world == "any_hand":
        axes.plot(
            delays,
            [case.closed_limit_n_per_m for case in cases],
            ls="--",
            color="0.4",
            label="2b/(T(1 + d))",
        )
    axes.set(
        title=(
            f"Stable for {options.world.replace('_', ' ')}, |H(−1)| ≤ {options.nyquist:g} N/m"
        ),
        ylim=(0.0, None),
    )
    axes.grid(alpha=0.3)
    axes.legend()
    return save_figure(figure, path, fresh)
