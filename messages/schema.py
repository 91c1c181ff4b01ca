"""JSON Schema of each message type, for recordings and for nodes in other languages.

Foxglove and Lichtblick read a flat schema only: everything inlined, no ``$ref``, no ``anyOf``, one
schema for all items of an array. msgspec's own generator uses all three, so the schema is built
here from the types and the docstrings. Meaning and unit of a field are written once, in
messages/types.py, and are part of every file.
"""

import re
import sys
from functools import cache
from inspect import cleandoc
from typing import Any

import msgspec

from messages.event_kinds import DATA
from messages.types import Message

_SECTION_ENTRY = re.compile(r"^(\w+(?:, \w+)*) : .*()$")
_ENTRY = re.compile(r"^(\w+(?:, \w+)*): (.+)$")
_UNIT = re.compile(r"\[([^\]]+)\]")

_SCALARS: dict[type[msgspec.inspect.Type], str] = {
    msgspec.inspect.IntType: "integer",
    msgspec.inspect.FloatType: "number",
    msgspec.inspect.StrType: "string",
    msgspec.inspect.BoolType: "boolean",
}

_LIMITS = {
    "ge": "minimum",
    "le": "maximum",
    "gt": "exclusiveMinimum",
    "lt": "exclusiveMaximum",
    "max_length": "maxLength",
}


def attributes(docstring: str) -> dict[str, str]:
    """Return the meaning of each field in a docstring, each on one line.

    Read from its numpydoc section ``Attributes``, or else from lines ``name: meaning``.
    """
    found: dict[str, str] = {}
    names: list[str] = []
    whole, _, section = cleandoc(docstring).partition("Attributes\n")
    for line in (section or whole).splitlines()[1:]:
        text = line.strip()
        if entry := (_SECTION_ENTRY if section else _ENTRY).match(line):
            names = entry[1].split(", ")
            text = entry[2]
        elif not line.startswith(" "):
            names = []
        for name in names:
            found[name] = f"{found.get(name, '')} {text}".strip()
    return found


def unit_of(meaning: str) -> str:
    """Return the unit in a field's `meaning`, e.g. ``N/m``; empty if it has none."""
    unit = _UNIT.search(meaning)
    return unit[1] if unit else ""


def _inline(info: msgspec.inspect.Type, path: str) -> dict[str, Any]:
    if isinstance(info, msgspec.inspect.TupleType) and all(
        item == info.item_types[0] for item in info.item_types
    ):
        count = len(info.item_types)
        return {
            "type": "array",
            "items": _inline(info.item_types[0], path),
            "minItems": count,
            "maxItems": count,
        }
    if isinstance(info, msgspec.inspect.DictType) and isinstance(
        info.value_type, msgspec.inspect.FloatType
    ):
        # Foxglove reads only the properties of an object, and requires the keyword.
        known = {
            name: {"type": "number", "description": meaning}
            for name, meaning in DATA.items()
        }
        return {
            "type": "object",
            "properties": known,
            "additionalProperties": {"type": "number"},
        }
    if type(info) not in _SCALARS:
        raise TypeError(
            f"{path}: {type(info).__name__} has no flat JSON schema; use numbers, text, equal"
            " tuples, or numbers by name"
        )
    found: dict[str, Any] = {"type": _SCALARS[type(info)]}
    for limit, keyword in _LIMITS.items():
        value = getattr(info, limit, None)
        # JSON has no infinity to exclude
        if value is not None and abs(value) != sys.float_info.max:
            found[keyword] = value
    return found


@cache
def _schema(message_type: type[Message]) -> dict[str, Any]:
    info = msgspec.inspect.type_info(message_type)
    if not isinstance(info, msgspec.inspect.StructType):
        raise TypeError(f"{message_type!r} is not a message type")
    meanings: dict[str, str] = {}
    for base in reversed(message_type.__mro__):
        meanings.update(
            attributes(base.__doc__ or "") if issubclass(base, Message) else {}
        )
    properties: dict[str, Any] = {}
    for field in info.fields:
        properties[field.encode_name] = _inline(
            field.type, f"{message_type.__name__}.{field.name}"
        )
        if field.name in meanings:
            properties[field.encode_name]["description"] = meanings[field.name]
        if field.default_factory is not msgspec.NODEFAULT:
            properties[field.encode_name]["default"] = field.default_factory()
        if field.default is not msgspec.NODEFAULT:
            default = field.default
            properties[field.encode_name]["default"] = (
                list(default) if isinstance(default, tuple) else default
            )
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": message_type.__name__,
        "description": (message_type.__doc__ or "").strip().split("\n", 1)[0],
        "type": "object",
        "properties": properties,
        "required": [field.encode_name for field in info.fields if field.required],
    }


def schema(message_type: type[Message]) -> dict[str, Any]:
    """Return the flat JSON Schema (draft 2020-12) of a `message_type`, with meanings, units.

    It contains no ``$ref`` and no ``anyOf``. Fields unknown to this version are allowed, as the
    evolution rules of messages.types require. Raises TypeError if a field's type has no flat form;
    the text names the field.
    """
    return _schema(message_type)


def schema_json(message_type: type[Message]) -> bytes:
    """Return the schema of a `message_type` as JSON, for an MCAP record (``jsonschema``)."""
    return msgspec.json.encode(_schema(message_type))
