"""Check that a scene models enough and no more: switch each term, compare the outcome.

The outcome is the purpose of a scene (``model.outcome`` of its launch file): settling time, contact
force, largest stiffness, buzz at rest; in several axes also the force and proxy at every tick.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from nodes.base.setup import least_delay
from nodes.coupling.parameters import PlantParameters
from nodes.launcher.launch_spec import Launch, Model
from nodes.launcher.plants import known_plant
from nodes.parameters.store import convert
from nodes.stability.k_max import k_max, with_spring
from nodes.stability.plant import Plant
from sim.arrays import Array
from sim.experiments.perception import tolerances
from sim.experiments.term_scene import Edit, TermScene, has_normal, meets, term_scene
from sim.experiments.terms import (
    BROUGHT,
    CONVENTIONS,
    PROTECTS,
    TERMS,
    TOGETHER,
    NeedTerm,
)
from sim.measure.stopwatch import Timing, interleaved
from sim.play.player import How
from sim.play.trace import ChainTrace

# motion at rest that is ignored [m]: about the fingertip's threshold near 250 Hz, where it is
# most sensitive
BUZZ = 1e-6
_FORCE = 0.01
_TAIL = 5

# Plays variants: one after another here, or in parallel (`sim.studies.sweeps.spread`).
Players = Callable[[Sequence[Callable[[], ChainTrace]]], list[ChainTrace]]


@dataclass(frozen=True)
class Outcome:
    """Outcome of a run; None where a value is undefined."""

    # Last time farther than 1 % of the travel from the end position; run length if it did not
    # settle [s].
    settling_s: float
    peak_force_n: float  # largest force [N]
    rest_force_n: float  # mean force over the last fifth [N]
    travel_m: float  # range of motion [m]
    limit_cycle_m: float  # peak-to-peak motion over the last fifth [m]
    # H(1) at which the loop becomes unstable [N/m]; None without contact or poles.
    h1_max_n_per_m: float | None


@dataclass(frozen=True)
class Finding:
    """Effect of switching one term."""

    term: str  # the term, two terms switched together, or a convention
    # ``off`` with its replacement, or ``on`` with the value; ``other`` for a convention
    switched: str
    # ``needed``, ``superfluous``, ``sought``, ``protects``, ``missing``, ``left out``, ``not
    # needed``, ``brought by the loop``, ``convention``.
    verdict: str
    moved: float  # largest relative change of any relevant outcome [1]
    most: str  # name of that outcome
    changes: dict[str, float]  # relative change of each relevant outcome [1]
    # Cost of the term per tick in plain Python [µs]; None if below the timing spread, and for
    # a convention.
    cost_us: float | None
    # Uncertainty of that cost from the spread of the timing rounds [µs]; None with one round.
    cost_spread_us: float | None = None


@dataclass(frozen=True)
class Needs:
    """Which model terms change the outcome, and which are missing."""

    outcome: Outcome  # of the unchanged scene
    findings: tuple[Finding, ...]  # one per term, pair and convention switched
    # time per tick of the unchanged scene in plain Python [µs]; None if not timed
    tick_us: float | None

    @property
    def superfluous(self) -> tuple[str, ...]:
        """Declared terms that change no outcome when removed."""
        return tuple(f.term for f in self.findings if f.verdict == "superfluous")

    @property
    def left_out(self) -> tuple[Finding, ...]:
        """Terms left out on purpose although they change an outcome."""
        return tuple(f for f in self.findings if f.verdict == "left out")

    @property
    def missing(self) -> tuple[str, ...]:
        """Undeclared terms that change an outcome and were not left out on purpose."""
        return tuple(f.term for f in self.findings if f.verdict == "missing")


def plant_of(scene: TermScene) -> Plant | None:
    """Return device and hand as a linear plant, both of a pair; None if no mass is known."""
    run = scene.launch.run
    known = known_plant(scene.launch, scene.namespace)
    if "mass" not in known:
        return None
    plant: PlantParameters = convert(known, PlantParameters, scene.hops.coupling)
    return plant.at(run.period, least_delay(run.apply))


def stiffest(scene: TermScene) -> float | None:
    """Return the H(1) at which the loop at the wall or anchor becomes unstable [N/m].

    None if the chain has neither.
    """
    laws = scene.instead.law
    plant = plant_of(scene)
    law = scene.laws.all[-1]
    if scene.shortened and laws is not None:
        law = [laws, *(swap.law for swap in scene.instead.swaps)][-1]
    has_wall = (
        meets(scene).get("kind") != "free" and not scene.shapes and len(scene.axes) == 1
    )
    if not has_wall or plant is None or law.evaluate is not None:
        return None
    return k_max(with_spring(law, -law.h1), plant).h1_max_n_per_m


def outcome(scene: TermScene, trace: ChainTrace) -> Outcome:
    """Compute the outcome of a run."""
    axes = list(trace.axes)
    return measured_outcome(
        trace.position[:, axes], trace.force[:, axes], trace.period, stiffest(scene)
    )


def measured_outcome(
    position: Array, force: Array, period: float, h1_max: float | None = None
) -> Outcome:
    """Compute the outcome of a run from positions and forces, shape (ticks, axes).

    Distances and forces are Euclidean norms.
    """
    tail = max(2, len(position) // _TAIL)
    end = position[-tail:]
    rest = force[-tail:].mean(axis=0)
    travel = float(np.ptp(position, axis=0).max())
    away = np.flatnonzero(
        ~(np.linalg.norm(position - end.mean(axis=0), axis=1) <= 0.01 * travel)
    )
    return Outcome(
        settling_s=(int(away[-1]) + 1 if len(away) else 0) * period,
        peak_force_n=float(np.linalg.norm(force, axis=1).max()),
        rest_force_n=float(rest[0] if len(rest) == 1 else np.linalg.norm(rest)),
        travel_m=travel,
        limit_cycle_m=float(np.ptp(end, axis=0).max()),
        h1_max_n_per_m=h1_max,
    )


def movement(before: Outcome, after: Outcome, period: float) -> dict[str, float]:
    """Return the relative change of each value of two outcomes."""

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
    """A scene with something switched: name, scene and how (`Finding.switched`)."""

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
    """Switch every term of a chain; return the effect and cost of each.

    Parameters
    ----------
    launch : Launch
        The parsed launch file.
    namespace : str
        Namespace of the chain; empty for a launch of one.
    model : Model, optional
        Purpose of the scene; by default that of the launch file.
    rounds : int
        Interleaved timing rounds; 0: no timing.
    step : callable
        Called with the name of each timed item.
    players : callable
        Plays the variants, by default one after another.
    tolerance : callable, optional
        Ignored change per outcome; by default the model's.

    Returns
    -------
    Needs
        A finding for each term, pair of terms and convention.

    Raises
    ------
    ParameterError
        As `sim.play.player.play`, or if a shape is to be replaced and there is no contact.
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

        variants = variants_of(
            scene, TERMS, CONVENTIONS if has_normal(scene) else {}, TOGETHER
        )
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


