"""Design a law for a device and delay: the stiffest over a mass range, and a passive one."""

import itertools
import math
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from messages.errors import UsageError
from nodes.laws import CompiledLaw
from nodes.recording.figure_style import (
    OMEGA,
    PAGE_WIDTH,
    new_figure,
    save_figure,
    styled,
    threshold,
)
from nodes.stability.closed_loop import pole_radius
from nodes.stability.effective_damping import effective_damping
from nodes.stability.plant import Plant
from nodes.stability.rest import rest
from sim.axes import plain_log
from sim.design.demand import CONVENTIONS, Demand, Robust
from sim.design.families import (
    Tuned,
    best_pd,
    certificate,
    certified,
    compare,
    designed,
    fir,
    latest_delay,
    to_yaml,
)
from sim.design.hands import judge_grasps
from sim.design.landing import best_pd_windowed, drops, prove_over
from sim.design.passive import Passive, certain_damping, stiffest_passive
from sim.design.recorded_loop import Measured, replayed_radius
from sim.experiments.rest_map import rest_map
from sim.experiments.terms import RESOLUTION
from sim.results import fresh
from sim.studies import any_world_design as any_world
from sim.studies import device_options as shared
from sim.studies.design_options import DesignOptions
from sim.studies.law_looks import law_looks
from sim.studies.result import Answer, answered
from sim.studies.sweeps import SPREAD, spread

# replayed ticks of a recording, enough for a decay of 0.99 per tick to reach rounding
_REPLAYED = 2000


def design(options: DesignOptions) -> Answer:
    """Design a law, or compare families of laws."""
    if not 1 <= options.taps <= 12:
        raise UsageError(
            f"--taps {options.taps}: between 1 and 12; the search is over each of them"
        )
    if options.compare and options.taps < 2:
        raise UsageError(f"--taps {options.taps} --compare: PD and PDα have at least 2 taps")
    if options.every_delay and options.compare:
        raise UsageError("--every-delay: of one design, not of --compare")
    if options.radius > 1.0:
        raise UsageError(f"--radius {options.radius:g}: above 1 is unstable")
    if options.world != "wall":
        unused = (
            "hand",
            "grasp",
            "radius",
            "from_run",
            "effort",
            "every_delay",
            "resolution",
            "friction",
            "margins",
            *SPREAD,
        )
        options.refuse_unused(f"--for {options.world} is a condition on frequencies", *unused)
        if options.compare:
            options.refuse_unused("--compare takes --delays", "delay")
        return any_world.run(options)
    if not options.mass[0] > 0.0:
        raise UsageError(f"--mass {options.mass[0]:g}..{options.mass[1]:g}: must be positive")
    if options.compare:
        options.refuse_unused(
            "--compare takes --delays and --margins, and --rate",
            "delay",
            "from_run",
            "effort",
            "grasp",
        )
    else:
        options.refuse_unused("it is of --compare", "delays", "margins", *SPREAD)
    demand, measured = _demand(options)
    return _compare(options, demand) if options.compare else _design(options, demand, measured)


def _demand(options: DesignOptions) -> tuple[Demand, Measured | None]:
    rate, delay = options.rate or 500.0, options.delay or (1.0, 1.0)
    run = None
    if options.from_run is not None:
        run = shared.recorded(options.from_run)
        rate, delay = options.rate or 1.0 / run.period, options.delay or run.delay
    nyquist = options.nyquist
    if (options.friction is None) != (options.resolution is None):
        raise UsageError("--friction, --resolution: rest takes both, or neither")
    if options.friction is not None and options.resolution is not None:
        nyquist = min(nyquist, 2.0 * options.friction / options.resolution)
    least, most = options.damping
    device = (options.mass, least, delay, 1.0 / rate, options.radius, nyquist)
    lands = CONVENTIONS if options.land else ()
    widest = most if most > least else None
    return Demand(*device, damping_max=widest, stiffness=options.hand, lands=lands), run


def _wanted(demand: Demand) -> dict[str, Any]:
    return {
        "mass_kg": list(demand.mass),
        "damping_n_s_per_m": demand.damping,
        "damping_max_n_s_per_m": demand.damping_max,
        "delay_ticks": list(demand.delay),
        "rate_hz": 1.0 / demand.period,
        "radius_limit": demand.radius,
        "h_nyquist_limit_n_per_m": demand.nyquist,
        "hand_n_per_m": list(demand.stiffness),
        "lands": bool(demand.lands),
    }


