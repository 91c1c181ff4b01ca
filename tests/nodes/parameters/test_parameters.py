"""Parameters: YAML, errors with path, value and limit, atomic changes, watched files."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Annotated, Any

import msgspec
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.coupling.parameters import CouplingParameters
from nodes.parameters.store import (
    ParameterError,
    ParameterStore,
    convert,
    merge,
    of_node,
)
from nodes.parameters.yaml_io import (
    MAX_CHARACTERS,
    MAX_DEPTH,
    MAX_INT,
    MAX_KEPT,
    parse_yaml,
    read_yaml,
    write_yaml,
)

# -- YAML
# --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1e3", 1000.0),
        ("1E-3", 0.001),
        ("-2.5e+2", -250.0),
        ("1.", 1.0),
        (".5", 0.5),
        ("1_000", 1000),
        ("010", 10),
        ("0x10", 16),
        ("1:30", "1:30"),
        ("off", "off"),
        ("on", "on"),
        ("yes", "yes"),
        ("y", "y"),
        ("true", True),
        ("~", None),
        ("null", None),
        ("", None),
        ("2026-01-01", "2026-01-01"),
        ("'1e3'", "1e3"),
        ("nan", "nan"),
        ("1e", "1e"),
        ("<<", "<<"),
        ("=", "="),
        (str(MAX_INT), MAX_INT),
        (f"-{MAX_INT}", -MAX_INT),
    ],
)
def test_scalars_are_what_they_look_like(text: str, value: object) -> None:
    read = parse_yaml(text, "test")
    assert read == value
    assert type(read) is type(value)


@pytest.mark.parametrize("size", [0, MAX_KEPT])
def test_what_was_read_is_the_reader_s_own(size: int) -> None:
    """A short text is parsed once: who changes what came of it changes no later reading."""
    text = "a: {b: [1, {c: 2}]}\n" + "#" * size
    first = parse_yaml(text, "one")
    first["a"]["b"][1]["c"] = 3
    first["a"]["b"].append(4)
    del first["a"]
    assert parse_yaml(text, "other") == {"a": {"b": [1, {"c": 2}]}}


def nested(depth: int) -> str:
    return "[" * depth + "]" * depth


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("{a: 1, a: 2}", "'a' stands twice"),
        ("a: {b: 1, c: 2, b: 3}", "'b' stands twice"),
        ("{1: a}", "key 1 is not text"),
        ("{off: a, true: b}", "key True is not text"),
        ("{~: a}", "key None is not text"),
        ("a: &x [1]\nb: *x", "aliases are not accepted"),
        ("a: &a [z]\nb: &b [*a, *a]\nc: &c [*b, *b]", "aliases are not accepted"),
        ("!!python/object/apply:os.system [echo]", "python"),
        ("!!set {a, b}", "set"),
        ("!!binary aGk=", "binary"),
        ("!!timestamp 2026-01-01", "timestamp"),
        ("[1, 2", "line 1"),
        ("a: b: c", "line 1"),
        ("--- 1\n--- 2", "document"),
        (nested(MAX_DEPTH + 1), f"nested deeper than {MAX_DEPTH}"),
        (nested(100_000), f"nested deeper than {MAX_DEPTH}"),
        (str(MAX_INT + 1), f"limit ±{MAX_INT}"),
        ("9" * 5000, f"limit ±{MAX_INT}"),
        (" " * (MAX_CHARACTERS + 1), f"limit {MAX_CHARACTERS}"),
        ("a: \x00", "x00"),
    ],
)
def test_what_could_surprise_is_refused_with_its_place(text: str, told: str) -> None:
    with pytest.raises(ParameterError, match=r"scene\.yaml") as raised:
        parse_yaml(text, "scene.yaml")
    assert told in str(raised.value)


def test_limits_themselves_are_accepted() -> None:
    assert parse_yaml(nested(MAX_DEPTH), "test") is not None
    assert parse_yaml(" " * MAX_CHARACTERS, "test") is None


@pytest.mark.parametrize(
    ("content", "told"), [(b"a: \xff", "not UTF-8"), (None, "No such file")]
)
def test_unreadable_files_are_told(
    tmp_path: Path, content: bytes | None, told: str
) -> None:
    path = tmp_path / "scene.yaml"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ParameterError, match=told) as raised:
        read_yaml(path)
    assert str(path) in str(raised.value)


scalars = (
    st.none()
    | st.booleans()
    | st.integers(-MAX_INT, MAX_INT)
    | st.floats(allow_nan=False, allow_infinity=False)
    | st.text(st.characters(exclude_categories=["Cs"]), max_size=12)
    | st.sampled_from(
        [
            "off",
            "1e3",
            "010",
            "1:30",
            "~",
            "",
            "null",
            "=",
            "<<",
            "2026-01-01",
            " a",
            "a: b",
            "#",
            "- x",
        ]
    )
)
names = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
trees = st.recursive(
    scalars,
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(names, inner, max_size=4)
    ),
    max_leaves=20,
)


def bits(value: Any) -> Any:
    """Return floats as bits, so that −0.0 and the last digit count."""
    if isinstance(value, float):
        return struct.pack("<d", value)
    if isinstance(value, dict):
        return {key: bits(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [bits(inner) for inner in value]
    return type(value), value


@given(trees)
def test_what_is_written_reads_back_to_the_bit(tree: Any) -> None:
    assert bits(parse_yaml(write_yaml(tree), "test")) == bits(tree)


def test_repeated_objects_are_written_out() -> None:
    taps = [1.0, 2.0]
    assert parse_yaml(write_yaml({"a": taps, "b": taps}), "test") == {
        "a": taps,
        "b": taps,
    }


# -- types, paths, limits
# ------------------------------------------------------------------------------------------------


class Inner(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A group of parameters."""

    gain: Annotated[float, msgspec.Meta(ge=0.0)] = 1.0
    points: list[list[float]] = []


