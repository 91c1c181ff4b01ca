"""List, show and switch the coupling's laws: haptic law switch multi_term."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from messages.errors import UsageError
from nodes.cli.ask import chosen_node, sub_verb
from nodes.cli.law_worlds import world_figures, world_lines
from nodes.cli.main import add_json, answer
from nodes.cli.param import FORCE, forced, receipt_text
from nodes.client.launches import ask
from nodes.laws import law_names
from nodes.parameters.quantities import declare as declare_quantities
from nodes.parameters.quantities import declare_law, positive, whole
from nodes.parameters.yaml_io import parse_yaml

if TYPE_CHECKING:
    from nodes.laws import CompiledLaw
    from nodes.stability.plant import Plant

# Options that describe a law, and a loop, that need not run.
OF_LAW = ("stiffness", "gain", "order", "taps", "gains", "derivative")
OF_LOOP = ("rate", "mass", "heaviest", "damping", "delay", "hand", "launch")
DEFAULTS = {
    "rate": 500.0,
    "mass": 0.1,
    "damping": 1.0,
    "delay": 0.0,
    "hand": 0.0,
}  # the paper's experiment [Hz, kg, N s/m, ticks, N/m]
ROWS = (
    ("h1_n_per_m", "H(1), stiffness felt at rest", "N/m"),
    ("h_nyquist_n_per_m", "H(−1), gain of encoder noise", "N/m"),
    (
        "f_min_n_s_per_m",
        "least f(ω), H(1) as spring (the lower, the more damping)",
        "N s/m",
    ),
    ("f_nyquist_n_s_per_m", "f(ω_N), H(1) as spring", "N s/m"),
    ("damping_needed_n_s_per_m", "device damping needed to be passive", "N s/m"),
    ("delay_ticks", "delay of the loop", "ticks"),
    ("pole_radius", "pole radius (stable below 1)", ""),
)

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
)


_DESCRIBE = (
    "Describe kinds of law without a launch: formula, parameters, judgement, example."
)

LEAK = 0.05  # relative difference between H(1) and K above which a warning is shown


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-verbs."""
    sub = parser.add_subparsers(
        dest="chosen", metavar="describe|list|show|switch", required=True
    )

    def declare(
        name: str, run: Callable[[argparse.Namespace], int], text: str
    ) -> argparse.ArgumentParser:
        own = sub_verb(sub, name, run, text)
        own.add_argument(
            "--node",
            default="coupling",
            help="name of the coupling (default: %(default)s)",
        )
        return own

    describe = sub.add_parser("describe", help=_DESCRIBE, description=_DESCRIBE)
    describe.set_defaults(run=_describe)
    describe.add_argument(
        "kind",
        nargs="?",
        help="kind of law or preset (default: every installed kind, in short)",
    )
    add_json(describe)
    declare(
        "list",
        _list,
        "List the laws that a running coupling can switch to; * marks the active one.",
    )
    switch = declare(
        "switch",
        _switch,
        "Switch the law between two ticks; print what both really render.",
    )
    switch.add_argument("law", help="name of a law, or a mapping {kind: ...}")
    switch.add_argument(
        "--ramp",
        type=whole(0, 100_000),
        metavar="TICKS",
        help="duration of the cross-fade (default: the coupling's parameter)",
    )
    switch.add_argument("--force", action="store_true", help=FORCE)
    _declare_show(
        declare(
            "show",
            _show,
            "Show what a law really renders in the running loop, in a launch file (--launch), or"
            " in a loop described by options.",
        )
    )


def _declare_show(show: argparse.ArgumentParser) -> None:
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


def _describe(arguments: argparse.Namespace) -> int:
    from nodes.laws.described_laws import describe_law, public_kinds
    from nodes.laws.presets import preset_names
    from nodes.parameters.refusals import choices

    if arguments.kind is None:
        found = [describe_law(kind) for kind in public_kinds()]
        lines = [f"{one['kind']:15} {one['formula']}" for one in found]
        lines.append(
            f"presets: {', '.join(preset_names())}; haptic law describe KIND shows more"
        )
        return answer(arguments.json, {"laws": found}, "\n".join(lines))
    known = [*law_names(), *preset_names()]
    if arguments.kind not in known:
        raise UsageError(
            f"{arguments.kind!r} is not an installed law or preset;"
            f" {choices(arguments.kind, known)}"
        )
    described = describe_law(arguments.kind)
    return answer(
        arguments.json, {"laws": [described]}, "\n".join(_described_lines(described))
    )


def _described_lines(described: dict[str, Any]) -> list[str]:
    """Return the description of a kind for a terminal."""
    from nodes.laws.described_laws import calls, limits_text

    rows = []
    for one in described["parameters"]:
        default = (
            "required"
            if one["required"]
            else _short("none" if one["default"] is None else one["default"])
        )
        rows.append(
            (one["name"], one["unit"], limits_text(one), default, one["meaning"])
        )
        for inner in one.get("fields", ()):
            name = f"  {inner['name']}"
            rows.append((name, inner["unit"], limits_text(inner), "", inner["meaning"]))
    widths = [max((len(row[i]) for row in rows), default=0) for i in range(4)]
    lines = [f"{described['kind']}: {described['formula']}"]
    for *cells, meaning in rows:
        shown = "  ".join(
            f"{cell:{wide}}" for cell, wide in zip(cells, widths, strict=True)
        )
        lines.append(f"  {shown}  {meaning}")
    for one in described["parameters"]:
        if "one of those below" in limits_text(one):
            lines.append(
                f"  {one['name']} is one of {', '.join(map(str, one['choices']))}"
            )
    for name, gain in described.get("gains", {}).items():
        lines.append(
            f"  gains {name:10} D^α is multiplied by {gain['gain']} [{gain['unit']}]"
        )
    lines.append(
        f"  stability is judged by {described['judged_by'] or 'nothing known'}"
    )
    if described["presets"]:
        lines.append(f"  presets: {', '.join(described['presets'])}")
    return [*lines, *(f"  {text}" for text in calls(described).values())]


