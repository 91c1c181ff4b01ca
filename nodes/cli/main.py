"""The command ``haptic``: finds its verbs through the entry points ``haptic.verbs`` and imports only the one asked for.

A verb is a module whose docstring's first line is its help and which has ``add(parser)``: it
declares its arguments and sets ``run``, a function of the parsed arguments that returns the exit
code. A name with a dot is a sub-verb: ``study.kmax``.
"""

import argparse
import ast
import contextlib
import io
import json
import os
import re
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn, TextIO

from messages.errors import HapticError, UsageError
from nodes.base.kept_line import is_smart
from nodes.base.printable import COLOURS, printable
from nodes.base.stderr_queue import drain_stderr
from nodes.parameters.installed import OURS, version
from nodes.parameters.nearest import did_you_mean
from nodes.parameters.registry import NotInstalledError, Registry
from nodes.parameters.store import ParameterError

VERBS = Registry(
    "haptic.verbs",
    "verb",
    lambda _, found: (
        "" if callable(getattr(found, "add", None)) else f"{found!r} has no add(parser)"
    ),
)
ASKING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # signals that ask for an end

_CHOICE = re.compile(
    r"invalid choice: '(?P<given>[^']*)' \((?:maybe you meant '[^']*', )?choose from"
    r" (?P<known>.*)\)"
)


class Parser(argparse.ArgumentParser):
    """Takes no abbreviations, and says what was probably meant; sub-parsers, which argparse makes, are of this class too."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **{**options, "allow_abbrev": False})
        # The innermost one is left in the namespace: who finds words left over complains with its
        # usage.
        self.set_defaults(parser=self)

    def add_argument(self, *names: Any, **options: Any) -> argparse.Action:
        """Declare an argument; one that may be left out has a default, or argparse lists it among those that are missing."""
        return super().add_argument(
            *names, **({"default": []} if options.get("nargs") == "*" else {}) | options
        )

    def error(self, message: str) -> NoReturn:
        """Complain and exit with 2."""
        wrong = _CHOICE.search(message)
        if wrong is not None:
            message += did_you_mean(
                wrong["given"], (word.strip("'\" ") for word in wrong["known"].split(","))
            )
        super().error(message)

    def refuse(self, words: list[str]) -> NoReturn:
        """Complain about words that nothing takes."""
        options = [word.partition("=")[0] for word in words if word.startswith("-")]
        hint = did_you_mean(options[0], self._option_string_actions) if options else ""
        super().error(f"unrecognized arguments: {' '.join(words)}{hint}")


def verbs() -> list[str]:
    """List the verbs, without their sub-verbs."""
    return [name for name in VERBS.names() if "." not in name]


def sub_verbs(verb: str) -> dict[str, str]:
    """List the sub-verbs that are registered for a verb: name, and the name with the verb's."""
    return {name.partition(".")[2]: name for name in VERBS.names() if name.startswith(f"{verb}.")}


