"""Print a script that completes haptic's words on TAB: eval "$(haptic completion bash)"."""

import argparse
import contextlib
from collections.abc import Callable, Iterable
from typing import Any

from nodes.cli.main import VERBS, Parser, parser_for, verbs
from nodes.launcher import runs, scenario_files
from nodes.launcher.runs import RunError, RunInfo, find_run
from nodes.parameters.registry import NotInstalledError
from nodes.parameters.store import ParameterError

SCRIPTS = {  # script per shell; each runs ``haptic completion words`` at every TAB
    "bash": (
        """\
_haptic() {
    local words
    words=$(haptic completion words -- "${COMP_WORDS[@]:1:COMP_CWORD}" 2>/dev/null)
    COMPREPLY=($(compgen -W "$words" -- "${COMP_WORDS[COMP_CWORD]}"))
    [[ ${COMPREPLY[0]-} == *:= ]] && compopt -o nospace
}
COMP_WORDBREAKS=${COMP_WORDBREAKS//:/}
COMP_WORDBREAKS=${COMP_WORDBREAKS//=/}
complete -o default -F _haptic haptic
"""
    ),
    "zsh": (
        """\
_haptic() {
    local -a found
    found=("${(@f)$(haptic completion words -- "${(@)words[2,CURRENT]}" 2>/dev/null)}")
    [[ -n ${found[1]} ]] || { _files; return }
    compadd -S '' -- ${(M)found:#*:=}
    compadd -- ${found:#*:=}
}
(( $+functions[compdef] )) || { autoload -Uz compinit && compinit -u }
compdef _haptic haptic
"""
    ),
    "fish": (
        """\
function __haptic
    set -l typed (commandline -opc) (commandline -ct)
    haptic completion words -- $typed[2..-1] 2>/dev/null
end
complete -c haptic -a '(__haptic)'
"""
    ),
}


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "shell",
        choices=[*SCRIPTS, "words"],
        help="the shell; words: print completions (used by the scripts)",
    )
    parser.add_argument(
        "typed",
        nargs="*",
        help="with words: the words typed so far, the last one unfinished",
    )
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    if arguments.shell == "words":
        print("\n".join(candidates(arguments.typed)))
    else:
        print(SCRIPTS[arguments.shell], end="")
    return 0


def candidates(typed: list[str]) -> list[str]:
    """Return the words that may replace the last word of `typed`."""
    *done, prefix = typed or [""]
    chosen = next((word for word in done if not word.startswith("-")), None)
    if chosen is None:
        return _fitting([*verbs(), "--version", "--help"], prefix)
    try:
        parser: argparse.ArgumentParser = parser_for(chosen)
    except NotInstalledError:
        return []
    parser, rest = _descend(parser, done)
    options: dict[str, Any] = parser._option_string_actions
    before = options.get(rest[-1]) if rest else None
    if before is not None and before.nargs != 0:
        return _fitting(_values(before, rest), prefix)
    if prefix.startswith("-"):
        return _fitting(options, prefix)
    places = [action for action in parser._actions if not action.option_strings]
    given = _positionals(rest, options)
    found: list[str] = []
    for number, action in enumerate(places):
        # An argument that accepts several words also covers all that follow.
        if number == len(given) or (
            number < len(given) and action.nargs in ("*", "+", argparse.REMAINDER)
        ):
            found += _values(action, given)
    return _fitting(found, prefix)


def _fitting(words: Iterable[str], prefix: str) -> list[str]:
    return [word for word in dict.fromkeys(words) if word.startswith(prefix)]


def _descend(
    parser: argparse.ArgumentParser, done: list[str]
) -> tuple[argparse.ArgumentParser, list[str]]:
    """Return the parser of the innermost sub-verb typed, and the words after its name."""
    rest = list(done)
    while True:
        sub = next(
            (
                action
                for action in parser._actions
                if isinstance(action, argparse._SubParsersAction)
            ),
            None,
        )
        below = parser.get_default("sub_verbs")
        place = next(
            (i for i, word in enumerate(rest) if not word.startswith("-")), None
        )
        if place is None:
            return parser, rest
        word = rest[place]
        if sub is not None and word in sub.choices:
            parser = sub.choices[word]
        elif below and word in below:
            declare = parser.get_default("declare")
            parser = Parser(prog=word)
            declare(VERBS.load(below[word]), parser)
        else:
            return parser, rest
        rest = rest[place + 1 :]


def _positionals(rest: list[str], options: dict[str, Any]) -> list[str]:
    """Return the words that are neither options nor their values."""
    found = []
    skip = False
    for word in rest:
        if skip:
            skip = False
        elif word.startswith("-"):
            action = options.get(word)
            skip = action is not None and action.nargs is None
        else:
            found.append(word)
    return found


def _values(action: argparse.Action, given: list[str]) -> list[str]:
    """Return the values of an argument: its choices, or names of running or installed things."""
    if action.choices is not None:
        return [str(choice) for choice in action.choices]
    source = _SOURCES.get(action.dest)
    # Offer nothing if no launch runs, or several do.
    with contextlib.suppress(RunError, ParameterError):
        return source(given) if source else []
    return []


def _run() -> RunInfo:
    return find_run(None)


def _assignments(given: list[str]) -> list[str]:
    return (
        [
            f"{name}:="
            for name in scenario_files.read_arguments(scenario_files.find(given[0]))[1]
        ]
        if given
        else []
    )


def _laws(_given: list[str]) -> list[str]:
    for setup in _run().nodes.values():
        if "laws" in setup.parameters:
            return list(setup.parameters["laws"])
    return []


_SOURCES: dict[str, Callable[[list[str]], list[str]]] = {
    "scenario": lambda _: list(scenario_files.scenarios()),
    "assignments": _assignments,
    "topic": lambda _: list(_run().endpoints()),
    "topics": lambda _: list(_run().endpoints()),
    "node": lambda _: list(_run().nodes),
    "run_name": lambda _: list(runs.runs()),
    "law": _laws,
}
