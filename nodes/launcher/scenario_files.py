"""Launch files by name, and their arguments: found, read, checked and filled in."""

import contextlib
import os
import re
from collections.abc import Mapping
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from nodes.base.node import Node
from nodes.base.node_kinds import load, node_kinds
from nodes.launcher.launch_spec import Argument, Including, LaunchText, RunSpec
from nodes.launcher.origins import Origins
from nodes.launcher.usual_arguments import with_usual
from nodes.parameters.interface_words import interface
from nodes.parameters.refusals import choices, find_misfit
from nodes.parameters.registry import Registry
from nodes.parameters.store import ParameterError, convert
from nodes.parameters.yaml_io import parse_yaml, read_yaml

# Names of packages with launch files; they are not imported.
COLLECTIONS = Registry("haptic.launch", "collection of scenarios")
_WHOLE = re.compile(r"^\$\(var ([A-Za-z_][A-Za-z0-9_]*)\)$")
_WITHIN = re.compile(r"\$\(var ([A-Za-z_][A-Za-z0-9_]*)\)")
RUN = "run."
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
    return file.summary, {
        **offered_arguments(path, file, Including()),
        **file.arguments,
    }


def _substitutes_device(kind: type[Node]) -> bool:
    """Return whether nodes of a kind have another device than the one they name."""
    own, inherited = (each.substitute_device for each in (kind, Node))
    return own.__func__ is not inherited.__func__  # type: ignore[attr-defined]


def offered_arguments(
    path: Path, file: LaunchText, including: Including
) -> dict[str, Argument]:
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
            inner = find(beside(path, str(entry.get("launch"))))
            if offered := offered_arguments(
                inner,
                convert(with_usual(read_yaml(inner)), LaunchText, inner.name),
                including,
            ):
                return offered
    return {}


def beside(path: Path, launch: str) -> str:
    """Resolve an included launch file: a scenario, a path, or a file beside the including one."""
    near = path.resolve().parent / launch
    return str(near) if launch not in scenarios() and near.is_file() else launch


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


def fill_in(
    path: Path, arguments: Mapping[str, Argument], given: Mapping[str, Any]
) -> dict[str, Any]:
    """Return the arguments' values, given or default, checked against their limits."""
    values: dict[str, Any] = {}
    for name in given:
        if name not in arguments:
            setting = interface.get().argument(f"{RUN}{name}", given[name])
            remedy = f"{setting} sets it in any launch file"
            if name not in RunSpec.__struct_fields__:
                listed = interface.get().arguments(path.stem)
                remedy = f"{choices(name, arguments)} ({listed})"
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


def substitute(
    data: Any, values: Mapping[str, Any], where: str, origins: Origins
) -> Any:
    """Return a tree with its ``$(var NAME)`` filled in."""
    if isinstance(data, dict):
        return {
            key: substitute(inner, values, f"{where}.{key}", origins)
            for key, inner in data.items()
        }
    if isinstance(data, list):
        return [
            substitute(inner, values, f"{where}[{i}]", origins)
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
