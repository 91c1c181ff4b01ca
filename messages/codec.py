"""Encode and decode messages; refuse whatever is malformed, truncated, oversized, wrongly typed or not finite.

msgspec does both the MessagePack and the type check in one pass (0.2 µs); a second pass over the float fields refuses NaN
and infinity, which MessagePack can carry and a haptic device must never see.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import msgspec

from messages.types import Message, Vector

MAX_PAYLOAD = 65536
"""Longest payload that is looked at [bytes]; the longest legitimate one (a receipt) is under 16 KiB."""

M = TypeVar("M", bound=Message)

_encode: Callable[[Message], bytes] = msgspec.msgpack.Encoder().encode


class MessageRefusedError(ValueError):
    """A payload that is not a valid message; the text says what, where and which limit."""


def encode(message: Message) -> bytes:
    """Encode a message as one MessagePack map.

    Parameters
    ----------
    message : Message
        Any message of messages.types.

    Returns
    -------
    bytes
        The second frame of the wire format.
    """
    return _encode(message)


def _finite_check(message_type: type[Message]) -> Callable[[Any], bool]:
    """Build one expression that is finite exactly when all float fields are.

    A sum of finite floats overflows only beyond 1e307; such values are refused too, and rightly so.
    """
    terms = []
    for field in msgspec.structs.fields(message_type):
        if field.type is float:
            terms.append(f"m.{field.name}")
        elif field.type == Vector:
            terms += [f"m.{field.name}[{i}]" for i in range(3)]
    expression = " + ".join(terms)
    # The expression is made of our own field names only.
    return eval(f"lambda m: isfinite({expression})", {"isfinite": math.isfinite})  # type: ignore[no-any-return]  # noqa: S307


class Decoder(Generic[M]):
    """Decode the payloads of one message type.

    Parameters
    ----------
    message_type : type of Message
        What the topic carries.
    """

    def __init__(self, message_type: type[M]) -> None:
        self.message_type = message_type
        self._decode: Callable[[bytes], M] = msgspec.msgpack.Decoder(message_type).decode
        self._finite = _finite_check(message_type)

    def decode(self, payload: bytes) -> M:
        """Decode one payload.

        Parameters
        ----------
        payload : bytes
            Second frame of the wire format.

        Returns
        -------
        Message
            The typed message.

        Raises
        ------
        MessageRefusedError
            When the payload is malformed, truncated, over MAX_PAYLOAD, wrongly typed or holds a float that is not finite.
        """
        if len(payload) > MAX_PAYLOAD:
            raise MessageRefusedError(f"{self.message_type.__name__}: {len(payload)} bytes, limit {MAX_PAYLOAD}")
        try:
            message = self._decode(payload)
        except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
            raise MessageRefusedError(f"{self.message_type.__name__}: {error}") from error
        if not self._finite(message):
            raise MessageRefusedError(f"{self.message_type.__name__}: a field is not finite: {message}")
        return message
