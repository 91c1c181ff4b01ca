"""Launch files: one YAML per scenario, with arguments, checked completely before anything is started.

A launch file has these parts: ``summary``, ``arguments`` (with default, unit, help, limits), ``run`` (rate, pace, apply,
duration, axes, scheduling), ``nodes``, and where it matters ``model`` (what the scene is for, what it leaves out on
purpose). ``$(var NAME)`` stands for an argument and ``$(dirname)`` for the folder of the launch file, as in ROS 2.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import msgspec

from nodes.base.kinds import load, node_kinds
from nodes.launcher import stand_in
from nodes.launcher.launch_spec import Argument, Launch, LaunchText, NodeSpec, RunSpec
from nodes.launcher.origins import Origins
from nodes.parameters.refusals import choices
from nodes.parameters.registry import Registry
from nodes.parameters.store import ParameterError, convert, merge, of_node
from nodes.parameters.yaml_io import parse_yaml, read_yaml

__all__ = [
    "COLLECTIONS",
    "find",
    "launch_dirs",
    "parse_assignments",
    "read",
    "read_arguments",
    "scenarios",
    "without",
]

COLLECTIONS = Registry("haptic.launch", "collection of scenarios")
"""What adds scenarios: each names a package with launch files in it, which is not imported."""

_KINDS = {float: "a number", int: "a whole number", str: "text", bool: "true or false", list: "a list"}
_WHOLE = re.compile(r"^\$\(var ([A-Za-z_][A-Za-z0-9_]*)\)$")
_WITHIN = re.compile(r"\$\(var ([A-Za-z_][A-Za-z0-9_]*)\)")
_NAME = re.compile(r"^[a-z][a-z0-9_]{0,31}$")


def launch_dirs() -> list[Path]:
    """List where launch files are looked up.

    Returns
    -------
    list of Path
        In the wheel, beside the package, then in each installed package named under the entry points ``haptic.launch``.
    """
    nodes = Path(__file__).resolve().parents[1]
    specs = [find_spec(point.value) for point in COLLECTIONS.points().values()]
    added = [Path(place) for spec in specs if spec for place in spec.submodule_search_locations or ()]
    return [path for path in (nodes / "_launch", nodes.parent / "launch", *added) if path.is_dir()]


def scenarios() -> dict[str, Path]:
    """List the launch files that are installed.

    Returns
    -------
    dict of str to Path
        Scenario to file, sorted; this project's go before those of other packages.
    """
    found = {path.stem: path for folder in reversed(launch_dirs()) for path in folder.glob("*.yaml")}
    return dict(sorted(found.items()))


def find(name: str) -> Path:
    """Find a launch file.

    Parameters
    ----------
    name : str
        A scenario of the project, or the path of a YAML file.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    ParameterError
        When there is none; the text lists what there is.
    """
    known = scenarios()
    if name in known:
        return known[name]
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or os.sep in name:
        if path.is_file():
            return path
        raise ParameterError(f"{name}: {'is a directory, expected a launch file' if path.is_dir() else 'no such file'}")
    raise ParameterError(f"no launch file is named {name!r}; {choices(name, known)}")


def read_arguments(path: Path) -> tuple[str, dict[str, Argument]]:
    """Read only what a launch file says about itself.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    tuple of str and dict
        Summary, and arguments by name.
    """
    file = convert(read_yaml(path), LaunchText, path.name)
    return file.summary, {**stand_in.offered(file.nodes), **file.arguments}


def parse_assignments(words: list[str]) -> dict[str, Any]:
    """Read ``name:=value`` words.

    Parameters
    ----------
    words : list of str
        As typed.

    Returns
    -------
    dict of str to object
        Values as YAML reads them.

    Raises
    ------
    ParameterError
        When a word is not of that form.
    """
    values = {}
    for word in words:
        name, sign, text = word.partition(":=")
        if not sign:
            raise ParameterError(f"{word!r}: expected name:=value")
        values[name] = parse_yaml(text, name) if text else ""
    return values


def _fill_in(path: Path, arguments: Mapping[str, Argument], given: Mapping[str, Any]) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name in given:
        if name not in arguments:
            raise ParameterError(
                f"{path.name}: no argument {name!r}; {choices(name, arguments)} (haptic launch --show-args {path.stem})"
            )
    for name, argument in arguments.items():
        value = given.get(name, argument.default)
        where = f"{path.name}.arguments.{name}"
        kind = type(argument.default)
        if kind is float and type(value) is int:
            value = float(value)
        if kind is str and isinstance(value, (int, float)):
            value = str(value)
        if type(value) is not kind:
            raise ParameterError(f"{where}: expected {_KINDS.get(kind, kind.__name__)}, got {value!r}")
        unit = f" {argument.unit}" if argument.unit else ""
        if argument.min is not None and isinstance(value, (int, float)) and not value >= argument.min:
            raise ParameterError(f"{where}: {value!r}{unit}, limit: at least {argument.min:g}{unit}")
        if argument.max is not None and isinstance(value, (int, float)) and not value <= argument.max:
            raise ParameterError(f"{where}: {value!r}{unit}, limit: at most {argument.max:g}{unit}")
        if argument.choices and value not in argument.choices:
            raise ParameterError(f"{where}: {value!r}, expected one of {', '.join(argument.choices)}")
        values[name] = value
    return values


def _substitute(data: Any, values: Mapping[str, Any], where: str, origins: Origins) -> Any:
    if isinstance(data, dict):
        return {key: _substitute(inner, values, f"{where}.{key}", origins) for key, inner in data.items()}
    if isinstance(data, list):
        return [_substitute(inner, values, f"{where}[{i}]", origins) for i, inner in enumerate(data)]
    if isinstance(data, str):
        data = data.replace("$(dirname)", origins.folder)
        for name in _WITHIN.findall(data):
            if name not in values:
                raise ParameterError(f"{where}: $(var {name}) is not an argument; {choices(name, values)}")
            origins.filled_in(where, name)
        whole = _WHOLE.match(data)
        if whole:
            return values[whole.group(1)]
        return _WITHIN.sub(lambda match: str(values[match.group(1)]), data)
    return data


def read(name: str, given: Mapping[str, Any], laid_over: Sequence[Path] = ()) -> Launch:
    """Read a launch file, fill in its arguments and lay files of parameters over those of its nodes.

    Parameters
    ----------
    name : str
        Scenario or path.
    given : mapping of str to object
        Arguments that differ from their defaults; every launch file has ``tick`` (see `RunSpec`), and each with a virtual
        device ``device`` (`nodes.launcher.stand_in`).
    laid_over : sequence of Path
        YAML files, each a mapping from node to parameters, whole or in part, as ``haptic param dump`` and
        ``haptic study design`` write them; a later one goes before an earlier one.

    Returns
    -------
    Launch
        Ready to be started.

    Raises
    ------
    ParameterError
        With the path, the value and the limit of whatever is wrong.
    """
    path = find(name)
    data = read_yaml(path)
    origins = Origins(path, given, data.get("nodes") or {} if isinstance(data, dict) else {})
    try:
        return _read(path, data, given, laid_over, origins)
    except ParameterError as error:
        raise ParameterError(origins.located(str(error))) from error


def _read(path: Path, data: Any, given: Mapping[str, Any], laid_over: Sequence[Path], origins: Origins) -> Launch:
    file = convert(data, LaunchText, path.name)
    tick = {} if "tick" in file.arguments else {"tick": given["tick"]} if "tick" in given else {}
    declared = {**(stand_in.offered(file.nodes) if stand_in.DEVICE in given else {}), **file.arguments}
    values = _fill_in(path, declared, {name: value for name, value in given.items() if name not in tick})
    over = [_by_node(written, file.nodes, path.name) for written in laid_over]
    for written in laid_over:
        origins.laid_over(written)
    run = convert({**_substitute(file.run, values, f"{path.name}.run", origins), **tick}, RunSpec, f"{path.name}.run")
    nodes = {}
    kinds = node_kinds()
    for node, spec in file.nodes.items():
        where = f"{path.name}.nodes.{node}"
        if not _NAME.match(node):
            raise ParameterError(f"{where}: a node's name is lower-case letters, digits and _, at most 32")
        made: NodeSpec = convert(_substitute(spec, values, where, origins), NodeSpec, where)
        if made.kind not in kinds:
            raise ParameterError(f"{where}.kind: {made.kind!r} is not installed; {choices(made.kind, sorted(kinds))}")
        for tree in over:
            made = msgspec.structs.replace(made, parameters=merge(made.parameters, tree.get(node, {})))
        if made.watch:
            made = msgspec.structs.replace(made, parameters=_watched(node, made, where))
        nodes[node] = made
    device = "none" if stand_in.DEVICE in file.arguments else values.get(stand_in.DEVICE, "none")
    if device not in stand_in.NONE:
        nodes = stand_in.stand_in(nodes, device, path.name)
    if not run.axes:
        wanted = dict.fromkeys(
            axis for node, spec in nodes.items() for axis in load(kinds[spec.kind]).axes(spec.parameters, node)
        )
        run = msgspec.structs.replace(run, axes=list(wanted) or ["z"])
    elif len(set(run.axes)) < len(run.axes):
        raise ParameterError(f"{path.name}.run.axes: [{', '.join(run.axes)}]: an axis stands twice")
    return Launch(
        scenario=path.stem,
        summary=file.summary,
        path=str(path),
        text=path.read_text(encoding="utf-8"),
        arguments=values,
        run=run,
        nodes=nodes,
        model=file.model,
        origins=origins,
    )


def without(launch: Launch, left_out: list[str]) -> Launch:
    """Leave nodes out of a launch.

    Parameters
    ----------
    launch : Launch
        The launch.
    left_out : list of str
        Names of nodes.

    Returns
    -------
    Launch
        The same launch without them.

    Raises
    ------
    ParameterError
        When a node is not there.
    """
    for name in left_out:
        if name not in launch.nodes:
            raise ParameterError(f"{launch.scenario}.nodes: no node {name!r}; {choices(name, launch.nodes)}")
    return msgspec.structs.replace(
        launch, nodes={name: spec for name, spec in launch.nodes.items() if name not in left_out}
    )


def _by_node(written: Path, nodes: Mapping[str, Any], where: str) -> dict[str, Any]:
    tree = read_yaml(written)
    if not isinstance(tree, dict) or not tree:
        raise ParameterError(f"{written}: expected a mapping from node to parameters, got {str(tree)[:100]!r}")
    for node, parameters in tree.items():
        if node not in nodes:
            raise ParameterError(f"{written}: {where} has no node {node!r}; {choices(node, nodes)}")
        if not isinstance(parameters, dict):
            raise ParameterError(f"{written}.{node}: expected a mapping of parameters, got {str(parameters)[:100]!r}")
    return tree


def _watched(node: str, spec: NodeSpec, where: str) -> dict[str, Any]:
    if not Path(spec.watch).is_file():
        raise ParameterError(f"{where}.watch: {spec.watch}: no such file; write one with haptic param dump {node}")
    merged: dict[str, Any] = merge(spec.parameters, of_node(read_yaml(spec.watch), node))
    return merged
