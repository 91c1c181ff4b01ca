"""Command line ``haptic``: finds verbs by entry points, imports only the requested one.

A verb is a module whose docstring's first line is its help and which has ``add(parser)``: it
declares its arguments and sets ``run``, a function of the parsed arguments that returns the exit
code. A name with a dot is a sub-verb, ``study.kmax``; it may be a function of options instead.
"""

import argparse
import ast
import contextlib
import io
import json
import os
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NoReturn, TextIO

import msgspec

from messages.errors import HapticError, UsageError
from nodes.base.kept_line import is_smart
from nodes.base.log_line import AS_JSON, COMMAND, FAILS, LogLine
from nodes.base.printable import COLOURS, printable
from nodes.base.stderr_queue import drain_stderr
from nodes.parameters.installed import OURS, version
from nodes.parameters.nearest import did_you_mean
from nodes.parameters.options import takes_options
from nodes.parameters.registry import NotInstalledError, Registry
from nodes.parameters.store import ParameterError

VERBS = Registry(
    "haptic.verbs",
    "verb",
    lambda name, found: (
        ""
        if callable(getattr(found, "add", None))
        or ("." in name and takes_options(found))
        else f"{found!r} has no add(parser)"
    ),
)
ASKING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # signals that ask for an end


class _Listed(argparse.Action):
    """Add the values of a repeated list option; argparse would forget the first ones."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,  # noqa: ARG002
        namespace: argparse.Namespace,
        values: Any,
        option_string: str | None = None,  # noqa: ARG002
    ) -> None:
        before = getattr(namespace, self.dest, self.default)
        setattr(
            namespace, self.dest, [*(() if before is self.default else before), *values]
        )


def _told(text: str, default: Any) -> str:
    """Return the end of a help text that names the default; empty if there is nothing to tell."""
    nothing = not default or default is True or argparse.SUPPRESS in (text, default)
    if nothing or "(default" in text:
        return ""
    return f" (default: {_written(default)})".replace("%", "%%")


def _written(default: Any) -> str:
    """Return a default as it would be typed."""
    if isinstance(default, list):
        return " ".join(map(_written, default))
    if isinstance(default, tuple):
        return "..".join(dict.fromkeys(map(_written, default)))
    return f"{default:g}" if isinstance(default, float) else str(default)


class Parser(argparse.ArgumentParser):
    """Argument parser without abbreviations that suggests corrections.

    argparse makes sub-parsers of this class too.
    """

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **{**options, "allow_abbrev": False})
        # The innermost parser ends up in the namespace; its usage is shown for unknown words.
        self.set_defaults(parser=self)

    def add_argument(self, *names: Any, **options: Any) -> argparse.Action:
        """Declare an argument; an optional positional gets a default, a repeated list grows.

        Without a default, argparse lists it among the missing arguments. The help text of an
        argument ends with its default, unless the text names one.
        """
        if text := options.get("help"):
            options = {**options, "help": text + _told(text, options.get("default"))}
        if options.get("nargs") == "*":
            options = {"default": [], **options}
        if options.get("nargs") in ("+", "*") and str(names[0]).startswith("-"):
            options = {"action": _Listed, **options}
        return super().add_argument(*names, **options)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        """Reject a value that is none of the choices, with a suggestion.

        argparse has no public place for this: its error has the choices in a sentence only. A test
        fails when argparse no longer calls this method.
        """
        if action.choices is not None and value not in action.choices:
            known = ", ".join(map(repr, action.choices))
            hint = did_you_mean(value, map(str, action.choices))
            raise argparse.ArgumentError(
                action, f"invalid choice: {value!r} (choose from {known}){hint}"
            )

    def refuse(self, words: list[str]) -> NoReturn:
        """Report unknown words and exit with 2."""
        options = [word.partition("=")[0] for word in words if word.startswith("-")]
        hint = did_you_mean(options[0], self._option_string_actions) if options else ""
        super().error(f"unrecognized arguments: {' '.join(words)}{hint}")


def verbs() -> list[str]:
    """Return the names of all verbs, without sub-verbs."""
    return [name for name in VERBS.names() if "." not in name]


def sub_verbs(verb: str) -> dict[str, str]:
    """Return the sub-verbs of a verb: name to registered name."""
    return {
        name.partition(".")[2]: name
        for name in VERBS.names()
        if name.startswith(f"{verb}.")
    }


def add_run_name(parser: argparse.ArgumentParser) -> None:
    """Declare --run."""
    parser.add_argument(
        "--run",
        metavar="NAME",
        dest="run_name",
        help=(
            "name of the launch, if several run, or NAME/NAMESPACE for one of its chains"
            " (default: $HAPTIC_RUN)"
        ),
    )


def add_json(parser: argparse.ArgumentParser) -> None:
    """Declare --json."""
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object on the last line"
    )


def answer(as_json: bool, figures: Mapping[str, Any], text: str) -> int:
    """Print a verb's result as text, or as one JSON object, and return exit code 0."""
    print(json.dumps(figures) if as_json else printable(text), flush=True)
    return 0


