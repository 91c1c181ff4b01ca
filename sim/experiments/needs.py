"""No more model than a scene needs, and no less: switch every term and look whether the outcome moves.

The outcome is what a scene is for (``model.outcome`` of its launch file): when it settles, how hard
it pushes, how stiff it may get, whether it buzzes at rest; in several axes what is felt along a
way, force and proxy at every tick, too.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from nodes.coupling.parameters import PlantParameters
from nodes.launcher.launch_spec import Launch, Model
from nodes.launcher.plants import known_plant
from nodes.parameters.store import convert
from nodes.stability.k_max import k_max, with_spring
from nodes.stability.plant import Plant
from sim.arrays import Array
from sim.experiments.perception import tolerances
from sim.experiments.term_scene import Edit, TermScene, has_normal, meets, term_scene
from sim.experiments.terms import BROUGHT, CONVENTIONS, PROTECTS, TERMS, TOGETHER, NeedTerm
from sim.measure.stopwatch import Timing, interleaved
from sim.play.player import How
from sim.play.trace import ChainTrace

# motion at rest that does not count [m]: about what a fingertip feels at its most sensitive, near
# 250 Hz
BUZZ = 1e-6
_FORCE = 0.01
_TAIL = 5

# How variants are played: one after another here, or side by side (`sim.studies.sweeps.spread`).
Players = Callable[[Sequence[Callable[[], ChainTrace]]], list[ChainTrace]]


@dataclass(frozen=True)
class Outcome:
    """What came of a scene; None where a figure makes no sense."""

    # Last time at which the device was further than 1 % of its travel from where it ended; the
    # length of the run when it did not come to rest [s].
    settling_s: float
    peak_force_n: float  # largest force [N]
    rest_force_n: float  # mean force over the last fifth [N]
    travel_m: float  # range of the motion [m]
    limit_cycle_m: float  # swing over the last fifth, peak to peak [m]
    # Stiffness at which the loop becomes unstable (K_max in terms of H(1)); None without contact or
    # poles [N/m].
    h1_max_n_per_m: float | None


@dataclass(frozen=True)
class Finding:
    """What switching one term did."""

    term: str  # the term, or two that were switched together, or a convention
    # ``off``, with what there is in its place, or ``on``, with the value; ``other`` for a
    # convention
    switched: str
    # ``needed``, ``superfluous``, ``sought``, ``protects``, ``missing``, ``left out``, ``not
    # needed``, ``brought by the loop``, ``convention``.
    verdict: str
    moved: float  # largest relative movement of any outcome that counts [1]
    most: str  # which outcome that was
    changes: dict[str, float]  # relative movement of each outcome that counts [1]
    # What the term costs per tick in plain Python [µs]; None where the spread is larger, and for a
    # convention.
    cost_us: float | None
    # How far that cost may be off by the spread of the rounds that were timed [µs]; None with one
    # round.
    cost_spread_us: float | None = None


@dataclass(frozen=True)
class Needs:
    """Whether a scene models enough and no more."""

    outcome: Outcome  # of the scene as it is
    findings: tuple[Finding, ...]  # one for each term, pair and convention that was switched
    # time per tick of the scene as it is, in plain Python [µs]; None where nothing was timed
    tick_us: float | None

    @property
    def superfluous(self) -> tuple[str, ...]:
        """Declared terms without which nothing moves."""
        return tuple(f.term for f in self.findings if f.verdict == "superfluous")

    @property
    def left_out(self) -> tuple[Finding, ...]:
        """Terms that are left out on purpose although they move something."""
        return tuple(f for f in self.findings if f.verdict == "left out")

    @property
    def missing(self) -> tuple[str, ...]:
        """Terms that are not there, not left out on purpose, and move something."""
        return tuple(f.term for f in self.findings if f.verdict == "missing")


def plant_of(scene: TermScene) -> Plant | None:
    """Return device and hand as the linear loop sees them, of a pair both; None where nobody knows a mass."""
    run = scene.launch.run
    known = known_plant(scene.launch, scene.namespace)
    if "mass" not in known:
        return None
    plant: PlantParameters = convert(known, PlantParameters, scene.hops.coupling)
    return plant.at(run.period, float(run.apply == "next_tick"))


def stiffest(scene: TermScene) -> float | None:
    """Return the stiffness H(1) at which the loop becomes unstable at the chain's wall or anchor [N/m]; None without one."""
    laws, plant = scene.instead.law, plant_of(scene)
    law = scene.laws.all[-1]
    if scene.shortened and laws is not None:
        law = [laws, *(swap.law for swap in scene.instead.swaps)][-1]
    has_wall = meets(scene).get("kind") != "free" and not scene.shapes and len(scene.axes) == 1
    if not has_wall or plant is None or law.evaluate is not None:
        return None
    return k_max(with_spring(law, -law.h1), plant).h1_max_n_per_m


