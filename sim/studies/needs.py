"""Toggle every model term of a scene: which are superfluous or missing, and their cost."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from nodes.parameters.options import FileOptions, argument, option
from nodes.parameters.quantities import whole
from nodes.parameters.store import ParameterError
from sim.experiments.perception import THRESHOLDS, tolerances
from sim.studies.result import Findings
from sim.studies.sweeps import SpreadOptions, spread

if TYPE_CHECKING:
    from pathlib import Path

    from nodes.launcher.launch_spec import Launch, Model
    from sim.experiments.needs import Needs
    from sim.experiments.rest_map import RestFound

_ROUNDING = 1e-15  # rounding of positions of a few centimetres in double precision [m]


@dataclass(frozen=True, kw_only=True)
class NeedsOptions(SpreadOptions, FileOptions):
    """Options of `needs`."""

    scenario: str = argument(help="name of a launch file, or the path of one")
    assignments: list[str] = argument(
        default=[],
        nargs="*",
        metavar="name:=value",
        help="arguments of the launch file",
    )
    rounds: int = option(
        default=5,
        type=whole(0, 10000),
        help="interleaved rounds of timing; 0 times nothing",
    )
    tolerance: str = option(
        default="model",
        choices=("model", "jnd"),
        help=(
            "a change that counts: the launch file's tolerance, or what a hand notices"
            " (default: model)"
        ),
    )


@dataclass(frozen=True)
class RestNeeds:
    """Effect of encoder and friction on the last law at rest."""

    declared: bool  # whether the scene has both; else those of a Touch X
    resolution_m: float
    friction_n: float
    found: RestFound

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name."""
        figures = vars(self) | self.found.as_json()
        return {name: one for name, one in figures.items() if name != "found"}

    @property
    def line(self) -> str:
        """The effect in one line, and the map's path in another."""
        return (
            f"rest: {1e6 * self.resolution_m:.3g} µm of encoder and {self.friction_n:.3g} N of"
            f" friction{'' if self.declared else ' (a Touch X: the scene has none)'};"
            f" {self.found.rest.text()}\n{self.found.map.plot}"
        )


@dataclass(frozen=True)
class ChainNeeds:
    """Which terms of one chain of a scene matter."""

    scenario: str  # with the chain's name, if the launch has several
    model: Model  # what its launch file declares
    felt: bool  # whether changes are judged by what a hand notices
    needs: Needs
    # None without contact, of a device not rigid or a law not linear
    rest: RestNeeds | None

    def as_json(self) -> dict[str, Any]:
        """Return the figures by name."""
        found, tolerance = self.needs, tolerances(self.model.tolerance, self.felt)
        return {
            "scenario": self.scenario,
            "outcome": found.outcome,
            "tolerance": self.model.tolerance,
            "tolerances": {
                outcome: tolerance(outcome) for outcome in self.model.outcome
            },
            "thresholds": THRESHOLDS,
            "tick_us": found.tick_us,
            "terms": found.findings,
            "superfluous": found.superfluous,
            "missing": found.missing,
            "left_out": [finding.term for finding in found.left_out],
            "rest": self.rest,
        }


@dataclass(frozen=True, repr=False, kw_only=True)
class NeedsFound(Findings):
    """Which terms of each chain of a scene matter."""

    scenario: str
    chains: dict[str, ChainNeeds]

    @property
    def answer(self) -> dict[str, Any]:
        """Figures by name, those of a single chain at the top level."""
        figures = super().answer
        (first, *others) = figures["chains"].values()
        return figures if others else first


def needs(options: NeedsOptions) -> NeedsFound:
    """Report whether each chain of a scene models enough and no more."""
    from nodes.launcher import launch_file, scenario_files
    from nodes.launcher.wiring import chains_of

    launch = launch_file.read(
        options.scenario, scenario_files.parse_assignments(options.assignments)
    )
    judged = {chain: _judge(options, launch, chain) for chain in chains_of(launch)}
    if not judged:
        raise ParameterError("no chain, so nothing to play", path=launch.scenario)
    enough = not any(
        one.needs.superfluous or one.needs.missing for one in judged.values()
    )
    lines = ["\n\n".join(map(_text, judged.values()))]
    return NeedsFound(lines=lines, held=enough, scenario=launch.scenario, chains=judged)


