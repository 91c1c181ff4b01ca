"""Survey mesh files: how a scene feels each, and whether it feels it rightly."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from messages.errors import UsageError
from nodes.launcher.scenario_files import launch_dirs
from nodes.parameters.options import argument, option
from nodes.parameters.quantities import SEED, positive, whole
from sim.studies.result import Findings
from sim.studies.sweeps import SpreadOptions, spread

if TYPE_CHECKING:
    from sim.lab.mesh_survey import MeshJudged

_SHOWN = 20  # files named of those that are refused, fail or are felt wrongly


@dataclass(frozen=True, kw_only=True)
class MeshesOptions(SpreadOptions):
    """Options of `meshes`."""

    sources: list[str] = argument(
        default=[],
        nargs="*",
        metavar="SOURCE",
        help="folders, files, or names of installed packages; none: meshes of our launch files",
    )
    largest: float = option(
        default=20.0, type=positive, help="largest file that is read [MB] (default: 20)"
    )
    most: int = option(
        default=0,
        type=whole(0, 10**6),
        help="files of each source, evenly drawn (default: all)",
    )
    seed: int = option(default=0, type=SEED, help="of the places (default: 0)")


@dataclass(frozen=True, repr=False, kw_only=True)
class MeshesFound(Findings):
    """The files of each source by how they are felt, and each file."""

    counts: dict[str, dict[str, int]]  # by source, then by how it is felt
    places: int  # judged places and ticks
    rows: list[MeshJudged]


def meshes(options: MeshesOptions) -> MeshesFound:
    """Judge all files; fail if reading one fails, or one is felt wrongly."""
    from sim.lab.mesh_survey import WIDTH, MeshFelt, judge, sources

    ours = [str(folder / "meshes") for folder in launch_dirs()]
    given = options.sources or [path for path in ours if Path(path).is_dir()]
    found = sources(given, 1e6 * options.largest)
    if options.most:
        found = [
            one._replace(files=one.files[:: -(-len(one.files) // options.most) or 1])
            for one in found
        ]
    files = [file for one in found for file in one.files]
    if not files:
        raise UsageError(f"{', '.join(options.sources)}: no mesh file found")
    rows = spread(options, [partial(judge, file, options.seed) for file in files], 8)
    head = [*(str(felt) for felt in MeshFelt), "wrongly", "files"]
    counts, lines, at = {}, [f"{'':32}" + "".join(f"{name:>14}" for name in head)], 0
    for one in found:
        mine = rows[at : at + len(one.files)]
        at += len(mine)
        counts[one.name] = _counts(mine)
        lines.append(_line(one.name, counts[one.name], head))
    total = _counts(rows)
    if len(found) > 1:
        lines.append(_line("all", total, head))
    solid = total[str(MeshFelt.SOLID)]
    closed = solid + total[str(MeshFelt.CLOSED)]
    places = sum(row.places for row in rows)
    lines.append(
        f"{solid / len(rows):.1%} are felt as solids as they are,"
        f" {closed / len(rows):.1%} with --close; {places} places and ticks judged at a"
        f" width of {1e3 * WIDTH:g} mm"
    )
    named = [
        row
        for row in rows
        if row.wrong or row.felt in (MeshFelt.REFUSED, MeshFelt.FAILED)
    ]
    lines += [
        f"{os.path.basename(row.file)}: {row.felt}{f', {row.wrong} wrong' if row.wrong else ''}:"
        f" {row.reason.replace(row.file, '').lstrip(': ')}"
        for row in named[:_SHOWN]
    ]
    return MeshesFound(
        lines=lines,
        held=not any(row.wrong or row.felt is MeshFelt.FAILED for row in rows),
        counts=counts,
        places=places,
        rows=[replace(row, file=os.path.basename(row.file)) for row in rows],
    )


def _counts(rows: list[MeshJudged]) -> dict[str, int]:
    from sim.lab.mesh_survey import MeshFelt

    felt = Counter(row.felt for row in rows)
    found = {str(one): felt[one] for one in MeshFelt}
    return {**found, "wrongly": sum(row.wrong > 0 for row in rows), "files": len(rows)}


def _line(name: str, counts: dict[str, int], head: list[str]) -> str:
    return f"{name[-31:]:32}" + "".join(f"{counts[one]:14d}" for one in head)