def _design(options: DesignOptions, demand: Demand, measured: Measured | None) -> Answer:
    step = options.progress(3)

    def free(wanted: Demand) -> Tuned:
        return designed(wanted, options.taps, options.effort)

    try:
        law = certified(free, demand) if options.every_delay else free(demand)
    except ValueError as error:
        raise UsageError(f"--every-delay: {error}") from error
    step(f"{options.taps} free taps", 1)
    pd = best_pd(demand)
    step("PD, to compare", 1)
    passive = None
    if demand.damping > 0.0:
        passive = stiffest_passive(
            options.taps, demand.period, demand.damping, demand.delay, demand.nyquist
        )
    figures: dict[str, Any] = {
        "demand": _wanted(demand),
        "designed": None,
        "passive": None,
        "best_pd": _row(pd, demand),
    }
    lines = [_describe(demand)]
    if measured is not None and options.from_run is not None:
        figures |= _replayed(options.from_run, demand, law, measured)
        lines.append(
            f"recorded delay {measured.median:.4g} ticks, jitter {measured.jitter:.4g} ticks,"
            f" {measured.unanswered} of {len(measured.delays)} ticks not answered in time; pole"
            f" radius when the first {_REPLAYED} are replayed one by one:"
            f" {figures['replayed_radius']}"
        )
    if law.found is not None and law.law is not None:
        result, said = _designed(options, demand, law, pd)
        plot = _draw(options.out / "design.png", demand, law, pd, passive)
        figures |= {"designed": result, "plot": str(plot)}
        if not result["lands"]:
            lines[:0] = [
                "This law does NOT survive a landing: a drop on a floor does not settle; without"
                " --no-land it would"
            ]
        lines += [*said, str(plot)]
        if options.grasp is not None:
            judged = judge_grasps(law.found.law, demand, options.grasp)
            result["grasp"] = asdict(judged)
            lines.append(f"{'':13}  {judged.text()}")
        if options.friction is not None and options.resolution is not None:
            sensed = options.resolution, options.friction
            lines += _at_rest(*sensed, options.out / "design_rest.png", law.found, demand, result)
    else:
        lines.append(
            "no law of this length keeps the demand: allow a larger radius, a narrower range, more"
            " taps or --no-land"
        )
    if passive is not None:
        figures["passive"] = _passive_row(passive, demand, options.out)
        lines.append(_passive_line(passive, demand, figures["passive"]))
    return answered(figures, lines, held=law.found is not None)


def _designed(
    options: DesignOptions, demand: Demand, law: Tuned, pd: Tuned
) -> tuple[dict[str, Any], list[str]]:
    """Write the designed law to a file; return its figures and lines."""
    assert law.found is not None  # noqa: S101  # checked by the caller
    assert law.law is not None  # noqa: S101  # checked by the caller
    path = fresh(options.out / "designed.yaml")
    lands = all(drops(law.found.law, demand).values())
    every, landing = certificate(law.found.law, demand), prove_over(law.found.law, demand)
    result = _row(law, demand) | {"yaml": str(path), "lands": lands, "every_delay": every}
    result["landing_proof"] = asdict(landing)
    comment = "\n".join(
        [_describe(demand), *([] if lands else ["it does NOT survive a landing"]), landing.text()]
    )
    path.write_text(to_yaml(law.law, comment=comment), encoding="utf-8")
    proofs: dict[Any, str] = {True: "certified", False: "NOT stable", None: "not decided"}
    proof = proofs.get(every, "the range is wider than a tick")
    return result, [
        _line(result),
        f"{'':13}  every sequence of these delays, five masses: {proof} (THEORY.md §10)",
        f"{'':13}  {landing.text()} (THEORY.md §19)",
        _line(_row(pd, demand)),
        f"haptic param load coupling {path}",
    ]


def _at_rest(
    resolution: float,
    friction: float,
    path: Path,
    found: Robust,
    demand: Demand,
    figures: dict[str, Any],
) -> list[str]:
    """Write the friction that the law needs, and plot a map of its K.

    The device is the heaviest and least damped of the range.
    """
    device = Plant(
        demand.period, demand.mass[1], demand.damping, demand.delay[1], demand.stiffness[0]
    )
    # The proof requires a law that is passive at every delay of the range.
    passive = certain_damping(found.taps, demand.period, *demand.delay) <= demand.damping
    needed = replace(rest(found.law, device, resolution), certain=passive)
    free = needed.free(friction)
    drawn = rest_map(found.law, found.h1_n_per_m, device, resolution, friction, path)
    figures["rest"] = asdict(needed) | {"map": drawn, "limit_cycle_free": free}
    stops = "stops" if free is True else "need not stop"
    return [f"with {friction:g} N a motion {stops}: {needed.text()}", str(path)]