class Outer(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters of a node."""

    name: str = "x"
    count: Annotated[int, msgspec.Meta(le=5)] = 0
    inner: Inner = Inner()
    maybe: Inner | None = None
    free: dict[Annotated[str, msgspec.Meta(pattern="^[a-z]+$")], Any] = {}


@pytest.mark.parametrize(
    ("data", "told"),
    [
        ({"count": 6}, "node.count: expected a whole number of at most 5, got 6"),
        ({"count": 2.5}, "node.count: expected a whole number, got 2.5"),
        (
            {"inner": {"gain": -0.5}},
            "node.inner.gain: expected a number of at least 0, got -0.5",
        ),
        (
            {"inner": {"gain": "strong"}},
            "node.inner.gain: expected a number, got 'strong'",
        ),
        (
            {"inner": {"gain": float("nan")}},
            "node.inner.gain: nan is not a finite number",
        ),
        (
            {"inner": {"points": [[0.0, 1.0], [2.0, float("inf")]]}},
            "node.inner.points[1][1]: inf is not a finite number",
        ),
        (
            {"inner": {"points": [[0.0, "a"]]}},
            "node.inner.points[0][1]: expected a number, got 'a'",
        ),
        (
            {"inner": {"gian": 1.0}},
            "node.inner.gian: no such parameter; available: gain, points; did you mean gain?",
        ),
        (
            {"free": {"deep": {"x": float("nan")}}},
            "node.free.deep.x: nan is not a finite number",
        ),
        ({"free": {"A": 1}}, "node.free: expected a name that matches '^[a-z]+$'"),
        ({"inner": {"gain": 10**400}}, "node.inner.gain"),
        ([], "node: expected a mapping, got a list"),
    ],
)
def test_refusals_name_path_value_and_limit(data: Any, told: str) -> None:
    with pytest.raises(ParameterError) as raised:
        convert(data, Outer, "node")
    assert told in str(raised.value)


@pytest.mark.parametrize(
    ("values", "told"),
    [
        (
            {"cuont": 1},
            "node.cuont: no such parameter; available: name, count, inner, maybe, free",
        ),
        (
            {"inner.gian": 1.0},
            "node.inner.gian: no such parameter; available: gain, points",
        ),
        (
            {"inner.gain.x": 1.0},
            "node.inner.gain.x: no such parameter; it has no names below",
        ),
        (
            {"maybe.gain": 1.0},
            "node.maybe.gain: no such parameter; it has nothing below it; set it as a whole",
        ),
        ({"free.a.b": 1.0}, "node.free.a: no such parameter; available: nothing yet"),
        (
            {"inner.points[0]": [1.0]},
            "node.inner.points[0]: no such parameter; it has 0 entries from [0]",
        ),
        ({"": 1}, "'' is not a parameter's name"),
        ({"a..b": 1}, "'a..b' is not a parameter's name"),
        ({"inner[gain]": 1}, "'inner[gain]' is not a parameter's name"),
        (
            {"count": 1, "inner.gain": -1.0},
            "node.inner.gain: expected a number of at least 0, got -1.0",
        ),
        ({}, "expected names and values"),
        ([("count", 1)], "expected names and values"),
    ],
)
def test_a_refused_set_changes_nothing(values: Any, told: str) -> None:
    store = ParameterStore("node", Outer, {"count": 3})
    before = store.current
    with pytest.raises(ParameterError) as raised:
        store.changed(values)
    assert told in str(raised.value)
    assert store.current is before
    assert store.dump() == ParameterStore("node", Outer, {"count": 3}).dump()


def test_names_are_free_in_mappings_only() -> None:
    store = ParameterStore(
        "node", Outer, {"free": {"a": {"x": 1}}, "inner": {"points": [[1.0, 2.0]]}}
    )
    made = store.changed(
        {
            "free.b": 5,
            "free.a.y": 2,
            "inner.points[0][1]": 7,
            "count": 4,
            "maybe": {"gain": 2},
        }
    )
    assert made.free == {"a": {"x": 1, "y": 2}, "b": 5}
    assert made.inner.points == [[1.0, 7.0]]
    assert made.maybe == Inner(gain=2.0)
    assert store.current.free == {"a": {"x": 1}}


def test_get_reads_values_branches_and_entries() -> None:
    store = ParameterStore("node", Outer, {"inner": {"points": [[1.0, 2.0]]}})
    assert store.get("inner.points[0][1]") == 2.0
    assert store.get("inner") == {"gain": 1.0, "points": [[1.0, 2.0]]}
    assert store.flat()["inner.points"] == [[1.0, 2.0]]
    for name in ("inner.points[1]", "inner.x", "count.x"):
        with pytest.raises(ParameterError, match="no such parameter"):
            store.get(name)


def test_merging_lays_over_and_another_kind_replaces() -> None:
    base = {
        "law": "pd",
        "laws": {
            "pd": {"kind": "pd", "stiffness": 1.0, "damping": 2.0},
            "old": {"kind": "fir"},
        },
    }
    over = {
        "laws": {
            "pd": {"stiffness": 5.0},
            "old": {"kind": "pd", "damping": 1.0},
            "new": {"kind": "fir", "taps": [1.0]},
        }
    }
    before = msgspec.json.encode(base)
    assert merge(base, over) == {
        "law": "pd",
        "laws": {
            "pd": {"kind": "pd", "stiffness": 5.0, "damping": 2.0},
            "old": {"kind": "pd", "damping": 1.0},
            "new": {"kind": "fir", "taps": [1.0]},
        },
    }
    assert msgspec.json.encode(base) == before
    assert merge({"a": [1, 2, 3]}, {"a": [4]}) == {"a": [4]}
    assert merge({"a": {"b": 1}}, {"a": None}) == {"a": None}


def test_a_file_may_name_its_node_or_not() -> None:
    assert of_node({"coupling": {"law": "pd"}}, "coupling") == {"law": "pd"}
    assert of_node({"law": "pd"}, "coupling") == {"law": "pd"}
    for wrong in (None, [1], "pd", {"coupling": 3}):
        with pytest.raises(ParameterError, match="coupling: expected a mapping"):
            of_node(wrong, "coupling")


law_names = st.from_regex(r"[A-Za-z][A-Za-z0-9_-]{0,10}", fullmatch=True)
gains = st.floats(1e-3, 1e5)
some_laws = st.dictionaries(
    law_names,
    st.fixed_dictionaries({"kind": st.just("pd"), "stiffness": gains, "damping": gains})
    | st.fixed_dictionaries(
        {
            "kind": st.just("fir"),
            "taps": st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=5),
        }
    )
    | st.just("paper_optimum"),
    min_size=1,
    max_size=4,
)


@st.composite
def couplings(draw: st.DrawFn) -> dict[str, Any]:
    laws = draw(some_laws)
    swaps = st.fixed_dictionaries(
        {
            "at": st.floats(0, 1e3),
            "law": st.sampled_from(sorted(laws)),
            "ramp": st.integers(0, 9),
        }
    )
    return {
        "law": draw(st.sampled_from(sorted(laws))),
        "laws": laws,
        "ramp": draw(st.integers(0, 1000)),
        "clamp": draw(st.booleans()),
        "schedule": draw(st.lists(swaps, max_size=2)),
        "fallback": {"damping": draw(gains)},
        "stability": draw(st.sampled_from(["warn", "refuse", "off"])),
        "plant": draw(
            st.none()
            | st.fixed_dictionaries(
                {"mass": gains, "delay": st.none() | st.floats(0.0, 100.0)}
            )
        ),
    }


@given(couplings(), couplings())
@settings(max_examples=60)
def test_dump_then_load_is_the_identity(
    one: dict[str, Any], other: dict[str, Any]
) -> None:
    store = ParameterStore("coupling", CouplingParameters, one)
    dumped = parse_yaml(write_yaml({"coupling": store.dump()}), "dump")
    assert store.merged(dumped) == store.current
    # Loaded over other parameters it restores all but the laws that the dump does not know, which
    # stay.
    changed = ParameterStore("coupling", CouplingParameters, other)
    restored = msgspec.to_builtins(changed.merged(dumped))
    kept = {name: law for name, law in other["laws"].items() if name not in one["laws"]}
    assert restored == {**store.dump(), "laws": {**kept, **restored["laws"]}}
    assert {name: restored["laws"][name] for name in one["laws"]} == one["laws"]


@given(couplings(), st.data())
@settings(max_examples=60)
def test_what_is_set_is_what_is_got(tree: dict[str, Any], data: st.DataObject) -> None:
    store = ParameterStore("coupling", CouplingParameters, tree)
    flat = store.flat()
    path = data.draw(st.sampled_from(sorted(flat)))
    assert store.get(path) == flat[path]
    # Setting everything to what it is, all at once, changes nothing.
    assert store.changed(flat) == store.current
