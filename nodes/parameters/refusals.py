"""Errors about values of the wrong type: parameter, value and what is expected there.

msgspec refuses a value with a sentence. It is not read here: the data are walked beside the types
that msgspec describes, up to the first value that does not fit.
"""

import operator
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import msgspec
from msgspec import inspect

from nodes.parameters.nearest import did_you_mean

# a step of a path: a name, or an index
STEP = re.compile(r"([^.\[\]]+)|\[(\d+)\]")


class TypeWord(NamedTuple):
    """The word for a type, and the Python types of its values."""

    noun: str
    values: tuple[type, ...]
    article: str = "a "

    @property
    def name(self) -> str:
        """Noun with its article."""
        return f"{self.article}{self.noun}"


# in the order in which alternatives are listed
KINDS: dict[type[inspect.Type], TypeWord] = {
    inspect.BoolType: TypeWord("true or false", (bool,), ""),
    inspect.IntType: TypeWord("whole number", (int,)),
    inspect.FloatType: TypeWord("number", (int, float)),
    inspect.StrType: TypeWord("text", (str,), ""),
    inspect.ListType: TypeWord("list", (list, tuple)),
    inspect.VarTupleType: TypeWord("list", (list, tuple)),
    inspect.TupleType: TypeWord("list", (list, tuple)),
    inspect.DictType: TypeWord("mapping", (Mapping,)),
    inspect.StructType: TypeWord("mapping", (Mapping,)),
    inspect.NoneType: TypeWord("nothing", (type(None),), ""),
}


class Bound(NamedTuple):
    """A bound of a type: its attribute, its wording, and whether a value keeps it."""

    attribute: str
    words: str
    is_kept: Callable[[Any, Any], bool]
    preposition: str = "of "


BOUNDS = (
    Bound("gt", "above", operator.gt, ""),
    Bound("ge", "at least", operator.ge),
    Bound("lt", "below", operator.lt, ""),
    Bound("le", "at most", operator.le),
    Bound("min_length", "length at least", lambda value, limit: len(value) >= limit),
    Bound("max_length", "length at most", lambda value, limit: len(value) <= limit),
)


class Misfit(NamedTuple):
    """A value that a type does not accept: its path, and why."""

    path: str
    text: str


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
    return cut(repr(value), 80)


