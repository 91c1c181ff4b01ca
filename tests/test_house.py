"""The house stays a house: imports go one way, between packages, between their rooms, and between files.

A room is a sub-package (``nodes.driver``); a module directly in a package is a room of its own. Every import counts, also one
inside a function or for types only.
"""

from __future__ import annotations

import ast
import itertools
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

from tests.support import ROOT

FLOORS = ("messages", "nodes", "sim")
"""From the ground up: a package imports from itself and from those before it."""


def name_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {name_of(path): path for floor in FLOORS for path in sorted((ROOT / floor).rglob("*.py"))}


def imported(module: str) -> Iterator[tuple[str, str]]:
    """Name each module of ours that this one imports, and the line that does it."""
    path = MODULES[module]
    for found in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(found, ast.Import):
            names = [name.name for name in found.names]
        elif isinstance(found, ast.ImportFrom):
            assert found.level == 0, f"{path}:{found.lineno}: relative import"
            names = [
                inner if (inner := f"{found.module}.{name.name}") in MODULES else str(found.module)
                for name in found.names
            ]
        else:
            continue
        for name in names:
            if name.split(".")[0] in FLOORS and name != module:
                assert name in MODULES, f"{path}:{found.lineno}: no module {name}"
                yield name, f"{path.relative_to(ROOT)}:{found.lineno} imports {name}"


def room(module: str) -> str:
    return ".".join(module.split(".")[:2])


def cycle(arrows: Mapping[str, Mapping[str, str]]) -> list[str]:
    """Find a cycle; the imports that make it, or none."""
    done: set[str] = set()

    def search(at: str, way: list[str]) -> list[str]:
        if at in way:
            ring = [*way[way.index(at) :], at]
            return [arrows[a][b] for a, b in itertools.pairwise(ring)]
        if at in done:
            return []
        for following in arrows.get(at, {}):
            if ring := search(following, [*way, at]):
                return ring
        done.add(at)
        return []

    for start in arrows:
        if ring := search(start, []):
            return ring
    return []


def test_no_import_goes_up() -> None:
    wrong = [
        line
        for module in MODULES
        for name, line in imported(module)
        if FLOORS.index(name.split(".")[0]) > FLOORS.index(module.split(".")[0])
    ]
    assert wrong == []


def test_no_circle_between_files() -> None:
    assert cycle({module: dict(imported(module)) for module in MODULES}) == []


def test_no_circle_between_rooms() -> None:
    arrows: dict[str, dict[str, str]] = {}
    for module in MODULES:
        for name, line in imported(module):
            if room(name) != room(module):
                arrows.setdefault(room(module), {}).setdefault(room(name), line)
    assert cycle(arrows) == []


def test_a_circle_is_found_and_named() -> None:
    """The search itself: without this, an empty list would prove nothing."""
    arrows = {"a": {"b": "a imports b"}, "b": {"c": "b imports c"}, "c": {"b": "c imports b"}}
    assert cycle(arrows) == ["b imports c", "c imports b"]


def test_few_modules_stand_outside_the_rooms() -> None:
    outside = [module for module in MODULES if module.count(".") == 1 and MODULES[module].name != "__init__.py"]
    assert len([module for module in outside if not module.startswith("messages.")]) <= 6


def test_one_word_is_one_class() -> None:
    """No two public classes have one name: a reader who meets it in a message or a page knows which."""
    found: dict[str, list[str]] = {}
    for module, path in MODULES.items():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                found.setdefault(node.name, []).append(module)
    assert {name: places for name, places in found.items() if len(places) > 1} == {}


def test_the_tables_of_rooms_name_every_room() -> None:
    for floor in ("nodes", "sim"):
        page = (ROOT / floor / "README.md").read_text(encoding="utf-8")
        told = set(re.findall(r"`([\w.]+?)/?`", "".join(re.findall(r"^\| (`.*?) \|", page, re.MULTILINE))))
        there = {path.name for path in (ROOT / floor).iterdir() if path.is_dir() and path.name != "__pycache__"}
        assert there - told == set(), floor
