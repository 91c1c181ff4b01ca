"""A node's parameters: one typed tree, addressed by path, changed all or nothing.

A path is, for example, ``laws.pd.stiffness``. Names, types, limits and defaults are defined only in
the struct that types the tree. The YAML reader, the command line and control requests all use it,
so an error always has path, value and limit.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, Final, Self

import msgspec

from messages.errors import HapticError
from nodes.parameters.refusals import STEP, choices, find_misfit

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
    """An invalid parameter; the text has node, path, value, limit and remedy.

    Parameters
    ----------
    text : str
        The value, its limit and the remedy.
    path : str, optional
        The parameter, e.g. ``coupling.laws.pd.stiffness``; the error's text begins with it.
    """

    def __init__(self, text: str, path: str = "") -> None:
        super().__init__(text, path)

    @property
    def text(self) -> str:
        """The error's text without the path and `remedies`."""
        return str(self.args[0])

    @property
    def path(self) -> str:
        """The parameter; empty if the error names none."""
        return str(self.args[1])

    @property
    def fault(self) -> str:
        """The error's text without `remedies`, with the path."""
        return f"{self.path}: {self.text}" if self.path else self.text

    def continued(self, more: str) -> Self:
        """Return the same error with `more` at the end of its text.

        Returns
        -------
        ParameterError
            Of the same class.
        """
        return type(self)(self.text + more, self.path).with_remedies(*self.remedies)


def convert(data: Any, target: Any, where: str) -> Any:
    """Convert builtins to a validated struct.

    Parameters
    ----------
    data : object
        Builtins, e.g. from YAML.
    target : type
        The struct to make.
    where : str
        Start of the path in errors, e.g. ``coupling``.

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
        misfit = find_misfit(data, target)
        if misfit is None:  # a rule of msgspec's that the walk does not know
            raise ParameterError(f"{error}", path=where) from error
        raise ParameterError(f"{misfit.text}", path=f"{where}{misfit.path}") from error


MAX_ENTRIES: Final = 100_000  # longest list, and largest mapping, in any parameter


def _refuse_unbounded(data: Any, where: str) -> None:
    """Reject numbers that are not finite, and lists and mappings that are too long."""
    if isinstance(data, float) and not math.isfinite(data):
        raise ParameterError(f"{data} is not a finite number", path=where)
    if isinstance(data, Mapping | list | tuple) and len(data) > MAX_ENTRIES:
        raise ParameterError(f"{len(data)} entries, limit {MAX_ENTRIES}", path=where)
    if isinstance(data, Mapping):
        for key, value in data.items():
            _refuse_unbounded(value, f"{where}.{key}")
    elif isinstance(data, list | tuple):
        for i, value in enumerate(data):
            _refuse_unbounded(value, f"{where}[{i}]")


def merge(base: Any, over: Any) -> Any:
    """Return a whole tree with a partial one merged over it.

    Parameters
    ----------
    base, over : object
        Builtins. Mappings are merged name by name, everything else is replaced; a mapping with
        another ``kind`` replaces the old one, whose parameters would not fit it.

    Returns
    -------
    object
        A new tree; neither argument is changed.
    """
    if not (isinstance(base, Mapping) and isinstance(over, Mapping)):
        return over
    if "kind" in over and over["kind"] != base.get("kind", over["kind"]):
        return dict(over)
    merged = {key: merge(base.get(key), value) for key, value in over.items()}
    return {**base, **merged}


def of_node(tree: Any, node: str) -> Any:
    """Return the parameters in `tree`, without a top level that is just the `node`'s name.

    Returns
    -------
    dict
        The node's parameters.

    Raises
    ------
    ParameterError
        If it is not a mapping.
    """
    if isinstance(tree, Mapping) and set(tree) == {node}:
        tree = tree[node]
    if not isinstance(tree, Mapping):
        raise ParameterError(
            f"expected a mapping of parameters, got {str(tree)[:100]!r}", path=node
        )
    return dict(tree)


def flattened(tree: Any, path: str = "") -> dict[str, Any]:
    """Return a `tree` of parameters as a flat mapping; `path` is that of the tree itself.

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
    """Return what differs between the parameters `before` and `after` a change.

    Returns
    -------
    dict of str to list
        Path to the values before and after; None where absent.
    """
    old = flattened(msgspec.to_builtins(before))
    new = flattened(msgspec.to_builtins(after))
    return {
        path: [old.get(path), new.get(path)]
        for path in dict.fromkeys([*old, *new])
        if old.get(path) != new.get(path)
    }