HOW: How = "interpreted"  # term costs are measured in plain Python


def _play(scene: TermScene) -> ChainTrace:
    with np.errstate(all="ignore"):
        return scene.play(HOW)


def _with_cost(
    finding: Finding, variant: Variant, whole: Timing, mine: Timing, rounds: int
) -> Finding:
    """Add the cost of a term per tick [µs] if it exceeds the spread of its timing rounds."""
    cost = 1e6 * (whole.median - mine.median) * (1.0 if variant.off else -1.0)
    spread = (
        0.5e6 * ((mine.high - mine.low) + (whole.high - whole.low))
        if rounds > 1
        else None
    )
    known = finding.switched != "other" and spread is not None and abs(cost) > spread
    return replace(finding, cost_us=cost if known else None, cost_spread_us=spread)


def variants_of(
    scene: TermScene,
    terms: Sequence[NeedTerm],
    conventions: Mapping[str, Edit],
    together: Sequence[tuple[str, str]],
) -> list[Variant]:
    """Return all variants: each term and some pairs switched, and the conventions."""
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
    variant: Variant,
    moved_by: dict[str, float],
    model: Model,
    tolerance: Callable[[str], float],
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
    """Return the root mean square of a difference over that of `scale`."""
    size = float(np.sqrt(np.mean(np.sum(scale**2, axis=1))))
    difference = float(np.sqrt(np.mean(np.sum((after - before) ** 2, axis=1))))
    if not np.isfinite(difference):
        return float("inf")
    return (
        difference / size if size > 0.0 else 0.0 if difference == 0.0 else float("inf")
    )
