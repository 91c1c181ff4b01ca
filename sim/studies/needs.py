"""Toggle every model term of a scene: which are superfluous or missing, and their cost."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from nodes.parameters.options import FileOptions, argument, option
from nodes.parameters.quantities import whole
from nodes.parameters.store import ParameterError
from sim.studies.result import Answer, answered
from sim.studies.sweeps import SpreadOptions, spread

if TYPE_CHECKING:
    from pathlib import Path

    from nodes.launcher.launch_spec import Launch
    from sim.experiments.needs import Needs

_ROUNDING = 1e-15  # rounding of positions of a few centimetres in double precision [m]


@dataclass(frozen=True, kw_only=True)
class NeedsOptions(SpreadOptions, FileOptions):
    """Options of `needs`."""

    scenario: str = argument(help="name of a launch file, or the path of one")
    assignments: list[str] = argument(
        default=[], nargs="*", metavar="name:=value", help="arguments of the launch file"
    )
    rounds: int = option(
        default=5,
        type=whole(0, 10000),
        help="interleaved rounds of timing; 0 times nothing (default: 5)",
    )
    tolerance: str = option(
        default="model",
        choices=("model", "jnd"),
        help=(
            "a change that counts: the launch file's tolerance, or what a hand notices"
            " (default: model)"
        ),
    )


def needs(options: NeedsOptions) -> Answer:
    """Report whether each chain of a scene models enough and no more."""
    from nodes.launcher import launch_file
    from nodes.launcher.wiring import chains_of

    launch = launch_file.read(options.scenario, launch_file.parse_assignments(options.assignments))
    judged = {chain: _judge(options, launch, chain) for chain in chains_of(launch)}
    if not judged:
        raise ParameterError("no chain, so nothing to play", path=launch.scenario)
    figures = [found for found, _ in judged.values()]
    answer = figures[0]
    if len(figures) > 1:
        answer = {"scenario": launch.scenario, "chains": dict(zip(judged, figures, strict=True))}
    enough = not any(found["superfluous"] or found["missing"] for found in figures)
    return answered(answer, "\n\n".join(text for _, text in judged.values()), held=enough)


def _judge(options: NeedsOptions, launch: Launch, chain: str) -> tuple[dict[str, Any], str]:
    """Judge one chain; return its figures and text."""
    from sim.experiments.needs import needs as found_needs
    from sim.experiments.perception import THRESHOLDS, tolerances

    model = launch.models.get(chain) or launch.model
    felt, name = options.tolerance == "jnd", "/".join(filter(None, (launch.scenario, chain)))
    tolerance = tolerances(model.tolerance, felt)
    found = found_needs(
        launch,
        chain,
        model,
        options.rounds,
        options.progress(options.rounds),
        partial(spread, options),
        tolerance,
    )
    figures: dict[str, Any] = {
        "scenario": name,
        "outcome": asdict(found.outcome),
        "tolerance": model.tolerance,
        "tolerances": {outcome: tolerance(outcome) for outcome in model.outcome},
        "thresholds": [asdict(threshold) for threshold in THRESHOLDS],
        "tick_us": found.tick_us,
        "terms": [asdict(finding) for finding in found.findings],
        "superfluous": list(found.superfluous),
        "missing": list(found.missing),
        "left_out": [finding.term for finding in found.left_out],
        "rest": _rest(launch, chain, options.out / f"needs_rest{chain.replace('/', '_')}.png"),
    }
    text = _text(name, model, found, felt)
    if (told := figures["rest"]) is not None:
        text += (
            f"\nrest: {1e6 * told['resolution_m']:.3g} µm of encoder and {told['friction_n']:.3g} N"
            f" of friction{'' if told['declared'] else ' (a Touch X: the scene has none)'};"
            f" {told['text']}\n{told['map']['plot']}"
        )
    return figures, text


def _rest(launch: Launch, chain: str, path: Path) -> dict[str, Any] | None:
    """Return the effect of encoder and friction on the last law at rest; None without contact.

    Also None if the device is not rigid or the law is not linear.
    """
    from nodes.stability.rest import rest
    from sim.experiments.rest_map import rest_map
    from sim.experiments.terms import FRICTION, RESOLUTION
    from sim.play.launched import NotOneAxisError, from_launch

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
    found = rest(law, device, resolution)
    drawn = rest_map(law, law.h1, device, resolution, friction, path)
    told = {"declared": declared, "resolution_m": resolution, "friction_n": friction}
    return {**told, **asdict(found), "text": found.text(), "map": drawn}


def _micrometres(length: float) -> str:
    """Format a length in µm; rounding counts as zero."""
    return "0" if length < _ROUNDING else f"{1e6 * length:.3g}"


def _text(name: str, model: Any, found: Needs, felt: bool) -> str:
    from sim.experiments.perception import THRESHOLDS

    now = found.outcome
    stiffest = "" if now.h1_max_n_per_m is None else f", K_max (H(1)) {now.h1_max_n_per_m:.5g} N/m"
    timed = "" if found.tick_us is None else f"; {found.tick_us:.3g} µs per tick in plain Python"
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
        lines.append(f"{f.term:24} {f.switched:34} {moved:>9}  {f.most:14} {cost:>14}  {f.verdict}")
    missing, superfluous = (
        ", ".join(names) or "nothing" for names in (found.missing, found.superfluous)
    )
    lines += ["", f"superfluous: {superfluous}", f"missing: {missing}"]
    if found.left_out:
        told = ", ".join(f"{f.term} ({f.most} by {100 * f.moved:.3g} %)" for f in found.left_out)
        lines.append(f"left out on purpose although it matters: {told}")
    for one in THRESHOLDS:
        lines.append(
            f"a hand notices {100 * one.low:.0f} to {100 * one.high:.0f} % of {one.quantity}"
            f" ({one.source})"
        )
    return "\n".join(lines)
