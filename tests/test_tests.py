"""Tests stand beside their subject, share tests/support, and are marked by their cost."""

from __future__ import annotations

import ast
import itertools
import re
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

import pytest
from _pytest.mark.expression import Expression
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support import ROOT
from tests.support.examples import multiply
from tests.support.sources import nodes_if_named, nodes_of
from tests.support.thorough import unfounded

FILES = sorted((ROOT / "tests").rglob("test_*.py"))
OF_NO_ROOM = {"tests/benchmarks"}
"""Folders of tests that mirror no folder of the product."""

FROM_TESTS = re.compile(r"^\s*(?:from|import)\b.*\btests\b(?!\.support)", re.MULTILINE)
"""Import of something in tests/ that is not obviously of tests/support."""


def imports_of_tests(path: Path) -> list[str]:
    """Name what a file imports of tests/ outside tests/support, with its line."""
    found: list[str] = []
    if not FROM_TESTS.search(path.read_text(encoding="utf-8")):
        return found
    for node in nodes_of(path):
        if not isinstance(node, ast.Import | ast.ImportFrom):
            continue
        if isinstance(node, ast.Import):
            names = [name.name for name in node.names]
        else:
            names = [f"{node.module}.{name.name}" for name in node.names]
        found += [
            f"{path}:{node.lineno} imports {name}"
            for name in names
            if f"{name}.".startswith("tests.")
            and not f"{name}.".startswith("tests.support.")
        ]
    return found


def test_no_test_module_imports_another() -> None:
    """A change of one would fail the other; pytest rewrites only the first's assertions."""
    assert [line for path in FILES for line in imports_of_tests(path)] == []


def test_an_import_of_another_is_found(tmp_path: Path) -> None:
    path = tmp_path / "test_one.py"
    path.write_text(
        "from tests.nodes.view import test_server\nfrom tests.support import ROOT\n"
        "import tests.conftest\nfrom tests import support\n",
        encoding="utf-8",
    )
    assert [line.split()[-1] for line in imports_of_tests(path)] == [
        "tests.nodes.view.test_server",
        "tests.conftest",
    ]


def test_tests_stand_where_their_subject_stands() -> None:
    folders = {path.parent.relative_to(ROOT) for path in FILES} - {Path("tests")}
    strangers = {
        str(folder)
        for folder in folders
        if not (ROOT / folder.relative_to("tests")).is_dir()
        and str(folder) not in OF_NO_ROOM
    }
    assert strangers == set()


def test_what_is_smoke_starts_a_process() -> None:
    """README's line runs tests that are not ``process``, and ``smoke`` ones of those that are."""
    alone = []
    for path in FILES:
        for node in nodes_if_named(path, "smoke"):
            marks = [ast.unparse(mark) for mark in getattr(node, "decorator_list", [])]
            is_smoke = any(mark.startswith("pytest.mark.smoke") for mark in marks)
            if is_smoke and "pytest.mark.process" not in marks:
                alone.append(f"{path}:{getattr(node, 'lineno', 0)}")
    assert alone == []


class Marked(NamedTuple):
    """What a collected test is asked for: its name and markers."""

    nodeid: str
    marks: tuple[pytest.Mark, ...]

    def iter_markers(self, name: str | None = None) -> list[pytest.Mark]:
        """Return its markers, or those of a name."""
        return [mark for mark in self.marks if name in (None, mark.name)]


def marked(test: str, *names: str, quick: str | None = None) -> Any:
    marks = [pytest.Mark(name, (), {}, _ispytest=True) for name in names]
    if quick is not None:
        given = (quick,) if quick else ()
        marks.append(pytest.Mark("thorough", given, {}, _ispytest=True))
    return Marked(test, tuple(marks))


@pytest.mark.parametrize(
    ("items", "wrong"),
    [
        ([marked("a::t", quick="q"), marked("a::q")], []),
        ([marked("a::t", quick="q"), marked("a::q", "process", "smoke")], []),
        ([marked("a::t[1]", quick="t"), marked("a::t[2]")], []),
        ([marked("a::t", quick="b::q"), marked("b::q")], []),
        # The other file was not collected: nothing is known.
        ([marked("a::t", quick="b::q"), marked("a::q")], []),
        ([marked("a::t", quick="q")], ["a::t names q"]),
        ([marked("a::t", quick="")], ["a::t names no test"]),
        ([marked("a::t", quick="q"), marked("a::q", "process")], ["a::t names q"]),
        ([marked("a::t", quick="q"), marked("a::q", "slow")], ["a::t names q"]),
        (
            [marked("a::t", quick="q"), marked("a::q", quick="t")],
            ["a::t names q", "a::q names t"],
        ),
        ([marked("a::t[1]", quick="t"), marked("a::t[2]", "slow")], ["a::t names t"]),
    ],
)
def test_what_is_thorough_names_a_quicker_test_that_readme_s_line_runs(
    items: list[Any], wrong: list[str]
) -> None:
    assert unfounded(items) == wrong


def test_ci_runs_with_each_commit_all_that_readme_s_line_leaves_out_but_slow_ones() -> (
    None
):
    """For every combination of markers, by pytest's own evaluation of both expressions."""
    options = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    first = options["tool"]["pytest"]["ini_options"]["addopts"].partition("-m '")[2]
    script = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    (second,) = re.findall(r"^\.venv/bin/pytest -m '(.+)'$", script, re.MULTILINE)
    default, rest = Expression.compile(first.rstrip("'")), Expression.compile(second)
    names = ("slow", "thorough", "process", "smoke", "hypothesis")
    for present in itertools.product((False, True), repeat=len(names)):
        marks = dict(zip(names, present, strict=True))

        def has(name: str, /, **_: object) -> bool:
            return marks[name]  # noqa: B023

        runs = [expression.evaluate(has) for expression in (default, rest)]
        assert any(runs) is not marks["slow"], marks


def test_a_property_test_tries_as_many_examples_as_asked_for() -> None:
    tried = []

    @settings(max_examples=10, database=None)
    @given(number=st.integers())
    def a_property(number: int) -> None:
        tried.append(number)

    for times, wanted in ((1.0, 10), (3.0, 30), (0.01, 1)):
        multiply(a_property, times)
        tried.clear()
        a_property()
        assert len(tried) == wanted
        multiply(a_property, 10.0 / wanted)
