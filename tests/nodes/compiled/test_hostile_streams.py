"""Hostile messages: both ticks refuse, count and answer the same, in any order."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from messages.codec import MAX_PAYLOAD, encode
from messages.types import MAX_COUNT, Force, Message
from nodes.compiled.choose_tick import choose
from nodes.coupling.node import Coupling
from nodes.driver.node import Driver
from nodes.environment.node import Environment
from tests.support.scripted import (
    Outcome,
    Script,
    ScriptedSimulation,
    assert_alike,
    played,
)
from tests.support.scripted_world import EPOCH, TICK, Arrival, at
from tests.support.scripts import KINDS, answer, driver, follower, question

ALL = ["driver", *KINDS]
TOO_LONG = [MAX_PAYLOAD + n for n in (1, 2, 32, 63, 64, 65, 66)]


@pytest.fixture(scope="module", autouse=True)
def compiled_before() -> None:
    kernels = [Driver.kernel_module, Environment.kernel_module, Coupling.kernel_module]
    assert choose("compiled", kernels, print) == "compiled"


def changed(message: Message, **given: Any) -> bytes:
    """Encode a message with fields that its type would refuse."""
    return msgspec.msgpack.encode({**msgspec.to_builtins(message), **given})


def padded(message: Message, size: int) -> bytes:
    """Encode a message made long by an unknown field."""
    empty = len(changed(message, later=bytes(60_000))) - 60_000
    payload = changed(message, later=bytes(size - empty))
    assert len(payload) == size
    return payload


Frames = Callable[[bytes, Message], tuple[bytes, ...]]
GOOD: dict[str, Frames] = {
    "as it is": lambda topic, message: (topic, encode(message)),
    "with a field of a later version": lambda topic, message: (
        topic,
        changed(message, later=[1, {"a": None}]),
    ),
    # What only the interpreted tick skips: the compiled one hands the message back to it.
    "with an extension of MessagePack": lambda topic, message: (
        topic,
        changed(message, later=msgspec.msgpack.Ext(1, b"later")),
    ),
    "as long as may be": lambda topic, message: (topic, padded(message, MAX_PAYLOAD)),
    "its fields in another order": lambda topic, message: (
        topic,
        msgspec.msgpack.encode(dict(reversed(msgspec.to_builtins(message).items()))),
    ),
}
BAD: dict[str, Frames] = {
    "nothing": lambda topic, _: (topic, b""),
    "cut": lambda topic, message: (topic, encode(message)[:-3]),
    "with more behind it": lambda topic, message: (topic, encode(message) + b"\x00"),
    "no map": lambda topic, _: (topic, b"\x93\x01\x02\x03"),
    "what MessagePack does not have": lambda topic, _: (topic, b"\xc1" * 40),
    "a million nested lists": lambda topic, _: (topic, b"\x91" * 60_000),
    "a stamp that is not a number": lambda topic, message: (
        topic,
        changed(message, stamp=math.nan),
    ),
    "a stamp without an end": lambda topic, message: (
        topic,
        changed(message, stamp=-math.inf),
    ),
    "a tick before the first": lambda topic, message: (topic, changed(message, seq=-1)),
    "a tick after the last": lambda topic, message: (
        topic,
        changed(message, seq=MAX_COUNT + 1),
    ),
    "a tick that is a word": lambda topic, message: (
        topic,
        changed(message, seq="now"),
    ),
    "a topic that begins alike": lambda topic, message: (topic + b"s", encode(message)),
    "a topic of 5000 letters": lambda topic, message: (
        topic + b"x" * 5000,
        encode(message),
    ),
    **{
        f"{size} bytes": lambda topic, message, size=size: (
            topic,
            padded(message, size),
        )  # type: ignore[misc]
        for size in TOO_LONG
    },
}


def message_of(kind: str, seq: int, stamp: float) -> Message:
    return (
        Force(seq=seq, stamp=0.0, force=(0.0, 0.0, 1.0))
        if kind == "driver"
        else question(kind, seq, stamp)
    )


def script_of(
    kind: str, coming: list[tuple[float, float, int, Frames]], pace: str
) -> Script:
    """Return a script of messages: place, delay [µs], tick and modification of each."""
    base = follower(kind, [], pace) if kind in KINDS else driver([], ticks=32)
    if pace == "lockstep" and kind == "driver":
        base = base._replace(kind=ScriptedSimulation, pace=pace)
    topic = base.kind.listens_to[0].encode()
    arrivals = [
        Arrival(
            at(place, late),
            made(topic, message_of(kind, seq, 1e-9 * (EPOCH + TICK * place))),
        )
        for place, late, seq, made in coming
    ]
    return base._replace(arrivals=arrivals)


def with_one_refused(kind: str, made: Frames, pace: str) -> Script:
    """Insert a refused message between two ticks, 20 times; then a stream without it."""
    coming = [(float(seq), 500.0, seq, GOOD["as it is"]) for seq in range(32)]
    # In lockstep a driver that was answered asks at once; so the bad one comes right before the
    # good one.
    coming += [(float(seq), 400.0, seq, made) for seq in range(4, 24)]
    return script_of(kind, coming, pace)


def without_texts(outcome: Outcome) -> Outcome:
    """Remove the texts of refusals, which depend on what follows a message of one frame."""
    return outcome._replace(events=[(kind, "", 0, 0.0) for kind, *_ in outcome.events])


@pytest.mark.parametrize("pace", ["realtime", "lockstep"])
@pytest.mark.parametrize("kind", ALL)
@pytest.mark.parametrize("bad", BAD)
def test_what_is_refused_is_refused_alike_and_costs_no_other_message(
    bad: str, kind: str, pace: str, tmp_path: Path
) -> None:
    outcome, node = assert_alike(with_one_refused(kind, BAD[bad], pace), tmp_path)
    assert node.events.refused == 20
    assert {name for name, *_ in outcome.events} <= {"refused", "safety", "eased"}
    # Told at the first, and at powers of two: 1, 2, 4, 8, 16.
    assert [name for name, *_ in outcome.events].count("refused") == 5
    assert node.counters.ticks == 32
    assert node.counters.gaps == 0


@pytest.mark.parametrize("pace", ["realtime", "lockstep"])
@pytest.mark.parametrize("kind", ALL)
@pytest.mark.parametrize("good", GOOD)
def test_what_is_taken_is_taken_alike(
    good: str, kind: str, pace: str, tmp_path: Path
) -> None:
    coming = [(float(seq), 500.0, seq, GOOD[good]) for seq in range(32)]
    outcome, node = assert_alike(script_of(kind, coming, pace), tmp_path)
    assert node.events.refused == 0
    assert node.counters.ticks == 32
    assert len(outcome.sent) == 32 + (kind == "driver")


@pytest.mark.parametrize("kind", ALL)
@pytest.mark.parametrize("frames", ["one", "three", "one, of another topic"])
def test_messages_of_one_frame_and_of_three_cost_themselves_only(
    frames: str, kind: str, tmp_path: Path
) -> None:
    made: Frames = {
        "one": lambda topic, _: (topic,),
        "three": lambda topic, message: (topic, encode(message), b"more"),
        "one, of another topic": lambda topic, _: (topic + b"s",),
    }[frames]
    script = with_one_refused(kind, made, "realtime")
    plain, one = played(script, "plain", tmp_path)
    compiled, other = played(script, "compiled", tmp_path)
    assert without_texts(compiled) == without_texts(plain)
    assert one.events.refused == other.events.refused == 20
    assert other.counters.ticks == 32


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_numbers_that_are_none_reach_no_device(number: float, tmp_path: Path) -> None:
    def made(topic: Any, message: Any) -> Any:
        return topic, changed(message, force=[0.0, number, 0.0])

    outcome, node = assert_alike(with_one_refused("driver", made, "realtime"), tmp_path)
    assert node.events.refused == 20
    assert all(map(math.isfinite, sum((force for _, force, _ in outcome.given), ())))


@pytest.mark.parametrize("kind", KINDS)
def test_ticks_that_jump_make_no_count_that_cannot_be_told(
    kind: str, tmp_path: Path
) -> None:
    jumps = [0, MAX_COUNT - 1, MAX_COUNT, 0, MAX_COUNT - 1, MAX_COUNT, 1, MAX_COUNT]
    coming = [
        (float(place), 500.0, seq, GOOD["as it is"]) for place, seq in enumerate(jumps)
    ]
    for pace in ("realtime", "lockstep"):
        _, node = assert_alike(script_of(kind, coming, pace), tmp_path)
        assert node.status().gaps == MAX_COUNT


ANY = {
    **GOOD,
    **{
        name: made
        for name, made in BAD.items()
        if "bytes" not in name and "million" not in name
    },
}
coming = st.lists(
    st.tuples(
        st.integers(0, 30),
        st.integers(0, 9_000),
        st.integers(-6, 3),
        st.sampled_from(
            [*["as it is"] * 12, *["with an extension of MessagePack"] * 6, *ANY]
        ),
    ),
    max_size=60,
)


AS_IT_IS = "as it is"


@settings(max_examples=80)
@example(
    kind="driver",
    stream=[
        (0, 0, 0, AS_IT_IS),
        (0, 0, 0, AS_IT_IS),
        (2, 1, 1, AS_IT_IS),
        (21, 2001, 0, "nothing"),
        (22, 0, -1, AS_IT_IS),
    ],
)
@given(kind=st.sampled_from(ALL), stream=coming)
def test_late_repeated_overtaken_and_damaged_messages_in_any_order(
    kind: str, stream: list[tuple[int, int, int, str]], tmp_path: Path
) -> None:
    made = [
        (float(place), float(late), max(place + step, 0), ANY[name])
        for place, late, step, name in stream
    ]
    assert_alike(script_of(kind, made, "realtime"), tmp_path)


def test_the_answers_of_this_suite_are_answers(tmp_path: Path) -> None:
    """A normal stream is answered tick by tick, or the comparisons would be empty."""
    outcome, node = assert_alike(
        driver([answer(seq) for seq in range(32)], ticks=32), tmp_path
    )
    assert node.driving.missed == 0
    assert any(force != (0.0, 0.0, 0.0) for _, force, _ in outcome.given)
