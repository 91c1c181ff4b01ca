"""nodes/TROUBLESHOOTING.md quotes messages as the sources have them."""

from __future__ import annotations

import ast
import re
from functools import cache

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
def texts() -> str:
    """Return every text of the sources, with … for inserted values."""
    found = []
    for path in sources_of("messages", "nodes", "sim"):
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
    assert quoted in texts()
