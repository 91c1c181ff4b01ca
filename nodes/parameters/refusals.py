"""What msgspec refuses, in words: which parameter, what was given, what could have been, and what was probably meant."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Iterator
from typing import Any

from msgspec import inspect

_AT = re.compile(r"^(?P<reason>.*?)(?: - at (?:`key(?:\[\.\.\.\])?` in )?`\$(?P<path>.*)`)?$", re.DOTALL)
_STEP = re.compile(r"\.([^.\[\]]+)|\[(\d+|\.\.\.)\]")
_UNKNOWN = re.compile(r"Object contains unknown field `(?P<name>.*)`", re.DOTALL)
_MISSING = re.compile(r"Object missing required field `(?P<name>.*)`", re.DOTALL)
_ENUM = re.compile(r"Invalid enum value (?P<value>.*)", re.DOTALL)
_PATTERN = re.compile(r"Expected `str` matching regex (?P<pattern>.*)", re.DOTALL)
_BOUND = re.compile(r"Expected `(?P<wanted>[a-z |]+)`(?P<length> of length)? (?P<sign>[<>]=?) (?P<limit>\S+)")
_TYPE = re.compile(r"Expected `(?P<wanted>[a-z |]+)`, got `(?P<given>[a-z]+)`")

_SIGNS = {">": "above", ">=": "of at least", "<": "below", "<=": "of at most"}

_WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "text",
    "bool": "true or false",
    "null": "nothing",
    "array": "a list",
    "object": "a mapping",
}


def choices(given: object, known: Iterable[str]) -> str:
    """Say what there is in place of a name that is not, and which was probably meant."""
    names = list(known)
    close = difflib.get_close_matches(given, names, 1) if isinstance(given, str) else []
    return f"there is: {', '.join(names) or 'nothing yet'}" + "".join(f"; did you mean {name}?" for name in close)


def short(value: object) -> str:
    """Show a value in an error, short however long it is."""
    text = repr(value)
    return text if len(text) <= 80 else text[:77] + "..."


def worded(told: str, data: Any, target: Any) -> tuple[str, str]:
    """Word a refusal."""
    match = _AT.match(told)
    reason, path = (match["reason"], match["path"] or "") if match else (told, "")
    if unknown := _UNKNOWN.fullmatch(reason):
        fields = [field.encode_name for info in _types_at(target, path) for field in getattr(info, "fields", ())]
        return f"{path}.{unknown['name']}", f"no such parameter; {choices(unknown['name'], fields)}"
    if missing := _MISSING.fullmatch(reason):
        return f"{path}.{missing['name']}", "is missing, and has no default"
    value = _look_up(data, path)
    shown = "" if value is None else f", got {short(value)}"
    if enum := _ENUM.fullmatch(reason):
        known = [str(one) for info in _types_at(target, path) for one in getattr(info, "values", ())]
        close = difflib.get_close_matches(str(value), known, 1)
        hint = "".join(f"; did you mean {name}?" for name in close)
        shown = shown or f", got {enum['value']}"
        return path, f"expected one of {', '.join(known)}{shown}{hint}"
    if bound := _BOUND.fullmatch(reason):
        sign = _SIGNS[bound["sign"]]
        sign = f"of length {sign.removeprefix('of ')}" if bound["length"] else sign
        words = f"{_said(bound['wanted'])} {sign} {float(bound['limit']):.12g}"
        return path, f"expected {words}{shown}"
    if pattern := _PATTERN.fullmatch(reason):
        return path, f"expected a name that matches {pattern['pattern']}{shown}"
    if kinds := _TYPE.fullmatch(reason):
        shown = shown or f", got {_said(kinds['given'])}"
        return path, f"expected {_said(kinds['wanted'])}{shown}"
    return path, f"{reason.replace('`', '')}{shown}"


def _said(types: str) -> str:
    return " or ".join(_WORDS.get(word, word) for word in types.split(" | "))


def _look_up(data: Any, path: str) -> Any:
    for name, index in _STEP.findall(path):
        try:
            data = data[name] if name else data[int(index)]
        except (KeyError, IndexError, TypeError, ValueError):
            return None
    return data if isinstance(data, str | int | float | bool) else None


def _types_at(target: Any, path: str) -> list[inspect.Type]:
    """All types that a value may have at a path."""
    found = list(_members(inspect.type_info(target)))
    for name, index in _STEP.findall(path):
        found = [inner for info in found for below in _below(info, name, index) for inner in _members(below)]
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
