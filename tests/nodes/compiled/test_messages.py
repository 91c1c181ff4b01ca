"""Compiled reading and writing of messages, against msgspec and the plain tick."""

from __future__ import annotations

import ctypes
import math
import struct
from collections.abc import Callable
from functools import cache
from typing import Any

import msgpack
import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from messages.codec import Decoder, MessageRefusedError, encode
from messages.types import MAX_COUNT, DeviceState, Force, Message, Proxy
from nodes.compiled.kernels.encode import make_encode
from nodes.compiled.message_fields import (
    FLAG,
    TEXT,
    VECTOR,
    WHOLE,
    NotCompilableError,
    fields_of,
    key_blocks,
)
from tests.support.scanned import assert_read_alike, kept, scanner

TYPES = (DeviceState, Proxy, Force)


reals = st.floats(allow_nan=False, allow_infinity=False)
counts = st.integers(0, MAX_COUNT)
vectors = st.tuples(reals, reals, reals)
names = st.text(st.characters(max_codepoint=127), max_size=128)
messages = st.one_of(
    st.builds(
        DeviceState,
        seq=counts,
        stamp=reals,
        position=vectors,
        force=vectors,
        force_seq=st.integers(-1, MAX_COUNT),
        age=counts,
        response=reals,
        missed=counts,
        safety=names,
        energy=reals,
        delay=reals,
        guard=reals,
    ),
    st.builds(
        Proxy,
        seq=counts,
        stamp=reals,
        position=vectors,
        proxy=vectors,
        normal=vectors,
        distance=reals,
        contact=st.booleans(),
        delay=reals,
    ),
    st.builds(
        Force, seq=counts, stamp=reals, force=vectors, law=names, revision=counts
    ),
)


@given(messages)
def test_what_the_nodes_send_is_read(message: Message) -> None:
    assert assert_read_alike(type(message), encode(message))


@cache
def encoder(message: type[Message]) -> Callable[[Message], bytes]:
    write: Any = make_encode(message)
    compiled = kept(
        lambda at, keys, reals, wholes, text, size: write(
            at, keys, reals, wholes, text, size
        ),
        f"write_{message.__name__}",
    )
    keys = ctypes.create_string_buffer(key_blocks(message))

    def made(value: Message) -> bytes:
        banks: tuple[Any, Any] = np.zeros(32), np.zeros(16, np.int64)
        text = b""
        for field in fields_of(message):
            given_value = getattr(value, field.name)
            if field.kind == TEXT:
                text = msgspec.msgpack.encode(given_value)
            elif field.kind == VECTOR:
                banks[0][field.slot : field.slot + 3] = given_value
            else:
                banks[int(field.kind in (WHOLE, FLAG))][field.slot] = given_value
        out, told = (
            ctypes.create_string_buffer(1024),
            ctypes.create_string_buffer(text, len(text) + 16),
        )
        at = ctypes.addressof(out)
        end = compiled(
            at, ctypes.addressof(keys), *banks, ctypes.addressof(told), len(text)
        )
        return out.raw[: end - at]

    return made


@given(messages)
def test_what_is_written_is_msgspecs_byte_for_byte(message: Message) -> None:
    assert encoder(type(message))(message) == encode(message)


def test_every_width_of_an_integer_is_written_as_msgspec_does() -> None:
    edges = {0, *(2**k + d for k in (7, 8, 15, 16, 31, 32, 52) for d in (-1, 0, 1))}
    for seq in sorted(edges):
        message = Force(seq=seq, stamp=0.0, force=(0.0, 0.0, 0.0))
        assert encoder(Force)(message) == encode(message)
        assert assert_read_alike(Force, encode(message))
    for force_seq in (-1, 0, 127):
        state = DeviceState(
            seq=0, stamp=0.0, position=(0.0, 0.0, 0.0), force_seq=force_seq
        )
        assert encoder(DeviceState)(state) == encode(state)


def as_map(entries: list[tuple[bytes, bytes]], wide: bool = False) -> bytes:
    head = (
        b"\xde" + struct.pack(">H", len(entries))
        if wide or len(entries) > 15
        else bytes([0x80 | len(entries)])
    )
    return head + b"".join(key + value for key, value in entries)


whole_codes = st.one_of(
    st.integers(0, 127).map(lambda v: bytes([v])),
    st.integers(-32, -1).map(lambda v: struct.pack("b", v)),
    st.integers(0, 255).map(lambda v: b"\xcc" + struct.pack(">B", v)),
    st.integers(0, 2**16 - 1).map(lambda v: b"\xcd" + struct.pack(">H", v)),
    st.integers(0, 2**32 - 1).map(lambda v: b"\xce" + struct.pack(">I", v)),
    st.integers(0, 2**64 - 1).map(lambda v: b"\xcf" + struct.pack(">Q", v)),
    st.integers(-(2**7), 2**7 - 1).map(lambda v: b"\xd0" + struct.pack(">b", v)),
    st.integers(-(2**15), 2**15 - 1).map(lambda v: b"\xd1" + struct.pack(">h", v)),
    st.integers(-(2**31), 2**31 - 1).map(lambda v: b"\xd2" + struct.pack(">i", v)),
    st.integers(-(2**63), 2**63 - 1).map(lambda v: b"\xd3" + struct.pack(">q", v)),
)
real_codes = st.one_of(
    st.floats().map(lambda v: b"\xcb" + struct.pack(">d", v)),
    st.floats(width=32).map(lambda v: b"\xca" + struct.pack(">f", v)),
    whole_codes,
)
anything = st.recursive(
    st.one_of(
        st.none(),
        st.booleans(),
        st.integers(-(2**63), 2**64 - 1),
        st.floats(),
        st.text(),
        st.binary(),
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=4),
        st.dictionaries(st.text(max_size=4), inner, max_size=4),
    ),
    max_leaves=8,
).map(msgpack.packb)
keys = st.sampled_from(
    [field.name for field in fields_of(Force)]
    + ["x", "Seq", "forces", "stam", "stämp", ""]
).map(msgpack.packb)
codes = st.one_of(
    whole_codes,
    real_codes,
    st.tuples(real_codes, real_codes, real_codes).map(lambda v: b"\x93" + b"".join(v)),
    anything,
    st.just(b"\xc1"),
    st.just(b"\xd4\x01\x00"),
)


