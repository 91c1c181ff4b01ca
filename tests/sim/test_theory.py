"""Whoever cites THEORY.md finds there what is cited."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = next(folder for folder in Path(__file__).resolve().parents if (folder / "pyproject.toml").exists())
PAGE = ROOT / "sim" / "THEORY.md"
CITED = re.compile(r"\btheory\.md\s+(§\d+(?:(?:\s*,\s*|\s+and\s+|[-–])§?\d+)*)", re.IGNORECASE)
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
    missing = {str(path): sorted(found - there) for path, found in cited.items() if found - there}
    assert missing == {}


def test_sections_are_numbered_without_a_gap() -> None:
    numbers = [int(number) for number in HEADING.findall(PAGE.read_text(encoding="utf-8"))]
    assert numbers == list(range(1, len(numbers) + 1))


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
