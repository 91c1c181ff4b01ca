"""Score of a mutation run: what each room noticed, with a 95 % interval (Wilson 1927)."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Final, NamedTuple

from tests.support import ROOT
from tests.support.mutations.mutation import Mutation, Outcome, Stage

NORMAL_95: Final = 1.959963984540054
"""Quantile 0.975 of the standard normal distribution."""


class Tried(NamedTuple):
    """A mutation that was tried, and the test that notices it."""

    group: str  # room it was drawn from, or "named"
    mutation: Mutation
    noticed_by: str | None  # id of the first test that fails; None if all pass
    stage: Stage = Stage.IN_PROCESS  # the last one that was run

    @property
    def survives(self) -> bool:
        """Whether every test passes with it."""
        return self.noticed_by is None


class Count(NamedTuple):
    """How many mutations of a group were tried and noticed."""

    tried: int = 0
    in_process: int = 0  # noticed by a test in one process
    launched: int = 0  # noticed by a test that starts processes only

    @property
    def noticed(self) -> int:
        """How many were noticed at any stage."""
        return self.in_process + self.launched

    def with_one(self, one: Tried) -> Count:
        """Return the count with one more."""
        launched = not one.survives and one.stage is Stage.LAUNCHED
        in_process = not one.survives and not launched
        return Count(
            self.tried + 1, self.in_process + in_process, self.launched + launched
        )


def wilson(noticed: int, tried: int) -> tuple[float, float]:
    """Return the 95 % interval of a share by Wilson's score; (0, 1) if nothing was tried."""
    if not tried:
        return 0.0, 1.0
    share, spread = noticed / tried, NORMAL_95**2 / tried
    centre = (share + spread / 2.0) / (1.0 + spread)
    half = math.sqrt(spread * (share * (1.0 - share) + spread / 4.0)) / (1.0 + spread)
    return max(centre - half, 0.0), min(centre + half, 1.0)


def counts(tried: Iterable[Tried]) -> dict[str, Count]:
    """Return how many were tried and noticed: of each group, and of all that were drawn."""
    found: dict[str, Count] = {}
    for one in tried:
        for group in {one.group, "named" if one.group == "named" else "all drawn"}:
            found[group] = found.get(group, Count()).with_one(one)
    return found


def as_record(tried: list[Tried]) -> dict[str, object]:
    """Return the score as data for JSON."""
    groups = {}
    for group, count in counts(tried).items():
        low, high = wilson(count.noticed, count.tried)
        groups[group] = {
            "tried": count.tried,
            "in_process": count.in_process,
            "launched": count.launched,
            "low": low,
            "high": high,
        }
    rows = [
        {
            "name": one.mutation.name,
            "source": source_of(one.mutation),
            "noticed_by": one.noticed_by,
            "stage": int(one.stage),
        }
        for one in tried
    ]
    survive = [one.mutation.name for one in tried if one.survives]
    return {"groups": groups, "survive": survive, "tried": rows}


def source_of(mutation: Mutation) -> str:
    """Return a digest of the file that a mutation changes, as it is now."""
    return hashlib.sha256((ROOT / mutation.file).read_bytes()).hexdigest()[:16]


def known(record: Path, *, again: bool) -> dict[tuple[str, str], Outcome]:
    """Return what a file of `as_record` knows: the outcome of each name and source.

    Parameters
    ----------
    record : Path
        The file; nothing is known where there is none.
    again : bool
        Leave out what survived, because the tests have grown since.
    """
    if not record.exists():
        return {}
    rows = json.loads(record.read_text(encoding="utf-8"))["tried"]
    return {
        (row["name"], row["source"]): Outcome(row["noticed_by"], Stage(row["stage"]))
        for row in rows
        if row["noticed_by"] is not None or not again
    }


def as_lines(tried: list[Tried]) -> list[str]:
    """Return the score as a table, all that were drawn last, then what survives."""
    lines = [
        f"{'room':16}{'tried':>6}{'in process':>12}{'launched':>10}{'%':>5}   95 % interval"
    ]
    for group, count in sorted(
        counts(tried).items(),
        key=lambda item: (item[0] == "all drawn", item[0] == "named"),
    ):
        low, high = wilson(count.noticed, count.tried)
        lines.append(
            f"{group:16}{count.tried:6}{count.in_process:12}{count.launched:10}"
            f"{100 * count.noticed / count.tried:5.0f}"
            f"   {100 * low:.0f} to {100 * high:.0f} %"
        )
    survive = [one.mutation.name for one in tried if one.survives]
    return [*lines, *(f"survives: {name}" for name in survive)]
