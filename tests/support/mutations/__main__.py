"""Try mutations, print the score of each room, and exit with 1 if a named one survives."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from contextlib import nullcontext
from pathlib import Path

from tests.support.commit import commit
from tests.support.mutations.drawn import ROOMS, draw, room_of
from tests.support.mutations.forked import Forks
from tests.support.mutations.mutation import (
    Mutation,
    Outcome,
    Stage,
    copy_sources,
    failing_anyway,
    forks,
    function_of,
    near,
    noticed_by,
)
from tests.support.mutations.rooms import NAMED_RULES
from tests.support.mutations.safety import SAFETY_RULES
from tests.support.mutations.score import Tried, as_lines, as_record, known, source_of


def part_of(mutations: tuple[Mutation, ...], part: str) -> list[Mutation]:
    """Return the part ``i/n`` of some mutations: every n-th, from the i-th on."""
    index, _, count = part.partition("/")
    return list(mutations[int(index) :: int(count)])


def try_all(
    groups: list[tuple[str, Mutation]],
    folder: Path,
    record: Path | None = None,
    *,
    again: bool = False,
    last: Stage = Stage.LAUNCHED,
) -> list[Tried]:
    """Try mutations in a copy of the sources; return the test that notices each.

    All are tried by tests in one process, then the survivors by tests that start processes. A test
    that fails without any mutation notices nothing; what it seemed to notice is tried without it.

    Parameters
    ----------
    groups : list of (str, Mutation)
        Mutations, each with the group it counts in.
    folder : Path
        The copy of the sources.
    record : Path, optional
        Results are read from it and written to it one by one.
    again : bool
        Try again what survived according to `record`.
    last : Stage
        The stage at which a survivor is left.
    """
    found = known(record, again=again) if record else {}
    key = {one.name: (one.name, source_of(one)) for _, one in groups}

    failing: frozenset[str] = frozenset()

    def try_one(mutation: Mutation, stage: Stage, forked: Forks | None) -> None:
        test = noticed_by(mutation, folder, failing, stage, forked)
        found[key[mutation.name]] = Outcome(test, stage)
        said = f"noticed  {mutation.name}   {test}"
        print(
            said if test else f"SURVIVES {mutation.name}", file=sys.stderr, flush=True
        )
        if record:
            text = json.dumps(as_record(tried()), indent=2, ensure_ascii=False)
            record.write_text(f"{text}\n", encoding="utf-8")

    def tried() -> list[Tried]:
        known_now = [(group, one) for group, one in groups if key[one.name] in found]
        return [Tried(group, one, *found[key[one.name]]) for group, one in known_now]

    def is_left(mutation: Mutation, stage: Stage) -> bool:
        before = found.get(key[mutation.name])
        return before is None or (before.noticed_by is None and before.stage < stage)

    while True:
        for stage in [one for one in Stage if one <= last]:
            left = [one for _, one in groups if is_left(one, stage)]
            in_process = left if stage is Stage.IN_PROCESS else []
            with forks(in_process, folder) if in_process else nullcontext() as forked:
                for mutation in left:
                    try_one(mutation, stage, forked)
        more = _noticing_nothing(tried(), folder, failing)
        if not more:
            return tried()
        failing |= more
        for one in tried():
            if one.noticed_by and function_of(one.noticed_by) in more:
                del found[key[one.mutation.name]]
                if one.stage is Stage.LAUNCHED:
                    survived = Outcome(None, Stage.IN_PROCESS)
                    found[key[one.mutation.name]] = survived


def _noticing_nothing(
    tried: list[Tried], folder: Path, failing: frozenset[str]
) -> frozenset[str]:
    """Return which tests that noticed mutations fail without any, beside those known."""
    found: frozenset[str] = frozenset()
    for stage in Stage:
        noticing = {
            function_of(one.noticed_by)
            for one in tried
            if one.noticed_by and one.stage is stage
        }
        tests = {test for test in noticing - failing if test.startswith("tests/")}
        found |= failing_anyway(tests, folder, stage)
    return found


def main() -> int:
    """Try the mutations that the arguments select; print a line for each, and the score."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.support.mutations", description=__doc__
    )
    parser.add_argument(
        "--part", default="0/1", help="which of the named: i/n is every n-th"
    )
    parser.add_argument(
        "--drawn", type=int, default=0, help="how many to draw from the syntax"
    )
    parser.add_argument(
        "--only-drawn", action="store_true", help="leave out the named ones"
    )
    parser.add_argument(
        "--room", action="append", choices=list(ROOMS), help="draw from this room"
    )
    parser.add_argument(
        "--near",
        action="store_true",
        help="only tests that name or import the file, if several do",
    )
    parser.add_argument("--seed", help="what they are drawn by (default: the commit)")
    parser.add_argument(
        "--json",
        type=Path,
        help="file for the score, written after each; what it has already is not tried again",
    )
    parser.add_argument(
        "--again", action="store_true", help="try again what survived in that file"
    )
    parser.add_argument(
        "--stages",
        type=int,
        choices=[int(one) for one in Stage],
        default=int(max(Stage)),
        help="1: leave a drawn one that no test in one process notices; 2 (default): try tests"
        " that start processes too",
    )
    arguments = parser.parse_args()
    named = (
        []
        if arguments.only_drawn
        else part_of((*SAFETY_RULES, *NAMED_RULES), arguments.part)
    )
    drawn = draw(arguments.drawn, arguments.seed or commit(), arguments.room)
    if arguments.near:
        drawn = [one._replace(tests=near(one.tests)) for one in drawn]
    groups = [("named", one) for one in named] + [(room_of(one), one) for one in drawn]
    with tempfile.TemporaryDirectory(prefix="haptic-mutations-") as folder:
        copy_sources(Path(folder))
        tried = try_all(
            groups,
            Path(folder),
            arguments.json,
            again=arguments.again,
            last=Stage(arguments.stages),
        )
    print("\n".join(as_lines(tried)))
    return int(any(one.survives for one in tried if one.group == "named"))


if __name__ == "__main__":
    sys.exit(main())
