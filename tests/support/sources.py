"""Python sources as trees, parsed once a process: many tests read all of them."""

from __future__ import annotations

import ast
import gc
from functools import cache
from pathlib import Path

from tests.support import ROOT


@cache
def sources_of(*folders: str) -> tuple[Path, ...]:
    """Return the Python files of folders of the project, sorted by path."""
    return tuple(
        sorted(path for folder in folders for path in (ROOT / folder).rglob("*.py"))
    )


@cache
def tree_of(path: Path) -> ast.Module:
    """Parse a file, once.

    Trees of all sources are a million objects that live until the end. Garbage collection would go
    through them again and again, for three times what parsing takes: they are exempt from it.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        return ast.parse(path.read_text(encoding="utf-8"))
    finally:
        gc.freeze()
        if enabled:
            gc.enable()


@cache
def nodes_of(path: Path) -> tuple[ast.AST, ...]:
    """Return all nodes of a file's tree, walked once."""
    return tuple(ast.walk(tree_of(path)))


def nodes_if_named(path: Path, *names: str) -> tuple[ast.AST, ...]:
    """Return all nodes of a file that contains one of some identifiers; otherwise none.

    An identifier of a tree stands in the text that it was parsed from: other files need no tree.
    """
    text = path.read_text(encoding="utf-8")
    return nodes_of(path) if any(name in text for name in names) else ()
