"""Compare designed laws with fractional solids, passive taps and two rates at one demand."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from messages.errors import UsageError
from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.parameters.options import FileOptions, option, quantity
from nodes.parameters.quantities import Interval, positive
from nodes.recording.figure_style import (
    GREY,
    name_rows,
    new_figure,
    save_figure,
    styled,
    threshold,
)
from nodes.stability.plant import Plant
from sim.measure.jobs import SweepRow
from sim.results import fresh
from sim.studies import device_options as shared
from sim.studies.result import Findings
from sim.studies.sweeps import SweepOptions, swept

ORDERS = (0.3, 0.5, 0.7, 0.9, 1.0)
RELAXATIONS = (0.5, 1.0, 2.0, 4.0)  # relaxation times tried [ticks]
SERVO = 4  # servo ticks per loop tick, with two rates
FAMILIES = (
    "pd",
    "Kelvin-Voigt",
    "Maxwell",
    "standard linear solid",
    "passive FIR",
    "two rates",
    "designed",
)


@dataclass(frozen=True, kw_only=True)
class RelativesOptions(SweepOptions, FileOptions):
    """Options of `relatives`."""

    mass: tuple[float, float] = quantity("mass", Interval(0.05, 0.2))
    taps: int = quantity("taps", 8)
    damping: float = quantity("damping", 1.0)
    delay: float = quantity("delay", 1.0)
    rate: float = quantity("rate", 500.0)
    from_run: Path | None = option(
        type=Path,
        metavar="RECORDING",
        help="take rate and median delay from a recording instead",
    )
    nyquist: float = option(
        default=10000.0, type=positive, help="|H(-1)| allowed [N/m]"
    )
    families: list[str] = option(
        default=list(FAMILIES), nargs="+", choices=FAMILIES, help="which (default: all)"
    )


def tune_family(job: Mapping[str, Any]) -> dict[str, Any]:
    """Tune one family to the demand; return its stiffest law and its required damping."""
    from nodes.stability.effective_damping import damping_needed
    from sim.design.demand import Demand
    from sim.design.families import best_pd, designed
    from sim.design.landing import drops
    from sim.design.passive import stiffest_passive

    period, delay = 1.0 / job["rate"], (job["delay"],) * 2
    lightest, heaviest = job["mass"]
    asked = Demand(
        (lightest, heaviest), job["damping"], delay, period, 0.99, job["nyquist"]
    )
    family = job["family"]
    if family == "two rates":
        return _two_rates(job, period)
    law: CompiledLaw | None = None
    result: dict[str, Any] = {"family": family, "law": None}
    if family == "passive FIR":
        found = stiffest_passive(4, period, job["damping"], delay, job["nyquist"])
        law, result["law"] = (
            CompiledLaw(tuple(found.taps.tolist())),
            {"kind": "fir", "taps": found.taps.tolist()},
        )
    elif family in ("Kelvin-Voigt", "standard linear solid"):
        tuned = _best_solid(asked, job["taps"], family)
        law, result["law"] = (None, None) if tuned is None else tuned
    elif family == "Maxwell":
        # It renders no permanent force: the leak of its truncated response is no wall.
        return result | {"h1_n_per_m": 0.0}
    else:
        one = best_pd(asked) if family == "pd" else designed(asked, 4)
        law, result["law"] = (None if one.found is None else one.found.law), one.law
    if law is None:
        return result | {"h1_n_per_m": None}
    settled = drops(law, asked)
    needed = damping_needed(law, period, delay[0])
    # With a short memory H(1) is K plus the leak of its truncation, felt permanently by a law
    # that should relax.
    nominal = (result["law"] or {}).get("stiffness")
    return result | {
        "h1_n_per_m": law.h1,
        "leak_n_per_m": None if nominal is None else law.h1 - nominal,
        "h_nyquist_n_per_m": law.h_nyquist,
        "radius": _radius(law, asked),
        "damping_needed_n_s_per_m": needed,
        # The programme ends at the device's own damping, to its tolerance.
        "passive": needed <= job["damping"] * (1.0 + 1e-6),
        "at_nyquist_without_delay_n_s_per_m": 0.5 * period * law.h_nyquist,
        "drops_settled": f"{sum(settled.values())} of {len(settled)}",
    }


def _radius(law: Any, asked: Any) -> float:
    from nodes.stability.closed_loop import pole_radius

    return max(
        pole_radius(law, Plant(asked.period, mass, asked.damping, asked.delay[0]))
        for mass in _masses(asked.mass)
    )


def _masses(ends: Sequence[float]) -> list[float]:
    import numpy as np

    found: list[float] = np.geomspace(ends[0], ends[1], 11).tolist()
    return found


def _best_solid(
    asked: Any, taps: int, family: str
) -> tuple[Any, dict[str, Any]] | None:
    """Tune K and B at every order and relaxation time; a Kelvin–Voigt solid has none."""
    from sim.design.families import best_linear

    best: tuple[float, Any, dict[str, Any]] | None = None
    for order in ORDERS:
        for ticks in (0.0,) if family == "Kelvin-Voigt" else RELAXATIONS:
            shape: dict[str, Any] = {
                "kind": "pd_alpha",
                "order": order,
                "taps": max(taps, 2),
                "gains": "physical",
            }
            if ticks:
                shape = {
                    "kind": "fractional_sls",
                    "order": order,
                    "taps": taps,
                    "relaxation": ticks * asked.period,
                }
            tuned = best_linear(family, shape, asked)
            if (
                tuned.found is not None
                and tuned.law is not None
                and (best is None or tuned.found.h1_n_per_m > best[0])
            ):
                best = (
                    tuned.found.h1_n_per_m,
                    parse_law(tuned.law).compile(asked.period),
                    tuned.law,
                )
    return None if best is None else best[1:]


def _two_rates(job: Mapping[str, Any], period: float) -> dict[str, Any]:
    """Tune a bare spring under a servo's damper to the demand.

    It is the stiffest that meets the pole radius at every mass, and the bound on noise.
    """
    import numpy as np

    # The servo applies forces at its own ticks, never before the loop does.
    late = math.ceil(job["delay"] * SERVO - 1e-9)
    # The damper acts on every servo sample: encoder noise is multiplied by K + 2 B_s N/T, as
    # by |H(−1)| in the others.
    noise = 2.0 * SERVO / period
    top = min(0.5 * job["mass"][0] * SERVO / period, job["nyquist"] / noise)
    best = (0.0, 0.0)
    gains = np.geomspace(0.01 * top, top, 24)
    for _ in range(3):
        found = [
            (
                _stiffest_spring(
                    job, period, damper, late, job["nyquist"] - noise * damper
                ),
                damper,
            )
            for damper in gains
        ]
        best = max(best, *found)
        if not best[0]:
            break
        # A finer grid about the best: a third of the spacing on either side.
        step = (gains[1] / gains[0]) ** 0.8
        gains = np.minimum(np.geomspace(best[1] / step, best[1] * step, 7), top)
    stiffness, damper = float(best[0]), float(best[1])
    return {
        "family": "two rates",
        "law": {"stiffness": stiffness, "servo_damping": damper, "ratio": SERVO},
        "delay_ticks": late / SERVO,
        "h1_n_per_m": stiffness or None,
        "h_nyquist_n_per_m": stiffness + noise * damper,
    }


def _stiffest_spring(
    job: Mapping[str, Any], period: float, damper: float, late: int, most: float
) -> float:
    """Return the stiffest spring up to `most` [N/m] that meets the radius; 0 if none does.

    It acts beside a servo's damper.
    """
    import numpy as np

    from sim.stability.two_rate import TwoRate, two_rate_radius

    devices = [
        TwoRate(mass, job["damping"], float(damper), SERVO, late)
        for mass in _masses(job["mass"])
    ]

    def keeps(stiffness: float) -> bool:
        law = CompiledLaw((stiffness,))
        return all(two_rate_radius(law, period, device) <= 0.99 for device in devices)

    low, high = 20.0, min(most, 4.0 * job["mass"][0] / period**2)
    if high <= low:
        return 0.0
    # Too soft a spring creeps home, too stiff a one rings; the radius is met in between or
    # nowhere.
    grid = np.geomspace(low, high, 60).tolist()
    kept = [i for i, stiffness in enumerate(grid) if keeps(stiffness)]
    if not kept:
        return 0.0
    if kept[-1] + 1 == len(grid):
        return float(grid[-1])
    low, high = grid[kept[-1]], grid[kept[-1] + 1]
    for _ in range(20):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if keeps(middle) else (low, middle)
    return float(low)


@dataclass(frozen=True, repr=False, kw_only=True)
class RelativesFound(Findings):
    """The stiffest law of each family at one demand."""

    delay_ticks: float
    rate_hz: float
    rows: list[SweepRow]  # of the ledger, one per family


def relatives(options: RelativesOptions) -> RelativesFound:
    """Tune every family and compare them."""
    if not 2 <= options.taps <= 32:
        raise UsageError(f"--taps {options.taps}: between 2 and 32")
    if not (options.mass[0] > 0.0 and options.damping > 0.0):
        raise UsageError(
            "--mass and --damping must be positive: nothing is passive without damping"
        )
    if options.from_run is not None:
        options.refuse_unused("--from-run tells it", "delay", "rate")
        measured = shared.recorded(options.from_run)
        options = replace(options, rate=1.0 / measured.period, delay=measured.median)
    told = options.chosen("damping", "delay", "rate", "taps", "nyquist")
    jobs = [
        told | {"mass": list(options.mass), "family": family}
        for family in options.families
    ]
    rows, ledger = swept(options, tune_family, jobs, "relatives")
    low, high = options.mass
    lines = [
        (
            f"m {low:g}..{high:g} kg, b {options.damping:g} N s/m, delay {options.delay:.4g}"
            f" ticks at {options.rate:g} Hz, pole radius <= 0.99, |H(-1)| <="
            f" {options.nyquist:g} N/m"
        ),
        (
            f"{'family':22} {'H(1) [N/m]':>10} {'of it leak':>10} {'H(-1)':>9} "
            f" {'passive with b of':>18} {'by ω_N, d = 0':>14}  drops settled"
        ),
        *map(_line, rows),
        (
            f"passive at this delay: those with a b of at most {options.damping:g} N s/m"
            " (THEORY.md §16)"
        ),
    ]
    picture = draw(options.out / "relatives.png", lines[0], options.damping, rows)
    found = RelativesFound(
        lines=lines, delay_ticks=options.delay, rate_hz=options.rate, rows=rows
    )
    return replace(found, ledger=ledger, picture=picture)


def _line(row: Mapping[str, Any]) -> str:
    if not row["h1_n_per_m"]:
        why = (
            "bears nothing for ever: H(1) = 0"
            if row["family"] == "Maxwell"
            else "no law keeps the demand"
        )
        return f"{row['family']:22} {why}"
    if row["family"] == "two rates":
        damping = row["law"]["servo_damping"]
        result = f"a servo's damper of {damping:.3g} N s/m at {SERVO} times the rate"
        late = f"{row['delay_ticks']:g} ticks late; haptic lab two_rate for other rates"
        return (
            f"{row['family']:22} {row['h1_n_per_m']:10.1f} {0.0:10.1f}"
            f" {row['h_nyquist_n_per_m']:9.0f}  {result}, {late}"
        )
    leak = "" if row["leak_n_per_m"] is None else f"{row['leak_n_per_m']:.1f}"
    return (
        f"{row['family']:22} {row['h1_n_per_m']:10.1f} {leak:>10} {row['h_nyquist_n_per_m']:9.0f} "
        f" {row['damping_needed_n_s_per_m']:18.3f}"
        f" {row['at_nyquist_without_delay_n_s_per_m']:14.3f}  {row['drops_settled']}"
    )


@styled
def draw(
    path: Path, demand: str, damping: float, rows: Sequence[Mapping[str, Any]]
) -> Path:
    """Plot the stiffness of each family and its required damping for passivity."""
    figure = new_figure(8.6, 1.6 + 0.32 * len(rows))
    figure.suptitle(demand, fontsize=8.5, x=0.01, ha="left")
    stiffness, passive = figure.subplots(1, 2, sharey=True)
    name_rows(stiffness, [row["family"] for row in rows])
    for at, row in enumerate(rows):
        felt, needed = row["h1_n_per_m"], row.get("damping_needed_n_s_per_m")
        why = "" if felt else "H(1) = 0" if felt == 0.0 else "no law keeps the demand"
        for axes, value, told in (
            (stiffness, felt or None, why),
            (passive, needed, "" if why else "not judged"),
        ):
            if value is None:
                axes.annotate(
                    told,
                    (0.15, at),
                    xycoords=("axes fraction", "data"),
                    fontsize=8,
                    color=GREY,
                    va="center",
                )
                continue
            axes.plot([0.0, value], [at, at], color=GREY, lw=0.8, ls="-")
            axes.plot(value, at, "o", color="C0")
            text = f"{value:.3g}" if value < 100.0 else f"{value:.0f}"
            axes.annotate(
                text,
                (value, at),
                xytext=(6, 0),
                textcoords="offset points",
                fontsize=8,
                va="center",
            )
    stiffness.set(
        xlabel="stiffness felt at rest, H(1)  [N/m]",
        xlim=(0.0, 1.2 * (stiffness.get_xlim()[1] or 1.0)),
    )
    passive.set(
        xlabel="damping with which it is passive  [N s/m]",
        xlim=(0.0, 1.2 * max(damping, passive.get_xlim()[1])),
    )
    threshold(passive, damping, f"the device's, {damping:g} N s/m", vertical=True)
    return save_figure(figure, path, fresh)