def outcome(scene: TermScene, trace: ChainTrace) -> Outcome:
    """Work out what came of a run."""
    axes = list(trace.axes)
    return measured_outcome(
        trace.position[:, axes], trace.force[:, axes], trace.period, stiffest(scene)
    )


def measured_outcome(
    position: Array, force: Array, period: float, h1_max: float | None = None
) -> Outcome:
    """Work out what came of a run: positions and forces, (ticks, axes); lengths and forces are those in space."""
    tail = max(2, len(position) // _TAIL)
    end, rest = position[-tail:], force[-tail:].mean(axis=0)
    travel = float(np.ptp(position, axis=0).max())
    away = np.flatnonzero(~(np.linalg.norm(position - end.mean(axis=0), axis=1) <= 0.01 * travel))
    return Outcome(
        settling_s=(int(away[-1]) + 1 if len(away) else 0) * period,
        peak_force_n=float(np.linalg.norm(force, axis=1).max()),
        rest_force_n=float(rest[0] if len(rest) == 1 else np.linalg.norm(rest)),
        travel_m=travel,
        limit_cycle_m=float(np.ptp(end, axis=0).max()),
        h1_max_n_per_m=h1_max,
    )


def movement(before: Outcome, after: Outcome, period: float) -> dict[str, float]:
    """Compare two outcomes, each figure in its own measure."""

    def relative(a: float, b: float, least: float) -> float:
        if not (math.isfinite(a) and math.isfinite(b)):
            return 0.0 if a == b or (math.isnan(a) and math.isnan(b)) else math.inf
        return abs(b - a) / max(abs(a), least)

    cycles = before.limit_cycle_m, after.limit_cycle_m
    swing = max(cycles)
    buzz = 0.0 if swing <= BUZZ else abs(cycles[1] - cycles[0]) / swing
    if not math.isfinite(swing):
        buzz = relative(*cycles, BUZZ)
    figures = {
        "settling": relative(before.settling_s, after.settling_s, 50.0 * period),
        "peak_force": relative(before.peak_force_n, after.peak_force_n, _FORCE),
        "rest_force": relative(before.rest_force_n, after.rest_force_n, _FORCE),
        "travel": relative(before.travel_m, after.travel_m, BUZZ),
        "limit_cycle": buzz,
    }
    a, b = before.h1_max_n_per_m, after.h1_max_n_per_m
    if a is not None or b is not None:
        figures["k_max"] = math.inf if a is None or b is None else relative(a, b, 1e-3)
    return figures


class Variant(NamedTuple):
    """A scene with something switched: what, the scene, and how (`Finding.switched`)."""

    terms: tuple[str, ...]
    scene: TermScene
    switched: str
    off: bool = False  # whether its terms were switched off


def here(plays: Sequence[Callable[[], ChainTrace]]) -> list[ChainTrace]:
    """Play variants one after another."""
    return [play() for play in plays]


def needs(
    launch: Launch,
    namespace: str = "",
    model: Model | None = None,
    rounds: int = 5,
    step: Callable[[str], None] = lambda _: None,
    players: Players = here,
    tolerance: Callable[[str], float] | None = None,
) -> Needs:
    """Switch every term of a chain: what each moves, and what it costs.

    Parameters
    ----------
    launch : Launch
        The launch file, read.
    namespace : str
        Of the chain; empty for a launch of one.
    model : Model, optional
        What the scene is for; by default as the launch file says of the chain.
    rounds : int
        Interleaved rounds of timing; 0 times nothing.
    step : callable
        Called with what was timed.
    players : callable
        Plays the variants, here one after another.
    tolerance : callable, optional
        Change of an outcome that does not count; by default the model's.

    Returns
    -------
    Needs
        A finding for each term, pair of terms and convention.

    Raises
    ------
    ParameterError
        As of `sim.play.player.play`; where a shape is to be replaced and nothing is touched.
    """
    scene = term_scene(launch, namespace)
    model = (launch.models.get(namespace) or launch.model) if model is None else model
    tolerance = tolerance or tolerances(model.tolerance, felt=False)
    with np.errstate(all="ignore"):
        first = _play(scene)
        before = outcome(scene, first)

        def changes(changed: TermScene, trace: ChainTrace) -> dict[str, float]:
            return movement(before, outcome(changed, trace), trace.period) | {
                "force": apart(first.force, trace.force, first.force),
                "proxy": apart(first.proxy, trace.proxy, first.proxy - first.measured),
            }

        variants = variants_of(scene, TERMS, CONVENTIONS if has_normal(scene) else {}, TOGETHER)
        played = players([partial(_play, variant.scene) for variant in variants])
        findings = [
            _finding(variant, changes(variant.scene, trace), model, tolerance)
            for variant, trace in zip(variants, played, strict=True)
        ]
        if not rounds:
            return Needs(before, tuple(findings), None)
        jobs = {
            str(i): (one.ready(HOW), first.ticks)
            for i, one in enumerate([scene, *(variant.scene for variant in variants)])
        }
        timings = interleaved(jobs, rounds, step)
    costs = [
        _with_cost(finding, variant, timings["0"], timings[str(i)], rounds)
        for i, (finding, variant) in enumerate(zip(findings, variants, strict=True), 1)
    ]
    return Needs(before, tuple(costs), 1e6 * timings["0"].median)


HOW: How = "interpreted"  # what a term costs is told of plain Python


def _play(scene: TermScene) -> ChainTrace:
    with np.errstate(all="ignore"):
        return scene.play(HOW)


def _with_cost(
    finding: Finding, variant: Variant, whole: Timing, mine: Timing, rounds: int
) -> Finding:
    """Add what a term costs a tick [µs], where that is more than the spread of its rounds."""
    cost = 1e6 * (whole.median - mine.median) * (1.0 if variant.off else -1.0)
    spread = 0.5e6 * ((mine.high - mine.low) + (whole.high - whole.low)) if rounds > 1 else None
    known = finding.switched != "other" and spread is not None and abs(cost) > spread
    return replace(finding, cost_us=cost if known else None, cost_spread_us=spread)


def variants_of(
    scene: TermScene,
    terms: Sequence[NeedTerm],
    conventions: Mapping[str, Edit],
    together: Sequence[tuple[str, str]],
) -> list[Variant]:
    """Switch each term off where the scene has it and on where it has not, some together, and the conventions."""
    found: list[Variant] = []
    by_name = {term.name: term for term in terms}
    for term in terms:
        if term.declared(scene):
            simpler = f"off: {term.simpler}" if term.simpler else "off"
            found.append(Variant((term.name,), term.without(scene), simpler, off=True))
        elif term.typical is not None:
            changed = term.typical(scene)
            if term.declared(changed):
                found.append(Variant((term.name,), changed, f"on, {term.value}"))
    for left, right in together:
        pair = (by_name[left], by_name[right])
        if not any(term.declared(scene) or term.typical is None for term in pair):
            changed = scene
            for term in pair:
                changed = changed if term.typical is None else term.typical(changed)
            found.append(Variant((left, right), changed, "on"))
    return found + [
        Variant((name,), switch(scene), "other") for name, switch in conventions.items()
    ]


def _finding(
    variant: Variant, moved_by: dict[str, float], model: Model, tolerance: Callable[[str], float]
) -> Finding:
    terms, switched = variant.terms, variant.switched
    counts: set[str] = {*model.outcome}
    changes = {name: value for name, value in moved_by.items() if name in counts}
    most = max(changes, key=lambda name: changes[name] / tolerance(name), default="")
    moved = changes.get(most, 0.0)
    matters = bool(most) and moved > tolerance(most)
    if variant.off:
        why = {
            "needed": matters,
            "sought": set(terms) <= {*model.sought},
            "protects": set(terms) <= PROTECTS,
        }
        verdict = next((word for word, so in why.items() if so), "superfluous")
    elif switched == "other":
        verdict = "convention"
    elif not matters:
        verdict = "not needed"
    elif any(term in model.leaves_out for term in terms):
        verdict = "left out"
    elif set(terms) <= BROUGHT:
        verdict = "brought by the loop"
    else:
        verdict = "missing"
    return Finding(" and ".join(terms), switched, verdict, moved, most, changes, None)


def apart(before: Array, after: Array, scale: Array) -> float:
    """Root mean square of a difference over that of what it is measured by."""
    size = float(np.sqrt(np.mean(np.sum(scale**2, axis=1))))
    difference = float(np.sqrt(np.mean(np.sum((after - before) ** 2, axis=1))))
    if not np.isfinite(difference):
        return float("inf")
    return difference / size if size > 0.0 else 0.0 if difference == 0.0 else float("inf")