@contextlib.contextmanager
def heeding(
    heed: Callable[[int], Any], numbers: Iterable[signal.Signals] = ASKING
) -> Iterator[None]:
    """Call `heed` for signals that ask for an end, during the block."""
    before = {
        number: signal.signal(number, lambda number, _: heed(number))
        for number in numbers
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def coloured(text: str, colour: str, stream: TextIO) -> str:
    """Return `text` in a colour on a terminal, unless NO_COLOR is set (no-color.org)."""
    return (
        text
        if not is_smart(stream) or os.environ.get("NO_COLOR")
        else f"\x1b[{COLOURS[colour]}m{text}\x1b[0m"
    )


def complain(error: object) -> None:
    """Print an error to standard error."""
    if AS_JSON:
        ways = error.remedies if isinstance(error, HapticError) else ()
        line = LogLine(str(error), COMMAND, FAILS, remedies=ways)
        sys.stderr.write(f"{line.as_json()}\n")
    else:
        name = coloured(f"{COMMAND}:", "red", sys.stderr)
        print(name, printable(str(error)), file=sys.stderr)
    # A launch in this process replaced standard error by a queue: write it out before exiting.
    drain_stderr()


def parser_for(chosen: str | None) -> Parser:
    """Return the parser: of one verb, which is imported, or with the names of all."""
    parser = Parser(
        prog="haptic", description="Haptic virtual coupling in separate processes."
    )
    parser.add_argument(
        "--version", action="store_true", help="print the version and exit"
    )
    sub = parser.add_subparsers(dest="verb", metavar="VERB")
    if chosen is None:
        for name in verbs():
            sub.add_parser(name, help=first_line(name).replace("%", "%%"))
    else:
        module = VERBS.load(chosen)
        own = sub.add_parser(
            chosen, description=(module.__doc__ or "").strip().partition("\n")[0]
        )
        module.add(own)
        _add_registered(own, chosen)
    return parser


def _add_registered(parser: argparse.ArgumentParser, verb: str) -> None:
    """Add the sub-verbs registered as ``"VERB.NAME"`` after a verb's own."""
    places = [
        action
        for action in parser._actions
        if isinstance(action, argparse._SubParsersAction)
    ]
    for place in places:
        for name, full in sub_verbs(verb).items():
            if name in place.choices:
                continue
            place.metavar = f"{place.metavar}|{name}"
            own = place.add_parser(
                name,
                help=first_line(full).replace("%", "%%"),
                description=first_line(full),
            )
            try:
                VERBS.load(full).add(own)
            # A broken package costs only its own sub-verb.
            except (Exception, SystemExit) as error:  # noqa: BLE001
                own = Parser(prog=own.prog, add_help=False)
                place.choices[name] = own
                own.add_argument("rest", nargs=argparse.REMAINDER)
                own.set_defaults(run=partial(_refuse, error))


def _refuse(error: BaseException, arguments: argparse.Namespace) -> int:
    """Raise the error that keeps a sub-verb from running."""
    del arguments
    text = (
        str(error)
        if isinstance(error, NotInstalledError)
        else f"cannot declare its arguments: {error!r}"
    )
    raise UsageError(text) from error


def first_line(name: str) -> str:
    """Return the help of a verb without importing its module, which would cost half a second."""
    try:
        spec = find_spec(VERBS.points()[name].module)
        text = (
            ""
            if spec is None or spec.origin is None
            else Path(spec.origin).read_bytes()
        )
        help_text = ast.get_docstring(ast.parse(text)) if text else "(not installed)"
    except (Exception, SystemExit) as error:  # noqa: BLE001  # raised by its package or its text
        return f"(cannot be imported: {type(error).__name__}: {error})"
    return (help_text or "").strip().partition("\n")[0]


def main(argv: list[str] | None = None) -> int:
    """Run one verb and return the exit code."""
    argv = sys.argv[1:] if argv is None else argv
    # A node blocks signals in all but one thread, and a command started by it inherits that.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ASKING)
    # Verbs draw into files, whatever backend matplotlib is configured with.
    os.environ["MPLBACKEND"] = "agg"
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # Print a question mark for characters that the locale lacks, not a traceback.
            stream.reconfigure(errors="replace")
    try:
        return _run(argv)
    except (UsageError, ParameterError) as error:
        complain(error)
        return 2
    except KeyboardInterrupt:
        return 130
    except BrokenPipeError:
        # The reader of the pipe (head, grep -q) has ended; silence Python's error at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        # A disk or directory refused: no traceback.
        where = f"{error.filename}: " if error.filename else ""
        complain(f"{where}{error.strerror or error}")
        return 1


def _run(argv: list[str]) -> int:
    # If the first word is an option, list all verbs.
    parser = parser_for(argv[0] if argv and argv[0] in verbs() else None)
    arguments, left_over = parser.parse_known_args(argv)
    if left_over:
        # argparse accepts no positional words after options, but name:=value may stand anywhere.
        if not hasattr(arguments, "assignments") or any(
            ":=" not in word for word in left_over
        ):
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
            ways = msgspec.to_builtins(error.remedies)
            print(json.dumps({"error": str(error), "remedies": ways}), flush=True)
        complain(error)
        return 1


if __name__ == "__main__":
    # Imported under its real name, so that main() catches a verb's UsageError.
    from nodes.cli.main import main as haptic

    sys.exit(haptic())
