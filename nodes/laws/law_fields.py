"""Describe a law's parameters for the page's sliders: types, limits and meaning.

No law is named here: a newly registered law gets its sliders automatically.
"""

from __future__ import annotations

import re
from typing import Any

from msgspec import inspect

from messages.schema import attributes, unit_of
from nodes.laws import Law, law_kinds
from nodes.parameters.registry import Registry

_GROUP = re.compile(r"entry points ``(haptic\.\w+)``")
_LIMITS = ("gt", "ge", "lt", "le")


def _typed(info: inspect.Type, meaning: str) -> dict[str, Any] | None:
    """Return the description of a type; None if a page cannot edit it."""
    limits = {
        name: value
        for name in _LIMITS
        if (value := getattr(info, name, None)) is not None
    }
    if isinstance(info, inspect.FloatType):
        return {"type": "number", **limits}
    if isinstance(info, inspect.IntType):
        return {"type": "integer", **limits}
    if isinstance(info, inspect.BoolType):
        return {"type": "choice", "choices": [False, True]}
    if isinstance(info, inspect.LiteralType):
        return {"type": "choice", "choices": list(info.values)}
    if isinstance(info, inspect.StrType):
        group = _GROUP.search(meaning)
        # The choices of a registered name are the installed ones.
        return (
            {"type": "choice", "choices": Registry(group[1], "name").names()}
            if group
            else None
        )
    if isinstance(info, inspect.UnionType):
        usual = [kind for kind in info.types if not isinstance(kind, inspect.NoneType)]
        return _typed(usual[0], meaning) if len(usual) == 1 else None
    if isinstance(info, inspect.ListType | inspect.VarTupleType | inspect.TupleType):
        item, *others = (
            info.item_types
            if isinstance(info, inspect.TupleType)
            else (info.item_type,)
        )
        if any(other != item for other in others):
            return None
        if isinstance(item, inspect.StructType):
            return {"type": "list", "fields": _fields(item)}
        inner = _typed(item, meaning)
        return (
            {"type": "numbers"}
            if inner is not None and inner["type"] in ("number", "integer")
            else None
        )
    return None


def _fields(info: inspect.StructType) -> list[dict[str, Any]]:
    meanings = attributes(info.cls.__doc__ or "")
    found = []
    for field in info.fields:
        text = meanings.get(field.name, "")
        described = _typed(field.type, text)
        if described is None:
            continue
        entry = {
            "name": field.encode_name,
            "unit": unit_of(text),
            "told": text,
            **described,
        }
        if isinstance(field.default, int | float | str):
            entry["default"] = field.default
        found.append(entry)
    return found


def law_fields(law: type[Law]) -> list[dict[str, Any]]:
    """Return the descriptions of a law's parameters."""
    info = inspect.type_info(law)
    assert isinstance(info, inspect.StructType)  # noqa: S101  # every Law is a struct
    return _fields(info)


def all_law_fields() -> dict[str, list[dict[str, Any]]]:
    """Return the parameter descriptions of all installed laws."""
    return {kind: law_fields(law) for kind, law in law_kinds().items()}
