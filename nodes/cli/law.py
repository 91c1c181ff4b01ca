"""List, show and switch the coupling's laws: haptic law switch multi_term."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Any

from messages.errors import UsageError
from nodes.cli.ask import chosen_node, sub_verb
from nodes.cli.law_figures import figure_table, short_value
from nodes.cli.law_show import declare_show, show
from nodes.cli.main import add_json, answer
from nodes.cli.param import FORCE, forced, receipt_text
from nodes.client.launches import ask
from nodes.laws import law_names
from nodes.parameters.quantities import whole
from nodes.parameters.yaml_io import parse_yaml

_DESCRIBE = (
    "Describe kinds of law without a launch: formula, parameters, judgement, example."
)


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-verbs."""
    sub = parser.add_subparsers(
        dest="chosen", metavar="describe|list|show|switch", required=True
    )

    def declare(
        name: str, run: Callable[[argparse.Namespace], int], text: str
    ) -> argparse.ArgumentParser:
        own = sub_verb(sub, name, run, text)
        own.add_argument("--node", default="coupling", help="name of the coupling")
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
    declare_show(
        declare(
            "show",
            show,
            "Show what a law really renders in the running loop, in a launch file (--launch), or"
            " in a loop described by options.",
        )
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
            else short_value("none" if one["default"] is None else one["default"])
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
            f"{key} {short_value(value)}" for key, value in law.items() if key != "kind"
        )
        lines.append(
            f"{'*' if name == found['active'] else ' '} {name:{width}}  {law['kind']}: {values}"
        )
    if found["active"] not in found["laws"]:
        lines.append(
            f"* {found['active']}: a law failed; choose another with haptic law switch"
        )
    return answer(arguments.json, {"run": run.run, **found}, "\n".join(lines))


def _switch(arguments: argparse.Namespace) -> int:
    run, node = chosen_node(arguments)
    values = {} if arguments.ramp is None else {"ramp": arguments.ramp}
    law: Any = arguments.law
    if law.lstrip().startswith("{"):
        law = parse_yaml(law, "law")
    receipt = ask(run, node, "law.switch", law=law, **values, **forced(arguments))
    lines = [receipt_text(node, receipt)]
    if "was" in receipt:
        lines += figure_table(
            {
                f"was {receipt['from']}": receipt["was"],
                f"is {receipt['to']}": receipt["is"],
            }
        )
    return answer(
        arguments.json, {"run": run.run, "node": node, **receipt}, "\n".join(lines)
    )
