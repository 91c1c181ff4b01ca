"""Events: the same kinds and numbers in the code, in PROTOCOL.md and in every recording."""

from __future__ import annotations

import ast
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

import messages
from messages import topics
from messages.codec import Decoder, encode
from messages.event_kinds import (
    DATA,
    EVENTS,
    MARK,
    EventKind,
    OtherKind,
    UnknownEventError,
    checked_data,
)
from messages.schema import schema
from messages.types import Event
from nodes.base.events import Clock, Events
from nodes.driver.force_words import NOTES, STATES
from nodes.driver.state import SAFETY
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordWriter
from tests.support.schemas import validate
from tests.support.setups import setup_of
from tests.support.sources import nodes_if_named, sources_of

PAGE = (Path(messages.__file__).parent / "PROTOCOL.md").read_text(encoding="utf-8")
SOURCES = Path(messages.__file__).parents[1]
UNITS = {
    "m": "m",
    "n": "N",
    "s": "s",
    "j": "J",
    "kg": "kg",
    "ticks": "ticks",
    "bytes": "bytes",
    "m_per_s": "m/s",
}
"""Suffixes of names, and their units."""


def rows(head: str) -> dict[str, list[str]]:
    """Return the page's table with a given head, by its first column."""
    table = PAGE[PAGE.index(head) :].partition("\n\n")[0].splitlines()[2:]
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in table]
    return {row[0].strip("`"): row[1:] for row in cells}


def named(cell: str) -> tuple[str, ...]:
    return tuple(re.findall(r"`(\w+)`", cell))


def test_the_type_lists_the_kinds_of_the_registry() -> None:
    assert list(get_args(EventKind)) == list(EVENTS) == sorted(EVENTS)
    assert list(DATA) == sorted(DATA)


def test_the_page_has_the_kinds_numbers_and_causes_of_the_code() -> None:
    found = {
        kind: (meaning, named(data))
        for kind, (meaning, data) in rows("| kind | meaning |").items()
    }
    assert found == {
        kind: (known.meaning, known.data) for kind, known in EVENTS.items()
    }
    assert {
        name: meaning for name, (meaning,) in rows("| number | meaning |").items()
    } == DATA
    causes = {
        int(cause): (kind.strip("`"), named(data))
        for cause, (kind, _, data) in rows("| `cause` | kind").items()
    }
    assert causes == {cause: (note.kind, note.fields) for cause, note in NOTES.items()}


@pytest.mark.parametrize("kind", EVENTS)
def test_the_numbers_of_every_kind_are_known_and_end_with_their_unit(
    kind: EventKind,
) -> None:
    assert EVENTS[kind].meaning
    assert len(set(EVENTS[kind].data)) == len(EVENTS[kind].data)
    for name in EVENTS[kind].data:
        unit = re.search(r"\[(.+)\]", DATA[name])
        ends = [end for end in UNITS if name.endswith(f"_{end}")]
        assert (unit[1] if unit else None) == (
            UNITS[max(ends, key=len)] if ends else None
        ), name


def test_no_number_stands_for_nothing() -> None:
    assert {name for known in EVENTS.values() for name in known.data} == set(DATA)


def test_states_are_numbered_as_the_driver_numbers_them() -> None:
    assert re.findall(r"\d+ (\w+)", DATA["after"]) == list(SAFETY)
    assert set(STATES) == set(SAFETY)


@pytest.mark.parametrize("cause", NOTES)
def test_each_cause_carries_numbers_that_its_kind_has(cause: int) -> None:
    note = NOTES[cause]
    assert {"cause", "tick", *note.fields} <= set(EVENTS[note.kind].data)
    shown = dict.fromkeys(("tick", *note.fields), 1.0) | {"axis": "y"}
    assert "{" not in note.text.format_map(shown) + note.short.format_map(shown)


def calls() -> Iterator[tuple[str, ast.Call]]:
    """Yield each call that emits an event of a literal kind."""
    names = ("emit", "emit_each", "deny")
    for path in sources_of("nodes", "sim"):
        for node in nodes_if_named(path, *names):
            called = node.func if isinstance(node, ast.Call) else None
            if isinstance(called, ast.Attribute) and called.attr in names:
                assert isinstance(node, ast.Call)
                yield f"{path.relative_to(SOURCES)}:{node.lineno}", node