def _replayed(path: Path, demand: Demand, law: Tuned, measured: Measured) -> dict[str, Any]:
    """Replay the recorded delays with the lightest and the heaviest device.

    Jitter is not equivalent to a constant delay.
    """
    worst = math.inf
    if law.found is not None:
        devices = [
            Plant(demand.period, m, demand.damping, 0.0, hand)
            for m in demand.mass
            for hand in demand.stiffness
        ]
        worst = max(
            replayed_radius(law.found.law, device, measured.delays[:_REPLAYED])
            for device in devices
        )
    return {
        "from_run": str(path),
        "delay_median_ticks": measured.median,
        "jitter_ticks": measured.jitter,
        "unanswered_ticks": measured.unanswered,
        "replayed_radius": worst if math.isfinite(worst) else None,
    }


def _describe(demand: Demand) -> str:
    mass, delay = demand.mass, demand.delay
    return (
        f"m {mass[0]:g}..{mass[1]:g} kg, b {_span(demand.dampings)} N s/m, delay"
        f" {delay[0]:.4g}..{delay[1]:.4g} ticks at {1.0 / demand.period:g} Hz, pole radius <="
        f" {demand.radius:g}, |H(-1)| <= {demand.nyquist:g} N/m, hand"
        f" {demand.stiffness[0]:g}..{demand.stiffness[1]:g} N/m"
    )


def _span(ends: tuple[float, float]) -> str:
    return f"{ends[0]:g}" if ends[0] == ends[1] else f"{ends[0]:g}..{ends[1]:g}"


def _row(tuned: Tuned, demand: Demand) -> dict[str, Any]:
    if tuned.found is None:
        return {"family": tuned.family, "law": None, "h1_n_per_m": None}
    found = tuned.found
    return {
        "family": tuned.family,
        "law": tuned.law,
        "taps_n_per_m": found.taps.tolist(),
        "h1_n_per_m": found.h1_n_per_m,
        "h_nyquist_n_per_m": found.h_nyquist_n_per_m,
        "pole_radius": found.radius,
        "worst_mass_kg": found.worst[0],
        "stable_up_to_delay_ticks": latest_delay(found.law, demand),
        "drops_settled": drops(found.law, demand),
    }


def _passive_row(passive: Passive, demand: Demand, out: Path) -> dict[str, Any]:
    """Write the passive law to a file; return its figures."""
    path = fresh(out / "passive.yaml")
    comment = f"passive for any mass and hand: {_describe(demand)}"
    path.write_text(
        to_yaml(fir(passive.taps, demand.period), "passive", comment=comment), encoding="utf-8"
    )
    law = CompiledLaw(tuple(passive.taps.tolist()))
    loops = itertools.product(demand.mass, demand.delay, demand.stiffness)
    radius = max(
        pole_radius(law, Plant(demand.period, mass, demand.damping, delay, hand))
        for mass, delay, hand in loops
    )
    figures = asdict(passive)
    return {
        "pole_radius": radius,
        "taps_n_per_m": figures.pop("taps").tolist(),
        **figures,
        "yaml": str(path),
    }


def _passive_line(passive: Passive, demand: Demand, row: dict[str, Any]) -> str:
    return (
        f"passive        H(1) {passive.h1_n_per_m:9.2f} N/m  H(-1) {passive.h_nyquist_n_per_m:9.1f}"
        f" N/m  radius {row['pole_radius']:.6f}  K T/b {passive.ratio:.4f} (bound"
        f" {passive.bound_n_per_m * demand.period / demand.damping:.4f})  {row['yaml']}"
    )


def _line(row: dict[str, Any]) -> str:
    if row["law"] is None:
        return f"{row['family']:13}  keeps the demand with no stiffness at all"
    limit, dropped = row["stable_up_to_delay_ticks"], row["drops_settled"]
    tuning = ", ".join(
        f"{key} {row['law'][key]:.5g}"
        for key in ("stiffness", "damping", "order")
        if key in row["law"]
    )
    return (
        f"{row['family']:13}  H(1) {row['h1_n_per_m']:9.2f} N/m  H(-1)"
        f" {row['h_nyquist_n_per_m']:9.1f} N/m  radius {row['pole_radius']:.6f}  stable up to"
        f" {'100 ticks, and on' if limit is None else f'{limit:.3f} ticks'}  drops settled"
        f" {sum(dropped.values())}/{len(dropped)} "
        f" {tuning or 'taps ' + ', '.join(f'{tap:.6g}' for tap in row['taps_n_per_m'])}"
    )


