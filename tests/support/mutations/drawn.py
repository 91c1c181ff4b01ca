"""Mutations drawn from the syntax: a comparison, sign, number, condition or statement.

Libraries for this (mutmut, cosmic-ray) rewrite a whole package or import it mutated; our kernels
are compiled from their source and laid out by annotations, so a mutation here changes one place of
one file's text.
"""

from __future__ import annotations

import ast
import random
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Final

from tests.support import ROOT
from tests.support.mutations.mutation import Mutation
from tests.support.mutations.unnoticed import children, is_equivalent, is_margin

ROOMS: Final = {
    room: (f"tests/{room}",)
    for room in (
        *(
            "nodes/driver",
            "nodes/laws",
            "nodes/stability",
            "nodes/coupling",
            "nodes/recording",
        ),
        "sim/identify",
    )
}
"""Rooms whose files are changed, and the mirroring folder of tests, which must notice."""

SUPPORT: Final = ROOT / "tests" / "support"
COMPILED: Final = frozenset({"kernel", "compiled_tick", "tick"})
"""Files of a room that only compiled ticks run; their tests are in tests/nodes/compiled."""
_STARTS: Final = "mark.process"
"""Text of a file with tests that start processes."""

_COMPARED: Final[dict[type[ast.cmpop], tuple[str, str]]] = {
    ast.Lt: ("<", "<="),
    ast.LtE: ("<=", "<"),
    ast.Gt: (">", ">="),
    ast.GtE: (">=", ">"),
    ast.Eq: ("==", "!="),
    ast.NotEq: ("!=", "=="),
}
_COMPUTED: Final[dict[type[ast.operator], tuple[str, str]]] = {
    ast.Add: ("+", "-"),
    ast.Sub: ("-", "+"),
    ast.Mult: ("*", "/"),
    ast.Div: ("/", "*"),
}


class _Places:
    """Places in a file's text that can be changed, in characters."""

    def __init__(self, text: str) -> None:
        self.text = text
        self._lines = [0]
        for line in text.splitlines(keepends=True):
            self._lines.append(self._lines[-1] + len(line))
        self._bytes = [line.encode() for line in text.splitlines(keepends=True)]

    def at(self, line: int, column: int) -> int:
        """Return the place of a line and of a column in bytes, as ast counts them."""
        return self._lines[line - 1] + len(self._bytes[line - 1][:column].decode())

    def span(self, node: ast.expr | ast.stmt) -> tuple[int, int]:
        """Return where a node begins and ends."""
        assert node.end_lineno is not None
        assert node.end_col_offset is not None
        return (
            self.at(node.lineno, node.col_offset),
            self.at(node.end_lineno, node.end_col_offset),
        )

    def changes(self, node: ast.AST) -> Iterator[tuple[int, str, str]]:
        """Yield the changes of a node: place, present text, new text."""
        if (
            isinstance(node, ast.Compare)
            and len(node.ops) == 1
            and type(node.ops[0]) in _COMPARED
        ):
            old, new = _COMPARED[type(node.ops[0])]
            if old in ("==", "!=") or not is_margin(node):
                yield from self._between(node.left, node.comparators[0], old, new)
        elif isinstance(node, ast.BinOp) and type(node.op) in _COMPUTED:
            if not isinstance(node.left, (ast.JoinedStr,)) and not _is_text(node):
                yield from self._between(
                    node.left, node.right, *_COMPUTED[type(node.op)]
                )
        elif isinstance(node, ast.BoolOp):
            pair = ("and", "or") if isinstance(node.op, ast.And) else ("or", "and")
            yield from self._between(node.values[0], node.values[1], *pair)
        elif isinstance(node, (ast.If, ast.IfExp, ast.While)):
            begin, end = self.span(node.test)
            old = self.text[begin:end]
            yield begin, old, f"(not ({old}))"
        elif isinstance(node, ast.Constant):
            begin, end = self.span(node)
            if type(node.value) is int:
                yield begin, self.text[begin:end], repr(node.value + 1)
            elif type(node.value) is float:
                yield begin, self.text[begin:end], repr(2.0 * node.value or 1.0)
        elif isinstance(node, ast.AugAssign):
            begin, end = self.span(node)
            yield begin, self.text[begin:end], "pass"

    def _between(
        self, left: ast.expr, right: ast.expr, old: str, new: str
    ) -> Iterator[tuple[int, str, str]]:
        begin, end = self.span(left)[1], self.span(right)[0]
        place = self.text.find(old, begin, end)
        if place >= 0:
            yield place, old, new


def _is_text(node: ast.BinOp) -> bool:
    return any(
        isinstance(side, ast.Constant) and isinstance(side.value, (str, bytes))
        for side in (node.left, node.right)
    )


