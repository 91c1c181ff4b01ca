"""Fields of a message as tables for the compiled tick, read from the message's own type.

So a bound, a default or a new field is written once, in messages/types.py. A field of a kind that
is not listed here cannot be compiled; the plain tick then handles its message.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import msgspec.inspect as inspect

from messages.errors import HapticError
from messages.types import Message

REAL, VECTOR, WHOLE, FLAG, TEXT = range(5)
# longest name of a field [bytes]: with its header one copy of 16 bytes
LONGEST_NAME: Final = 15


class NotCompilableError(HapticError):
    """A feature that the compiled tick does not support; the text names it."""


class Field(NamedTuple):
    """One field of a message."""

    name: str  # its key on the wire
    kind: int  # `REAL`, `VECTOR`, `WHOLE`, `FLAG` or `TEXT`
    # index of its value in the floats (a vector takes three), the integers (also flags) or the
    # texts
    slot: int
    # bounds of an integer; `high` is the longest length of a text [characters]
    low: int
    high: int
    # value if absent; None if required; 0 for texts, which are only checked
    default: float | None


def fields_of(message: type[Message]) -> tuple[Field, ...]:
    """Return the fields of a message type."""
    described = inspect.type_info(message)
    assert isinstance(described, inspect.StructType)  # noqa: S101
    fields = []
    used = [0, 0, 0]
    for field in described.fields:
        name, kind_of = field.encode_name, field.type
        low = high = room = 0
        if isinstance(kind_of, inspect.FloatType):
            kind = REAL
            bank = 0
            room = 1
        elif isinstance(kind_of, inspect.TupleType) and all(
            isinstance(t, inspect.FloatType) for t in kind_of.item_types
        ):
            kind = VECTOR
            bank = 0
            room = len(kind_of.item_types)
        elif (
            isinstance(kind_of, inspect.IntType)
            and kind_of.ge is not None
            and kind_of.le is not None
        ):
            kind = WHOLE
            bank = 1
            room = 1
            low = kind_of.ge
            high = kind_of.le
        elif isinstance(kind_of, inspect.BoolType):
            kind = FLAG
            bank = 1
            room = 1
        elif isinstance(kind_of, inspect.StrType) and kind_of.max_length is not None:
            kind = TEXT
            bank = 2
            room = 1
            high = kind_of.max_length
        else:
            raise NotCompilableError(
                f"{message.__name__}.{name}: a field of type {kind_of}"
            )
        if kind == VECTOR and room != 3:
            raise NotCompilableError(
                f"{message.__name__}.{name}: a vector of {room}, not three"
            )
        if len(name.encode()) > LONGEST_NAME:
            raise NotCompilableError(
                f"{message.__name__}.{name}: a name longer than {LONGEST_NAME} bytes"
            )
        default: float | None = None
        if not field.required:
            default = float(field.default) if kind in (REAL, WHOLE, FLAG) else 0.0
            if kind == VECTOR and any(field.default):
                raise NotCompilableError(
                    f"{message.__name__}.{name}: a default that is not zero"
                )
        if kind == TEXT and used[bank]:
            raise NotCompilableError(f"{message.__name__}.{name}: a second text")
        fields.append(Field(name, kind, used[bank], low, high, default))
        used[bank] += room
    return tuple(fields)


def slots(fields: tuple[Field, ...], *names: str) -> list[int]:
    """Return the indices of fields' values."""
    known = {field.name: field.slot for field in fields}
    return [known[name] for name in names]


def key_blocks(message: type[Message]) -> bytes:
    """Return the encoded keys of a message, in blocks of 16 bytes."""
    keys = [field.name.encode() for field in fields_of(message)]
    encoded = [bytes([0xA0 | len(key)]) + key for key in keys]
    return b"".join(one.ljust(16, b"\0") for one in encoded)
