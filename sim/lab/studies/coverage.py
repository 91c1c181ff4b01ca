"""Identify and tune hundreds of random devices; check intervals and laws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.errors import UsageError
from nodes.parameters.options import FileOptions, option, quantity
from nodes.parameters.quantities import COUNT, SECONDS, SEED
from nodes.recording.figure_style import (
    COLOURS,
    INK,
    new_figure,
    save_figure,
    styled,
    threshold,
)
from sim.results import fresh
from sim.studies.result import Findings, at_top
from sim.studies.sweeps import SweepOptions, swept

if TYPE_CHECKING:
    from sim.lab.monte_carlo.outside import OutsidePopulation
    from sim.lab.monte_carlo.study import Population

WANTED = 0.90  # minimum coverage of a 95 % interval


@dataclass(frozen=True, kw_only=True)
class CoverageOptions(SweepOptions, FileOptions):
    """Options of `coverage`."""

    devices: int = option(
        default=200, type=COUNT, help="how many; half are held, but for --outside"
    )
    seconds: float = option(default=8.0, type=SECONDS, help="of each push")
    rate: float = quantity("rate", 500.0)
    seed: int = option(default=1, type=SEED, help="of the population")
    outside: bool = option(
        action="store_true",
        help="devices that are not rigid: joints, lags, backlash and more, kind by kind",
    )
    tune: bool = option(
        action="store_true", help="tune a law for each device too: seconds per device"
    )


@dataclass(frozen=True, repr=False, kw_only=True)
class CoverageFound(Findings):
    """How often the intervals of a population contain the truth, and how good its laws are."""

    found: Population | OutsidePopulation = at_top()


def coverage(options: CoverageOptions) -> CoverageFound:
    """Sweep over the devices."""
    from sim.lab.monte_carlo.study import study_device, summary

    if options.outside:
        return _outside(options)
    told = options.chosen("seed", "seconds", "rate", "tune")
    jobs = [
        {"number": number, "held": number % 2 == 1, **told}
        for number in range(options.devices)
    ]
    rows, ledger = swept(
        options, study_device, jobs, "coverage", 1 if options.tune else 8
    )
    found = summary(rows)
    kept = all(_kept(one.coverage, one.told) for one in found.parameters.values())
    return CoverageFound(
        lines=_text(found),
        held=kept and not (found.tuned and found.tuned.unstable),
        found=found,
        ledger=ledger,
        picture=draw(options.out / "coverage.png", rows),
    )


def _outside(options: CoverageOptions) -> CoverageFound:
    """Sweep over devices that are not rigid."""
    from scipy.stats import binom

    from sim.lab.monte_carlo.outside import study_outside, summary_outside
    from sim.lab.monte_carlo.study import ALLOWED, NEEDLESS
    from sim.lab.monte_carlo.virtual import KINDS

    if options.tune:
        raise UsageError("--tune: not with --outside, where most devices are refused")
    told, kinds = options.chosen("seed", "seconds", "rate"), list(KINDS)
    # All kinds in turn, so that an interrupted study covers each.
    jobs = [
        {"kind": kinds[n % len(kinds)], "number": n // len(kinds), **told}
        for n in range(options.devices)
    ]
    rows, ledger = swept(options, study_outside, jobs, "coverage_outside")
    found = summary_outside(rows)
    lines = [
        f"{'kind':18} {'devices':>7} {'rigid':>6} {'richer':>7} {'reported':>9} {'refused':>8}"
        f" {'needless':>9} {'false':>6} {'named':>6}  intervals missed"
    ]
    for kind, one in found.kinds.items():
        wrong = f"  false: {', '.join(one.false_of)}" if one.false_of else ""
        lines.append(
            f"{kind:18} {one.devices:7d} {one.rigid:6d} {one.richer:7d}"
            f" {one.reported:9d} {one.refused:8d} {one.needless:9d} {one.false:6d}"
            f" {one.named:6d}  {one.missed} of {one.intervals}{wrong}"
        )
    total = found.total
    lines.append(
        f"{total.devices} devices: something false of {total.false}, {total.refused}"
        f" refused, {total.named} named rightly; {total.missed} of {total.intervals} 95 %"
        " intervals miss"
    )
    lines.append(
        f"false certainty {_share(total.false, total.devices)}, at most {ALLOWED:.0%};"
        f" needless refusals {_share(total.needless, total.good)} of the devices whose fit"
        f" has K_max within 1 %, at most {NEEDLESS:.0%}"
    )

    def kept(count: int, of: int, allowed: float) -> bool:
        # More than allowed, beyond chance.
        return count <= allowed * of or bool(binom.sf(count - 1, of, allowed) >= 0.01)

    held = kept(total.false, total.devices, ALLOWED) and kept(
        total.needless, total.good, NEEDLESS
    )
    return CoverageFound(lines=lines, held=held, found=found, ledger=ledger)


def _share(count: int, of: int) -> str:
    return f"{count} of {of} ({count / of:.1%})" if of else "0 of 0"


def _kept(coverage: float | None, devices: int) -> bool:
    """Return whether the coverage is high enough; without devices it is.

    With few devices it may be low by chance, at most one time in a hundred.
    """
    from scipy.stats import binom

    if coverage is None or coverage >= WANTED:
        return True
    return bool(binom.cdf(round(coverage * devices), devices, 0.95) >= 0.01)


def _text(found: Population) -> list[str]:
    lines = [
        (
            f"{found.devices} devices, {found.refused} refused, residual"
            f" {found.residual_steps_median:.3f} encoder steps (rounding: 0.289)"
        ),
        f"{'parameter':10} {'told':>5} {'cannot':>7} {'in 95 %':>8} {'median error':>13}",
    ]
    for name, one in found.parameters.items():
        if one.coverage is not None:
            error = one.median_relative_error
            shown = "—" if error is None else f"{100 * error:.2g} %"
            lines.append(
                f"{name:10} {one.told:5d} {one.cannot_tell:7d} {100 * one.coverage:6.1f} %"
                f" {shown:>13}"
            )
    if (tuned := found.tuned) is not None:
        lines.append(
            f"{tuned.laws} tuned laws, {tuned.unstable} unstable; H(1) of the law for the"
            f" true device: median {100 * tuned.of_known_median:.1f} %, least"
            f" {100 * tuned.of_known_min:.1f} %; of PD tuned alike: median x"
            f" {tuned.of_pd_median:.2f}, least x {tuned.of_pd_min:.2f}"
        )
    return lines


@styled
def draw(path: Path, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Plot estimates against the truth, and errors in units of their own interval."""
    from matplotlib.ticker import NullFormatter

    named = {"mass": "kg", "damping": "N s/m", "friction": "N", "delay": "ticks"}
    figure = new_figure(10.0, 5.0)
    panels = figure.subplots(2, len(named), height_ratios=(1.4, 1.0))
    for column, (name, unit) in enumerate(named.items()):
        top, bottom = panels[0][column], panels[1][column]
        for held, colour, mark in ((False, COLOURS[0], "o"), (True, COLOURS[1], "x")):
            known = [
                row[name]
                for row in rows
                if row["held"] == held and row[name]["value"] is not None
            ]
            if not known:
                continue
            points = [one["truth"] for one in known], [one["value"] for one in known]
            top.plot(
                *points, mark, color=colour, ms=2.5, label="held" if held else "free"
            )
            half = [max(0.5 * (one["high"] - one["low"]), 1e-300) for one in known]
            off = [
                (one["value"] - one["truth"]) / h
                for one, h in zip(known, half, strict=True)
            ]
            bottom.hist(
                off,
                bins=25,
                range=(-2.5, 2.5),
                histtype="step",
                color=colour,
                ls="--" if held else "-",
            )
        ends = top.get_xlim()
        top.plot(ends, ends, color=INK, ls="-", lw=0.5)
        top.set(title=name, xlabel=f"truth  [{unit}]", ylabel=f"identified  [{unit}]")
        if name in ("mass", "damping"):
            top.set(xscale="log", yscale="log")
            for axis in (top.xaxis, top.yaxis):
                axis.set_minor_formatter(NullFormatter())
        bottom.axvspan(-1.0, 1.0, alpha=0.12)
        threshold(bottom, 1.0, "95 %", vertical=True)
        bottom.set(
            xlabel="error over half interval  [1]",
            ylabel="devices" if column == 0 else "",
        )
    panels[0][0].legend()
    return save_figure(figure, path, fresh)
