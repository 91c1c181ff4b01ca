"""Encoding a message as one MessagePack map, byte for byte as messages/codec.py does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from messages.types import Message
from nodes.compiled.kernels.machine import (
    compilable,
    copy16,
    put_be16,
    put_be32,
    put_be64,
    put_byte,
    put_real,
    reals_at,
    wholes_at,
)
from nodes.compiled.layout import LoopState
from nodes.compiled.message_fields import FLAG, REAL, VECTOR, WHOLE, fields_of
from nodes.compiled.published import Published


@compilable
def put_whole(at: int, value: int) -> int:
    """Write an integer in the shortest form. Return the address after it."""
    if -0x20 <= value < 0x80:
        put_byte(at, value)
        return at + 1
    # four widths, unsigned ones first: 0xCC to 0xCF, then 0xD0 to 0xD3
    first = 0xCC if value >= 0 else 0xD0
    if -0x80 <= value < 0x100:
        put_byte(at, first)
        put_byte(at + 1, value)
        return at + 2
    if -0x8000 <= value < 0x10000:
        put_byte(at, first + 1)
        put_be16(at + 1, value)
        return at + 3
    if -0x80000000 <= value < 0x100000000:
        put_byte(at, first + 2)
        put_be32(at + 1, value)
        return at + 5
    put_byte(at, first + 3)
    put_be64(at + 1, value)
    return at + 9


@compilable
def put_double(at: int, value: float) -> int:
    """Write a float. Return the address after it."""
    put_byte(at, 0xCB)
    put_real(at + 1, value)
    return at + 9


def make_encode(
    message: type[Message], offsets: Sequence[int] = ()
) -> Callable[[int, int, Any, Any, int, int], int]:
    """Return the encoder of a message type, with values at these offsets or in its slots."""
    fields = fields_of(message)
    count = len(fields)
    if offsets:
        fields = tuple(
            field._replace(slot=offset)
            for field, offset in zip(fields, offsets, strict=True)
        )
    kinds, slots, sizes = (
        np.array(row)
        for row in zip(
            *((f.kind, f.slot, 1 + len(f.name)) for f in fields), strict=True
        )
    )
    real, vector, whole, flag = REAL, VECTOR, WHOLE, FLAG

    @compilable
    def encode(
        at: int, keys: int, reals: Any, wholes: Any, text: int, text_size: int
    ) -> int:
        if count < 16:
            put_byte(at, 0x80 | count)
            at += 1
        else:
            put_byte(at, 0xDE)
            put_be16(at + 1, count)
            at += 3
        for k in range(count):
            copy16(at, keys + 16 * k)
            at += sizes[k]
            kind, slot = kinds[k], slots[k]
            if kind == real:
                at = put_double(at, reals[slot])
            elif kind == vector:
                put_byte(at, 0x93)
                at = put_double(at + 1, reals[slot])
                at = put_double(at, reals[slot + 1])
                at = put_double(at, reals[slot + 2])
            elif kind == whole:
                at = put_whole(at, wholes[slot])
            elif kind == flag:
                put_byte(at, 0xC2 | wholes[slot])
                at += 1
            else:
                for m in range(0, text_size, 16):
                    copy16(at + m, text + m)
                at += text_size
        return at

    return encode


def make_write(table: Published) -> Callable[[Any, int], int]:
    """Make the function that writes a message at an address, straight out of a node's state.

    It returns where the message ends.
    """
    encode = make_encode(table.message, table.offsets)
    room = max(table.offsets) + 3

    @compilable
    def write(s: LoopState, at: int) -> int:
        reals = reals_at(s.here, room)
        wholes = wholes_at(s.here, room)
        return encode(at, s.out_keys, reals, wholes, s.text, s.text_size)

    made: Callable[[Any, int], int] = write
    return made
