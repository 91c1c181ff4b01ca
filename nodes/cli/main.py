"""The command ``haptic``: finds its verbs through the entry points ``haptic.verbs`` and imports only the one asked for.

A verb is a module whose docstring's first line is its help and which has ``add(parser)``: it declares its arguments and sets
``run``, a function of the parsed arguments that returns the exit code.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Mapping
from importlib.metadata import EntryPoint, entry_points
from typing import Any

GROUP = "haptic.verbs"


class UsageError(Exception):
    """What the user asked for cannot be done as asked; the text says why and what to do. Exit code 2."""


class RefusedError(Exception):
    """What was asked is sensible, but was refused or did not succeed; the text says why. Exit code 1."""


def answer(as_json: bool, figures: Mapping[str, Any], text: str) -> None:
    """Print a verb's answer: for people, or with --json one JSON object as the last line.

    Parameters
    ----------
    as_json : bool
        Whether --json was given.
    figures : mapping of str to object
        The figures, units in the keys.
    text : str
        The same for people.
    """
    print(json.dumps(figures) if as_json else text, flush=True)


def _parser(verbs: Mapping[str, EntryPoint], chosen: str | None) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="haptic", description="Haptic virtual coupling in separate processes.")
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    sub = parser.add_subparsers(dest="verb", metavar="VERB")
    for name in sorted(verbs):
        if chosen is not None and name != chosen:
            sub.add_parser(name)
            continue
        if chosen is None:
            sub.add_parser(name, help=_help_line(verbs[name]))
            continue
        module = verbs[name].load()
        verb = sub.add_parser(name, description=(module.__doc__ or "").strip().splitlines()[0])
        module.add(verb)
    return parser


def _help_line(point: EntryPoint) -> str:
    try:
        text = point.load().__doc__
    except Exception as error:  # noqa: BLE001  # a broken verb of another package must not hide the others
        return f"(cannot be loaded: {type(error).__name__}: {error})".replace("%", "%%")
    return (text or "").strip().partition("\n")[0].replace("%", "%%")


def main(argv: list[str] | None = None) -> int:
    """Run one verb.

    Parameters
    ----------
    argv : list of str, optional
        Arguments after the program's name; those of the process when left out.

    Returns
    -------
    int
        Exit code: 0 done, 1 failed, 2 wrong usage, 130 interrupted.
    """
    argv = sys.argv[1:] if argv is None else argv
    verbs = {point.name: point for point in entry_points(group=GROUP)}
    chosen = next((word for word in argv if not word.startswith("-")), None)
    parser = _parser(verbs, chosen if chosen in verbs else None)
    arguments, left_over = parser.parse_known_args(argv)
    if left_over:
        # argparse does not take positional words after options; name:=value may stand anywhere.
        if not hasattr(arguments, "assignments") or any(":=" not in word for word in left_over):
            parser.error(f"unrecognized arguments: {' '.join(left_over)}")
        arguments.assignments += left_over
    if arguments.version:
        from importlib.metadata import version

        print(f"haptic-nodes {version('haptic-nodes')}")
        return 0
    run = getattr(arguments, "run", None)
    if run is None:
        parser.print_help()
        return 2
    try:
        return int(run(arguments))
    except UsageError as error:
        print(f"haptic: {error}", file=sys.stderr)
        return 2
    except RefusedError as error:
        if getattr(arguments, "json", False):
            print(json.dumps({"error": str(error)}), flush=True)
        print(f"haptic: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader of a pipe (head, grep -q) went away: not our failure, and Python must not complain at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0


if __name__ == "__main__":
    # Under its real name, so that a verb's UsageError is the one that main() knows.
    from nodes.cli.main import main as haptic

    sys.exit(haptic())