@settings(max_examples=400)
@given(
    st.permutations(["seq", "stamp", "force", "law", "revision"]),
    st.tuples(
        whole_codes,
        real_codes,
        st.tuples(real_codes, real_codes, real_codes),
        names,
        whole_codes,
    ),
    st.lists(st.tuples(keys, codes), max_size=4),
    st.booleans(),
    st.data(),
)
def test_in_any_order_with_any_width_and_unknown_keys(
    order: list[str],
    values: Any,
    more: list[tuple[bytes, bytes]],
    wide: bool,
    data: Any,
) -> None:
    """Both refuse each message, or leave it to msgspec, or read it alike."""
    seq, stamp, force, law, revision = values
    known = {
        "seq": seq,
        "stamp": stamp,
        "force": b"\x93" + b"".join(force),
        "law": msgpack.packb(law),
        "revision": revision,
    }
    entries = [(msgpack.packb(name), known[name]) for name in order]
    for entry in more:
        entries.insert(data.draw(st.integers(0, len(entries))), entry)
    payload = as_map(entries, wide)
    try:
        Decoder(Force).decode(payload)
        right = True
    except MessageRefusedError:
        right = False
    read = (
        assert_read_alike(Force, payload)
        if right
        else scanner(Force)(payload) is not None
    )
    assert right or not read


@given(messages, st.data())
def test_a_damaged_payload_is_never_read_otherwise(message: Message, data: Any) -> None:
    payload = bytearray(encode(message))
    for _ in range(data.draw(st.integers(1, 3))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(
            st.integers(0, 255)
        )
    damaged = bytes(
        payload[: data.draw(st.integers(0, len(payload)))]
        if data.draw(st.booleans())
        else payload
    )
    assert_read_alike(type(message), damaged)


def test_just_inside_and_just_outside_of_what_is_read() -> None:
    def force(**changed: Any) -> bytes:
        return bytes(
            msgpack.packb(
                {
                    "seq": 1,
                    "stamp": 2.0,
                    "force": [1.0, 2.0, 3.0],
                    "law": "pd",
                    "revision": 0,
                    **changed,
                }
            )
        )

    def read(payload: bytes) -> bool:
        return scanner(Force)(payload) is not None

    assert read(force())
    assert read(force(seq=MAX_COUNT))
    assert not read(force(seq=MAX_COUNT + 1))
    assert not read(force(seq=-1))
    assert not read(force(seq=True))
    assert not read(force(seq=1.0))
    assert read(force(stamp=-1))
    assert not read(force(stamp=math.nan))
    assert not read(force(stamp=math.inf))
    assert not read(force(force=[1.0, 2.0]))
    assert not read(force(force=[1.0, 2.0, 3.0, 4.0]))
    assert not read(force(force=[1.0, math.inf, 3.0]))
    assert read(force(law="x" * 128))
    assert not read(force(law="x" * 129))
    assert not read(force(law=b"pd"))
    assert not read(force(law=None))
    assert not read(force() + b"\x00")
    assert not read(force()[:-1])
    assert not read(b"")
    assert not read(b"\xc0")
    assert not read(msgpack.packb({"seq": 1, "stamp": 2.0}))
    assert not read(msgpack.packb([1, 2.0, [1.0, 2.0, 3.0]]))
    # Left to msgspec, which reads it or says why not.
    assert not read(force(law="é"))
    assert not read(force(unknown=msgpack.ExtType(1, b"")))
    for depth, skipped in ((10, True), (2000, False)):
        nested = b"\x91" * depth + b"\xc0"
        entries = [
            (msgpack.packb(name), msgpack.packb(value))
            for name, value in msgpack.unpackb(force()).items()
        ]
        assert read(as_map([*entries, (msgpack.packb("unknown"), nested)])) == skipped


def test_a_field_that_cannot_be_compiled_is_named() -> None:
    class Odd(Message, frozen=True, kw_only=True):
        thing: bytes = b""

    with pytest.raises(NotCompilableError, match=r"Odd\.thing"):
        fields_of(Odd)

    class Long(Message, frozen=True, kw_only=True):
        a_name_that_is_too_long: float = 0.0

    with pytest.raises(NotCompilableError, match="longer than 15 bytes"):
        fields_of(Long)