def test_every_event_that_is_emitted_is_registered_and_every_kind_is_emitted() -> None:
    """Rare ones too: an unregistered kind would end the node."""
    # chosen by an expression
    used = {note.kind for note in NOTES.values()} | {
        "device_force",
        "device_force_back",
        MARK,
    }
    for place, call in calls():
        assert isinstance(call.func, ast.Attribute)
        kind: Any = (
            "denied"
            if call.func.attr == "deny"
            else ast.literal_eval(first)
            if (first := literal(call))
            else ""
        )
        if not kind:
            continue
        dicts = [one for one in ast.walk(call) if isinstance(one, ast.Dict)]
        names = [
            ast.literal_eval(key)
            for one in dicts
            for key in one.keys
            if key is not None
        ]
        assert kind in EVENTS or "." in kind, place
        assert set(names) <= {*EVENTS[kind].data}, place
        used.add(kind)
    # of an environment that is not in every tree yet
    assert used | {"world"} == set(EVENTS)


def literal(call: ast.Call) -> ast.expr | None:
    return (
        call.args[0] if call.args and isinstance(call.args[0], ast.Constant) else None
    )


def node_events() -> Events:
    setup = setup_of(name="a", pace="lockstep")
    return Events("a", Clock(setup, lambda: 7), lambda: 7)


@given(data=st.data(), kind=st.sampled_from(sorted(EVENTS)))
def test_every_kind_comes_through_wire_and_recording(
    data: st.DataObject, kind: EventKind
) -> None:
    names = (
        st.sampled_from(EVENTS[kind].data or ("",)).filter(bool)
        if EVENTS[kind].data
        else st.nothing()
    )
    numbers = data.draw(st.dictionaries(names, st.floats() | st.integers(0, 2**53)))
    events = node_events()
    events.emit_each(kind, "a sentence", numbers)
    ((_, payload),) = events.outbox
    event = Decoder(Event).decode(payload)
    finite = {
        name: float(value) for name, value in numbers.items() if math.isfinite(value)
    }
    assert (event.kind, event.data) == (kind, finite)
    validate(json.loads(msgspec.json.encode(event)), schema(Event))


@pytest.mark.parametrize(
    ("kind", "data", "named_in"),
    [
        ("safty", {}, "'safty'"),
        ("safety", {"span": 1.0}, "span"),
        ("hung", {"limit_s": 1.0}, "none"),
    ],
)
def test_what_is_not_registered_is_refused_at_once(
    kind: Any, data: dict[str, float], named_in: str
) -> None:
    events = node_events()
    with pytest.raises(UnknownEventError, match=named_in):
        events.emit(kind, "", data)
    assert not events.outbox


def test_another_package_has_kinds_of_its_own() -> None:
    assert checked_data(
        OtherKind("glove.overheat"), {"celsius": 61, "odd": math.nan}
    ) == {"celsius": 61.0}


def test_an_event_without_numbers_is_read() -> None:
    """From an older recording, or another language."""
    old = {
        "seq": 1,
        "stamp": 0.0,
        "node": "driver",
        "kind": "safety",
        "reason": "waiting → active",
    }
    assert Decoder(Event).decode(msgspec.msgpack.encode(old)).data == {}


def foxglove(described: dict[str, Any], path: str = "") -> None:
    """Parse a schema as Foxglove's parseJsonSchema.ts does; raise where it would."""
    assert described["type"] == "object", path
    for name, field in described["properties"].items():
        if field["type"] == "object":
            foxglove(field, f"{path}.{name}")
        elif field["type"] == "array":
            assert field["items"]["type"] in (
                "boolean",
                "string",
                "number",
                "integer",
            ), path
        else:
            assert field["type"] in ("boolean", "string", "number", "integer"), path


def test_foxglove_reads_the_numbers_of_an_event(tmp_path: Path) -> None:
    foxglove(schema(Event))
    assert set(schema(Event)["properties"]["data"]["properties"]) == set(DATA)
    path, topic = tmp_path / "a.mcap", topics.event("driver")
    event = Event(
        seq=3,
        stamp=0.1,
        node="driver",
        kind="stopped",
        reason="r",
        data={"span_s": 0.25},
    )
    with RecordWriter(str(path), {}) as writer:
        writer.write(topic, event, 0.1)
    recording = Recording(path)
    assert list(recording.messages(topic)) == [event]
    assert encode(event)
