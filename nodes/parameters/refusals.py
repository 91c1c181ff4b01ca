"""Rewords msgspec's errors: parameter, value, what is allowed, and the probable intention.

Only path and field names are taken from msgspec's text; the rest comes from the type and the value
at that path.
"""

import operator
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

from msgspec import inspect

from nodes.parameters.nearest import did_you_mean

_AT = re.compile(
    r"^(?P<reason>.*?)(?: - at (?:`key(?:\[\.\.\.\])?` in )?`\$(?P<path>.*)`)?$", re.DOTALL
)
STEP = re.compile(r"([^.\[\]]+)|\[(\d+|\.\.\.)\]")
_UNKNOWN = re.compile(r"Object contains unknown field `(?P<name>.*)`", re.DOTALL)
_MISSING = re.compile(r"Object missing required field `(?P<name>.*)`", re.DOTALL)

# names of types, in the order in which alternatives are listed
_NAMES: dict[type[inspect.Type], str] = {
    inspect.BoolType: "true or false",
    inspect.IntType: "a whole number",
    inspect.FloatType: "a number",
    inspect.StrType: "text",
    inspect.ListType: "a list",
    inspect.VarTupleType: "a list",
    inspect.TupleType: "a list",
    inspect.DictType: "a mapping",
    inspect.StructType: "a mapping",
    inspect.NoneType: "nothing",
}

# Python types of the values whose bounds are checked
_KINDS: dict[type[inspect.Type], tuple[type, ...]] = {
    inspect.IntType: (int,),
    inspect.FloatType: (int, float),
    inspect.StrType: (str,),
    inspect.ListType: (list, tuple),
    inspect.VarTupleType: (list, tuple),
    inspect.DictType: (dict,),
}

_BOUNDS: tuple[tuple[str, str, Callable[[Any, Any], bool]], ...] = (
    ("gt", "above", operator.gt),
    ("ge", "of at least", operator.ge),
    ("lt", "below", operator.lt),
    ("le", "of at most", operator.le),
    ("min_length", "of length at least", lambda value, limit: len(value) >= limit),
    ("max_length", "of length at most", lambda value, limit: len(value) <= limit),
)
"""Attribute of a bound, its wording, and whether a value keeps it."""


def choices(given: object, known: Iterable[str]) -> str:
    """Return the known names, and the most similar one, for an error about an unknown name."""
    names = list(known)
    return f"available: {', '.join(names) or 'nothing yet'}{did_you_mean(given, names)}"


def missing_words(names: Sequence[str]) -> str:
    """Return the text about missing parameters; the path before it ends with the first."""
    others = f"; also missing: {', '.join(names[1:])}" if len(names) > 1 else ""
    return f"is missing, and has no default{others}"


def short(value: object) -> str:
    """Return a value's repr, cut to 80 characters."""
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def worded(refusal: str, data: Any, target: Any) -> tuple[str, str]:
    """Return path and text of a refusal by msgspec."""
    match = _AT.match(refusal)
    reason, path = (match["reason"], match["path"] or "") if match else (refusal, "")
    if unknown := _UNKNOWN.fullmatch(reason):
        fields = [
            field.encode_name
            for info in _types_at(target, path)
            for field in getattr(info, "fields", ())
        ]
        return f"{path}.{unknown['name']}", f"no such parameter; {choices(unknown['name'], fields)}"
    if missing := _MISSING.fullmatch(reason):
        names = [missing["name"], *_also_missing(missing["name"], data, target, path)]
        return f"{path}.{names[0]}", missing_words(names)
    value, known = look_up(data, path)
    shown = f", got {_called(value)}" if known else ""
    # errors raised by a type's own checks are passed on
    types = (
        _types_at(target, path) if reason.startswith(("Expected ", "Invalid enum value ")) else []
    )
    for info in types:
        if isinstance(info, inspect.DictType) and isinstance(value, dict):
            for key in value:
                if words := "".join(_broken(inner, key) for inner in _members(info.key_type)):
                    return path, f"expected {words}, got {short(key)}"
        if words := _broken(info, value):
            length = f" of length {len(value)}" if isinstance(value, list | tuple) else ""
            return path, f"expected {words}{shown}{length}"
    if choice := [str(one) for info in types for one in getattr(info, "values", ())]:
        hint = did_you_mean(str(value), choice)
        return path, f"expected one of {', '.join(choice)}{shown}{hint}"
    if words := " or ".join(
        dict.fromkeys(name for kind, name in _NAMES.items() for info in types if type(info) is kind)
    ):
        return path, f"expected {words}{shown}"
    scalar = isinstance(value, str | int | float)
    return path, f"{reason.replace('`', '')}{shown if scalar else ''}"


def _also_missing(first: str, data: Any, target: Any, path: str) -> list[str]:
    """Return the other required fields that are missing at a path, if all there is one struct."""
    value, known = look_up(data, path)
    structs = [info for info in _types_at(target, path) if isinstance(info, inspect.StructType)]
    if not known or len(structs) != 1 or not isinstance(value, dict):
        return []
    return [
        field.encode_name
        for field in structs[0].fields
        if field.required and field.encode_name not in value and field.encode_name != first
    ]


def _broken(info: inspect.Type, value: Any) -> str:
    """Return the bound that a value breaks, as text; empty if of another type or valid."""
    if (
        isinstance(info, inspect.TupleType)
        and isinstance(value, list | tuple)
        and len(value) != len(info.item_types)
    ):
        return f"a list of length {len(info.item_types)}"
    if isinstance(value, bool) or not isinstance(value, _KINDS.get(type(info), ())):
        return ""
    for name, words, kept in _BOUNDS:
        limit = getattr(info, name, None)
        if limit is not None and not kept(value, limit):
            return f"{_NAMES[type(info)]} {words} {limit:.12g}"
    pattern = info.pattern if isinstance(info, inspect.StrType) else None
    return (
        ""
        if pattern is None or re.search(pattern, str(value))
        else f"a name that matches {pattern!r}"
    )


def _called(value: Any) -> str:
    if isinstance(value, str | int | float):
        return short(value)
    kinds = {dict: "a mapping", list: "a list", tuple: "a list", type(None): "nothing"}
    return kinds.get(type(value), type(value).__name__)


def look_up(data: Any, path: str) -> tuple[Any, bool]:
    """Return the value at a path, and whether it is known.

    It is unknown below a mapping whose key msgspec does not name.
    """
    for name, index in STEP.findall(path):
        try:
            data = data[name] if name else data[int(index)]
        except (KeyError, IndexError, TypeError, ValueError):
            return None, False
    return data, True


def _types_at(target: Any, path: str) -> list[inspect.Type]:
    """Return all types that a value may have at a path."""
    found = list(_members(inspect.type_info(target)))
    for name, index in STEP.findall(path):
        found = [
            inner
            for info in found
            for below in _below(info, name, index)
            for inner in _members(below)
        ]
    return found


def _members(info: inspect.Type) -> Iterator[inspect.Type]:
    if isinstance(info, inspect.UnionType):
        for one in info.types:
            yield from _members(one)
    elif isinstance(info, inspect.Metadata):
        yield from _members(info.type)
    else:
        yield info


def _below(info: inspect.Type, name: str, index: str) -> Iterator[inspect.Type]:
    if isinstance(info, inspect.StructType) and name:
        yield from (field.type for field in info.fields if field.encode_name == name)
    elif isinstance(info, inspect.DictType):
        yield info.value_type
    elif isinstance(info, inspect.TupleType) and index.isdigit():
        yield from info.item_types[int(index) : int(index) + 1]
    elif isinstance(info, inspect.CollectionType):
        yield info.item_type
