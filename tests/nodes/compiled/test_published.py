"""The publish tables: both ticks send the same variable of the state for each field."""

from __future__ import annotations

import ctypes
from typing import Annotated, Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from messages.codec import Decoder
from messages.types import MAX_COUNT, Message, Vector
from nodes.compiled.kernels.encode import make_write
from nodes.compiled.kernels.machine import record_at
from nodes.compiled.kernels.sources import record_of
from nodes.compiled.layout import LONGEST_OUT, LoopState, state_of, struct
from nodes.compiled.message_fields import key_blocks
from nodes.compiled.published import Published, payload_of, published
from nodes.coupling import state as coupling
from nodes.driver import state as driver
from nodes.environment import state as environment
from tests.support.scanned import kept

HOPS: dict[str, tuple[Published, type[Any]]] = {
    "driver": (driver.PUBLISHED, driver.DriverState),
    "environment": (environment.PUBLISHED, environment.EnvironmentState),
    "coupling": (coupling.PUBLISHED, coupling.CouplingState),
}


def filled(state: Any, table: Published, numbers: Any) -> None:
    """Put numbers where the fields of a message stand."""
    words = (ctypes.c_int64 * (ctypes.sizeof(state) // 8)).from_buffer(state)
    reals = (ctypes.c_double * len(words)).from_buffer(state)
    for field, offset in zip(
        msgspec.structs.fields(table.message), table.offsets, strict=True
    ):
        if field.type == Vector:
            reals[offset : offset + 3] = [numbers.draw(REALS) for _ in range(3)]
        elif offset >= 0 and "float" in str(field.type):
            reals[offset] = numbers.draw(REALS)
        elif offset >= 0:
            words[offset] = numbers.draw(
                st.booleans() if field.type is bool else COUNTS
            )


REALS = st.floats(allow_nan=False, allow_infinity=False)
COUNTS = st.integers(0, MAX_COUNT)


@pytest.mark.parametrize("hop", HOPS)
def test_both_ticks_send_what_stands_in_the_state(hop: str) -> None:
    table, kind = HOPS[hop]
    look, write = record_at(record_of(kind)), make_write(table)
    compiled = kept(lambda address, at: write(look(address), at), f"publish_{hop}")
    plain = payload_of(table)
    keys = ctypes.create_string_buffer(key_blocks(table.message))
    room = ctypes.create_string_buffer(LONGEST_OUT + 16)

    @given(numbers=st.data(), text=st.text("abc", max_size=20))
    def alike(numbers: st.DataObject, text: str) -> None:
        state: Any = state_of(kind, compiled=True)
        filled(state, table, numbers)
        words = ctypes.create_string_buffer(
            msgspec.msgpack.encode(text).ljust(48, b"\0")
        )
        state.here, state.out_keys = ctypes.addressof(state), ctypes.addressof(keys)
        state.text, state.text_size = (
            ctypes.addressof(words),
            len(msgspec.msgpack.encode(text)),
        )
        begin = ctypes.addressof(room)
        payload = ctypes.string_at(begin, compiled(state.here, begin) - begin)
        assert payload == plain(state, text)
        Decoder(table.message).decode(payload)

    alike()


@struct
class Small(LoopState):
    """A state for the tables below."""

    stamp: float
    count: int
    point: Annotated[list[float], 3]
    many: Annotated[list[float], 5]


class Said(Message, frozen=True, kw_only=True, gc=False):
    """What is published from it."""

    point: Vector
    total: int = 0


def test_a_field_without_a_variable_of_its_kind_is_refused_by_its_name() -> None:
    assert published(Said, Small, total="count", point=("many", 2)).values == {
        "seq": "s.seq",
        "stamp": "s.stamp",
        "point": "(s.many[2], s.many[3], s.many[4])",
        "total": "s.count",
    }
    with pytest.raises(TypeError, match=r"Said\.total: Small has no 'total'"):
        published(Said, Small)
    with pytest.raises(
        TypeError, match=r"Said\.total: Small has no 'stamp' of that kind"
    ):
        published(Said, Small, total="stamp")
    with pytest.raises(
        TypeError, match=r"Said\.point: Small has no 'many' of that kind"
    ):
        published(Said, Small, total="count", point="many")
    with pytest.raises(
        TypeError, match=r"Said\.point: Small has no 'many' of that kind"
    ):
        # beyond the end
        published(Said, Small, total="count", point=("many", 3))
