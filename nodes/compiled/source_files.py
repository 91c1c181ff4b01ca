"""Sources of compiled code by digest, so that it is known whether they changed since."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import Final

import msgspec

# root of the installation, to which source paths are relative
ROOT: Final = Path(__file__).parents[2]


class Source(msgspec.Struct, frozen=True):
    """Digests of a source file.

    content: Of its bytes.
    code: Of its syntax tree without docstrings; empty for a file that is not Python.
    """

    content: str
    code: str = ""


def source_of(path: Path) -> Source:
    """Return the digests of a file."""
    content = path.read_bytes()
    code = _code_digest(content) if path.suffix == ".py" else ""
    return Source(hashlib.sha256(content).hexdigest(), code)


def _code_digest(content: bytes) -> str:
    """Return the digest of a Python file's syntax tree without docstrings."""
    # imported here, because a node only loads
    import ast

    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    tree = ast.parse(content)
    for node in ast.walk(tree):
        if (
            isinstance(node, documented)
            and ast.get_docstring(node, clean=False) is not None
        ):
            del node.body[0]
    return hashlib.sha256(ast.dump(tree).encode()).hexdigest()


def is_current(path: Path, known: Source) -> bool:
    """Return whether a file has the code of `known`; only a file that differs is parsed."""
    content = path.read_bytes()
    if hashlib.sha256(content).hexdigest() == known.content:
        return True
    try:
        return known.code != "" and _code_digest(content) == known.code
    except (SyntaxError, ValueError):
        return False


def sources_of(module: str) -> dict[str, Source]:
    """Return the digests of a module and all modules of these packages that it imports."""
    # imported here, because a node only loads
    import ast

    packages = {module.split(".", maxsplit=1)[0], "messages", "nodes", "sim"}
    seen: set[str] = set()
    waiting = [module]
    sources = {}
    while waiting:
        name = waiting.pop()
        if name in seen or name.split(".", maxsplit=1)[0] not in packages:
            continue
        seen.add(name)
        waiting.append(name.rpartition(".")[0])
        place = ROOT.joinpath(*name.split("."))
        # ``from module import name``: if `name` is no module, it is in that module's own file
        for path in (place.with_suffix(".py"), place / "__init__.py"):
            if path.is_file():
                sources[str(path.relative_to(ROOT))] = source_of(path)
                for found in ast.walk(ast.parse(path.read_bytes())):
                    if isinstance(found, ast.Import):
                        waiting += [one.name for one in found.names]
                    elif isinstance(found, ast.ImportFrom) and found.module:
                        waiting += [
                            found.module,
                            *(f"{found.module}.{one.name}" for one in found.names),
                        ]
    return sources
