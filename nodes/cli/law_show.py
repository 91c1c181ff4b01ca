"""Show what a law renders: of a running coupling, of a launch file, or as described."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from messages.errors import UsageError
from nodes.cli.ask import chosen_node
from nodes.cli.law_figures import ROWS, figure_table, leak_warning, short_value
from nodes.cli.law_worlds import world_figures, world_lines
from nodes.cli.main import answer
from nodes.client.launches import ask
from nodes.parameters.quantities import declare as declare_quantities
from nodes.parameters.quantities import declare_law, positive
from nodes.parameters.yaml_io import parse_yaml

if TYPE_CHECKING:
    from nodes.laws import CompiledLaw
    from nodes.stability.plant import Plant


# Options that describe a law, and a loop, that need not run.
OF_LAW = ("stiffness", "gain", "order", "taps", "gains", "derivative")
OF_LOOP = ("rate", "mass", "heaviest", "damping", "delay", "hand", "launch")
# The paper's experiment [Hz, kg, N s/m, ticks, N/m].
DEFAULTS = {"rate": 500.0, "mass": 0.1, "damping": 1.0, "delay": 0.0, "hand": 0.0}

_NO_PARAMETERS = (
    "run",
    "law",
    "kind",
    "rate_hz",
    "plant",
    "taps_n_per_m",
    "sections",
    "passive_scale",
    "landing_proof",
    "masses_kg",
    "worst_mass_kg",
)


def declare_show(show: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    show.add_argument(
        "law",
        nargs="?",
        help="name of a law, kind or preset, or a mapping {kind: ...} (default: the active law)",
    )
    show.add_argument(
        "assignments",
        nargs="*",
        metavar="name:=value",
        help="parameters of the law, or of the launch file",
    )
    show.add_argument(
        "--launch",
        metavar="SCENARIO",
        help="use law, rate and device of this launch file",
    )
    declare_quantities(
        show, rate=None, mass=None, damping=None, delay=None, hand=None, gain=None
    )
    declare_law(show)
    show.add_argument(
        "--heaviest",
        type=positive,
        help="largest mass of the device; --mass is then the smallest [kg]",
    )


def show(arguments: argparse.Namespace) -> int:
    """Print the figures of a law in its loop."""
    if ":=" in (arguments.law or ""):
        # ``law show --launch floor_drop stiffness:=900`` names no law: the word is an assignment.
        arguments.assignments.insert(0, arguments.law)
        arguments.law = None
    if arguments.launch is not None:
        figures = _of_launch(arguments)
    elif arguments.law is not None and _describes(arguments):
        figures = _described(arguments)
    else:
        run, node = chosen_node(arguments)
        figures = {"run": run.run, "rate_hz": 1.0 / run.nodes[node].period}
        figures |= ask(run, node, "law.show", law=arguments.law or "")
    worlds = world_figures(figures)
    lines = [
        *_head(figures),
        *figure_table({"": figures}),
        *world_lines(worlds, max(len(label) for _, label, _ in ROWS)),
    ]
    if "masses_kg" in figures:
        low, high = figures["masses_kg"]
        worst = f"{figures['worst_mass_kg']:.4g} kg"
        lines.append(
            f"  with {worst}, the worst of the device's {low:g} to {high:g} kg"
        )
    lines += leak_warning(figures)
    if "landing_proof" in figures:
        lines.append(f"  {figures['landing_proof']['text']}")
    if figures["h_nyquist_n_per_m"] is None:
        lines.append(
            "  H(1) is that of its taps, without its own code; the other figures need taps alone"
        )
    if (
        arguments.damping is not None
        and arguments.gain is None
        and "damping" in figures
    ):
        lines.append(
            f"  --damping {arguments.damping:g} is the device's; the law's own is --gain,"
            f" {figures['damping']:g} here"
        )
    return answer(arguments.json, figures | worlds, "\n".join(lines))


def _head(figures: dict[str, Any]) -> list[str]:
    """Return name, kind, parameters and taps of a law as lines."""
    skipped = {*_NO_PARAMETERS, *(key for key, _, _ in ROWS)}
    parameters = ", ".join(
        f"{key} {short_value(value)}"
        for key, value in figures.items()
        if key not in skipped and not key.startswith("f_")
    )
    taps = figures["taps_n_per_m"]
    shown = ", ".join(f"{tap:.6g}" for tap in taps[:8])
    more = f", … ({len(taps)})" if len(taps) > 8 else ""
    sections = figures["sections"]
    recursive = f", {sections} recursive sections" if sections else ""
    return [
        f"{figures['law']}: {figures.get('kind', '')} {parameters}".rstrip(),
        f"  taps {shown}{more} N/m{recursive}",
    ]


def _landing(
    law: CompiledLaw, plants: list[Plant], contact: str | None = None
) -> dict[str, Any]:
    """Return whether every drop is proven to settle, on the worst of the `plants`.

    `contact` names the launch's contact convention; a proof covers one convention only.
    """
    from nodes.stability.landing_proof import prove_landing

    worst = min(
        (prove_landing(law, plant) for plant in plants),
        key=lambda one: (one.proven, one.margin),
    )
    text = worst.text()
    if contact is not None and contact != worst.convention:
        text += f"; this launch has {contact}, which no proof covers"
    return {
        "proven": worst.proven,
        "convention": worst.convention,
        "contact": contact,
        "why": worst.why,
        "text": text,
    }


def _describes(arguments: argparse.Namespace) -> bool:
    """Whether the arguments describe a law and loop instead of a running coupling."""
    from nodes.launcher.runs import runs

    options = any(getattr(arguments, name) is not None for name in (*OF_LAW, *OF_LOOP))
    described = (
        arguments.assignments or options or arguments.law.lstrip().startswith("{")
    )
    return bool(described) or (arguments.run_name is None and not runs())


def _described(arguments: argparse.Namespace) -> dict[str, Any]:
    from nodes.coupling.law_book import worst_figures
    from nodes.coupling.parameters import PlantParameters
    from nodes.launcher.scenario_files import parse_assignments
    from nodes.laws.parse import compile_law, law_to_dict, parse_law

    data = (
        parse_yaml(arguments.law, "law")
        if arguments.law.lstrip().startswith("{")
        else {"kind": arguments.law}
    )
    for option in OF_LAW:
        if (value := getattr(arguments, option)) is not None:
            data["damping" if option == "gain" else option] = value
    law = parse_law({**data, **parse_assignments(arguments.assignments)})
    loop = {
        name: value if (value := getattr(arguments, name)) is not None else usual
        for name, usual in DEFAULTS.items()
    }
    period = 1.0 / loop["rate"]
    plant = PlantParameters(
        mass=loop["mass"],
        damping=loop["damping"],
        stiffness=loop["hand"],
        heaviest=arguments.heaviest,
    )
    compiled = compile_law(law, period)
    figures = worst_figures(compiled, plant, period, loop["delay"])
    figures["landing_proof"] = _landing(
        compiled, plant.over_workspace(period, loop["delay"])
    )
    device = {name: getattr(plant, name) for name in ("mass", "damping", "stiffness")}
    name = (
        arguments.law
        if not isinstance(data, dict) or "{" not in arguments.law
        else law.kind
    )
    return {
        "law": name,
        "rate_hz": loop["rate"],
        **law_to_dict(law),
        "plant": device,
        **figures,
    }


def _of_launch(arguments: argparse.Namespace) -> dict[str, Any]:
    import msgspec

    from nodes.base.setup import least_delay
    from nodes.coupling.law_book import LawBook
    from nodes.coupling.parameters import CouplingParameters, PlantParameters
    from nodes.launcher import launch_file, scenario_files
    from nodes.parameters.store import convert

    launch = launch_file.read(
        arguments.launch, scenario_files.parse_assignments(arguments.assignments)
    )
    if arguments.node not in launch.nodes:
        raise UsageError(
            f"{launch.scenario}: no node is named {arguments.node!r}; available:"
            f" {', '.join(launch.nodes)}"
        )
    parameters: CouplingParameters = convert(
        launch.nodes[arguments.node].parameters, CouplingParameters, arguments.node
    )
    if given := _device(arguments):
        plant = (
            msgspec.to_builtins(parameters.plant)
            if parameters.plant is not None
            else {"mass": DEFAULTS["mass"]}
        )
        parameters = msgspec.structs.replace(
            parameters, plant=convert({**plant, **given}, PlantParameters, "plant")
        )
    period = 1.0 / arguments.rate if arguments.rate is not None else launch.run.period
    book = LawBook(arguments.node, period)
    name = arguments.law or parameters.law
    delay = least_delay(launch.run.apply)
    proof = {}
    if parameters.plant is not None:
        contact = (
            f"{parameters.history} history, force"
            f" {'clamped' if parameters.clamp else 'not clamped'}"
        )
        plants = parameters.plant.over_workspace(period, delay)
        proof["landing_proof"] = _landing(
            book.compile(parameters, name), plants, contact
        )
    return {
        "law": name,
        "rate_hz": arguments.rate or launch.run.rate,
        **book.description(parameters, name),
        "plant": msgspec.to_builtins(parameters.plant),
        **book.figures(parameters, name, delay),
        **proof,
    }


def _device(arguments: argparse.Namespace) -> dict[str, float]:
    """Return the parameters of the device that the arguments name."""
    options = {
        "mass": "mass",
        "heaviest": "heaviest",
        "damping": "damping",
        "delay": "delay",
        "hand": "stiffness",
    }
    return {
        name: value
        for option, name in options.items()
        if (value := getattr(arguments, option)) is not None
    }
