"""Tests stand beside their subject, share tests/support, and are marked by their cost."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from tests.support import ROOT
from tests.support.examples import multiply

FILES = sorted((ROOT / "tests").rglob("test_*.py"))
OF_NO_ROOM = {"tests/benchmarks"}
"""Folders of tests that mirror no folder of the product."""


@cache
def tree_of(path: Path) -> ast.Module:
    """Parse a file, once."""
    return ast.parse(path.read_text(encoding="utf-8"))


def imports_of_tests(path: Path) -> list[str]:
    """Name what a file imports of tests/ outside tests/support, with its line."""
    found = []
    for node in ast.walk(tree_of(path)):
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
        for node in ast.walk(tree_of(path)):
            marks = [ast.unparse(mark) for mark in getattr(node, "decorator_list", [])]
            is_smoke = any(mark.startswith("pytest.mark.smoke") for mark in marks)
            if is_smoke and "pytest.mark.process" not in marks:
                alone.append(f"{path}:{getattr(node, 'lineno', 0)}")
    assert alone == []


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
