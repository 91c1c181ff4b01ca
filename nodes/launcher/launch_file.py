"""Read and check launch files: one YAML per scenario, with arguments.

A launch file has these parts: ``summary``, ``arguments`` (with default, unit, help, limits),
``run`` (rate, pace, apply, duration, axes, scheduling), ``nodes``, and optionally ``model`` (the
purpose of the scene and its intended omissions) and ``include`` (other launch files, each in a
namespace). ``$(var NAME)`` stands for an argument and ``$(dirname)`` for the folder of the launch
file, as in ROS 2. ``run.NAME:=VALUE`` sets a field of ``run`` for which there is no argument, and
``NODE.PATH:=VALUE`` any parameter of a node.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from messages.topics import within
from nodes.base.node_kinds import load, node_kinds
from nodes.base.setup import Axis
from nodes.launcher.given_law import with_named_law
from nodes.launcher.launch_spec import (
    Include,
    Including,
    Launch,
    LaunchText,
    Model,
    NodeSpec,
    RunSpec,
)
from nodes.launcher.node_parameters import is_node_parameter, places, with_parameters
from nodes.launcher.origins import Origins
from nodes.launcher.plants import with_plants
from nodes.launcher.scenario_files import (
    DEVICE,
    RUN,
    beside,
    fill_in,
    find,
    offered_arguments,
    substitute,
)
from nodes.launcher.usual_arguments import with_gain, with_usual
from nodes.parameters.interface_words import interface
from nodes.parameters.refusals import choices
from nodes.parameters.store import ParameterError, convert, merge, of_node
from nodes.parameters.yaml_io import read_yaml

_NAME = re.compile(r"(?=.{1,32}$)[a-z][a-z0-9_]*(/[a-z][a-z0-9_]*)*")
LISTED = "run"  # reserved: a node of this name would overwrite run.json


def read(
    name: str,
    given: Mapping[str, Any],
    laid_over: Sequence[Path] = (),
    including: Including | None = None,
) -> Launch:
    """Read a launch file, substitute its arguments and apply files of parameters.

    `given`: arguments that differ from their defaults; every launch file also accepts ``tick`` and
    ``run.NAME`` (see `RunSpec`), ``NODE.PATH`` (`nodes.launcher.node_parameters`), and ``device``
    if it has a virtual device. `laid_over`: YAML
    files that map nodes to some or all parameters, as ``haptic param dump`` and ``haptic study
    design`` write them; later files take precedence. `including`: the files that include this one.
    """
    path = find(name)
    outermost = including is None
    including = (including or Including()).another(path, name)
    data = read_yaml(path)
    given = with_gain(data, given)
    origins = Origins(
        path, given, data.get("nodes") or {} if isinstance(data, dict) else {}
    )
    try:
        launch = _read(path, data, given, laid_over, origins, including)
        # An including file may still change the device, so only the outermost fills in plants.
        return with_plants(launch) if outermost else launch
    except ParameterError as error:
        raise ParameterError(origins.located(error)) from error


def _read(
    path: Path,
    data: Any,
    given: Mapping[str, Any],
    laid_over: Sequence[Path],
    origins: Origins,
    including: Including,
) -> Launch:
    file = convert(with_usual(data), LaunchText, path.name)
    # Every launch file accepts ``run.NAME`` and ``tick``.
    over = {
        name
        for name in given
        if name.startswith(RUN) or (name == "tick" and name not in file.arguments)
    }
    over_run = {name.removeprefix(RUN): given[name] for name in over}
    declared = {
        **(offered_arguments(path, file, Including()) if DEVICE in given else {}),
        **file.arguments,
    }
    values = fill_in(
        path,
        declared,
        {
            name: value
            for name, value in given.items()
            if name not in over and not is_node_parameter(name)
        },
    )
    included = [
        _include(entry, values, f"{path.name}.include[{i}]", origins, including)
        for i, entry in enumerate(file.include)
    ]
    nodes = _nodes(path, file, values, origins, included)
    for written in laid_over:
        tree = _by_node(written, nodes, path.name)
        origins.laid_over(written)
        for node, parameters in tree.items():
            merged = merge(nodes[node].parameters, parameters)
            nodes[node] = msgspec.structs.replace(nodes[node], parameters=merged)
    for node, spec in nodes.items():
        if spec.watch:
            watched = _watched(node, spec, f"{path.name}.nodes.{node}")
            nodes[node] = msgspec.structs.replace(spec, parameters=watched)
    if DEVICE not in file.arguments and (device := values.get(DEVICE, "none")) not in (
        "",
        "none",
    ):
        nodes = _with_device(nodes, device, path.name)
    for name, node, place in places(given):
        origins.filled_in(f"nodes.{node}.parameters.{place}", name)
    nodes = with_parameters(nodes, given, path.name)
    nodes = {node: with_named_law(spec, node) for node, spec in nodes.items()}
    written_run = {
        **substitute(file.run, values, f"{path.name}.run", origins),
        **over_run,
    }
    run = convert(
        {**_common_run(included, written_run, path.name), **written_run},
        RunSpec,
        f"{path.name}.run",
    )
    run, axes = _axes(run, nodes, included, path.name)
    return Launch(
        scenario=path.stem,
        summary=file.summary,
        path=str(path),
        text=path.read_text(encoding="utf-8"),
        arguments=values,
        run=run,
        nodes=nodes,
        axes=axes,
        model=file.model,
        models=_models(included),
        origins=origins,
    )


def _with_device(
    nodes: Mapping[str, NodeSpec], device: str, where: str
) -> dict[str, NodeSpec]:
    """Replace every virtual device, and the plant of its coupling, by a real `device`."""
    kinds = node_kinds()
    found = dict(nodes)
    plants: dict[str, dict[str, Any]] = {}
    for name, spec in nodes.items():
        stood = load(kinds[spec.kind]).substitute_device(spec.parameters, name, device)
        if stood is not None:
            parameters, plants[name.rpartition("/")[0]] = stood
            found[name] = msgspec.structs.replace(spec, parameters=parameters)
    if not plants:
        raise ParameterError(
            f"{interface.get().argument(DEVICE, device)}: no node of it has a virtual device; leave"
            " it out",
            path=where,
        )
    for name, spec in found.items():
        plant = plants.get(name.rpartition("/")[0])
        if plant is not None and isinstance(spec.parameters.get("plant"), Mapping):
            found[name] = msgspec.structs.replace(
                spec, parameters=merge(spec.parameters, {"plant": plant})
            )
    return found


def _nodes(
    path: Path,
    file: LaunchText,
    values: Mapping[str, Any],
    origins: Origins,
    included: Sequence[tuple[str, Launch]],
) -> dict[str, NodeSpec]:
    """Return the nodes of included files, then the file's own."""
    nodes: dict[str, NodeSpec] = {}
    kinds = node_kinds()
    for namespace, launch in included:
        for name, spec in launch.nodes.items():
            full = f"{namespace}/{name}" if namespace else name
            if not _NAME.fullmatch(full) or full in nodes:
                why = (
                    "exists twice; give one a namespace"
                    if full in nodes
                    else "is longer than 32 letters"
                )
                raise ParameterError(
                    f"{launch.scenario}: node {full!r} {why}",
                    path=f"{path.name}.include",
                )
            remap = {
                topic: within(namespace, instead)
                for topic, instead in spec.remap.items()
            }
            nodes[full] = msgspec.structs.replace(spec, remap=remap)
    for node, spec in file.nodes.items():
        where = f"{path.name}.nodes.{node}"
        if not _NAME.fullmatch(node):
            raise ParameterError(
                "a node's name has lower-case letters, digits and _, with namespace and /"
                " before it, at most 32",
                path=where,
            )
        if node == LISTED:
            raise ParameterError(
                f"{LISTED!r} is reserved for the list of a run's nodes; choose another"
                " name, or a namespace",
                path=where,
            )
        if node in nodes:
            raise ParameterError(
                "an included launch file has a node of that name; give it a namespace",
                path=where,
            )
        nodes[node] = made = convert(
            substitute(spec, values, where, origins), NodeSpec, where
        )
        if made.kind not in kinds:
            raise ParameterError(
                f"{made.kind!r} is not installed; {choices(made.kind, sorted(kinds))}",
                path=f"{where}.kind",
            )
    if not nodes:
        raise ParameterError(
            "no nodes: add them under nodes, or other launch files under include",
            path=path.name,
        )
    return nodes