def _of_code(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes whose changes a test may notice, see `unnoticed`."""
    waiting = [tree]
    while waiting:
        for child in children(waiting.pop()):
            yield child
            waiting.append(child)


def all_of(file: Path, root: Path = ROOT) -> list[Mutation]:
    """Return every mutation of a file in the order of its text, without tests yet."""
    text = file.read_text(encoding="utf-8")
    lines, places, name = text.splitlines(), _Places(text), str(file.relative_to(root))
    found = []
    for node in _of_code(ast.parse(text)):
        for place, old, new in places.changes(node):
            line, column = (
                text.count("\n", 0, place) + 1,
                place - text.rfind("\n", 0, place),
            )
            if is_equivalent(name, lines[line - 1], old, new):
                continue
            said = f"{name}:{line}:{column}: {' '.join(old.split())} → {' '.join(new.split())}"
            found.append(Mutation(said, name, old, new, (), place))
    return sorted(found, key=lambda one: one.place or 0)


def draw(number: int, seed: str, rooms: list[str] | None = None) -> list[Mutation]:
    """Draw mutations from the rooms in turn; files are weighted by their number of places."""
    chance = random.Random(seed)  # noqa: S311  # which are tried is no secret
    pools = [list(_pool(room)) for room in rooms or list(ROOMS)]
    for pool in pools:
        chance.shuffle(pool)
    drawn = [pools[i % len(pools)][i // len(pools)] for i in range(number)]
    return [
        one._replace(
            tests=suite_of(room_of(one), ROOT / one.file),
            launched=launched_by(room_of(one), ROOT / one.file),
        )
        for one in drawn
    ]


@cache
def _pool(room: str) -> tuple[Mutation, ...]:
    """Return every mutation of a room's files."""
    files = sorted((ROOT / room).rglob("*.py"))
    return tuple(one for file in files for one in all_of(file))


def room_of(mutation: Mutation) -> str:
    """Return the room that a mutation was drawn from."""
    return next(room for room in ROOMS if mutation.file.startswith(f"{room}/"))


@cache
def _imports(path: Path) -> frozenset[str]:
    """Return what a file imports: modules, and names from them as if they were modules."""
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
        elif isinstance(node, ast.ImportFrom):
            found |= {f"{node.module}.{name.name}" for name in node.names}
            found.add(str(node.module))
    return frozenset(found)


def _module(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def _users(room: str, module: str) -> frozenset[str]:
    """Return a module with all of its room and of tests/support that import it in the end."""
    files = [*(ROOT / room).rglob("*.py"), *SUPPORT.glob("*.py")]
    found = {module}
    while more := {
        _module(file)
        for file in files
        if _module(file) not in found and _imports(file) & found
    }:
        found |= more
    return frozenset(found)


@cache
def _all_tests() -> dict[Path, str]:
    files = sorted((ROOT / "tests").rglob("test_*.py"))
    return {file: file.read_text(encoding="utf-8") for file in files}


def _folders(room: str, file: Path) -> tuple[str, ...]:
    """Return the folders of tests that mirror a file's room."""
    compiled = ("tests/nodes/compiled",) if file.stem in COMPILED else ()
    return (*compiled, *ROOMS[room])


def _tests_in(folders: tuple[str, ...]) -> list[Path]:
    return [
        path for folder in folders for path in sorted((ROOT / folder).glob("test_*.py"))
    ]


@cache
def launched_by(room: str, file: Path) -> tuple[str, ...]:
    """Return the files of a room's folders that start processes, those near a file first.

    Near by imports or not: what a launch runs is imported by its processes.
    """
    nearest = suite_of(room, file)
    names = [
        str(path.relative_to(ROOT))
        for path in _tests_in(_folders(room, file))
        if _STARTS in path.read_text(encoding="utf-8")
    ]
    return tuple(
        sorted(
            names,
            key=lambda name: nearest.index(name) if name in nearest else len(nearest),
        )
    )


@cache
def suite_of(room: str, file: Path) -> tuple[str, ...]:
    """Return a file's tests: of its name, importing it or what imports it, its room's.

    Where none of its room imports it, those that do in other folders come first.
    """
    module, folders = _module(file), _folders(room, file)
    tests = _tests_in(folders)

    def distance(test: Path) -> int:
        if test.stem.startswith(f"test_{file.stem}"):
            return 0
        if module in _imports(test):
            return 1
        return 2 if _imports(test) & _users(room, module) else 3

    near = sorted((test for test in tests if distance(test) < 3), key=distance)
    if not any(distance(test) < 2 for test in near):
        # Its own tests stand with another subject, which uses it.
        name = module.rpartition(".")[2]
        named = [test for test, text in _all_tests().items() if name in text]
        near = [test for test in named if module in _imports(test)] + near
    return (*(str(test.relative_to(ROOT)) for test in near), *folders)
