"""Read and check launch files: one YAML per scenario, with arguments.

A launch file has these parts: ``summary``, ``arguments`` (with default, unit, help, limits),
``run`` (rate, pace, apply, duration, axes, scheduling), ``nodes``, and optionally ``model`` (the
purpose of the scene and its intended omissions) and ``include`` (other launch files, each in a
namespace). ``$(var NAME)`` stands for an argument and ``$(dirname)`` for the folder of the launch
file, as in ROS 2. ``run.NAME:=VALUE`` sets a field of ``run`` for which there is no argument, and
``NODE.PATH:=VALUE`` any parameter of a node.
"""

import contextlib
import os
import re
from collections.abc import Mapping, Sequence
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import msgspec

from messages.topics import within
from nodes.base.node import Node
from nodes.base.node_kinds import load, node_kinds
from nodes.base.setup import Axis
from nodes.launcher.given_law import with_named_law
from nodes.launcher.launch_spec import (
    Argument,
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
from nodes.launcher.usual_arguments import with_gain, with_usual
from nodes.parameters.refusals import choices, find_misfit
from nodes.parameters.registry import Registry
from nodes.parameters.store import ParameterError, convert, merge, of_node
from nodes.parameters.yaml_io import parse_yaml, read_yaml

# Names of packages with launch files; they are not imported.
COLLECTIONS = Registry("haptic.launch", "collection of scenarios")
_WHOLE = re.compile(r"^\$\(var ([A-Za-z_][A-Za-z0-9_]*)\)$")
_WITHIN = re.compile(r"\$\(var ([A-Za-z_][A-Za-z0-9_]*)\)")
_NAME = re.compile(r"(?=.{1,32}$)[a-z][a-z0-9_]*(/[a-z][a-z0-9_]*)*")
_RUN = "run."
LISTED = "run"  # reserved: a node of this name would overwrite run.json

DEVICE = "device"  # argument that replaces a virtual device by a real one
_DEVICE = Argument(
    default="none",
    help="real device whose known values are used: haptic device presets",
)

# Limit of a text after substitution, a path's length: nested arguments could produce gigabytes.
MAX_FILLED_IN = 4096


def launch_dirs() -> list[Path]:
    """Return the folders with launch files: in the wheel, beside it, in other packages.

    Other packages register theirs under the entry points ``haptic.launch``.
    """
    nodes = Path(__file__).resolve().parents[1]
    specs = [_spec(point.value) for point in COLLECTIONS.points().values()]
    added = [
        Path(place)
        for spec in specs
        if spec
        for place in spec.submodule_search_locations or ()
    ]
    return [
        path
        for path in (nodes / "_launch", nodes.parent / "launch", *added)
        if path.is_dir()
    ]


def _spec(package: str) -> ModuleSpec | None:
    """Return the spec of a package with launch files; None if missing or not importable."""
    try:
        return find_spec(package)
    except (Exception, SystemExit):  # noqa: BLE001  # reported by `haptic doctor`
        return None


def scenarios() -> dict[str, Path]:
    """Return the installed launch files, sorted; this project's override other packages'."""
    found = {
        path.stem: path
        for folder in reversed(launch_dirs())
        for path in folder.glob("*.yaml")
    }
    return dict(sorted(found.items()))


def find(name: str) -> Path:
    """Return the path of a scenario or YAML file; the error lists the known ones."""
    known = scenarios()
    if name in known:
        return known[name]
    path = Path(name)
    if path.suffix in (".yaml", ".yml") or os.sep in name:
        try:
            name.encode()
            if path.is_file():
                return path
            if path.is_dir():
                raise ParameterError(
                    "is a directory, expected a launch file", path=name
                )
            raise ParameterError("no such file", path=name)
        except UnicodeEncodeError as error:
            raise ParameterError(
                f"{name!r}: not UTF-8, as a launch file's name has to be; rename it"
            ) from error
        except OSError as error:
            # The name is too long, or its folder is not readable.
            raise ParameterError(f"{error.strerror}", path=name) from error
    raise ParameterError(f"no launch file is named {name!r}; {choices(name, known)}")


def read_arguments(path: Path) -> tuple[str, dict[str, Argument]]:
    """Read summary and arguments of a launch file."""
    file = convert(with_usual(read_yaml(path)), LaunchText, path.name)
    return file.summary, {**_offered(path, file, Including()), **file.arguments}


def _substitutes_device(kind: type[Node]) -> bool:
    """Return whether nodes of a kind have another device than the one they name."""
    own, inherited = (each.substitute_device for each in (kind, Node))
    return own.__func__ is not inherited.__func__  # type: ignore[attr-defined]


def _offered(path: Path, file: LaunchText, including: Including) -> dict[str, Argument]:
    """Return the implicit arguments: `DEVICE`, if the launch has a virtual device."""
    kinds = node_kinds()
    for node in file.nodes.values():
        kind = node.get("kind") if isinstance(node, dict) else None
        factory = kinds.get(kind) if isinstance(kind, str) else None
        # Reading the launch reports unknown or broken kinds.
        with contextlib.suppress(ParameterError, AttributeError):
            made = factory and load(factory)
            if made and _substitutes_device(made):
                return {DEVICE: _DEVICE}
    # Reading the launch also reports broken includes.
    with contextlib.suppress(ParameterError):
        including = including.another(path, path.name)
        for entry in file.include:
            inner = find(_beside(path, str(entry.get("launch"))))
            if offered := _offered(
                inner,
                convert(with_usual(read_yaml(inner)), LaunchText, inner.name),
                including,
            ):
                return offered
    return {}


def _beside(path: Path, launch: str) -> str:
    """Resolve an included launch file: a scenario, a path, or a file beside the including one."""
    beside = path.resolve().parent / launch
    return str(beside) if launch not in scenarios() and beside.is_file() else launch


def parse_assignments(words: list[str]) -> dict[str, Any]:
    """Parse ``name:=value`` words, with values in YAML."""
    values = {}
    for word in words:
        name, sign, text = word.partition(":=")
        if not sign:
            name, sign, text = word.partition("=")
            meant = (
                f"; did you mean {name}:={text}?"
                if sign and name.isidentifier()
                else ""
            )
            raise ParameterError(f"{word!r}: expected name:=value{meant}")
        values[name] = parse_yaml(text, name) if text else ""
    return values


def _fill_in(
    path: Path, arguments: Mapping[str, Argument], given: Mapping[str, Any]
) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for name in given:
        if name not in arguments:
            remedy = f"{_RUN}{name}:={given[name]} sets it in any launch file"
            if name not in RunSpec.__struct_fields__:
                remedy = f"{choices(name, arguments)} (haptic launch --show-args {path.stem})"
            raise ParameterError(f"no argument {name!r}; {remedy}", path=path.name)
    for name, argument in arguments.items():
        value = given.get(name, argument.default)
        where = f"{path.name}.arguments.{name}"
        kind = type(argument.default)
        if kind is float and type(value) is int:
            value = float(value)
        if kind is str and isinstance(value, (int, float)):
            value = str(value)
        if not (kind is str and _is_law(value)) and (
            misfit := find_misfit(value, kind)
        ):
            raise ParameterError(misfit.text, path=f"{where}{misfit.path}")
        unit = f" {argument.unit}" if argument.unit else ""
        if (
            argument.min is not None
            and isinstance(value, (int, float))
            and not value >= argument.min
        ):
            raise ParameterError(
                f"{value!r}{unit}, limit: at least {argument.min:g}{unit}", path=where
            )
        if (
            argument.max is not None
            and isinstance(value, (int, float))
            and not value <= argument.max
        ):
            raise ParameterError(
                f"{value!r}{unit}, limit: at most {argument.max:g}{unit}", path=where
            )
        if argument.choices and value not in argument.choices:
            raise ParameterError(
                f"{value!r}, expected one of {', '.join(argument.choices)}", path=where
            )
        values[name] = value
    return values


def _is_law(value: Any) -> bool:
    """Return whether a value describes a law by kind and parameters, in place of its name."""
    return isinstance(value, Mapping) and isinstance(value.get("kind"), str)


def _bound(text: str, instead: Mapping[str, str], where: str) -> None:
    length = len(text) + sum(
        text.count(word) * (len(value) - len(word)) for word, value in instead.items()
    )
    if length > MAX_FILLED_IN and not _WHOLE.match(text):
        raise ParameterError(
            f"{length} characters once its arguments are filled in, limit {MAX_FILLED_IN}",
            path=where,
        )


def _substitute(
    data: Any, values: Mapping[str, Any], where: str, origins: Origins
) -> Any:
    if isinstance(data, dict):
        return {
            key: _substitute(inner, values, f"{where}.{key}", origins)
            for key, inner in data.items()
        }
    if isinstance(data, list):
        return [
            _substitute(inner, values, f"{where}[{i}]", origins)
            for i, inner in enumerate(data)
        ]
    if isinstance(data, str) and "$(" in data:
        _bound(
            data,
            {
                "$(dirname)": origins.folder,
                **{f"$(var {name})": str(values[name]) for name in values},
            },
            where,
        )
        data = data.replace("$(dirname)", origins.folder)
        for name in _WITHIN.findall(data):
            if name not in values:
                raise ParameterError(
                    f"$(var {name}) is not an argument; {choices(name, values)}",
                    path=where,
                )
            origins.filled_in(where, name)
        whole = _WHOLE.match(data)
        for name in _WITHIN.findall(data):
            if not whole and isinstance(values[name], Mapping):
                raise ParameterError(
                    f"{name} is a mapping, which cannot stand within a text; give a name",
                    path=where,
                )
        return (
            values[whole[1]]
            if whole
            else _WITHIN.sub(lambda match: str(values[match.group(1)]), data)
        )
    return data


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
        if name.startswith(_RUN) or (name == "tick" and name not in file.arguments)
    }
    over_run = {name.removeprefix(_RUN): given[name] for name in over}
    declared = {
        **(_offered(path, file, Including()) if DEVICE in given else {}),
        **file.arguments,
    }
    values = _fill_in(
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
        **_substitute(file.run, values, f"{path.name}.run", origins),
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
            f"{DEVICE}:={device}: no node of it has a virtual device; leave it out",
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
            _substitute(spec, values, where, origins), NodeSpec, where
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
    made: Include = convert(_substitute(entry, values, where, origins), Include, where)
    if made.namespace and not _NAME.fullmatch(made.namespace):
        raise ParameterError(
            f"{made.namespace!r}: lower-case letters, digits and _, without a / around, at most 32",
            path=f"{where}.namespace",
        )
    try:
        launch = without(
            read(
                _beside(including.files[-1], made.launch), made.arguments, (), including
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
