"""A node's parameters: one typed tree, addressed by paths such as ``laws.pd.stiffness``, changed all or nothing.

The struct that types the tree is the only place where names, types, limits and defaults are
written; the YAML reader, the command line and the control requests all go through it, so an error
always carries the path, the value and the limit.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, Final

import msgspec

from messages.errors import HapticError
from nodes.parameters.refusals import STEP, choices, worded

__all__ = [
    "ParameterError",
    "ParameterStore",
    "convert",
    "describe",
    "differences",
    "flattened",
    "merge",
    "of_node",
]

_PATH = re.compile(r"[^.\[\]]+(?:\.[^.\[\]]+|\[\d+\])*")


class ParameterError(HapticError, ValueError):
    """A parameter that cannot be taken; the text names node, path, value, limit and remedy."""


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
    _refuse_unbounded(data, where)
    try:
        return msgspec.convert(data, target)
    except (msgspec.ValidationError, OverflowError) as error:
        path, text = worded(str(error), data, target)
        raise ParameterError(f"{where}{path}: {text}") from error


MAX_ENTRIES: Final = 100_000  # longest list, and most names of a mapping, in any parameter


def _refuse_unbounded(data: Any, where: str) -> None:
    """Refuse numbers that are not finite, and lists and mappings too long for any parameter."""
    if isinstance(data, float) and not math.isfinite(data):
        raise ParameterError(f"{where}: {data} is not a finite number")
    if isinstance(data, Mapping | list | tuple) and len(data) > MAX_ENTRIES:
        raise ParameterError(f"{where}: {len(data)} entries, limit {MAX_ENTRIES}")
    if isinstance(data, Mapping):
        for key, value in data.items():
            _refuse_unbounded(value, f"{where}.{key}")
    elif isinstance(data, list | tuple):
        for i, value in enumerate(data):
            _refuse_unbounded(value, f"{where}[{i}]")


def merge(base: Any, over: Any) -> Any:
    """Lay a partial tree over a whole one.

    Parameters
    ----------
    base, over : object
        Builtins. Mappings are merged name by name, everything else is replaced; a mapping that
        names another ``kind`` replaces the one that is there, whose parameters would not fit it.

    Returns
    -------
    object
        A new tree; neither argument is changed.
    """
    if not (isinstance(base, Mapping) and isinstance(over, Mapping)):
        return over
    if "kind" in over and over["kind"] != base.get("kind", over["kind"]):
        return dict(over)
    return {**base, **{key: merge(base.get(key), value) for key, value in over.items()}}


def of_node(tree: Any, node: str) -> Any:
    """Take a top level of just the `node`'s name off the `tree` that a file holds.

    Returns
    -------
    dict
        The node's parameters.

    Raises
    ------
    ParameterError
        When it is not a mapping.
    """
    if isinstance(tree, Mapping) and set(tree) == {node}:
        tree = tree[node]
    if not isinstance(tree, Mapping):
        raise ParameterError(f"{node}: expected a mapping of parameters, got {str(tree)[:100]!r}")
    return dict(tree)


def flattened(tree: Any, path: str = "") -> dict[str, Any]:
    """Lay out a `tree` of parameters, builtins, by path; it stands at `path` itself.

    Returns
    -------
    dict of str to object
        Path to value; lists are values.
    """
    if not (isinstance(tree, dict) and tree):
        return {path: tree}
    found: dict[str, Any] = {}
    for key, inner in tree.items():
        found |= flattened(inner, f"{path}.{key}" if path else str(key))
    return found


def differences(before: msgspec.Struct, after: msgspec.Struct) -> dict[str, list[Any]]:
    """Tell what a change of parameters changed: two structs of one type, from `before` and `after` it.

    Returns
    -------
    dict of str to list
        Path to the values before and after; None where there was or is none.
    """
    old, new = flattened(msgspec.to_builtins(before)), flattened(msgspec.to_builtins(after))
    return {
        path: [old.get(path), new.get(path)]
        for path in dict.fromkeys([*old, *new])
        if old.get(path) != new.get(path)
    }


def describe(parameters: Mapping[str, Any]) -> str:
    """Write `parameters`, builtins, in one line.

    Returns
    -------
    str
        JSON, which is YAML flow style too.
    """
    return msgspec.json.encode(parameters).decode()


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

    Attributes
    ----------
    current : msgspec.Struct
        The parameters now.
    """

    def __init__(self, node: str, target: type[msgspec.Struct], data: Mapping[str, Any]) -> None:
        self._node = node
        self._target = target
        self.current: Any = convert(data, target, node)

    def accept(self, parameters: Any) -> None:
        """Take changed `parameters`, which the loop applied, as the current ones."""
        self.current = parameters

    def dump(self) -> dict[str, Any]:
        """Give all parameters, as `merged` and a launch file take them.

        Returns
        -------
        dict
            Builtins.
        """
        built: dict[str, Any] = msgspec.to_builtins(self.current)
        return built

    def flat(self) -> dict[str, Any]:
        """List all parameters by path.

        Returns
        -------
        dict of str to object
            Path to value; lists are values.
        """
        built = self.dump()
        return flattened(built) if built else {}

    def get(self, name: str) -> Any:
        """Read one parameter or one branch by its `name`, a path.

        Returns
        -------
        object
            Its value.

        Raises
        ------
        ParameterError
            When there is none of that name; the text lists what is there.
        """
        return self._walk(self.dump(), self._steps(name))

    def _steps(self, name: str) -> list[str | int]:
        if not (isinstance(name, str) and _PATH.fullmatch(name)):
            raise ParameterError(
                f"{self._node}: {name!r} is not a parameter's name, e.g. laws.pd.stiffness or"
                " axes[0]"
            )
        return [key if key else int(index) for key, index in STEP.findall(name)]

    def _walk(self, value: Any, steps: Sequence[str | int]) -> Any:
        """Go down a tree."""
        for depth, step in enumerate(steps):
            value = self._down(value, step, steps[:depth])
        return value

    def _down(self, value: Any, step: str | int, done: Sequence[str | int]) -> Any:
        if isinstance(step, str) and isinstance(value, dict) and step in value:
            return value[step]
        if isinstance(step, int) and isinstance(value, list) and step < len(value):
            return value[step]
        there = (
            "there is:"
            f" {'nothing below it; set it as a whole' if value is None else 'no further names'}"
        )
        if isinstance(value, dict):
            there = choices(step, value)
        elif isinstance(value, list):
            there = f"there is: {len(value)} entries from [0]"
        path = "".join(f"[{one}]" if isinstance(one, int) else f".{one}" for one in (*done, step))
        raise ParameterError(f"{self._node}.{path.removeprefix('.')}: no such parameter; {there}")

    def changed(self, values: Mapping[str, Any]) -> Any:
        """Make the parameters that result from setting some of them: `values`, from path to new value.

        A name that is not there yet is taken where names are free (a new law, a parameter that a
        law did not state); what reads that mapping refuses those it does not know.

        Returns
        -------
        msgspec.Struct
            All parameters, validated together.

        Raises
        ------
        ParameterError
            When a name is unknown or a value is refused; nothing has changed then.
        """
        if not isinstance(values, Mapping) or not values:
            raise ParameterError(f"{self._node}: expected names and values, got {values!r}")
        data = self.dump()
        for name, new in values.items():
            *upper, last = self._steps(name)
            branch = self._walk(data, upper)
            if not (isinstance(branch, dict) and isinstance(last, str) and self._free(upper)):
                self._down(branch, last, upper)
            branch[last] = new
        return convert(data, self._target, self._node)

    def _free(self, upper: list[str | int]) -> bool:
        """Whether names are free at a place: within a field that is typed as a mapping, not as a struct."""
        info: msgspec.inspect.Type = msgspec.inspect.type_info(self._target)
        for step in upper:
            if not isinstance(info, msgspec.inspect.StructType):
                break
            info = next((field.type for field in info.fields if field.encode_name == step), info)
        return isinstance(info, msgspec.inspect.DictType | msgspec.inspect.AnyType)

    def merged(self, values: Any) -> Any:
        """Make the parameters that result from loading a tree of `values`, whole or in part, over the current ones.

        A top level of just the node's name is taken off.

        Returns
        -------
        msgspec.Struct
            All parameters, validated together.

        Raises
        ------
        ParameterError
            When anything is refused.
        """
        return convert(merge(self.dump(), of_node(values, self._node)), self._target, self._node)
