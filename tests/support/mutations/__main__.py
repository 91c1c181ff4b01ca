"""Try mutations, print the score of each room, and exit with 1 if a named one survives."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

from tests.support.commit import commit
from tests.support.mutations.drawn import ROOMS, draw, room_of
from tests.support.mutations.mutation import (
    Mutation,
    copy_sources,
    failing_anyway,
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
) -> list[Tried]:
    """Try mutations in a copy of the sources; return the test that notices each.

    A test that fails without any mutation notices nothing; what it seemed to notice is tried
    without it.

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
    """
    found = known(record, again=again) if record else {}
    key = {one.name: (one.name, source_of(one)) for _, one in groups}

    def try_one(mutation: Mutation, failing: frozenset[str]) -> None:
        test = noticed_by(mutation, folder, failing)
        found[key[mutation.name]] = test
        said = f"noticed  {mutation.name}   {test}"
        print(
            said if test else f"SURVIVES {mutation.name}", file=sys.stderr, flush=True
        )
        if record:
            text = json.dumps(as_record(tried()), indent=2, ensure_ascii=False)
            record.write_text(f"{text}\n", encoding="utf-8")

    def tried() -> list[Tried]:
        known_now = [(group, one) for group, one in groups if key[one.name] in found]
        return [Tried(group, one, found[key[one.name]]) for group, one in known_now]

    for _, mutation in groups:
        if key[mutation.name] not in found:
            try_one(mutation, frozenset())
    failing: frozenset[str] = frozenset()
    while True:
        noticing = {function_of(one.noticed_by) for one in tried() if one.noticed_by}
        tests = {test for test in noticing - failing if test.startswith("tests/")}
        more = failing_anyway(tests, folder)
        if not more:
            return tried()
        failing |= more
        for one in tried():
            if one.noticed_by and function_of(one.noticed_by) in more:
                try_one(one.mutation, failing)


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
        tried = try_all(groups, Path(folder), arguments.json, again=arguments.again)
    print("\n".join(as_lines(tried)))
    return int(any(one.survives for one in tried if one.group == "named"))


if __name__ == "__main__":
    sys.exit(main())
