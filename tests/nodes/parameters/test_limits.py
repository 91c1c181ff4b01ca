"""No parameter sizes an array or a loop without limit: huge values work or are refused.

All numbers of all registered nodes, laws and surfaces are tried, also those of other packages.
Accepted values are used as before tick 0: checked, compiled, judged, and configured for nodes
without hardware. The kernel enforces limits of memory and processor time on a separate process.
"""

from __future__ import annotations

import copy
import os
import re
import resource
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from msgspec import inspect

from nodes.base.node_kinds import load, node_kinds
from nodes.coupling.law_book import worst_figures
from nodes.coupling.parameters import CouplingParameters, PlantParameters
from nodes.environment.surfaces import SURFACES, parse_surface
from nodes.laws import law_names, load_law
from nodes.laws.parse import compile_law, parse_law
from nodes.parameters.store import MAX_ENTRIES, ParameterError, convert
from nodes.stability.plant import MAX_DELAY, Plant
from sim.api.played import drop
from tests.support import ROOT
from tests.support.setups import setup_of

MEMORY = 1 << 30
"""Memory that parameters may allocate [bytes]; an array of 10⁹ numbers takes 8 times that."""
PROCESSOR = 240
"""Processor time of all parameters together [s]; ten times their usual time."""
HUGE = 1e9
# nodes that open no file, no socket and no hardware
CONFIGURED = ("coupling", "environment", "sim_driver")


def numbers(
    info: inspect.Type, seen: frozenset[type] = frozenset()
) -> Iterator[tuple[tuple[str | int, ...], type]]:
    """Yield all numbers below a type: path and type."""
    if isinstance(info, inspect.Metadata):
        yield from numbers(info.type, seen)
    elif isinstance(info, inspect.UnionType):
        for one in info.types:
            yield from numbers(one, seen)
    elif isinstance(info, inspect.StructType) and info.cls not in seen:
        for field in info.fields:
            for way, kind in numbers(field.type, seen | {info.cls}):
                yield (field.encode_name, *way), kind
    elif isinstance(info, inspect.TupleType):
        for i, one in enumerate(info.item_types):
            yield from (((i, *way), kind) for way, kind in numbers(one, seen))
    elif isinstance(info, inspect.CollectionType):
        yield from (((0, *way), kind) for way, kind in numbers(info.item_type, seen))
    elif isinstance(info, inspect.IntType | inspect.FloatType):
        yield (), int if isinstance(info, inspect.IntType) else float


def example(info: inspect.Type) -> Any:
    """Return a plain value of a type, with required fields only."""
    if isinstance(info, inspect.Metadata):
        return example(info.type)
    if isinstance(info, inspect.UnionType):
        return example(
            next(one for one in info.types if not isinstance(one, inspect.NoneType))
        )
    if isinstance(info, inspect.StructType):
        return {
            field.encode_name: example(field.type)
            for field in info.fields
            if field.required
        }
    if isinstance(info, inspect.TupleType):
        return [example(one) for one in info.item_types]
    if isinstance(info, inspect.CollectionType):
        return [example(info.item_type) for _ in range(max(1, info.min_length or 0))]
    if isinstance(info, inspect.LiteralType):
        return info.values[0]
    if isinstance(info, inspect.IntType | inspect.FloatType):
        lowest = info.ge if info.ge is not None else info.gt
        return (
            type(info.ge or 0)(0)
            if lowest is None
            else lowest + (1 if isinstance(info, inspect.IntType) else 1e-3)
        )
    return {inspect.DictType: {}, inspect.BoolType: False}.get(type(info), "x")


def put(tree: Any, info: inspect.Type, way: tuple[str | int, ...], value: Any) -> Any:
    """Insert a value into a tree, with required neighbours."""
    if isinstance(info, inspect.Metadata):
        return put(tree, info.type, way, value)
    if not way:
        return value
    if isinstance(info, inspect.UnionType):
        # The alternative that has such a number.
        inner = next(
            one for one in info.types if any(found == way for found, _ in numbers(one))
        )
        return put(tree, inner, way, value)
    tree = copy.deepcopy(tree) if tree else example(info)
    if isinstance(info, inspect.StructType):
        field = next(field for field in info.fields if field.encode_name == way[0])
        return {**tree, way[0]: put(tree.get(way[0]), field.type, way[1:], value)}
    inner = (
        info.item_types[int(way[0])]
        if isinstance(info, inspect.TupleType)
        else info.item_type  # type: ignore[attr-defined]
    )
    tree[way[0]] = put(tree[int(way[0])], inner, way[1:], value)
    return tree


PD = {"kind": "pd", "stiffness": 500.0, "damping": 3.0}
LEAST: dict[str, dict[str, Any]] = {  # parameters that a node cannot be made without
    "coupling": {"law": "pd", "laws": {"pd": PD}},
    "environment": {"surface": {"kind": "plane", "position": 0.0}},
    "sim_driver": {
        "device": {"mass": 0.1, "hand": {"stiffness": 100.0, "path": [[0.0, 0.0]]}}
    },
}


