"""The reference codec: plain dictionaries by msgpack, checked one field at a time.

For clients in Python that want no typed messages, and for tests of the wire. It shares nothing with
`messages.codec` but the message types: bytes are msgpack's, an independent implementation, and
types, bounds and defaults are checked here, so that msgspec's one pass has something to agree with.
It is some thirty times slower; nodes use `messages.codec`.
"""

import math
from collections.abc import Mapping
from typing import Any

import msgpack
import msgspec
from msgspec import inspect

from messages.codec import MAX_PAYLOAD, MessageRefusedError
from messages.topics import message_type

__all__ = ["read", "write"]


def read(topic: str, payload: bytes) -> dict[str, Any]:
    """Return the message of a payload as a dictionary, defaults filled in.

    Parameters
    ----------
    topic : str
        Topic that it came from, the first frame of the wire format.
    payload : bytes
        The second frame.

    Returns
    -------
    dict
        Field to value; vectors are lists of three floats. Unknown fields are left out.

    Raises
    ------
    MessageRefusedError
        If the topic carries no message of this protocol, or the payload is malformed, truncated,
        over MAX_PAYLOAD, wrongly typed, out of bounds or contains a float that is not finite.
    """
    if len(payload) > MAX_PAYLOAD:
        raise MessageRefusedError(f"{topic}: {len(payload)} bytes, limit {MAX_PAYLOAD}")
    try:
        found = msgpack.unpackb(
            payload,
            # What msgspec skips unread may be no UTF-8.
            unicode_errors="surrogateescape",
            strict_map_key=False,
            object_pairs_hook=_Map,
        )
    except (ValueError, msgpack.exceptions.UnpackException, RecursionError) as error:
        raise MessageRefusedError(f"{topic}: no MessagePack: {error}") from error
    return _checked(topic, found)


def write(topic: str, message: Mapping[str, Any]) -> bytes:
    """Return the payload of a message, after the checks of `read`.

    Parameters
    ----------
    topic : str
        Topic that it goes to.
    message : mapping
        Field to value; what has a default may be left out.

    Returns
    -------
    bytes
        One MessagePack map with all fields, the second frame of the wire format.

    Raises
    ------
    MessageRefusedError
        As `read`, also for a field that this protocol does not have.
    """
    full = _checked(
        topic, _Map((name, _mapped(value)) for name, value in message.items())
    )
    unknown = sorted(set(message) - set(full))
    if unknown:
        raise MessageRefusedError(f"{topic}: no such field: {', '.join(unknown)}")
    payload: bytes = msgpack.packb(full)
    return payload


class _Map(list[tuple[Any, Any]]):
    """A map as it came, in pairs: a name may be anything, and come twice."""


def _mapped(value: Any) -> Any:
    return _Map(value.items()) if isinstance(value, Mapping) else value


def _checked(topic: str, found: Any) -> dict[str, Any]:
    kind = message_type(topic)
    if kind is None:
        raise MessageRefusedError(f"{topic}: carries no message of this protocol")
    info = inspect.type_info(kind)
    assert isinstance(info, inspect.StructType)  # noqa: S101  # every message is a struct
    if not isinstance(found, _Map):
        raise MessageRefusedError(
            f"{topic}: a map is wanted, this is {type(found).__name__}"
        )
    for name, _ in found:
        if not isinstance(name, str):
            raise MessageRefusedError(
                f"{topic}: the name of a field is a text, not {name!r}"
            )
    named = dict(found)
    full: dict[str, Any] = {}
    for field in info.fields:
        name = field.encode_name
        if name in named:
            full[name] = _value(f"{topic} {name}", field.type, named[name])
        elif field.required:
            raise MessageRefusedError(f"{topic}: {name} is missing")
        elif field.default is not msgspec.NODEFAULT:
            full[name] = (
                list(field.default)
                if isinstance(field.default, tuple)
                else field.default
            )
        else:
            full[name] = field.default_factory()
    return full


def _is_text(value: str) -> bool:
    """Whether it came as UTF-8: what was none is in surrogates."""
    return not any("\ud800" <= letter <= "\udfff" for letter in value)


def _value(place: str, info: inspect.Type, value: Any) -> Any:
    """Return a value as its type has it, within its bounds."""
    if isinstance(info, inspect.TupleType):
        vector = isinstance(value, list | tuple) and not isinstance(value, _Map)
        if not vector or len(value) != len(info.item_types):
            raise MessageRefusedError(
                f"{place}: {len(info.item_types)} numbers are wanted"
            )
        return [
            _value(place, of, one)
            for of, one in zip(info.item_types, value, strict=True)
        ]
    if isinstance(info, inspect.DictType):
        if not isinstance(value, _Map) or len(value) > (info.max_length or math.inf):
            raise MessageRefusedError(
                f"{place}: a map of at most {info.max_length} is wanted"
            )
        return {
            _value(place, info.key_type, name): _value(place, info.value_type, one)
            for name, one in value
        }
    if isinstance(info, inspect.StrType):
        if not isinstance(value, str) or len(value) > (info.max_length or math.inf):
            raise MessageRefusedError(
                f"{place}: a text of at most {info.max_length} is wanted"
            )
        if not _is_text(value):
            raise MessageRefusedError(f"{place}: this is no UTF-8")
        return value
    if isinstance(info, inspect.BoolType):
        if not isinstance(value, bool):
            raise MessageRefusedError(
                f"{place}: true or false is wanted, this is {value!r}"
            )
        return value
    assert isinstance(info, inspect.IntType | inspect.FloatType)  # noqa: S101  # no other types
    return _number(place, info, value)


def _number(place: str, info: inspect.IntType | inspect.FloatType, value: Any) -> float:
    whole = isinstance(info, inspect.IntType)
    if (
        isinstance(value, bool)
        or not isinstance(value, int | float)
        or not math.isfinite(value)
    ):
        raise MessageRefusedError(
            f"{place}: a finite number is wanted, this is {value!r}"
        )
    if whole and not isinstance(value, int):
        raise MessageRefusedError(
            f"{place}: a whole number is wanted, this is {value!r}"
        )
    number = int(value) if whole else float(value)
    if (info.ge is not None and number < info.ge) or (
        info.le is not None and number > info.le
    ):
        raise MessageRefusedError(
            f"{place}: {number!r}, limits {info.ge!r} to {info.le!r}"
        )
    return number