def _judge(options: NeedsOptions, launch: Launch, chain: str) -> ChainNeeds:
    """Judge one chain."""
    from sim.experiments.needs import needs as found_needs

    model, felt = launch.models.get(chain) or launch.model, options.tolerance == "jnd"
    found = found_needs(
        launch,
        chain,
        model,
        options.rounds,
        options.progress(options.rounds),
        partial(spread, options),
        tolerances(model.tolerance, felt),
    )
    rest = _rest(
        launch, chain, options.out / f"needs_rest{chain.replace('/', '_')}.png"
    )
    name = "/".join(filter(None, (launch.scenario, chain)))
    return ChainNeeds(name, model, felt, found, rest)


def _rest(launch: Launch, chain: str, path: Path) -> RestNeeds | None:
    """Return the effect of encoder and friction on the last law at rest; None without contact.

    Also None if the device is not rigid or the law is not linear.
    """
    from sim.experiments.rest_map import RestFound, rest_map
    from sim.experiments.terms import FRICTION, RESOLUTION
    from sim.play.launched import NotOneAxisError, from_launch
    from sim.stability.rest import rest

    try:
        scene = from_launch(launch, chain)
    except NotOneAxisError:
        return None
    law, device = scene.last_law, scene.plant
    if scene.scene.surface.kind == "free" or law.evaluate is not None:
        return None
    body = scene.scene.device
    declared = bool(body.resolution and body.friction)
    resolution = (declared and body.resolution) or RESOLUTION
    friction = (declared and body.friction) or FRICTION
    drawn = rest_map(law, law.h1, device, resolution, friction, path)
    return RestNeeds(
        declared, resolution, friction, RestFound(rest(law, device, resolution), drawn)
    )


def _micrometres(length: float) -> str:
    """Format a length in µm; rounding counts as zero."""
    return "0" if length < _ROUNDING else f"{1e6 * length:.3g}"


def _text(one: ChainNeeds) -> str:
    name, model, found, felt = one.scenario, one.model, one.needs, one.felt
    now = found.outcome
    stiffest = (
        ""
        if now.h1_max_n_per_m is None
        else f", K_max (H(1)) {now.h1_max_n_per_m:.5g} N/m"
    )
    timed = (
        ""
        if found.tick_us is None
        else f"; {found.tick_us:.3g} µs per tick in plain Python"
    )
    lines = [
        f"{name}: for {', '.join(model.outcome)}; tolerance {100 * model.tolerance:g} %"
        + (", and what a hand notices of force and stiffness" if felt else ""),
        (
            f"settles in {now.settling_s:.3g} s, peak {now.peak_force_n:.3g} N, at rest"
            f" {now.rest_force_n:.3g} N, swing at rest {_micrometres(now.limit_cycle_m)}"
            f" µm{stiffest}{timed}"
        ),
        "",
        f"{'term':24} {'switched':34} {'moves':>9}  {'of which most':14} {'costs µs':>14}  verdict",
    ]
    for f in found.findings:
        moved = "∞" if f.moved == float("inf") else f"{100 * f.moved:.3g} %"
        cost = "" if f.cost_us is None else f"{f.cost_us:+.2f} ± {f.cost_spread_us:.2f}"
        lines.append(
            f"{f.term:24} {f.switched:34} {moved:>9}  {f.most:14} {cost:>14}  {f.verdict}"
        )
    missing, superfluous = (
        ", ".join(names) or "nothing" for names in (found.missing, found.superfluous)
    )
    lines += ["", f"superfluous: {superfluous}", f"missing: {missing}"]
    if found.left_out:
        told = ", ".join(
            f"{f.term} ({f.most} by {100 * f.moved:.3g} %)" for f in found.left_out
        )
        lines.append(f"left out on purpose although it matters: {told}")
    lines += [
        f"a hand notices {100 * limit.low:.0f} to {100 * limit.high:.0f} % of {limit.quantity}"
        f" ({limit.source})"
        for limit in THRESHOLDS
    ]
    return "\n".join(lines + ([] if one.rest is None else [one.rest.line]))