def describe(parameters: Mapping[str, Any]) -> str:
    """Return `parameters` in one line.

    Returns
    -------
    str
        JSON, which is YAML flow style too.
    """
    return msgspec.json.encode(parameters).decode()


class ParameterStore:
    """The parameters of a running node, and functions that make changed ones.

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
        The present parameters.
    """

    def __init__(
        self, node: str, target: type[msgspec.Struct], data: Mapping[str, Any]
    ) -> None:
        self._node = node
        self._target = target
        self.current: Any = convert(data, target, node)

    def accept(self, parameters: Any) -> None:
        """Set changed `parameters`, which the loop has applied, as the current ones."""
        self.current = parameters

    def dump(self) -> dict[str, Any]:
        """Return all parameters, as `merged` and a launch file read them.

        Returns
        -------
        dict
            Builtins.
        """
        built: dict[str, Any] = msgspec.to_builtins(self.current)
        return built

    def flat(self) -> dict[str, Any]:
        """Return all parameters by path.

        Returns
        -------
        dict of str to object
            Path to value; lists are values.
        """
        built = self.dump()
        return flattened(built) if built else {}

    def get(self, name: str) -> Any:
        """Return the parameter or branch `name`, a path.

        Returns
        -------
        object
            Its value.

        Raises
        ------
        ParameterError
            If there is no such parameter; the text lists the existing names.
        """
        return self._walk(self.dump(), self._steps(name))

    def _steps(self, name: str) -> list[str | int]:
        if not (isinstance(name, str) and _PATH.fullmatch(name)):
            raise ParameterError(
                f"{name!r} is not a parameter's name, e.g. laws.pd.stiffness or axes[0]",
                path=self._node,
            )
        return [key if key else int(index) for key, index in STEP.findall(name)]

    def _walk(self, value: Any, steps: Sequence[str | int]) -> Any:
        """Return the value at some steps below `value`."""
        for depth, step in enumerate(steps):
            value = self._down(value, step, steps[:depth])
        return value

    def _down(self, value: Any, step: str | int, done: Sequence[str | int]) -> Any:
        if isinstance(step, str) and isinstance(value, dict) and step in value:
            return value[step]
        if isinstance(step, int) and isinstance(value, list) and step < len(value):
            return value[step]
        there = (
            "it has nothing below it; set it as a whole"
            if value is None
            else "it has no names below"
        )
        if isinstance(value, dict):
            there = choices(step, value)
        elif isinstance(value, list):
            there = f"it has {len(value)} entries from [0]"
        path = "".join(
            f"[{one}]" if isinstance(one, int) else f".{one}" for one in (*done, step)
        )
        raise ParameterError(
            f"no such parameter; {there}", path=f"{self._node}.{path.removeprefix('.')}"
        )

    def changed(self, values: Mapping[str, Any]) -> Any:
        """Return the parameters with `values`, a mapping of path to new value, set.

        A new name is accepted where names are free (a new law, a parameter that a law did not
        state); the reader of that mapping rejects unknown ones.

        Returns
        -------
        msgspec.Struct
            All parameters, validated together.

        Raises
        ------
        ParameterError
            If a name is unknown or a value is invalid; then nothing has changed.
        """
        if not isinstance(values, Mapping) or not values:
            raise ParameterError(
                f"expected names and values, got {values!r}", path=self._node
            )
        data = self.dump()
        for name, new in values.items():
            *upper, last = self._steps(name)
            branch = self._walk(data, upper)
            if not (
                isinstance(branch, dict) and isinstance(last, str) and self._free(upper)
            ):
                self._down(branch, last, upper)
            branch[last] = new
        return convert(data, self._target, self._node)

    def _free(self, upper: list[str | int]) -> bool:
        """Return whether new names are allowed at a place: within a mapping, not a struct."""
        info: msgspec.inspect.Type = msgspec.inspect.type_info(self._target)
        for step in upper:
            if not isinstance(info, msgspec.inspect.StructType):
                break
            info = next(
                (field.type for field in info.fields if field.encode_name == step), info
            )
        return isinstance(info, msgspec.inspect.DictType | msgspec.inspect.AnyType)

    def merged(self, values: Any) -> Any:
        """Return the parameters with a tree of `values`, whole or partial, merged over them.

        A top level that is just the node's name is removed.

        Returns
        -------
        msgspec.Struct
            All parameters, validated together.

        Raises
        ------
        ParameterError
            If anything is invalid.
        """
        return convert(
            merge(self.dump(), of_node(values, self._node)), self._target, self._node
        )