def add_run_name(parser: argparse.ArgumentParser) -> None:
    """Declare --run."""
    parser.add_argument(
        "--run",
        metavar="NAME",
        dest="run_name",
        help=(
            "which launch, when several are running, or NAME/NAMESPACE for one of its chains"
            " (default: $HAPTIC_RUN)"
        ),
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """Offer --json."""
    parser.add_argument(
        "--json", action="store_true", help="answer with one JSON object on the last line"
    )


def answer(as_json: bool, figures: Mapping[str, Any], text: str) -> int:
    """Print a verb's answer, for people, or with --json one JSON object as the last line; its exit code."""
    print(json.dumps(figures) if as_json else printable(text), flush=True)
    return 0


@contextlib.contextmanager
def heeding(
    heed: Callable[[int], Any], numbers: Iterable[signal.Signals] = ASKING
) -> Iterator[None]:
    """Let a function take the signals that ask for an end, for the time of a block."""
    before = {number: signal.signal(number, lambda number, _: heed(number)) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def coloured(text: str, colour: str, stream: TextIO) -> str:
    """Colour a text for people: on a terminal only, and not where NO_COLOR is set (no-color.org)."""
    return (
        text
        if not is_smart(stream) or os.environ.get("NO_COLOR")
        else f"\x1b[{COLOURS[colour]}m{text}\x1b[0m"
    )


def complain(error: object) -> None:
    """Say on standard error what went wrong."""
    print(coloured("haptic:", "red", sys.stderr), printable(str(error)), file=sys.stderr)
    # A launch in this process has put a queue in place of standard error: who reads the exit code
    # finds the reason there.
    drain_stderr()


def parser_for(chosen: str | None) -> Parser:
    """Declare the command line: of one verb, which is imported, or the names of all."""
    parser = Parser(prog="haptic", description="Haptic virtual coupling in separate processes.")
    parser.add_argument("--version", action="store_true", help="print the version and exit")
    sub = parser.add_subparsers(dest="verb", metavar="VERB")
    if chosen is None:
        for name in verbs():
            sub.add_parser(name, help=first_line(name).replace("%", "%%"))
    else:
        module = VERBS.load(chosen)
        own = sub.add_parser(chosen, description=(module.__doc__ or "").strip().partition("\n")[0])
        module.add(own)
        _add_registered(own, chosen)
    return parser


def _add_registered(parser: argparse.ArgumentParser, verb: str) -> None:
    """Add what is registered as ``"VERB.NAME"`` to a verb that declares sub-verbs of its own; these go before."""
    places = [
        action for action in parser._actions if isinstance(action, argparse._SubParsersAction)
    ]
    for place in places:
        for name, full in sub_verbs(verb).items():
            if name in place.choices:
                continue
            place.metavar = f"{place.metavar}|{name}"
            own = place.add_parser(
                name, help=first_line(full).replace("%", "%%"), description=first_line(full)
            )
            try:
                VERBS.load(full).add(own)
            except (Exception, SystemExit) as error:  # noqa: BLE001  # of another package: it costs its own name
                own = Parser(prog=own.prog, add_help=False)
                place.choices[name] = own
                own.add_argument("rest", nargs=argparse.REMAINDER)
                own.set_defaults(run=partial(_refuse, error))


def _refuse(error: BaseException, arguments: argparse.Namespace) -> int:
    """Say why a sub-verb cannot be run; the others of its verb can."""
    del arguments
    text = (
        str(error)
        if isinstance(error, NotInstalledError)
        else f"cannot declare its arguments: {error!r}"
    )
    raise UsageError(text) from error


def first_line(name: str) -> str:
    """Read the help of a verb without running its module: of all verbs that would take half a second."""
    try:
        spec = find_spec(VERBS.points()[name].module)
        text = "" if spec is None or spec.origin is None else Path(spec.origin).read_bytes()
        help_text = ast.get_docstring(ast.parse(text)) if text else "(not installed)"
    except (Exception, SystemExit) as error:  # noqa: BLE001  # of the package that it is in, which is imported, or of its text
        return f"(cannot be imported: {type(error).__name__}: {error})"
    return (help_text or "").strip().partition("\n")[0]


def main(argv: list[str] | None = None) -> int:
    """Run one verb."""
    argv = sys.argv[1:] if argv is None else argv
    # A node waits for signals in a thread and blocks them everywhere else; a command that it starts
    # inherits that.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ASKING)
    # Verbs draw into files: what else matplotlib is told to draw on must not stop them.
    os.environ["MPLBACKEND"] = "agg"
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A terminal or a locale without µ gets a question mark, not a traceback.
            stream.reconfigure(errors="replace")
    try:
        return _run(argv)
    except (UsageError, ParameterError) as error:
        complain(error)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader of a pipe (head, grep -q) went away: not our failure, and Python must not
        # complain at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        # What a disk or a directory refuses is no fault of the program: no traceback.
        where = f"{error.filename}: " if error.filename else ""
        complain(f"{where}{error.strerror or error}")
        return 1


def _run(argv: list[str]) -> int:
    # Behind an option stands none: with it, all of them are listed.
    parser = parser_for(argv[0] if argv and argv[0] in verbs() else None)
    arguments, left_over = parser.parse_known_args(argv)
    if left_over:
        # argparse does not take positional words after options; name:=value may stand anywhere.
        if not hasattr(arguments, "assignments") or any(":=" not in word for word in left_over):
            arguments.parser.refuse(left_over)
        arguments.assignments = [*arguments.assignments, *left_over]
    if arguments.version:
        print(f"haptic-nodes {version(OURS) or 'not installed as a package'}")
        return 0
    run = getattr(arguments, "run", None)
    if run is None:
        parser.print_help()
        return 2
    try:
        return int(run(arguments))
    except (UsageError, ParameterError):
        raise
    except HapticError as error:
        if getattr(arguments, "json", False):
            print(json.dumps({"error": str(error)}), flush=True)
        complain(error)
        return 1


if __name__ == "__main__":
    # Under its real name, so that a verb's UsageError is the one that main() knows.
    from nodes.cli.main import main as haptic

    sys.exit(haptic())
