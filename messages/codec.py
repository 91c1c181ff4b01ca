"""Encoding and decoding of messages; invalid ones are refused.

Invalid means malformed, truncated, oversized, wrongly typed or not finite. msgspec checks
MessagePack, types and bounds in one pass (0.2 µs); NaN and infinity are out of bounds too (`Real`).
"""

from collections.abc import Callable
from typing import Generic, TypeVar

import msgspec

from messages.errors import HapticError
from messages.types import Message

__all__ = ["MAX_PAYLOAD", "Decoder", "M", "MessageRefusedError", "encode"]

MAX_PAYLOAD = 65536
"""Longest payload that is decoded [bytes]; the longest valid one, a receipt, has 16 KiB."""

M = TypeVar("M", bound=Message)

encode: Callable[[Message], bytes] = msgspec.msgpack.Encoder().encode
"""Encode a message as one MessagePack map, the second frame of the wire format.

msgspec's function itself, because a call of ours would slow the tick.
"""


class MessageRefusedError(HapticError, ValueError):
    """A payload that is not a valid message; the text has what, where and which limit."""


class Decoder(Generic[M]):
    """Decoder of the payloads of one message type.

    Parameters
    ----------
    message_type : type of Message
        Message type of the topic.
    """

    def __init__(self, message_type: type[M]) -> None:
        self.message_type = message_type
        self._decode: Callable[[bytes], M] = msgspec.msgpack.Decoder(
            message_type
        ).decode

    def decode(self, payload: bytes) -> M:
        """Decode one `payload`, the second frame of the wire format.

        Returns
        -------
        Message
            The typed message.

        Raises
        ------
        MessageRefusedError
            If the payload is malformed, truncated, over MAX_PAYLOAD, wrongly typed or contains a
            float that is not finite.
        """
        if len(payload) > MAX_PAYLOAD:
            raise MessageRefusedError(
                f"{self.message_type.__name__}: {len(payload)} bytes, limit {MAX_PAYLOAD}"
            )
        try:
            return self._decode(payload)
        except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
            raise MessageRefusedError(
                f"{self.message_type.__name__}: {error}"
            ) from error