def _compare(options: DesignOptions, demand: Demand) -> Answer:
    rows, lines = [], []
    cases = [
        replace(demand, delay=(delay, delay + margin))
        for margin in options.margins
        for delay in options.delays
    ]
    jobs = [partial(_tuned, case, options.taps, options.resolution or RESOLUTION) for case in cases]
    done = spread(options, jobs)
    for case, (laws, windowed) in zip(cases, done, strict=True):
        lines += [_describe(case), *(f"  {_line(law)}" for law in laws)]
        rows.append(_verdict(case, laws, lines) | {"pd_windowed": windowed})
        tuned = (
            "no stiffness"
            if windowed is None
            else "K {stiffness:.0f} N/m, B {damping:.3g} N s/m".format(**windowed)
        )
        lines.append(
            f"  pd_windowed has no poles, so no radius: {tuned} by its drops alone, all of which"
            " settle"
        )
    return answered({"demand": _wanted(demand), "cases": rows}, lines)


def _tuned(
    case: Demand, taps: int, resolution: float
) -> tuple[list[dict[str, Any]], dict[str, Any] | None]:
    """Tune every law to one specification, and PD with a windowed velocity by its drops."""
    laws = [_row(one, case) for one in compare(case, taps)]
    return laws, best_pd_windowed(case, resolution)


def _verdict(demand: Demand, laws: list[dict[str, Any]], lines: list[str]) -> dict[str, Any]:
    known = {law["family"]: law["h1_n_per_m"] for law in laws if law["h1_n_per_m"] is not None}
    mine = known.pop("designed", None)
    rival = max(known, key=lambda family: known[family]) if known else None
    gain = None if mine is None or rival is None else mine / known[rival]
    if gain is None:
        lines.append(
            "  nothing to compare: "
            + ("only the designed law keeps the demand" if mine else "no law does")
        )
    else:
        # A search for laws that survive landing ends on a ragged limit.
        verb = "stiffer than" if gain > 1.005 else "no stiffer than"
        lines.append(f"  designed is {verb} the best of the others ({rival}): x {gain:.3f}")
    return {"demand": _wanted(demand), "laws": laws, "best_other": rival, "gain": gain}


@styled
def _draw(path: Path, demand: Demand, law: Tuned, pd: Tuned, passive: Passive | None) -> Path:
    named = [(one.family, one.found.taps) for one in (law, pd) if one.found is not None]
    if passive is not None:
        named.append(("passive", passive.taps))
    figure = new_figure(PAGE_WIDTH, 3.4)
    left, right = figure.subplots(1, 2)
    masses = np.geomspace(0.5 * demand.mass[0], 2.0 * demand.mass[1], 121)
    theta = np.linspace(0.0, np.pi, 401)
    whole = round(demand.delay[1])
    looks = law_looks([name for name, _ in named])
    for (name, taps), look in zip(named, looks, strict=True):
        compiled = CompiledLaw(tuple(taps.tolist()))
        device, hands = (
            Plant(demand.period, demand.mass[0], demand.damping, demand.delay[1]),
            set(demand.stiffness),
        )
        radii = [
            max(pole_radius(compiled, replace(device, mass=m, stiffness=k)) for k in hands)
            for m in masses.tolist()
        ]
        label = f"{name}, H(1) = {compiled.h1:.0f} N/m"
        left.semilogx(masses, radii, **look.curve(), label=label)
        needed = 0.5 * demand.period * compiled.h1 + effective_damping(
            compiled, demand.period, theta / demand.period, whole
        )
        right.plot(theta / np.pi, needed, **look.curve(), label=label)
    plain_log(left.xaxis, float(masses[0]), float(masses[-1]))
    threshold(left, demand.radius, f"{demand.radius:g}: demanded at most")
    left.axvspan(*demand.mass, alpha=0.1, lw=0)
    left.set(
        xlabel="mass  [kg]",
        ylabel="pole radius  [1]",
        title=f"loop with a delay of {demand.delay[1]:.3g} T",
    )
    threshold(right, demand.damping, f"b = {demand.damping:g} N s/m of the device")
    right.set(
        xlabel=OMEGA, ylabel="damping needed  [N s/m]", title=f"passivity at a delay of {whole} T"
    )
    left.legend()
    return save_figure(figure, path, fresh)
