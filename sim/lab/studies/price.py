"""Compute the stiffness of a law against the uncertainty of joint, hand, mass and world."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from messages.errors import UsageError
from nodes.parameters.options import FileOptions, option, quantity
from nodes.parameters.quantities import not_negative, positive
from nodes.recording.figure_style import BAD, new_figure, save_figure, styled
from sim.measure.jobs import SweepRow
from sim.results import fresh
from sim.studies.device_options import DeviceOptions, refuse_taps
from sim.studies.result import Findings
from sim.studies.sweeps import SweepOptions, swept

# relative uncertainty of the joint's parameters, in either direction [%]
KNOWN = (0.0, 5.0, 20.0, 50.0)
VARIED = ("share", "frequency", "loss")  # parameters of a joint
WORLDS = {
    "any_world": "any world, this rigid device",
    "any_hand": "any hand and any world",
}
LAWS = "price.yaml"


@dataclass(frozen=True, kw_only=True)
class PriceOptions(DeviceOptions, SweepOptions, FileOptions):
    """Options of `price`."""

    delay: float = quantity("delay", 1.2)
    hand: float = quantity("hand", 500.0)
    share: float = option(
        default=0.3, type=positive, help="of the mass behind the joint"
    )
    frequency: float = option(default=40.0, type=positive, help="of the joint [Hz]")
    loss: float = option(default=0.03, type=positive, help="damping ratio of the joint")
    jitter: float = option(
        default=0.2, type=not_negative, help="of the delay, above it [ticks]"
    )
    known: list[float] = option(
        default=list(KNOWN),
        type=not_negative,
        nargs="*",
        help="how far off the joint's numbers may be, as factors [%%] (default: 0 5 20 50)",
    )
    vary: list[str] = option(
        default=list(VARIED),
        nargs="+",
        choices=VARIED,
        help="which of the joint's numbers are off by that, in every combination"
        " (default: all three)",
    )
    land: bool | None = option(
        action="on_off",
        help="only laws that land, certified for every sequence of delays; or only by poles,"
        " in seconds (default: both)",
    )
    taps: int = quantity("taps", 2)


def study_price(job: Mapping[str, Any]) -> dict[str, Any]:
    """Design for the known parameters by poles only, or also for landing and jitter.

    With landing the law is certified for every sequence of the delays.
    """
    from nodes.stability.flexible import FlexiblePlant, flexible_radius
    from sim.design.demand import CONVENTIONS, Demand
    from sim.design.families import certificate, certified, designed
    from sim.design.landing import drops

    period = 1.0 / job["rate"]
    device = (
        (job["mass"] / 1.1, job["mass"] * 1.1),
        job["damping"],
        (job["delay"], job["delay"] + job["jitter"]),
        period,
    )
    joints = () if job["spread"] is None else possible_joints(job)
    lands = CONVENTIONS if job["lands"] else ()
    asked = Demand(
        *device, 0.99, 1e4, stiffness=(0.0, job["hand"]), beyond=joints, lands=lands
    )

    def free(wanted: Demand) -> Any:
        return designed(wanted, job["taps"])

    found = (certified(free, asked) if job["lands"] else free(asked)).found
    if found is None:
        return {
            "h1_n_per_m": None,
            "radius": None,
            "drops_settled": None,
            "certified": None,
            "taps_n_per_m": None,
        }
    truth = (0.0, job["share"], job["frequency"], job["loss"])
    ends = itertools.product(asked.delay, asked.stiffness)
    plants = [
        FlexiblePlant(job["mass"], job["damping"], delay, hand, *truth)
        for delay, hand in ends
    ]
    real = replace(asked, beyond=(truth,))
    settled = drops(found.law, real)
    return {
        "h1_n_per_m": found.h1_n_per_m,
        "radius": max(flexible_radius(found.law, period, plant) for plant in plants),
        "drops_settled": f"{sum(settled.values())} of {len(settled)}",
        "certified": bool(certificate(found.law, real)),
        "taps_n_per_m": found.taps.tolist(),
    }


def possible_joints(
    job: Mapping[str, Any],
) -> tuple[tuple[float, float, float, float], ...]:
    """Return the joints to design for.

    These are the declared joint and all combinations of each varied parameter multiplied or
    divided by the factor.
    """
    spread = job["spread"]
    values = [
        (
            sorted(
                {
                    job[name] / spread,
                    min(job[name] * spread, 0.95)
                    if name == "share"
                    else job[name] * spread,
                }
            )
            if name in job["vary"]
            else [job[name]]
        )
        for name in VARIED
    ]
    declared = tuple(job[name] for name in VARIED)
    return tuple(
        (0.0, *joint) for joint in sorted({declared, *itertools.product(*values)})
    )


def price_of_worlds(options: PriceOptions) -> list[dict[str, Any]]:
    """Design for any world, and for any hand and any world, without the device's joint.

    The second covers every joint: one with its damping on the motor's side is a passive load of
    the motor, as a hand is.
    """
    from sim.design.any_world_families import margin_figures, stiffest_taps
    from sim.design.surroundings import Surroundings

    delay = (options.delay, options.delay + options.jitter)
    rows: list[dict[str, Any]] = []
    for world, mass in (
        ("any_world", (options.mass / 1.1, options.mass * 1.1)),
        ("any_hand", None),
    ):
        surroundings = Surroundings(
            1.0 / options.rate, options.damping, delay, 1e4, mass
        )
        design = stiffest_taps(surroundings, options.taps).design
        rows.append(
            {"world": world, "h1_n_per_m": None}
            if design is None
            else {"world": world, **margin_figures(design, surroundings.period)}
        )
    return rows


@dataclass(frozen=True, repr=False, kw_only=True)
class PriceFound(Findings):
    """H(1) of laws designed with less and less knowledge."""

    rows: list[SweepRow]  # job and figures, as in the ledger
    worlds: list[dict[str, Any]]  # figures of the laws for any world, and for any hand
    yaml: Path | None  # of all laws; None without a law


def price(options: PriceOptions) -> PriceFound:
    """Design with less and less knowledge."""
    refuse_taps(options.taps)
    if options.share >= 1.0:
        raise UsageError(
            f"--share {options.share:g}: expected a part of the mass, below 1"
        )
    device = options.chosen(
        "mass", "damping", "delay", "jitter", *VARIED, "taps", "rate", "vary"
    )
    jobs: list[dict[str, Any]] = [
        {**device, "hand": hand, "spread": spread, "lands": lands}
        for lands in ((False, True) if options.land is None else (options.land,))
        for hand in sorted({0.0, options.hand})
        for spread in (None, *(1.0 + off / 100.0 for off in sorted(set(options.known))))
    ]
    rows, ledger = swept(options, study_price, jobs, "price")
    priced = [{**job, **row} for job, row in zip(jobs, rows, strict=True)]
    lines = [
        (
            f"{options.mass:g} kg, joint of {options.frequency:g} Hz with"
            f" {100 * options.share:g} % of it, delay {options.delay:g} to"
            f" {options.delay + options.jitter:g} ticks, {options.taps} taps, pole radius at"
            " most 0.99"
        ),
        f"{'known':22} {'hand':24} {'asked':22} {'H(1) [N/m]':>10}  on the device",
        *map(_line, priced),
    ]
    worlds = price_of_worlds(options) if options.damping > 0.0 else []
    lines += (
        ["the world unknown, the joint left out:", *map(_world_line, worlds)]
        if worlds
        else []
    )
    laws = write_laws(options.out / LAWS, [*priced, *worlds], 1.0 / options.rate)
    lines += (
        []
        if laws is None
        else [f"haptic param load coupling {laws}   # then: haptic law switch NAME"]
    )
    picture = draw(options.out / "price.png", priced)
    found = PriceFound(lines=lines, rows=priced, worlds=worlds, yaml=laws)
    return replace(found, ledger=ledger, picture=picture)


def _name(row: Mapping[str, Any]) -> str:
    """Return the name of a row's law: letters, digits, - and _."""
    if "world" in row:
        return str(row["world"])
    known = (
        "rigid"
        if row["spread"] is None
        else f"joint_{100.0 * (row['spread'] - 1.0):.0f}"
    )
    return f"{known}_{'lands' if row['lands'] else 'poles'}_{'hands' if row['hand'] else 'free'}"


