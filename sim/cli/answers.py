"""The end of most verbs: an answer, its files, an exit code.

It imports little, because a verb imports it first.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from messages.errors import UsageError
from nodes.cli.main import add_json, answer


def add_answer(
    parser: argparse.ArgumentParser,
    run: Callable[[argparse.Namespace], int],
    files: bool = True,
) -> None:
    """Declare --json, --out for a verb that writes files, and the function to run."""
    add_json(parser)
    if files:
        text = "directory of files (default: %(default)s)"
        parser.add_argument(
            "--out-dir",
            "--out",
            type=Path,
            default=Path("studies"),
            dest="out",
            help=text,
        )
    parser.set_defaults(run=run, default_of=parser.get_default)


def report(
    arguments: argparse.Namespace,
    figures: Mapping[str, Any],
    lines: str | Sequence[str],
    *,
    ledger: Path | None = None,
    plot: Path | None = None,
    held: bool = True,
) -> int:
    """Print figures and lines, then the paths of files; return the exit code, 1 if not `held`."""
    files = {
        name: str(path)
        for name, path in (("ledger", ledger), ("plot", plot))
        if path is not None
    }
    text = [lines] if isinstance(lines, str) else lines
    answer(arguments.json, {**figures, **files}, "\n".join([*text, *files.values()]))
    return 0 if held else 1


def idle(arguments: argparse.Namespace, why: str, *names: str) -> None:
    """Reject options that have no effect with these arguments."""
    dests = {name: name.replace("-", "_") for name in names}
    found = [
        f"--{name}"
        for name, dest in dests.items()
        if getattr(arguments, dest) != arguments.default_of(dest)
    ]
    if found:
        raise UsageError(f"{', '.join(found)}: no effect here: {why}")


def given(arguments: argparse.Namespace, *names: str) -> dict[str, Any]:
    """Pick arguments by name."""
    return {name: getattr(arguments, name) for name in names}