def _include(
    entry: Any,
    values: Mapping[str, Any],
    where: str,
    origins: Origins,
    including: Including,
) -> tuple[str, Launch]:
    """Read an included launch file; return its namespace and content."""
    made: Include = convert(substitute(entry, values, where, origins), Include, where)
    if made.namespace and not _NAME.fullmatch(made.namespace):
        raise ParameterError(
            f"{made.namespace!r}: lower-case letters, digits and _, without a / around, at most 32",
            path=f"{where}.namespace",
        )
    try:
        launch = without(
            read(
                beside(including.files[-1], made.launch), made.arguments, (), including
            ),
            made.without,
        )
    except ParameterError as error:
        raise ParameterError(str(error), path=where) from error
    nodes = dict(launch.nodes)
    for node, over in made.parameters.items():
        if node not in nodes:
            raise ParameterError(
                f"no node {node!r}; {choices(node, nodes)}", path=f"{where}.parameters"
            )
        nodes[node] = msgspec.structs.replace(
            nodes[node], parameters=merge(nodes[node].parameters, over)
        )
    return made.namespace, msgspec.structs.replace(launch, nodes=nodes)


def _common_run(
    included: Sequence[tuple[str, Launch]], written: Mapping[str, Any], where: str
) -> dict[str, Any]:
    """Return fields of ``run`` from the included files, which must agree, if not set here."""
    found: dict[str, Any] = {}
    for _, launch in included:
        for name in set(RunSpec.__struct_fields__) - set(written) - {"axes"}:
            value = getattr(launch.run, name)
            if found.setdefault(name, value) != value:
                raise ParameterError(
                    f"the included files differ: {found[name]} and {value}; set it in this file",
                    path=f"{where}.run.{name}",
                )
    return found


