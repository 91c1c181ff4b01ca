"""Citations of THEORY.md exist there."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from tests.support.sources import nodes_if_named, sources_of

ROOT = next(
    folder
    for folder in Path(__file__).resolve().parents
    if (folder / "pyproject.toml").exists()
)
PAGE = ROOT / "sim" / "THEORY.md"
CITED = re.compile(
    r"\btheory\.md\s+(§\d+(?:(?:\s*,\s*|\s+and\s+|[-–])§?\d+)*)", re.IGNORECASE
)
HEADING = re.compile(r"^## (\d+)\. \S", re.MULTILINE)


def sections(page: str) -> set[int]:
    return {int(number) for number in HEADING.findall(page)}


def citations(text: str) -> set[int]:
    found: set[int] = set()
    for group in CITED.findall(text):
        for first, last in re.findall(r"(\d+)(?:[-–]§?(\d+))?", group):
            found.update(range(int(first), int(last or first) + 1))
    return found


def files() -> list[Path]:
    return [
        path
        for folder in ("messages", "nodes", "sim", "tests", "launch")
        for path in sorted((ROOT / folder).rglob("*"))
        if path.suffix in (".py", ".md", ".yaml", ".c") and path != Path(__file__)
    ] + [ROOT / "README.md"]


def test_every_section_cited_stands_in_the_page() -> None:
    there = sections(PAGE.read_text(encoding="utf-8"))
    cited = {path: citations(path.read_text(encoding="utf-8")) for path in files()}
    assert sum(map(len, cited.values())) > 30
    missing = {
        str(path): sorted(found - there)
        for path, found in cited.items()
        if found - there
    }
    assert missing == {}


def test_sections_are_numbered_without_a_gap() -> None:
    numbers = [
        int(number) for number in HEADING.findall(PAGE.read_text(encoding="utf-8"))
    ]
    assert numbers == list(range(1, len(numbers) + 1))


def test_every_row_of_the_papers_table_has_code_and_a_test() -> None:
    table = (
        PAGE.read_text(encoding="utf-8")
        .partition("statement by statement")[2]
        .partition("\n## ")[0]
    )
    rows = [
        line.split("|")[1:-1] for line in table.splitlines() if line.startswith("| ")
    ][2:]
    defined = {
        name
        for path in (ROOT / "tests").rglob("test_*.py")
        for name in re.findall(
            r"^def (test_\w+)", path.read_text(encoding="utf-8"), re.MULTILINE
        )
    }
    assert len(rows) > 20
    for row in rows:
        assert len(row) == 5, row
        for path in re.findall(r"`([a-z0-9_/]+\.py)`", row[2]):
            assert (ROOT / path).is_file(), path
        tests = re.findall(r"`(test_\w+)`", row[3] + row[4])
        assert tests, row
        assert set(tests) <= defined, row


def test_what_is_printed_cites_the_paper_or_this_page() -> None:
    """Each claim that a study prints has a source."""
    allowed = re.compile(r"^(paper\b|THEORY\.md §)")
    names = ("Claim", "_by_memory")
    for path in sources_of("sim"):
        for call in nodes_if_named(path, *names):
            if (
                isinstance(call, ast.Call)
                and getattr(call.func, "id", "") in names
                and call.args
            ):
                told = [
                    leaf.value
                    for leaf in ast.walk(call.args[0])
                    if isinstance(leaf, ast.Constant)
                ]
                texts = [text for text in told if isinstance(text, str) and " " in text]
                assert all(allowed.match(text) for text in texts), (
                    f"{path}:{call.lineno}: {texts}"
                )


@pytest.mark.parametrize(
    ("text", "found"),
    [
        ("(THEORY.md §3)", {3}),
        ("THEORY.md §2, §3", {2, 3}),
        ("THEORY.md §1-3", {1, 2, 3}),
        ("see THEORY.md §1 and §14", {1, 14}),
        ("THEORY.md\n    §5", {5}),
        ("§9 of another page", set()),
    ],
)
def test_citations_are_recognised(text: str, found: set[int]) -> None:
    assert citations(text) == found
