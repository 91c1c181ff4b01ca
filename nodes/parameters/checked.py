"""Checking structs created in Python like those from YAML: types, limits, numpy numbers."""

import functools
from collections.abc import Mapping
from typing import Annotated, Any, TypeAlias, get_type_hints

import msgspec

from nodes.parameters.refusals import choices, missing_words
from nodes.parameters.store import ParameterError, convert

Positive: TypeAlias = Annotated[float, msgspec.Meta(gt=0.0)]
NonNegative: TypeAlias = Annotated[float, msgspec.Meta(ge=0.0)]


@functools.cache
def _unchecked(kind: type[msgspec.Struct]) -> type[Any]:
    """Return a struct type with the same fields and no check of its own, for msgspec."""
    hints = get_type_hints(kind, include_extras=True)
    return msgspec.defstruct(
        kind.__name__,
        [(name, hints[name]) for name in kind.__struct_fields__],
        kw_only=True,
    )


def _plain(value: Any) -> Any:
    """Convert structs and numpy numbers to what YAML would give."""
    if hasattr(value, "tolist"):
        return value.tolist()
    return msgspec.to_builtins(value, enc_hook=lambda other: other.tolist())


def required_fields(kind: type[msgspec.Struct]) -> list[str]:
    """Return the names of the fields without a default."""
    return [field.name for field in msgspec.structs.fields(kind) if field.required]


def check_given(
    kind: type[msgspec.Struct], values: Mapping[str, Any], name: str
) -> None:
    """Raise ParameterError if a field without a default is missing, or a name is unknown."""
    fields = kind.__struct_fields__
    for unknown in values:
        if unknown not in fields:
            raise ParameterError(
                f"no such parameter; {choices(unknown, fields)}",
                path=f"{name}.{unknown}",
            )
    if missing := [field for field in required_fields(kind) if field not in values]:
        raise ParameterError(missing_words(missing), path=f"{name}.{missing[0]}")


def check_fields(made: msgspec.Struct, name: str = "") -> None:
    """Check all fields of a new struct as `convert` checks a mapping; for ``__post_init__``."""
    kind = type(made)
    values = {field: getattr(made, field) for field in kind.__struct_fields__}
    whole = convert(
        {field: _plain(value) for field, value in values.items()},
        _unchecked(kind),
        name or kind.__name__,
    )
    for field, value in values.items():
        found = getattr(whole, field)
        if type(found) is not type(value):
            msgspec.structs.force_setattr(made, field, found)
