"""The publish table of a hop: the variable of a node's state for each message field.

The interpreted tick makes the message from this table, and the compiled tick writes it from the
same one, straight out of the state. So a new field is a line in messages/types.py, and one in the
state, where the rule that computes it puts it.
"""

from __future__ import annotations

from collections.abc import Callable
from ctypes import Array, c_double, c_int64
from typing import Any, Final, NamedTuple

import msgspec

from messages.codec import encode
from messages.types import Message, Vector

_NUMBERS: Final[dict[Any, Any]] = {float: c_double, int: c_int64, bool: c_int64}


class Published(NamedTuple):
    """The fields of a message in the order of its type, and where they stand in a state."""

    message: type[Message]
    values: dict[str, str]  # Python expression by field, over a state `s` and a `text`
    # where each stands in the struct, in numbers of 8 bytes; −1: the text
    offsets: tuple[int, ...]


def published(
    message: type[Message], state: type[Any], **variables: str | tuple[str, int]
) -> Published:
    """Return the publish table of a message.

    Parameters
    ----------
    message : type of Message
        What is published.
    state : struct of nodes/compiled/layout.py
        What it is published from.
    **variables : str or tuple of str and int
        Variable of a field that has another name in the state; with an index, a part of an array.

    Raises
    ------
    TypeError
        For a field without a variable of its kind: a text (one, given when it is sent), a flag or
        whole number (``int``), a number (``float``), or a vector of three.
    """
    kinds = {name: kind for name, kind, *_ in state._fields_}
    found: dict[str, str] = {}
    offsets = []
    for field in msgspec.structs.fields(message):
        variable = variables.get(field.name, field.name)
        name, first = (variable, None) if isinstance(variable, str) else variable
        wanted = _kind_of(field.type)
        kind = kinds.get(name)
        if wanted is str:
            found[field.encode_name] = "text"
            offsets.append(-1)
            continue
        if kind is not wanted and not _has_part(kind, first, wanted):
            raise TypeError(
                f"{message.__name__}.{field.name}: {state.__name__} has no {name!r} of that kind;"
                " add it, or name its variable in the publish table"
            )
        found[field.encode_name] = _value_of(name, first, wanted, field.type is bool)
        offsets.append(getattr(state, name).offset // 8 + (first or 0))
    return Published(message, found, tuple(offsets))


def _kind_of(annotation: Any) -> Any:
    """Return what a field is in a struct; `str` for a text."""
    plain = getattr(annotation, "__origin__", annotation)
    if annotation == Vector:
        return c_double * 3
    return _NUMBERS.get(plain, plain)


def _has_part(kind: Any, first: int | None, wanted: Any) -> bool:
    """Return whether an array has a number or a vector from an index on."""
    if first is None or not issubclass(kind or int, Array):
        return False
    size = 1 if wanted in _NUMBERS.values() else 3
    item = wanted if size == 1 else c_double
    return kind._type_ is item and 0 <= first <= kind._length_ - size


def _value_of(name: str, first: int | None, wanted: Any, is_flag: bool) -> str:
    """Return the Python expression of a variable: a vector is a tuple, a flag a bool."""
    if wanted in _NUMBERS.values():
        value = f"s.{name}" if first is None else f"s.{name}[{first}]"
        return f"{value} != 0" if is_flag else value
    if first is None:
        return f"(*s.{name},)"
    return "(" + ", ".join(f"s.{name}[{first + i}]" for i in range(3)) + ")"


def message_of(table: Published) -> Callable[[Any, str], Any]:
    """Return the function that makes a message from a state and its text, interpreted.

    Its source is written from the table, as `dataclasses` does: a tick has no time for a loop over
    names.
    """
    return _made(table, "message({})")


def payload_of(table: Published) -> Callable[[Any, str], bytes]:
    """Return the function that encodes a message from a state and its text, interpreted."""
    return _made(table, "encode(message({}))")


def _made(table: Published, form: str) -> Callable[[Any, str], Any]:
    given = ", ".join(f"{name}={value}" for name, value in table.values.items())
    made: Callable[[Any, str], Any] = eval(  # noqa: S307  # of names of ours alone
        f"lambda s, text: {form.format(given)}",
        {"encode": encode, "message": table.message},
    )
    return made
