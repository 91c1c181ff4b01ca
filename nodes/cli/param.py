"""Read, describe, change, save and load parameters of running nodes.

Example: ``haptic param set coupling laws.pd.stiffness 1500``.
"""

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from messages.errors import RefusedError, UsageError
from nodes.base.node_kinds import load
from nodes.cli.ask import chosen_node, chosen_run, sub_verb
from nodes.cli.main import answer
from nodes.client.launches import ask, node_name
from nodes.environment.surfaces import SURFACES
from nodes.laws.base import LAWS
from nodes.laws.presets import PRESETS
from nodes.parameters.describe import described, names_below
from nodes.parameters.refusals import cut
from nodes.parameters.store import ParameterError
from nodes.parameters.yaml_io import parse_yaml, read_yaml, write_yaml

FORCE = "apply the change even if the loop becomes unstable, for studies of instability"

CHANGES_SHOWN = 8  # changes printed one by one
VALUE_LENGTH = 60  # length to which a printed value is shortened [characters]


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the sub-verbs."""
    sub = parser.add_subparsers(
        dest="chosen", metavar="list|get|set|describe|dump|load", required=True
    )
    listing = sub_verb(sub, "list", _list, "List the parameters of a node, or of all.")
    listing.add_argument("node", nargs="?", help="name of the node (default: all)")

    def declare(
        name: str, run: Callable[[argparse.Namespace], int], text: str
    ) -> argparse.ArgumentParser:
        own = sub_verb(sub, name, run, text)
        own.add_argument("node")
        return own

    get = declare("get", _get, "Read one parameter, or a group of parameters.")
    get.add_argument(
        "name", help="e.g. laws.pd.stiffness, or laws.multi_term.terms[0].gain"
    )
    change = declare(
        "set",
        _set,
        "Change parameters while the loop runs; several are applied together or not at all.",
    )
    change.add_argument(
        "pairs",
        nargs="*",
        metavar="NAME VALUE",
        help="parameter and YAML value, e.g. laws.pd.stiffness 1500",
    )
    describe = declare(
        "describe",
        _describe,
        "Describe parameters: type, unit, limits, default, meaning.",
    )
    describe.add_argument(
        "names", nargs="*", metavar="NAME", help="e.g. laws.pd.stiffness (default: all)"
    )
    dump = declare(
        "dump",
        _dump,
        "Write all parameters of a node as YAML, for load or a launch file.",
    )
    dump.add_argument(
        "--out", "-o", type=Path, metavar="FILE", help="write to a new file"
    )
    load = declare(
        "load",
        _load,
        "Apply a YAML file, complete or partial, to a node's parameters; all or nothing.",
    )
    load.add_argument(
        "file", help="file written by dump or a study; - for standard input"
    )
    for own in (change, load):
        own.add_argument("--force", action="store_true", help=FORCE)


def _flow(value: Any) -> str:
    return write_yaml(value, width=1_000_000).removesuffix("...\n").strip()


def _list(arguments: argparse.Namespace) -> int:
    run = chosen_run(arguments)
    names = [node_name(run, arguments.node)] if arguments.node else list(run.nodes)
    found = {name: ask(run, name, "param.list") for name in names}
    lines = []
    for name, values in found.items():
        lines.append(f"/{name}:")
        lines += [f"  {path}: {_flow(value)}" for path, value in values.items()] or [
            "  (none)"
        ]
    return answer(arguments.json, {"run": run.run, "nodes": found}, "\n".join(lines))


def _get(arguments: argparse.Namespace) -> int:
    run, node = chosen_node(arguments)
    value = ask(run, node, "param.get", name=arguments.name)
    return answer(
        arguments.json,
        {"run": run.run, "node": node, "name": arguments.name, "value": value},
        _flow(value),
    )


def _set(arguments: argparse.Namespace) -> int:
    words = arguments.pairs
    if not words:
        raise UsageError(f"param set: expected NODE NAME VALUE{_meant(arguments.node)}")
    run, node = chosen_node(arguments)
    if len(words) % 2:
        name, sign, value = words[-1].partition("=")
        meant = f"; did you mean {name.rstrip(':')} {value}?" if sign else ""
        raise UsageError(
            f"param set {node}: {words[-1]!r} has no value; expected pairs NAME VALUE{meant}"
        )
    values: dict[str, Any] = {}
    for name, text in zip(words[::2], words[1::2], strict=True):
        if name in values:
            raise UsageError(f"param set {node}: {name} is given twice")
        values[name] = parse_yaml(text, f"{node}.{name}")
    receipt = ask(run, node, "param.set", values=values, **forced(arguments))
    return answer(
        arguments.json,
        {"run": run.run, "node": node, "values": values, "receipt": receipt},
        receipt_text(node, receipt),
    )


def _meant(word: str) -> str:
    """Return what was probably meant by NODE.NAME=VALUE in one word, as a launch takes it."""
    place, sign, value = word.partition("=")
    node, dot, name = place.rstrip(":").partition(".")
    return f"; did you mean {node} {name} {value or 'VALUE'}?" if sign or dot else ""


def receipt_text(node: str, receipt: dict[str, Any]) -> str:
    """Return the text of a receipt."""
    changes = [
        f"{path} {_short(old)} → {_short(new)}"
        for path, (old, new) in receipt.get("changed", {}).items()
    ]
    lines = [
        f"/{node}: {changes[0] if changes else 'nothing changed'} from tick {receipt['seq']} on"
    ]
    if "force_step_n" in receipt:
        laws = (
            f"{receipt['from']} → {receipt['to']}"
            if receipt["from"] != receipt["to"]
            else receipt["to"]
        )
        fade = f", cross-fade of {receipt['ramp']} ticks" if receipt["ramp"] else ""
        lines[0] += f", law {laws}, force step {receipt['force_step_n']:.3g} N{fade}"
    lines += [f"  {change}" for change in changes[1:CHANGES_SHOWN]]
    lines += (
        [f"  and {len(changes) - CHANGES_SHOWN} more"]
        if len(changes) > CHANGES_SHOWN
        else []
    )
    return "\n".join([*lines, *_stability(receipt)])


def _short(value: Any) -> str:
    return cut("none" if value is None else _flow(value), VALUE_LENGTH)


def _stability(receipt: dict[str, Any]) -> list[str]:
    worlds = [f"  {text}" for text in receipt.get("world", ())]
    found = receipt.get("stability")
    if not found:
        return worlds
    if found["why"]:
        return [f"  stability not judged: {found['why']}", *worlds]
    before = (
        "" if found["was_pole_radius"] is None else f"{found['was_pole_radius']:.4g} → "
    )
    now = (
        "stable below 1" if found["stable"] else "UNSTABLE: applied because of --force"
    )
    of_law = (
        "" if found.get("law") in (None, receipt.get("to")) else f" of {found['law']}"
    )
    return [
        f"  pole radius{of_law} {before}{found['pole_radius']:.4g} ({now}) at a delay of"
        f" {found['delay_ticks']:.3g} ticks",
        *worlds,
    ]


def forced(arguments: argparse.Namespace) -> dict[str, bool]:
    """Return ``force`` only if --force was given, as nodes in other languages may lack it."""
    return {"force": True} if arguments.force else {}


def _struct_of(kind: str) -> type[Any] | None:
    """Return the struct of an installed law, preset or surface; None for anything else."""
    kind = str(PRESETS.get(kind, {"kind": kind})["kind"])
    return next(
        (
            registry.load(kind)
            for registry in (LAWS, SURFACES)
            if kind in registry.names()
        ),
        None,
    )


def _describe(arguments: argparse.Namespace) -> int:
    run, node = chosen_node(arguments)
    values = ask(run, node, "param.dump")
    names = arguments.names or list(ask(run, node, "param.list"))
    parameters = load(run.nodes[node].factory).Parameters
    found = {}
    for name in names:
        try:
            found[name] = described(parameters, values, name, _struct_of)
            for below in names_below(parameters, values, name, _struct_of) * bool(
                arguments.names
            ):
                found[below] = described(parameters, values, below, _struct_of)
        except ParameterError as error:
            raise UsageError(f"{node}.{error}") from error
    lines = []
    for name, what in found.items():
        default = "required" if what.required else f"default {_flow(what.default)}"
        kind = f"{what.type} [{what.unit}]" if what.unit else what.type
        lines.append(f"{name}: {', '.join(filter(None, (kind, what.limits, default)))}")
        lines += [f"  {what.meaning}"] if what.meaning else []
    figures = {"run": run.run, "node": node, "parameters": msgspec.to_builtins(found)}
    return answer(
        arguments.json, figures, "\n".join(lines) or f"{node} has no parameters"
    )


def _dump(arguments: argparse.Namespace) -> int:
    run, node = chosen_node(arguments)
    parameters = ask(run, node, "param.dump")
    text = write_yaml({node: parameters})
    if arguments.out is not None:
        try:
            with open(arguments.out, "x", encoding="utf-8") as file:
                file.write(text)
        except OSError as error:
            raise RefusedError(f"{arguments.out}: {error.strerror}") from error
        text = f"{arguments.out}\n"
    return answer(
        arguments.json,
        {"run": run.run, "node": node, "parameters": parameters},
        text.rstrip("\n"),
    )


def _load(arguments: argparse.Namespace) -> int:
    run, node = chosen_node(arguments)
    try:
        values = (
            parse_yaml(sys.stdin.read(), "-")
            if arguments.file == "-"
            else read_yaml(arguments.file)
        )
    except (ParameterError, UnicodeDecodeError) as error:
        raise UsageError(str(error)) from error
    receipt = ask(run, node, "param.load", values=values, **forced(arguments))
    return answer(
        arguments.json,
        {"run": run.run, "node": node, "file": arguments.file, "receipt": receipt},
        receipt_text(node, receipt),
    )
