"""Try mutations, print the score of each room, and exit with 1 if a named one survives."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

from tests.support.commit import commit
from tests.support.mutations.drawn import ROOMS, draw, room_of
from tests.support.mutations.mutation import Mutation, copy_sources, near, survives
from tests.support.mutations.rooms import NAMED_RULES
from tests.support.mutations.safety import SAFETY_RULES
from tests.support.mutations.score import Tried, as_lines, as_record


def part_of(mutations: tuple[Mutation, ...], part: str) -> list[Mutation]:
    """Return the part ``i/n`` of some mutations: every n-th, from the i-th on."""
    index, _, count = part.partition("/")
    return list(mutations[int(index) :: int(count)])


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
        "--json", type=Path, help="file for the score, written after each"
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
    tried: list[Tried] = []
    with tempfile.TemporaryDirectory(prefix="haptic-mutations-") as folder:
        copy_sources(Path(folder))
        for group, mutation in groups:
            tried.append(Tried(group, mutation, survives(mutation, Path(folder))))
            said = "SURVIVES" if tried[-1].survives else "noticed"
            print(f"{said:9}{mutation.name}", file=sys.stderr, flush=True)
            if arguments.json:
                text = json.dumps(as_record(tried), indent=2, ensure_ascii=False)
                arguments.json.write_text(f"{text}\n", encoding="utf-8")
    print("\n".join(as_lines(tried)))
    return int(any(one.survives for one in tried if one.group == "named"))


if __name__ == "__main__":
    sys.exit(main())