def write_laws(
    path: Path, rows: Sequence[Mapping[str, Any]], period: float
) -> Path | None:
    """Write all named laws for `haptic param load`; return the path, or None if no law."""
    from nodes.parameters.yaml_io import write_yaml

    laws = {
        _name(row): {"kind": "fir", "taps": row["taps_n_per_m"], "period": period}
        for row in rows
        if row.get("taps_n_per_m")
    }
    if not laws:
        return None
    written = fresh(path)
    written.write_text(write_yaml({"coupling": {"laws": laws}}), encoding="utf-8")
    return written


def _world_line(row: Mapping[str, Any]) -> str:
    start = f"{WORLDS[row['world']]:70}"
    if row["h1_n_per_m"] is None:
        return f"{start} {'no law':>10}"
    proof = "proven at every frequency" if row["proven"] else "not proven"
    return f"{start} {row['h1_n_per_m']:10.5g}  {proof}; {_taps(row)}"


def _taps(row: Mapping[str, Any]) -> str:
    taps = row.get("taps_n_per_m")
    return (
        "taps " + ", ".join(f"{tap:.6g}" for tap in taps)
        if taps
        else "taps not recorded"
    )


def _line(row: Mapping[str, Any]) -> str:
    known = (
        "believed rigid"
        if row["spread"] is None
        else f"joint to {100 * (row['spread'] - 1):.0f} %"
    )
    asked = "lands, every sequence" if row["lands"] else "poles alone"
    start = f"{known:22} {_held(row['hand']):24} {asked:22}"
    if row["h1_n_per_m"] is None:
        return f"{start} {'no law':>10}"
    verdict = (
        "stable"
        if row["radius"] < 1.0
        else f"UNSTABLE, pole radius {row['radius']:.3f}"
    )
    proof = "" if row["certified"] else ", NOT certified for every sequence of delays"
    return (
        f"{start} {row['h1_n_per_m']:10.5g}  {verdict}, {row['drops_settled']} drops settle{proof};"
        f" {_taps(row)}"
    )