def cut(text: str, most: int) -> str:
    """Return a text of at most `most` characters, with an ellipsis if cut."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


def find_misfit(data: Any, target: Any) -> Misfit | None:
    """Return the first value in `data` that `target`, a type, does not accept at its place."""
    return _misfit("", data, inspect.type_info(target))


def _misfit(path: str, value: Any, declared: inspect.Type) -> Misfit | None:
    """Return the first misfit at or below a path."""
    types = list(_members(declared))
    tags = tagged(declared)
    if len(tags) > 1 and isinstance(value, Mapping):
        name = next(iter(tags.values())).tag_field or ""
        if value.get(name) not in tags:
            wrong = _refused_tag(name, value, list(tags))
            return Misfit(f"{path}.{name}", wrong)
        types = [tags[value[name]]]
    # 5 is a whole number first, and a number where only numbers are accepted
    fitting = sorted((one for one in types if _fits(one, value)), key=_is_float)
    if not fitting:
        return Misfit(path, _refused(types, value))
    info = fitting[0]
    if words := _broken(info, value):
        length = f" of length {len(value)}" if isinstance(value, list | tuple) else ""
        return Misfit(path, f"expected {words}, got {_named(value)}{length}")
    if isinstance(info, inspect.StructType):
        return _misfit_in_struct(path, value, info)
    if isinstance(info, inspect.DictType):
        return _misfit_in_mapping(path, value, info)
    if isinstance(info, inspect.TupleType):
        return _misfit_in_list(path, value, info.item_types)
    if isinstance(info, inspect.CollectionType):
        return _misfit_in_list(path, value, [info.item_type] * len(value))
    return None


def _misfit_in_struct(
    path: str, value: Mapping[Any, Any], info: inspect.StructType
) -> Misfit | None:
    fields = {field.encode_name: field for field in info.fields}
    for name, inner in value.items():
        if name in fields:
            if misfit := _misfit(f"{path}.{name}", inner, fields[name].type):
                return misfit
        elif info.forbid_unknown_fields and name != info.tag_field:
            return Misfit(
                f"{path}.{name}", f"no such parameter; {choices(name, fields)}"
            )
    missing = [
        name for name, field in fields.items() if field.required and name not in value
    ]
    if missing:
        return Misfit(f"{path}.{missing[0]}", missing_words(missing))
    try:
        msgspec.convert(value, info.cls)
    except (msgspec.ValidationError, OverflowError) as error:
        # the struct's own check raised the cause
        return Misfit(path, str(error.__cause__ or error))
    return None


def _misfit_in_mapping(
    path: str, value: Mapping[Any, Any], info: inspect.DictType
) -> Misfit | None:
    for key, inner in value.items():
        if misfit := _misfit(path, key, info.key_type):
            return misfit
        if misfit := _misfit(f"{path}.{key}", inner, info.value_type):
            return misfit
    return None


def _misfit_in_list(
    path: str, value: Sequence[Any], item_types: Sequence[inspect.Type]
) -> Misfit | None:
    for i, (inner, item_type) in enumerate(zip(value, item_types, strict=True)):
        if misfit := _misfit(f"{path}[{i}]", inner, item_type):
            return misfit
    return None


def _members(info: inspect.Type) -> Iterator[inspect.Type]:
    """Return the alternatives of a type."""
    if isinstance(info, inspect.UnionType):
        for one in info.types:
            yield from _members(one)
    elif isinstance(info, inspect.Metadata):
        yield from _members(info.type)
    else:
        yield info


def tagged(info: inspect.Type) -> dict[Any, inspect.StructType]:
    """Return the structs among the alternatives of a type by their tag, a ``kind``."""
    return {
        one.tag: one
        for one in _members(info)
        if isinstance(one, inspect.StructType) and one.tag is not None
    }


def _refused_tag(name: str, value: Mapping[Any, Any], tags: Sequence[Any]) -> str:
    if name not in value:
        return f"missing; one of {', '.join(map(str, tags))}"
    hint = did_you_mean(value[name], tags)
    return (
        f"expected one of {', '.join(map(str, tags))}, got {_named(value[name])}{hint}"
    )


def _is_float(info: inspect.Type) -> bool:
    return isinstance(info, inspect.FloatType)


def _fits(info: inspect.Type, value: Any) -> bool:
    """Return whether a value is of a type, whatever its bounds and its contents."""
    if isinstance(info, inspect.LiteralType):
        return any(
            type(value) is type(choice) and value == choice for choice in info.values
        )
    if type(info) not in KINDS:
        return True
    if isinstance(value, bool):
        return isinstance(info, inspect.BoolType)
    return isinstance(value, KINDS[type(info)].values)


def _refused(types: Sequence[inspect.Type], value: Any) -> str:
    """Return what is expected in place of a value that fits none of the types."""
    known = {type(info) for info in types}
    names = dict.fromkeys(kind.name for info, kind in KINDS.items() if info in known)
    choice = [str(one) for info in types for one in getattr(info, "values", ())]
    hint = did_you_mean(value, choice)
    if not names:
        return f"expected one of {', '.join(choice)}, got {_named(value)}{hint}"
    return f"expected {' or '.join([*names, *choice])}, got {_named(value)}{hint}"


def _broken(info: inspect.Type, value: Any) -> str:
    """Return what is expected of a value that breaks a bound of its type, or ""."""
    if isinstance(info, inspect.TupleType) and len(value) != len(info.item_types):
        return f"a list of length {len(info.item_types)}"
    for bound in BOUNDS:
        limit = getattr(info, bound.attribute, None)
        if limit is not None and not bound.is_kept(value, limit):
            return f"{KINDS[type(info)].name} {bound.preposition}{bound.words} {limit:.12g}"
    if isinstance(info, inspect.FloatType) and abs(value) > sys.float_info.max:
        return f"a number of at most {sys.float_info.max:.12g}"
    pattern = info.pattern if isinstance(info, inspect.StrType) else None
    if pattern is not None and not re.search(pattern, value):
        return f"a name that matches {pattern!r}"
    return ""


def _named(value: Any) -> str:
    """Return how an error shows a value: scalars as they are, others by their kind."""
    if isinstance(value, str | int | float):
        return short(value)
    for info in (inspect.ListType, inspect.DictType, inspect.NoneType):
        if isinstance(value, KINDS[info].values):
            return KINDS[info].name
    return type(value).__name__
