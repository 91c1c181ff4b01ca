"""Design a law for a device and delay: the stiffest over a mass range, and a passive one."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace
from functools import partial
from pathlib import Path

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
    to_yaml,
)
from sim.design.hands import judge_grasps
from sim.design.landing import best_pd_windowed, drops, prove_over
from sim.design.passive import Passive, certain_damping, stiffest_passive
from sim.design.recorded_loop import Measured, replayed_radius
from sim.experiments.rest_map import RestFound, rest_map
from sim.experiments.terms import RESOLUTION
from sim.results import fresh
from sim.stability.every_delay import Certificate
from sim.stability.rest import ComesToRest, rest
from sim.studies import any_world_design as any_world
from sim.studies import device_options as shared
from sim.studies.design_found import (
    Compared,
    ComparedFound,
    DesignedLaw,
    DesignFound,
    Judged,
    PassiveLaw,
    Replayed,
    describe,
)
from sim.studies.design_options import DesignOptions
from sim.studies.law_looks import law_looks
from sim.studies.result import StudyResult
from sim.studies.sweeps import SPREAD, spread

# replayed ticks of a recording, enough for a decay of 0.99 per tick to reach rounding
_REPLAYED = 2000


def design(options: DesignOptions) -> StudyResult:
    """Design a law, or compare families of laws."""
    shared.refuse_taps(options.taps)
    if options.compare and options.taps < 2:
        raise UsageError(
            f"--taps {options.taps} --compare: PD and PDα have at least 2 taps"
        )
    if options.every_delay and options.compare:
        raise UsageError("--every-delay: of one design, not of --compare")
    if options.radius > 1.0:
        raise UsageError(f"--radius {options.radius:g}: above 1 is unstable")
    if options.world != "wall":
        why = f"--for {options.world} is a condition on frequencies"
        options.refuse_unused(
            why, "hand", "grasp", "radius", "from_run", "effort", "every_delay"
        )
        options.refuse_unused(why, "resolution", "friction", "margins", *SPREAD)
        if options.compare:
            options.refuse_unused("--compare takes --delays", "delay")
        return any_world.run(options)
    if not options.mass[0] > 0.0:
        raise UsageError(
            f"--mass {options.mass[0]:g}..{options.mass[1]:g}: must be positive"
        )
    if options.compare:
        why = "--compare takes --delays and --margins, and --rate"
        options.refuse_unused(why, "delay", "from_run", "effort", "grasp")
    else:
        options.refuse_unused("it is of --compare", "delays", "margins", *SPREAD)
    demand, measured = _demand(options)
    return (
        _compare(options, demand)
        if options.compare
        else _design(options, demand, measured)
    )


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


def _design(
    options: DesignOptions, demand: Demand, measured: Measured | None
) -> DesignFound:
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
    lines, replayed, picture = [describe(demand)], None, None
    if measured is not None and options.from_run is not None:
        replayed = _replayed(options.from_run, demand, law, measured)
        lines.append(
            f"recorded delay {measured.median:.4g} ticks, jitter {measured.jitter:.4g} ticks,"
            f" {measured.unanswered} of {len(measured.delays)} ticks not answered in time; pole"
            f" radius when the first {_REPLAYED} are replayed one by one:"
            f" {replayed.replayed_radius}"
        )
    made, best = _designed(options, demand, law), Judged.of(pd, demand)
    if made is None:
        lines.append(
            "no law of this length keeps the demand: allow a larger radius, a narrower range, more"
            " taps or --no-land"
        )
    else:
        picture = _draw(options.out / "design.png", demand, law, pd, passive)
        lines[:0] = [] if made.lands else [_FALLS]
        lines += [*_designed_lines(made, best), str(picture)]
        if made.grasp is not None:
            lines.append(f"{'':13}  {made.grasp.text()}")
        if made.rest is not None:
            free_of_cycles = made.rest.limit_cycle_free is ComesToRest.PROVEN
            stops = "stops" if free_of_cycles else "need not stop"
            lines += [
                f"with {options.friction:g} N a motion {stops}: {made.rest.rest.text()}",
                str(made.rest.map.plot),
            ]
    known = None if passive is None else _passive(passive, demand, options.out)
    return DesignFound(
        lines=[*lines, *([] if known is None else [known.line(demand)])],
        held=made is not None,
        demand=demand,
        designed=made,
        passive=known,
        best_pd=best,
        replayed=replayed,
        picture=picture,
    )


_FALLS = (
    "This law does NOT survive a landing: a drop on a floor does not settle; without --no-land it"
    " would"
)
_PROOFS = {
    Certificate.CERTIFIED: "certified",
    Certificate.UNSTABLE: "NOT stable",
    Certificate.UNDECIDED: "not decided",
    Certificate.TOO_WIDE: "the range is wider than a tick",
}


def _designed(options: DesignOptions, demand: Demand, law: Tuned) -> DesignedLaw | None:
    """Judge the designed law and write it to a file; None without a law."""
    if law.found is None or law.law is None:
        return None
    path, found = fresh(options.out / "designed.yaml"), law.found
    lands = all(drops(found.law, demand).values())
    landing = prove_over(found.law, demand)
    comment = "\n".join(
        [
            describe(demand),
            *([] if lands else ["it does NOT survive a landing"]),
            landing.text(),
        ]
    )
    path.write_text(to_yaml(law.law, comment=comment), encoding="utf-8")
    return DesignedLaw(
        Judged.of(law, demand),
        path,
        lands,
        certificate(found.law, demand),
        landing,
        None
        if options.grasp is None
        else judge_grasps(found.law, demand, options.grasp),
        _at_rest(options, found, demand),
    )


def _designed_lines(made: DesignedLaw, pd: Judged) -> list[str]:
    proof = _PROOFS[made.every_delay]
    return [
        made.judged.line,
        f"{'':13}  every sequence of these delays, five masses: {proof} (THEORY.md §10)",
        f"{'':13}  {made.landing_proof.text()} (THEORY.md §19)",
        pd.line,
        f"haptic param load coupling {made.yaml}",
    ]


def _at_rest(options: DesignOptions, found: Robust, demand: Demand) -> RestFound | None:
    """Return the friction that the law needs, and plot a map of its K.

    The device is the heaviest and least damped of the range.
    """
    step, friction = options.resolution, options.friction
    if step is None or friction is None:
        return None
    device = Plant(
        demand.period,
        demand.mass[1],
        demand.damping,
        demand.delay[1],
        demand.stiffness[0],
    )
    # The proof requires a law that is passive at every delay of the range.
    passive = (
        certain_damping(found.taps, demand.period, *demand.delay) <= demand.damping
    )
    needed = replace(rest(found.law, device, step), certain=passive)
    path = options.out / "design_rest.png"
    drawn = rest_map(found.law, found.h1_n_per_m, device, step, friction, path)
    return RestFound(needed, drawn, needed.free(friction))


def _replayed(path: Path, demand: Demand, law: Tuned, measured: Measured) -> Replayed:
    """Replay the recorded delays with the lightest and the heaviest device.

    Jitter is not equivalent to a constant delay.
    """
    worst = math.inf
    if law.found is not None:
        worst = max(
            replayed_radius(
                law.found.law,
                Plant(demand.period, m, demand.damping, 0.0, hand),
                measured.delays[:_REPLAYED],
            )
            for m in demand.mass
            for hand in demand.stiffness
        )
    radius = worst if math.isfinite(worst) else None
    return Replayed(path, measured.median, measured.jitter, measured.unanswered, radius)


def _passive(passive: Passive, demand: Demand, out: Path) -> PassiveLaw:
    """Judge the passive law and write it to a file."""
    path = fresh(out / "passive.yaml")
    comment = f"passive for any mass and hand: {describe(demand)}"
    path.write_text(
        to_yaml(fir(passive.taps, demand.period), "passive", comment=comment),
        encoding="utf-8",
    )
    law = CompiledLaw(tuple(passive.taps.tolist()))
    loops = itertools.product(demand.mass, demand.delay, demand.stiffness)
    radius = max(
        pole_radius(law, Plant(demand.period, mass, demand.damping, delay, hand))
        for mass, delay, hand in loops
    )
    return PassiveLaw(passive, radius, path)


def _compare(options: DesignOptions, demand: Demand) -> ComparedFound:
    cases = [
        replace(demand, delay=(delay, delay + margin))
        for margin in options.margins
        for delay in options.delays
    ]
    jobs = [
        partial(_tuned, case, options.taps, options.resolution or RESOLUTION)
        for case in cases
    ]
    done = spread(options, jobs)
    return ComparedFound(
        lines=[line for one in done for line in one.lines], demand=demand, cases=done
    )


def _tuned(case: Demand, taps: int, resolution: float) -> Compared:
    """Tune every law to one specification, and PD with a windowed velocity by its drops."""
    laws = [Judged.of(one, case) for one in compare(case, taps)]
    return Compared(case, laws, best_pd_windowed(case, resolution))


@styled
def _draw(
    path: Path, demand: Demand, law: Tuned, pd: Tuned, passive: Passive | None
) -> Path:
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
            max(
                pole_radius(compiled, replace(device, mass=m, stiffness=k))
                for k in hands
            )
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
        xlabel=OMEGA,
        ylabel="damping needed  [N s/m]",
        title=f"passivity at a delay of {whole} T",
    )
    left.legend()
    return save_figure(figure, path, fresh)
