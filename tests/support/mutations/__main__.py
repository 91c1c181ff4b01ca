"""Try mutations and count survivors; the exit code is 1 if a named one survives."""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

from tests.support.commit import commit
from tests.support.mutations.drawn import ROOMS, draw
from tests.support.mutations.mutation import Mutation, copy_sources, survives
from tests.support.mutations.rooms import NAMED_RULES
from tests.support.mutations.safety import SAFETY_RULES


def part_of(mutations: tuple[Mutation, ...], part: str) -> list[Mutation]:
    """Return the part ``i/n`` of some mutations: every n-th, from the i-th on."""
    index, _, count = part.partition("/")
    return list(mutations[int(index) :: int(count)])


def main() -> int:
    """Try the mutations that the arguments select; print a line for each, and the score."""
    parser = argparse.ArgumentParser(prog="python -m tests.support.mutations", description=__doc__)
    parser.add_argument("--part", default="0/1", help="which of the named: i/n is every n-th")
    parser.add_argument("--drawn", type=int, default=0, help="how many to draw from the syntax")
    parser.add_argument("--only-drawn", action="store_true", help="leave out the named ones")
    parser.add_argument("--room", action="append", choices=list(ROOMS), help="draw from this room")
    parser.add_argument("--seed", help="what they are drawn by (default: the commit)")
    parser.add_argument("--json", type=Path, help="file for the score and what survives")
    arguments = parser.parse_args()
    named = [] if arguments.only_drawn else part_of((*SAFETY_RULES, *NAMED_RULES), arguments.part)
    drawn = draw(arguments.drawn, arguments.seed or commit(), arguments.room)
    left: list[Mutation] = []
    with tempfile.TemporaryDirectory(prefix="haptic-mutations-") as folder:
        copy_sources(Path(folder))
        for mutation in (*named, *drawn):
            lives = survives(mutation, Path(folder))
            print(f"{'SURVIVES' if lives else 'noticed':9}{mutation.name}", flush=True)
            left += [mutation] if lives else []
    score = {
        "named": {"tried": len(named), "noticed": len([one for one in named if one not in left])},
        "drawn": {"tried": len(drawn), "noticed": len([one for one in drawn if one not in left])},
        "survive": [one.name for one in left],
    }
    print(json.dumps(score, ensure_ascii=False))
    if arguments.json:
        arguments.json.write_text(
            json.dumps(score, indent=2, ensure_ascii=False) + "\n", encoding="utf-8"
        )
    return int(any(one in left for one in named))


if __name__ == "__main__":
    sys.exit(main())