def _held(hand: float) -> str:
    return "no hand" if hand == 0.0 else f"hands of 0 to {hand:g} N/m"


@styled
def draw(path: Path, rows: Sequence[Mapping[str, Any]]) -> Path:
    """Plot H(1) against the knowledge of the joint."""
    figure = new_figure(7.0, 4.0)
    axes = figure.subplots()
    for lands, hand in sorted({(row["lands"], row["hand"]) for row in rows}):
        known = [
            row
            for row in rows
            if (row["lands"], row["hand"]) == (lands, hand)
            and row["spread"] is not None
        ]
        felt = [
            math.nan if row["h1_n_per_m"] is None else row["h1_n_per_m"]
            for row in known
        ]
        look: Any = {"marker": "o" if hand == 0.0 else "s", "ls": "-" if lands else ":"}
        label = f"{_held(hand)}, {'lands, every sequence of delays' if lands else 'poles alone'}"
        axes.plot(
            [100.0 * (row["spread"] - 1.0) for row in known], felt, label=label, **look
        )
    none = [
        100.0 * (row["spread"] - 1.0)
        for row in rows
        if row["spread"] is not None and row["h1_n_per_m"] is None
    ]
    if none:
        axes.plot(
            none,
            [0.0] * len(none),
            marker="x",
            ls="",
            color=BAD,
            clip_on=False,
            label="no law found",
        )
    axes.set(
        xlabel=f"{', '.join(rows[0]['vary'])} of the joint known to ± [%]",
        ylabel="H(1) of the designed law [N/m]",
        ylim=(0.0, None),
    )
    axes.grid(alpha=0.3)
    axes.legend()
    return save_figure(figure, path, fresh)
