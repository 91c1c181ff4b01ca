"""Points of cost and error, their Pareto front, and their files.

Every design choice is a point of cost and error. A point is on the front if no other point of its
group is both cheaper and more accurate.
"""

import csv
import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from sim.measure.jobs import program
from sim.results import fresh

Extra = float | int | str | None


@dataclass(frozen=True)
class Point:
    """One design choice with its cost and error."""

    # Name of the choice, e.g. ``gl 64``.
    name: str
    cost: float  # in the unit of its group
    error: float  # in the unit of its group
    # Its family, e.g. ``gl``; members are drawn as one line.
    family: str = ""
    # other values, with units in the keys
    detail: dict[str, Extra] = field(default_factory=dict)
    # whether no other point of the group is both cheaper and more accurate; set by
    # `with_front`
    on_front: bool = False


@dataclass(frozen=True)
class Group:
    """Points that are compared with each other."""

    name: str  # key of the group
    title: str  # quantity compared
    # Axis labels with units.
    cost_label: str
    error_label: str
    points: tuple[Point, ...]  # the points
    note: str = ""  # how the values were obtained, for the page
    linear: bool = False  # whether the errors are drawn on a linear scale
    # Whether each family is drawn as its own line, because families are not free choices.
    families: bool = False


def on_front(costs: Sequence[float], errors: Sequence[float]) -> list[bool]:
    """Return for each point whether it is on the Pareto front."""
    points = list(zip(costs, errors, strict=True))

    def beaten(cost: float, error: float) -> bool:
        # A point does not dominate an equal one.
        return any(
            (c, e) != (cost, error) and c <= cost and e <= error for c, e in points
        )

    return [error < math.inf and not beaten(cost, error) for cost, error in points]


def with_front(group: Group) -> Group:
    """Return the group with its front marked, sorted by cost."""
    marks = on_front([p.cost for p in group.points], [p.error for p in group.points])
    marked = [
        replace(point, on_front=mark)
        for point, mark in zip(group.points, marks, strict=True)
    ]
    return replace(group, points=tuple(sorted(marked, key=lambda p: (p.cost, p.error))))


def kept(path: Path, part: str) -> list[Group] | None:
    """Return the groups of a part stored by an interrupted run of the same code, or None."""
    stored = _stored(path).get(part)
    if stored is None:
        return None
    return [
        Group(**{**group, "points": tuple(Point(**point) for point in group["points"])})
        for group in stored
    ]


def keep(path: Path, part: str, groups: Sequence[Group]) -> None:
    """Add a part to the file of an interrupted run."""
    stored = _stored(path) | {
        "program": program(),
        part: [asdict(group) for group in groups],
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_suffix(".new")
    beside.write_text(json.dumps(stored), encoding="utf-8")
    beside.replace(path)


def _stored(path: Path) -> dict[str, Any]:
    """Read the file of an interrupted run; set it aside if its code version differs.

    A chart must not mix results of two versions.
    """
    stored: dict[str, Any] = (
        json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    )
    if stored and stored.get("program") != program():
        fresh(path)
        return {}
    return stored


def as_json(
    groups: Sequence[Group], machine: dict[str, Any], seconds: float
) -> dict[str, Any]:
    """Return all groups as one JSON object."""
    return {
        "points": [
            {"group": group.name, **asdict(point)}
            for group in groups
            for point in group.points
        ],
        "groups": {
            group.name: {
                "title": group.title,
                "cost": group.cost_label,
                "error": group.error_label,
                "note": group.note,
            }
            for group in groups
        },
        "machine": machine,
        "duration_s": round(seconds, 1),
    }


def save(
    groups: Sequence[Group], machine: dict[str, Any], seconds: float, folder: Path
) -> list[Path]:
    """Write the data of a chart: one JSON file, and one CSV file with all values as columns."""
    data = as_json(groups, machine, seconds)
    whole, table = fresh(folder / "chart.json"), fresh(folder / "chart.csv")
    whole.write_text(json.dumps(data, indent=1, allow_nan=True) + "\n")
    keys = sorted(
        {key for group in groups for point in group.points for key in point.detail}
    )
    with table.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["group", "name", "family", "cost", "error", "on_front", *keys])
        for row in data["points"]:
            fixed = [
                row[key]
                for key in ("group", "name", "family", "cost", "error", "on_front")
            ]
            writer.writerow(fixed + [row["detail"].get(key, "") for key in keys])
    return [whole, table]
