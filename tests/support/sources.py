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
    """Return all nodes of a file's tree but contexts (``ast.Load``), walked once.

    The order is that of `ast.walk`, whose generators take three times as long.
    """
    found: list[ast.AST] = [tree_of(path)]
    for node in found:  # which grows meanwhile
        for name in node._fields:
            value = getattr(node, name, None)
            if type(value) is list:
                found += [one for one in value if isinstance(one, ast.AST)]
            elif isinstance(value, ast.AST) and not isinstance(value, ast.expr_context):
                found.append(value)
    return tuple(found)


def nodes_if_named(path: Path, *names: str) -> tuple[ast.AST, ...]:
    """Return all nodes of a file that contains one of some identifiers; otherwise none.

    An identifier of a tree stands in the text that it was parsed from: other files need no tree.
    """
    text = path.read_text(encoding="utf-8")
    return nodes_of(path) if any(name in text for name in names) else ()
