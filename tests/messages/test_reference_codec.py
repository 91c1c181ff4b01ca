"""Compare two independent codecs: msgspec, and msgpack with a check per field."""

from __future__ import annotations

from typing import Any

import msgpack
import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from messages import reference_codec, topics
from messages.codec import MAX_PAYLOAD, Decoder, MessageRefusedError, encode
from messages.types import MAX_COUNT, Event, Message, NodeStatus
from tests.support.strategies import TYPES, messages

TOPICS: dict[type[Message], str] = {
    **{kind: topic for topic, kind in topics.FIXED.items() if topic != topics.PARTNER},
    NodeStatus: topics.status("driver"),
    Event: topics.event("driver"),
}


def both(kind: type[Message], payload: bytes) -> tuple[Any, Any]:
    """Read a payload by both; None for one that refuses it."""
    try:
        ours = msgspec.to_builtins(Decoder(kind).decode(payload))
    except MessageRefusedError:
        ours = None
    try:
        theirs = reference_codec.read(TOPICS[kind], payload)
    except MessageRefusedError:
        theirs = None
    return ours, theirs


def as_lists(message: Any) -> Any:
    """Write tuples as the lists that the wire has."""
    return msgspec.json.decode(msgspec.json.encode(message))


def test_every_message_type_has_a_topic() -> None:
    assert set(TOPICS) == set(TYPES)


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
@given(data=st.data())
@settings(max_examples=25)
def test_what_one_writes_the_other_reads(
    kind: type[Message], data: st.DataObject
) -> None:
    message = data.draw(messages(kind))
    payload = encode(message)
    plain = reference_codec.read(TOPICS[kind], payload)
    assert plain == as_lists(message)
    # The same fields in the same order: the same bytes.
    assert reference_codec.write(TOPICS[kind], plain) == payload
    assert Decoder(kind).decode(reference_codec.write(TOPICS[kind], plain)) == message


VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-(2**63), 2**64 - 1),
    st.sampled_from([-1, 0, 1, MAX_COUNT, MAX_COUNT + 1, 2.0, 2.5, 1e308, 1e15]),
    st.floats(),
    st.text(max_size=3),
    st.sampled_from(["x" * 128, "x" * 129, "x" * 4096, "x" * 4097]),
    st.lists(st.floats(), max_size=4),
    st.dictionaries(st.text(max_size=2), st.floats(), max_size=3),
)


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
@given(data=st.data())
@settings(max_examples=40)
def test_a_wrong_value_is_refused_by_both_or_read_alike(
    kind: type[Message], data: st.DataObject
) -> None:
    good = msgpack.unpackb(encode(data.draw(messages(kind))))
    name = data.draw(st.sampled_from([*good, "unknown"]))
    good[name] = data.draw(VALUES)
    if data.draw(st.booleans()):
        del good[data.draw(st.sampled_from(sorted(good)))]
    ours, theirs = both(kind, msgpack.packb(good))
    assert theirs == as_lists(ours)


@pytest.mark.parametrize("kind", TYPES, ids=lambda kind: kind.__name__)
@given(data=st.data())
@settings(max_examples=40)
def test_a_damaged_payload_is_refused_by_both_or_read_alike(
    kind: type[Message], data: st.DataObject
) -> None:
    payload = bytearray(encode(data.draw(messages(kind))))
    place = data.draw(st.integers(0, len(payload) - 1))
    payload[place] = data.draw(st.integers(0, 255))
    payload = payload[: data.draw(st.sampled_from([len(payload), place]))]
    ours, theirs = both(kind, bytes(payload))
    assert theirs in (None, as_lists(ours))
    if ours is not None and theirs is None:
        # Damage in a field that neither knows: msgspec skips it unread.
        with pytest.raises((ValueError, msgpack.exceptions.UnpackException)):
            msgpack.unpackb(
                payload, raw=True, strict_map_key=False, object_pairs_hook=list
            )


def test_refusals_name_topic_field_and_limit() -> None:
    good = {"seq": 3, "stamp": 0.006, "force": [0.0, 0.0, 1.5]}
    assert reference_codec.read("/coupling/force", msgpack.packb(good))["law"] == ""
    for change, told in (
        ({"seq": -1}, r"/coupling/force seq: -1, limits 0 to 9007199254740991"),
        ({"stamp": float("nan")}, "/coupling/force stamp: a finite number is wanted"),
        ({"force": [1.0]}, "/coupling/force force: 3 numbers are wanted"),
        ({"forces": 1.0}, "no such field: forces"),
    ):
        with pytest.raises(MessageRefusedError, match=told):
            reference_codec.write("/coupling/force", {**good, **change})
    with pytest.raises(MessageRefusedError, match="seq is missing"):
        reference_codec.write(
            "/coupling/force", {"stamp": 0.0, "force": [0.0, 0.0, 0.0]}
        )
    with pytest.raises(MessageRefusedError, match="/nowhere: carries no message"):
        reference_codec.read("/nowhere", b"\x80")
    with pytest.raises(MessageRefusedError, match=f"limit {MAX_PAYLOAD}"):
        reference_codec.read("/coupling/force", b"\x00" * (MAX_PAYLOAD + 1))
