"""A node's parameters: one typed tree, read from YAML, addressed by dotted paths, changed all or nothing.

The struct that types the tree is the only place where names, types, limits and defaults are written; the YAML reader, the
command line and the control requests all go through it, so an error always carries the path, the value and the limit.
"""

from __future__ import annotations

import fcntl
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec
import yaml

MAX_YAML_BYTES = 1_000_000
MAX_YAML_DEPTH = 32


class ParameterError(ValueError):
    """A parameter that cannot be taken; the text names node, path, value, limit and remedy."""


class _Loader(yaml.SafeLoader):
    """Safe YAML without aliases (they allow exponential bombs), without duplicate keys, with 1e3 as a number."""

    depth = 0

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.events.AliasEvent):
            raise yaml.YAMLError(f"aliases are not accepted{self.peek_event().start_mark}")
        self.depth += 1
        if self.depth > MAX_YAML_DEPTH:
            raise yaml.YAMLError(f"nested deeper than {MAX_YAML_DEPTH}{self.peek_event().start_mark}")
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node

    def construct_mapping(self, node: Any, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key, _ in node.value:
            name = self.construct_object(key, deep=True)
            if not isinstance(name, str):
                raise yaml.YAMLError(f"key {name!r} is not text{key.start_mark}")
            if name in seen:
                raise yaml.YAMLError(f"{name!r} stands twice{key.start_mark}")
            seen.add(name)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?(\d[\d_]*\.[\d_]*|\.\d[\d_]*|\d[\d_]*)([eE][-+]?\d+)?$|^[-+]?\.(inf|Inf|INF)$|^\.(nan|NaN|NAN)$"),
    list("-+0123456789."),
)


def parse_yaml(text: str, source: str) -> Any:
    """Read one YAML document, bounded in size and depth.

    Parameters
    ----------
    text : str
        The document.
    source : str
        Where it came from, for errors.

    Returns
    -------
    object
        Builtins.

    Raises
    ------
    ParameterError
        When it is not YAML, too long, too deep, or uses aliases or duplicate keys.
    """
    if len(text) > MAX_YAML_BYTES:
        raise ParameterError(f"{source}: {len(text)} characters, limit {MAX_YAML_BYTES}")
    try:
        # _Loader is a SafeLoader: it constructs builtins only.
        return yaml.load(text, Loader=_Loader)  # noqa: S506
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ParameterError(f"{source}: not valid YAML: {' '.join(str(error).split())}") from error


