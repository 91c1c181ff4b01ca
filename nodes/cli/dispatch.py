"""Verbs made of sub-verbs: import only the requested one, so that scipy slows no other.

The sub-verb NAME is registered beside the verbs as ``"VERB.NAME"``, and is a module of the same
shape, or a function of options where the verb declares such (`sim.cli.functions`).
"""

import argparse
import errno
import os
import sys
import tempfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from messages.errors import UsageError
from nodes.base.kept_line import erased
from nodes.cli.main import VERBS, Parser, complain, first_line, sub_verbs


def dispatch(
    parser: argparse.ArgumentParser,
    verb: str,
    noun: str,
    moved: Mapping[str, str] | None = None,
    declare: Callable[[Any, argparse.ArgumentParser], None] = lambda found, own: (
        found.add(own)
    ),
) -> None:
    """Pass the arguments of a verb on to one of its sub-verbs.

    Parameters
    ----------
    parser : argparse.ArgumentParser
        Parser of the verb.
    verb, noun : str
        Name of the verb, and the noun for its sub-verbs.
    moved : mapping of str to str, optional
        Former sub-verbs to their present commands: ``{"fig2": "lab fig2"}``.
    declare : callable, optional
        Declares the arguments of what is registered as a sub-verb.
    """
    known = sub_verbs(verb)
    width = max(map(len, known))
    names = "".join(
        f"  {name:{width}}  {first_line(full)}\n" for name, full in known.items()
    )
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.epilog = f"{noun}:\n{names}\nDetails: haptic {verb} {noun.upper()} --help"
    parser.add_argument(
        "chosen",
        metavar=noun.upper(),
        type=partial(_current, verb, moved or {}),
        choices=list(known),
        help="one of those below",
    )
    parser.add_argument(
        "rest", metavar="...", nargs=argparse.REMAINDER, help="its own arguments"
    )

    def run(arguments: argparse.Namespace) -> int:
        full = known[arguments.chosen]
        own = Parser(
            prog=f"{parser.prog} {arguments.chosen}", description=first_line(full)
        )
        declare(VERBS.load(full), own)
        return _call(own, arguments.rest, f"{verb} {arguments.chosen}")

    parser.set_defaults(run=run, sub_verbs=known, declare=declare)


def _call(own: Parser, rest: list[str], name: str) -> int:
    """Parse a sub-verb's arguments and run it; an interrupted one is named."""
    chosen, left_over = own.parse_known_args(rest)
    if left_over:
        chosen.parser.refuse(left_over)
    out = getattr(chosen, "out", None)
    if isinstance(out, Path):
        refuse_unwritable(out)
    try:
        return int(chosen.run(chosen))
    except KeyboardInterrupt as interrupt:
        sys.stderr.write(erased(sys.stderr))
        complain(": ".join([f"{name} was interrupted", *map(str, interrupt.args)]))
        raise


def _current(verb: str, moved: Mapping[str, str], name: str) -> str:
    """Return the name of a sub-verb; a former one is refused with the command that it is now."""
    if name in moved:
        raise argparse.ArgumentTypeError(
            f"haptic {verb} {name} is now haptic {moved[name]}"
        )
    return name


def refuse_unwritable(path: Path, option: str = "--out") -> None:
    """Raise UsageError early if `path` cannot be written; name `option` as the remedy."""
    there = next(
        place
        for place in (path, *path.absolute().parents)
        if place.exists() or place.is_symlink()
    )
    if there != path and not there.is_dir():
        raise UsageError(f"{path}: {there} is not a directory; choose another {option}")
    try:
        if there.is_dir():
            # Try it: root may write despite the mode, and nobody can write to a read-only disk.
            with tempfile.TemporaryFile(dir=there):
                pass
        elif not os.access(there, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise UsageError(
            f"{path}: {there} cannot be written to: {error.strerror}; choose another {option}"
        ) from error