def use_node(kind: str, parameters: dict[str, Any]) -> None:
    node = load(node_kinds()[kind])
    setup = setup_of(name=kind, kind=kind, parameters=parameters)
    convert(parameters, node.Parameters, kind)
    node.check(setup)
    if kind in CONFIGURED:
        made: Any = node(setup)
        made.configure()
        if kind == "coupling":
            made.operations()["law.show"]()


def use_law(kind: str, parameters: dict[str, Any]) -> None:
    for period in (0.002, 1e-5):
        law = compile_law(parse_law({"kind": kind, **parameters}), period)
        if law.evaluate is None:
            worst_figures(law, PlantParameters(mass=0.1, damping=1.0), period, 0.3)


def use_surface(kind: str, parameters: dict[str, Any]) -> None:
    parse_surface({"kind": kind, **parameters}, "surface")
    use_node("environment", {"surface": {"kind": kind, **parameters}})


def tried() -> Iterator[
    tuple[str, Any, tuple[str | int, ...], type, dict[str, Any], Any]
]:
    """Yield all numbers to try."""
    kinds = {name: load(factory) for name, factory in node_kinds().items()}
    groups = [
        (name, kind.Parameters, LEAST.get(name, {}), use_node)
        for name, kind in kinds.items()
    ]
    groups += [(name, load_law(name), {}, use_law) for name in law_names()]
    groups += [
        (name, SURFACES.load(name), {}, use_surface) for name in SURFACES.names()
    ]
    for name, struct, least, use in groups:
        info = inspect.type_info(struct)
        for way, kind in numbers(info):
            yield name, info, way, kind, least or example(info), use


def try_all() -> None:
    """Try each number at both ends, in a process that the kernel ends beyond its limits."""
    taken = refused = 0
    for name, info, way, kind, least, use in tried():
        for value in (
            (int(HUGE), 2**53, 2**70) if kind is int else (HUGE, 1e300, 5e-324)
        ):
            print(name, *way, value, file=sys.stderr, flush=True)
            try:
                use(name, put(least, info, way, value))
                taken += 1
            except ParameterError:
                refused += 1
    print(f"{taken} {refused}")


def bounded() -> None:
    """Limit this process, and try all numbers."""
    used = (
        int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        * resource.getpagesize()
    )
    resource.setrlimit(resource.RLIMIT_AS, (used + MEMORY, used + MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (PROCESSOR, PROCESSOR))
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # a node's run directory is the current one
        try_all()


@pytest.mark.process
@pytest.mark.smoke
def test_every_registered_number_is_used_or_refused_within_bounds() -> None:
    code = "import tests.nodes.parameters.test_limits as limits; limits.bounded()"
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        check=False,
        cwd=ROOT,
    )
    assert done.returncode == 0, done.stderr[-3000:]
    taken, refused = map(int, done.stdout.split())
    assert taken > 100
    assert refused > 100


@pytest.mark.parametrize(
    ("data", "text"),
    [
        (
            {"laws": {"a": {"taps": [0.0] * (MAX_ENTRIES + 1)}}},
            f"laws.a.taps: {MAX_ENTRIES + 1} entries, limit {MAX_ENTRIES}",
        ),
        ({"memory": 2**70}, "memory: expected a whole number of at most 1000000"),
        (
            {"plant": {"mass": 0.1, "delay": 100.0 + 1e-9}},
            "plant.delay: expected a number of at most 100, got 100.000000001",
        ),
        (
            {"plant": {"mass": 0.1, "device_delay": 1e9}},
            "plant.device_delay: expected a number of at most 100, got 1",
        ),
    ],
)
def test_what_is_beyond_a_limit_is_refused_with_path_value_and_limit(
    data: dict[str, Any], text: str
) -> None:
    with pytest.raises(ParameterError, match=f"^coupling.{re.escape(text)}"):
        convert({"law": "pd", **data}, CouplingParameters, "coupling")
    assert (
        convert(
            {"law": "pd", "plant": {"mass": 0.1, "delay": 100.0}},
            CouplingParameters,
            "coupling",
        ).plant.delay
        == 100.0
    )


def test_a_plant_of_python_and_a_run_of_one_process_have_limits_too() -> None:
    Plant(0.002, 0.1, 1.0, MAX_DELAY)
    with pytest.raises(ValueError, match=f"delay = .*at most {MAX_DELAY:g} ticks"):
        Plant(0.002, 0.1, 1.0, MAX_DELAY * (1.0 + 2.0**-52))
    with pytest.raises(ValueError, match="ticks is 1000000000000, expected at most"):
        drop(
            {"kind": "pd", "stiffness": 500.0, "damping": 3.0},
            Plant(0.002, 0.1, 1.0),
            ticks=10**12,
        )