def read_yaml(path: str | os.PathLike[str]) -> Any:
    """Read a YAML file.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    object
        Builtins.

    Raises
    ------
    ParameterError
        When it cannot be read or parsed.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ParameterError(f"{path}: {error}") from error
    return parse_yaml(text, str(path))


def convert(data: Any, target: Any, where: str) -> Any:
    """Type and validate builtins.

    Parameters
    ----------
    data : object
        Builtins, e.g. from YAML.
    target : type
        The struct to make.
    where : str
        What the path starts with in errors, e.g. ``coupling``.

    Returns
    -------
    object
        An instance of `target`.

    Raises
    ------
    ParameterError
        With the path, the value where it helps, and the limit.
    """
    try:
        made = msgspec.convert(data, target)
    except msgspec.ValidationError as error:
        reason, _, path = str(error).partition(" - at `$")
        spot = where + path.rstrip("`")
        value = _look_up(data, path.rstrip("`"))
        raise ParameterError(f"{spot}: {reason}{'' if value is None else f', got {value!r}'}") from error
    _refuse_non_finite(data, where)
    return made


def _look_up(data: Any, path: str) -> Any:
    for name, index in re.findall(r"\.([^.\[\]]+)|\[(\d+)\]", path):
        try:
            data = data[name] if name else data[int(index)]
        except (KeyError, IndexError, TypeError):
            return None
    return data if isinstance(data, (str, int, float, bool)) else None


def _refuse_non_finite(data: Any, where: str) -> None:
    if isinstance(data, float) and not (data - data == 0.0):
        raise ParameterError(f"{where}: {data} is not a finite number")
    if isinstance(data, Mapping):
        for key, value in data.items():
            _refuse_non_finite(value, f"{where}.{key}")
    elif isinstance(data, (list, tuple)):
        for i, value in enumerate(data):
            _refuse_non_finite(value, f"{where}[{i}]")


class ParameterStore:
    """The parameters a node runs with, and how to make changed ones.

    Parameters
    ----------
    node : str
        Name of the node, for errors.
    target : type
        Struct of the node's parameters.
    data : mapping
        Their values as builtins.
    """

    def __init__(self, node: str, target: type[msgspec.Struct], data: Mapping[str, Any]) -> None:
        self._node = node
        self._target = target
        self.current: Any = convert(data, target, node)

    def accept(self, parameters: Any) -> None:
        """Take changed parameters as the current ones.

        Parameters
        ----------
        parameters : msgspec.Struct
            What the loop applied.
        """
        self.current = parameters

    def dump(self) -> dict[str, Any]:
        """Give all parameters, as `replaced` and a launch file take them.

        Returns
        -------
        dict
            Builtins.
        """
        built: dict[str, Any] = msgspec.to_builtins(self.current)
        return built

    def flat(self) -> dict[str, Any]:
        """List all parameters by dotted path.

        Returns
        -------
        dict of str to object
            Path to value.
        """
        found: dict[str, Any] = {}

        def walk(value: Any, path: str) -> None:
            if isinstance(value, dict) and value:
                for key, inner in value.items():
                    walk(inner, f"{path}.{key}" if path else str(key))
            else:
                found[path] = value

        walk(self.dump(), "")
        return found

    def get(self, name: str) -> Any:
        """Read one parameter or one branch.

        Parameters
        ----------
        name : str
            Dotted path.

        Returns
        -------
        object
            Its value.

        Raises
        ------
        ParameterError
            When there is none of that name; the text lists what is there.
        """
        value: Any = self.dump()
        for i, part in enumerate(parts := name.split(".")):
            if not isinstance(value, dict) or part not in value:
                there = ", ".join(value) if isinstance(value, dict) else "no further names"
                raise ParameterError(f"{self._node}.{'.'.join(parts[: i + 1])}: no such parameter; there is: {there}")
            value = value[part]
        return value

    def changed(self, values: Mapping[str, Any]) -> Any:
        """Make the parameters that result from setting some of them.

        Parameters
        ----------
        values : mapping of str to object
            Dotted path to new value.

        Returns
        -------
        msgspec.Struct
            All parameters, validated together.

        Raises
        ------
        ParameterError
            When a name is unknown or a value is refused; nothing has changed then.
        """
        data = self.dump()
        for name, new in values.items():
            parent, _, last = name.rpartition(".")
            branch = data
            for part in parent.split(".") if parent else []:
                branch = branch.get(part) if isinstance(branch, dict) else None  # type: ignore[assignment]
            if not isinstance(branch, dict) or last not in branch:
                self.get(name)
            branch[last] = new
        return convert(data, self._target, self._node)

    def replaced(self, values: Mapping[str, Any]) -> Any:
        """Make parameters from a whole tree, as `dump` writes it.

        Parameters
        ----------
        values : mapping
            The tree; a top level of just the node's name is taken off.

        Returns
        -------
        msgspec.Struct
            All parameters, validated together.

        Raises
        ------
        ParameterError
            When anything is refused.
        """
        if isinstance(values, Mapping) and set(values) == {self._node}:
            values = values[self._node]
        return convert(values, self._target, self._node)


class WatchedFile:
    """A YAML file whose saved changes are picked up, never half-written ones.

    A file is read only when its size and time have stayed the same for two polls and the kernel confirms, by granting a
    read lease, that no process has it open for writing.

    Parameters
    ----------
    path : str
        The file.
    """

    def __init__(self, path: str) -> None:
        self.path = path
        self._seen = self._signature()
        self._applied = self._seen

    def _signature(self) -> tuple[int, int, int] | None:
        try:
            found = os.stat(self.path)
        except FileNotFoundError:
            return None
        return found.st_mtime_ns, found.st_size, found.st_ino

    def poll(self) -> Any:
        """Look whether the file was saved anew.

        Returns
        -------
        object or None
            Its content as builtins; None when there is nothing new or it is still being written.

        Raises
        ------
        ParameterError
            When it cannot be parsed; it is not tried again until it is saved again.
        """
        signature = self._signature()
        steady = signature == self._seen
        self._seen = signature
        if signature is None or not steady or signature == self._applied:
            return None
        with open(self.path, encoding="utf-8") as file:
            try:
                fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_RDLCK)
            except BlockingIOError:
                return None
            except OSError:
                # The file system or its owner gives no leases (NFS, another user's file): two equal polls must do.
                text = file.read()
            else:
                text = file.read()
                fcntl.fcntl(file, fcntl.F_SETLEASE, fcntl.F_UNLCK)
        if self._signature() != signature:
            return None
        self._applied = signature
        return parse_yaml(text, self.path)