def _models(included: Sequence[tuple[str, Launch]]) -> dict[str, Model]:
    """Return the model of each included chain, by namespace; without one, this file's applies."""
    found = {}
    for namespace, launch in included:
        for inner in dict.fromkeys(name.rpartition("/")[0] for name in launch.nodes):
            if chain := "/".join(filter(None, (namespace, inner))):
                found[chain] = launch.models.get(inner) or launch.model
    return found


def _axes(
    run: RunSpec,
    nodes: Mapping[str, NodeSpec],
    included: Sequence[tuple[str, Launch]],
    where: str,
) -> tuple[RunSpec, dict[str, list[Axis]]]:
    """Return ``run`` with the first chain's axes, and the axes of other chains by namespace."""
    if len(set(run.axes)) < len(run.axes):
        raise ParameterError(
            f"[{', '.join(run.axes)}]: an axis is given twice", path=f"{where}.run.axes"
        )
    if run.axes:
        return run, {}
    kinds = node_kinds()
    axes = {}
    for namespace, launch in included:
        for inner in dict.fromkeys(name.rpartition("/")[0] for name in launch.nodes):
            axes["/".join(filter(None, (namespace, inner)))] = (
                launch.axes.get(inner) or launch.run.axes
            )
    for namespace in dict.fromkeys(name.rpartition("/")[0] for name in nodes):
        chain = {
            name: spec
            for name, spec in nodes.items()
            if name.rpartition("/")[0] == namespace
        }
        wanted = dict.fromkeys(
            axis
            for node, spec in chain.items()
            for axis in load(kinds[spec.kind]).axes(spec.parameters, node)
        )
        if wanted:
            axes.setdefault(namespace, list(wanted))
    first: list[Axis] = next(iter(axes.values()), ["z"])
    return msgspec.structs.replace(run, axes=first), {
        name: own for name, own in axes.items() if own != first
    }


def without(launch: Launch, left_out: list[str]) -> Launch:
    """Return the launch without some nodes."""
    for name in left_out:
        if name not in launch.nodes:
            raise ParameterError(
                f"no node {name!r}; {choices(name, launch.nodes)}",
                path=f"{launch.scenario}.nodes",
            )
    return msgspec.structs.replace(
        launch,
        nodes={
            name: spec for name, spec in launch.nodes.items() if name not in left_out
        },
    )


def _by_node(written: Path, nodes: Mapping[str, Any], where: str) -> dict[str, Any]:
    tree = read_yaml(written)
    if not isinstance(tree, dict) or not tree:
        raise ParameterError(
            f"expected a mapping from node to parameters, got {str(tree)[:100]!r}",
            path=str(written),
        )
    for node, parameters in tree.items():
        if node not in nodes:
            raise ParameterError(
                f"{where} has no node {node!r}; {choices(node, nodes)}",
                path=str(written),
            )
        if not isinstance(parameters, dict):
            raise ParameterError(
                f"expected a mapping of parameters, got {str(parameters)[:100]!r}",
                path=f"{written}.{node}",
            )
    return tree


def _watched(node: str, spec: NodeSpec, where: str) -> dict[str, Any]:
    if not Path(spec.watch).is_file():
        raise ParameterError(
            f"{spec.watch}: no such file; write one with haptic param dump {node}",
            path=f"{where}.watch",
        )
    merged: dict[str, Any] = merge(
        spec.parameters, of_node(read_yaml(spec.watch), node)
    )
    return merged
