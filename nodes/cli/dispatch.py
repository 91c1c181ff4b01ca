"""Verbs made of sub-verbs, importing only the one asked for: a study that needs scipy does not slow the others."""

from __future__ import annotations

import argparse
import ast
from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from nodes.cli.main import Parser
from nodes.cli.places import refuse_unwritable


def _first_line(module: str) -> str:
    """Help of a module, read without running it."""
    spec = find_spec(module)
    if spec is None or spec.origin is None:
        return "(not installed)"
    text = ast.get_docstring(ast.parse(Path(spec.origin).read_bytes())) or ""
    return text.strip().splitlines()[0] if text else ""


def dispatch(parser: argparse.ArgumentParser, modules: Mapping[str, str], noun: str) -> None:
    """Let a verb hand its arguments on to one of several modules of the same shape as a verb."""
    width = max(map(len, modules))
    names = "".join(f"  {name:{width}}  {_first_line(modules[name])}\n" for name in sorted(modules))
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = f"{noun}:\n{names}\nhaptic {parser.prog.split()[-1]} {noun.upper()} --help tells more."
    parser.add_argument("chosen", metavar=noun.upper(), choices=sorted(modules), help="one of those below")
    parser.add_argument("rest", metavar="...", nargs=argparse.REMAINDER, help="its own arguments")

    def run(arguments: argparse.Namespace) -> int:
        module = import_module(modules[arguments.chosen])
        line = _first_line(modules[arguments.chosen])
        own = Parser(prog=f"{parser.prog} {arguments.chosen}", description=line)
        module.add(own)
        chosen, left_over = own.parse_known_args(arguments.rest)
        if left_over:
            chosen.parser.refuse(left_over)
        out = getattr(chosen, "out", None)
        if isinstance(out, Path):
            refuse_unwritable(out)
        return int(chosen.run(chosen))

    parser.set_defaults(run=run, modules=modules)
