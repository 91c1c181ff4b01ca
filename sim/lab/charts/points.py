"""Speed against accuracy: points, their Pareto front, and the files they are kept in.

Every choice of the project is a point: what it costs and how wrong it is. A point is on the front
when nothing in its group is both cheaper and better; all others are choices one need not make.
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
    """One choice."""

    # What was chosen, e.g. ``gl 64``.
    name: str
    cost: float  # its cost, in the unit of its group
    error: float  # its error, in the unit of its group
    # What it is a member of, e.g. ``gl``: members are drawn as one line.
    family: str = ""
    detail: dict[str, Extra] = field(default_factory=dict)  # other figures, units in the keys
    # whether nothing in its group is both cheaper and better; set by `with_front`
    on_front: bool = False


@dataclass(frozen=True)
class Group:
    """Points that compete with each other."""

    name: str  # key of the group
    title: str  # what is compared
    # Axes, with units.
    cost_label: str
    error_label: str
    points: tuple[Point, ...]  # the choices
    note: str = ""  # how the figures were obtained, for the page
    linear: bool = False  # whether the errors are drawn on a linear scale
    # Whether each family is drawn as a line of its own: they are no choices between which one is
    # free.
    families: bool = False


def on_front(costs: Sequence[float], errors: Sequence[float]) -> list[bool]:
    """Mark the Pareto front."""
    points = list(zip(costs, errors, strict=True))

    def beaten(cost: float, error: float) -> bool:
        # An exact double of a point is not beaten by it.
        return any((c, e) != (cost, error) and c <= cost and e <= error for c, e in points)

    return [error < math.inf and not beaten(cost, error) for cost, error in points]


def with_front(group: Group) -> Group:
    """Mark the front of a group."""
    marks = on_front([p.cost for p in group.points], [p.error for p in group.points])
    marked = [
        replace(point, on_front=mark) for point, mark in zip(group.points, marks, strict=True)
    ]
    return replace(group, points=tuple(sorted(marked, key=lambda p: (p.cost, p.error))))


def kept(path: Path, part: str) -> list[Group] | None:
    """Read what an interrupted run of this very program has found of a part; None when there is nothing."""
    stored = _stored(path).get(part)
    if stored is None:
        return None
    return [
        Group(**{**group, "points": tuple(Point(**point) for point in group["points"])})
        for group in stored
    ]


def keep(path: Path, part: str, groups: Sequence[Group]) -> None:
    """Add a part to what an interrupted run has found."""
    stored = _stored(path) | {"program": program(), part: [asdict(group) for group in groups]}
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_suffix(".new")
    beside.write_text(json.dumps(stored), encoding="utf-8")
    beside.replace(path)


def _stored(path: Path) -> dict[str, Any]:
    """Read a diary; that of another version is set aside: figures of two programs do not belong on one chart."""
    stored: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    if stored and stored.get("program") != program():
        fresh(path)
        return {}
    return stored


def as_json(groups: Sequence[Group], machine: dict[str, Any], seconds: float) -> dict[str, Any]:
    """Put all groups into one JSON object."""
    return {
        "points": [
            {"group": group.name, **asdict(point)} for group in groups for point in group.points
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
    """Write the data of a chart: one JSON file, and one CSV file with a column for every figure of any point."""
    data = as_json(groups, machine, seconds)
    whole, table = fresh(folder / "chart.json"), fresh(folder / "chart.csv")
    whole.write_text(json.dumps(data, indent=1, allow_nan=True) + "\n")
    keys = sorted({key for group in groups for point in group.points for key in point.detail})
    with table.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["group", "name", "family", "cost", "error", "on_front", *keys])
        for row in data["points"]:
            fixed = [row[key] for key in ("group", "name", "family", "cost", "error", "on_front")]
            writer.writerow(fixed + [row["detail"].get(key, "") for key in keys])
    return [whole, table]
