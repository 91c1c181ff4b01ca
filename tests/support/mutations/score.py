"""Score of a mutation run: what each room noticed, with a 95 % interval (Wilson 1927)."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Final, NamedTuple

from tests.support import ROOT
from tests.support.mutations.mutation import Mutation

NORMAL_95: Final = 1.959963984540054
"""Quantile 0.975 of the standard normal distribution."""


class Tried(NamedTuple):
    """A mutation that was tried, and the test that notices it."""

    group: str  # room it was drawn from, or "named"
    mutation: Mutation
    noticed_by: str | None  # id of the first test that fails; None if all pass

    @property
    def survives(self) -> bool:
        """Whether every test passes with it."""
        return self.noticed_by is None


def wilson(noticed: int, tried: int) -> tuple[float, float]:
    """Return the 95 % interval of a share by Wilson's score; (0, 1) if nothing was tried."""
    if not tried:
        return 0.0, 1.0
    share, spread = noticed / tried, NORMAL_95**2 / tried
    centre = (share + spread / 2.0) / (1.0 + spread)
    half = math.sqrt(spread * (share * (1.0 - share) + spread / 4.0)) / (1.0 + spread)
    return max(centre - half, 0.0), min(centre + half, 1.0)


def counts(tried: Iterable[Tried]) -> dict[str, tuple[int, int]]:
    """Return how many were noticed and tried: of each group, and of all that were drawn."""
    found: dict[str, tuple[int, int]] = {}
    for one in tried:
        for group in {one.group, "named" if one.group == "named" else "all drawn"}:
            noticed, number = found.get(group, (0, 0))
            found[group] = (noticed + (not one.survives), number + 1)
    return found


def as_record(tried: list[Tried]) -> dict[str, object]:
    """Return the score as data for JSON."""
    groups = {}
    for group, (noticed, number) in counts(tried).items():
        low, high = wilson(noticed, number)
        groups[group] = {"tried": number, "noticed": noticed, "low": low, "high": high}
    rows = [
        {
            "name": one.mutation.name,
            "source": source_of(one.mutation),
            "noticed_by": one.noticed_by,
        }
        for one in tried
    ]
    survive = [one.mutation.name for one in tried if one.survives]
    return {"groups": groups, "survive": survive, "tried": rows}


def source_of(mutation: Mutation) -> str:
    """Return a digest of the file that a mutation changes, as it is now."""
    return hashlib.sha256((ROOT / mutation.file).read_bytes()).hexdigest()[:16]


def known(record: Path, *, again: bool) -> dict[tuple[str, str], str | None]:
    """Return what a file of `as_record` knows: the noticing test of each name and source.

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
        (row["name"], row["source"]): row["noticed_by"]
        for row in rows
        if row["noticed_by"] is not None or not again
    }


def as_lines(tried: list[Tried]) -> list[str]:
    """Return the score as a table, all that were drawn last, then what survives."""
    lines = [f"{'room':16}{'tried':>6}{'noticed':>9}{'%':>5}   95 % interval"]
    for group, (noticed, number) in sorted(
        counts(tried).items(),
        key=lambda item: (item[0] == "all drawn", item[0] == "named"),
    ):
        low, high = wilson(noticed, number)
        lines.append(
            f"{group:16}{number:6}{noticed:9}{100 * noticed / number:5.0f}"
            f"   {100 * low:.0f} to {100 * high:.0f} %"
        )
    survive = [one.mutation.name for one in tried if one.survives]
    return [*lines, *(f"survives: {name}" for name in survive)]