def _list(arguments: argparse.Namespace) -> int:
    run, node = chosen_node(arguments)
    found = ask(run, node, "law.list")
    width = max(map(len, found["laws"]))
    lines = []
    for name, law in found["laws"].items():
        values = ", ".join(
            f"{key} {_short(value)}" for key, value in law.items() if key != "kind"
        )
        lines.append(
            f"{'*' if name == found['active'] else ' '} {name:{width}}  {law['kind']}: {values}"
        )
    if found["active"] not in found["laws"]:
        lines.append(
            f"* {found['active']}: a law failed; choose another with haptic law switch"
        )
    return answer(arguments.json, {"run": run.run, **found}, "\n".join(lines))


def _short(value: Any) -> str:
    if isinstance(value, list) and len(value) > 4:
        return f"[{len(value)} values]"
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return (
            "["
            + "; ".join(
                ", ".join(f"{key} {inner}" for key, inner in term.items())
                for term in value
            )
            + "]"
        )
    return f"{value:g}" if isinstance(value, float) else str(value)


def _table(columns: dict[str, dict[str, Any]]) -> list[str]:
    """Return a table of the figures of one or two laws."""
    wide = max(len(label) for _, label, _ in ROWS)
    lines = []
    if len(columns) > 1:
        lines.append(f"  {'':{wide}}  " + "  ".join(f"{name:>14}" for name in columns))
    for key, label, unit in ROWS:
        values = [figures.get(key) for figures in columns.values()]
        if any(value is not None for value in values):
            shown = "  ".join(
                f"{'—' if value is None else format(value, '.6g'):>14}"
                for value in values
            )
            lines.append(f"  {label:{wide}}  {shown} {unit}".rstrip())
    return lines


def _switch(arguments: argparse.Namespace) -> int:
    run, node = chosen_node(arguments)
    values = {} if arguments.ramp is None else {"ramp": arguments.ramp}
    law: Any = arguments.law
    if law.lstrip().startswith("{"):
        law = parse_yaml(law, "law")
    receipt = ask(run, node, "law.switch", law=law, **values, **forced(arguments))
    lines = [receipt_text(node, receipt)]
    if "was" in receipt:
        lines += _table(
            {
                f"was {receipt['from']}": receipt["was"],
                f"is {receipt['to']}": receipt["is"],
            }
        )
    return answer(
        arguments.json, {"run": run.run, "node": node, **receipt}, "\n".join(lines)
    )


def _show(arguments: argparse.Namespace) -> int:
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
    skipped = {
        *_NO_PARAMETERS,
        "masses_kg",
        "worst_mass_kg",
        *(key for key, _, _ in ROWS),
    }
    parameters = ", ".join(
        f"{key} {_short(value)}"
        for key, value in figures.items()
        if key not in skipped and not key.startswith("f_")
    )
    taps = figures["taps_n_per_m"]
    lines = [
        f"{figures['law']}: {figures.get('kind', '')} {parameters}".rstrip(),
        "  taps"
        f" {', '.join(f'{tap:.6g}' for tap in taps[:8])}"
        + (f", … ({len(taps)})" if len(taps) > 8 else "")
        + " N/m"
        + (
            f", {figures['sections']} recursive sections" if figures["sections"] else ""
        ),
        *_table({"": figures}),
        *world_lines(worlds, max(len(label) for _, label, _ in ROWS)),
    ]
    if "masses_kg" in figures:
        low, high = figures["masses_kg"]
        worst = f"{figures['worst_mass_kg']:.4g} kg"
        lines.append(
            f"  with {worst}, the worst of the device's {low:g} to {high:g} kg"
        )
    lines += _leak(figures)
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


def _leak(figures: dict[str, Any]) -> list[str]:
    """Return a warning if H(1) differs from K because the taps of a short memory leak."""
    nominal = figures.get("stiffness")
    felt = figures["h1_n_per_m"]
    if (
        not isinstance(nominal, int | float)
        or felt is None
        or figures["h_nyquist_n_per_m"] is None
    ):
        return []
    if abs(felt - nominal) <= LEAK * max(abs(nominal), abs(felt)):
        return []
    return [
        f"  warning: H(1) is {felt:.6g} N/m and K {nominal:.6g} N/m, because a short memory leaks:"
        " use more taps, or sections"
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
    from nodes.launcher.launch_file import parse_assignments
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

    from nodes.coupling.law_book import LawBook
    from nodes.coupling.parameters import CouplingParameters, PlantParameters
    from nodes.launcher import launch_file
    from nodes.parameters.store import convert

    launch = launch_file.read(
        arguments.launch, launch_file.parse_assignments(arguments.assignments)
    )
    if arguments.node not in launch.nodes:
        raise UsageError(
            f"{launch.scenario}: no node is named {arguments.node!r}; available:"
            f" {', '.join(launch.nodes)}"
        )
    parameters: CouplingParameters = convert(
        launch.nodes[arguments.node].parameters, CouplingParameters, arguments.node
    )
    options = {
        "mass": "mass",
        "heaviest": "heaviest",
        "damping": "damping",
        "delay": "delay",
        "hand": "stiffness",
    }
    given = {
        name: value
        for option, name in options.items()
        if (value := getattr(arguments, option)) is not None
    }
    if given:
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
    delay = 1.0 if launch.run.apply == "next_tick" else 0.0
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
