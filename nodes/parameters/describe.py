"""Descriptions of parameters: type, unit, limits, default and meaning, from their struct."""

import sys
from collections.abc import Callable
from typing import Any

import msgspec
from msgspec import inspect

from messages.schema import attributes, unit_of
from nodes.parameters.refusals import BOUNDS, KINDS, STEP, choices, tagged
from nodes.parameters.store import ParameterError


class Description(msgspec.Struct, kw_only=True):
    """Description of a parameter."""

    type: str  # as text; ``parameters`` for a branch
    unit: str = ""  # unit; empty without one
    limits: str = ""  # as text; empty without any
    default: Any = None  # default value; None with `required` if there is none
    required: bool = False  # whether it must be given
    meaning: str = ""  # one sentence


_A_KIND = Description(
    type="text",
    required=True,
    meaning="What it is: one of the kinds that are installed.",
)


def described(
    target: type[Any],
    values: Any,
    path: str,
    struct_of: Callable[[str], type[Any] | None],
) -> Description:
    """Return the description of the parameter at `path`."""
    return _reached(target, values, path, struct_of)[0]


def names_below(
    target: type[Any],
    values: Any,
    path: str,
    struct_of: Callable[[str], type[Any] | None],
) -> list[str]:
    """Return the names of the parameters directly below a branch; of a leaf, none."""
    _, info, value = _reached(target, values, path, struct_of)
    info = _without_none(_of_kind(info, value))
    if isinstance(info, inspect.DictType) and not _kind(value):
        return [f"{path}.{name}" for name in value or ()]
    if isinstance(info, inspect.AnyType | inspect.DictType) and _kind(value):
        own = struct_of(_kind(value))
        info = inspect.type_info(own) if own is not None else info
    if not isinstance(info, inspect.StructType):
        return []
    return [f"{path}.{field.encode_name}" for field in info.fields]


def _reached(
    target: type[Any],
    values: Any,
    path: str,
    struct_of: Callable[[str], type[Any] | None],
) -> tuple[Description, inspect.Type, Any]:
    """Return the description of the parameter at `path`, its type and its value."""
    info: inspect.Type = inspect.type_info(target)
    found = Description(
        type=_words(info), meaning=(target.__doc__ or "").strip().partition("\n")[0]
    )
    done = ""
    for name, index in STEP.findall(path):
        if isinstance(info, inspect.AnyType) or (
            isinstance(info, inspect.DictType) and _kind(values)
        ):
            own = struct_of(_kind(values))
            info = inspect.type_info(own) if own is not None else info
        info = _without_none(_of_kind(info, values))
        if name == "kind" and _kind(values):
            return _A_KIND, inspect.StrType(), _kind(values)
        step = f"[{index}]" if index else f".{name}" if done else name
        if name and isinstance(info, inspect.StructType):
            fields = {field.encode_name: field for field in info.fields}
            if name not in fields:
                raise ParameterError(
                    f"no such parameter; {choices(name, fields)}", path=f"{done}{step}"
                )
            found = _field(info.cls, fields[name])
            info = fields[name].type
        elif name and isinstance(info, inspect.DictType):
            info = info.value_type
            found = Description(type=_words(info), meaning=found.meaning)
        elif index and isinstance(info, inspect.CollectionType):
            info = info.item_type
            found = Description(type=_words(info), meaning=found.meaning)
        elif not isinstance(info, inspect.AnyType):
            raise ParameterError(
                f"there is nothing below {done or 'it'}, which is {_words(info)}",
                path=f"{done}{step}",
            )
        values = _below(values, name, index)
        done += step
    return found, info, values


def _below(values: Any, name: str, index: str) -> Any:
    """Return the value at a name or an index; None if there is none."""
    if name:
        return values.get(name) if isinstance(values, dict) else None
    return (
        values[int(index)]
        if isinstance(values, list) and int(index) < len(values)
        else None
    )


def _kind(values: Any) -> str:
    """Return the kind that a free value names: a mapping's ``kind``, or a preset's name."""
    if isinstance(values, dict):
        return str(values.get("kind", ""))
    return values if isinstance(values, str) else ""


def _of_kind(info: inspect.Type, values: Any) -> inspect.Type:
    """Return the struct of a tagged union that a value's ``kind`` names."""
    return tagged(info).get(_kind(values), info)


def _without_none(info: inspect.Type) -> inspect.Type:
    if isinstance(info, inspect.Metadata):
        return _without_none(info.type)
    if isinstance(info, inspect.UnionType):
        rest = [one for one in info.types if not isinstance(one, inspect.NoneType)]
        return rest[0] if len(rest) == 1 else info
    return info


def _field(owner: type[Any], field: inspect.Field) -> Description:
    meanings: dict[str, str] = {}
    for base in reversed(owner.__mro__):
        meanings.update(attributes(base.__doc__ or ""))
    meaning = meanings.get(field.encode_name, "")
    default = field.default
    if default is msgspec.NODEFAULT and field.default_factory is not msgspec.NODEFAULT:
        default = field.default_factory()
    return Description(
        type=_words(field.type),
        unit=unit_of(meaning),
        limits=_limits(field.type),
        default=None if field.required else msgspec.to_builtins(default),
        required=field.required,
        meaning=meaning,
    )


def _words(info: inspect.Type) -> str:
    if isinstance(info, inspect.Metadata):
        return _words(info.type)
    if isinstance(info, inspect.UnionType):
        return " or ".join(dict.fromkeys(map(_words, info.types)))
    if isinstance(info, inspect.LiteralType):
        return f"one of {', '.join(map(str, info.values))}"
    if isinstance(info, inspect.StructType):
        return "parameters"
    if isinstance(info, inspect.DictType):
        return "parameters by name"
    if isinstance(info, inspect.TupleType):
        return (
            f"{len(info.item_types)} × {_words(info.item_types[0])}"
            if info.item_types
            else "nothing"
        )
    if isinstance(info, inspect.CollectionType):
        return f"list of {_words(info.item_type)}"
    return KINDS[type(info)].noun if type(info) in KINDS else "anything"


def _limits(info: inspect.Type) -> str:
    info = _without_none(info)
    found = []
    for bound in BOUNDS:
        limit = getattr(info, bound.attribute, None)
        # The largest double is how a finite number is required.
        if limit is not None and abs(limit) != sys.float_info.max:
            found.append(f"{bound.words} {limit:g}")
    return ", ".join(found)
