"""nodes/TROUBLESHOOTING.md quotes messages as the sources have them."""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path

import pytest

from tests.support import ROOT
from tests.support.sources import nodes_of, sources_of

PAGE = (ROOT / "nodes" / "TROUBLESHOOTING.md").read_text(encoding="utf-8")
QUOTED = sorted(
    {
        quoted
        for line in PAGE.splitlines()
        if line.startswith("|")
        for quoted in re.findall(r"`([a-z][^`]*)`", line.split("|")[1])
        if " " in quoted and not quoted.startswith("haptic ")
    }
)


@cache
def source(path: Path) -> str:
    return path.read_text(encoding="utf-8")


@cache
def words_of(quoted: str) -> frozenset[str]:
    """Return the words of a message: they stand in the source, however its lines are broken."""
    return frozenset(re.findall(r"[A-Za-z]+", quoted))


def texts(quoted: str) -> str:
    """Return the texts of the sources that have all words of a message, … for inserted values."""
    found = []
    for path in sources_of("messages", "nodes", "sim"):
        if not all(word in source(path) for word in words_of(quoted)):
            continue
        for node in nodes_of(path):
            if isinstance(node, ast.JoinedStr):
                found.append(
                    "".join(
                        str(part.value) if isinstance(part, ast.Constant) else "…"
                        for part in node.values
                    )
                )
            elif isinstance(node, ast.Constant) and isinstance(node.value, str):
                found.append(node.value)
    return "\n".join(found)


def test_messages_are_quoted() -> None:
    assert len(QUOTED) >= 4


@pytest.mark.parametrize("quoted", QUOTED)
def test_a_quoted_message_is_one_of_ours(quoted: str) -> None:
    assert quoted in texts(quoted)
