"""Describe a mesh file: units, shells, holes, repairs, and what a scene does with it."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.errors import UsageError
from nodes.cli.dispatch import refuse_unwritable
from nodes.cli.main import add_json, answer
from nodes.environment.shapes.mesh_file import MOST_EDGES, MOST_WIDTH
from nodes.parameters.quantities import above_zero

if TYPE_CHECKING:
    from nodes.environment.shapes.mesh_flaws import Counts
    from nodes.environment.shapes.mesh_holes import Hole
    from nodes.environment.shapes.mesh_report import MeshReport


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument("file", type=Path, help="an STL, OBJ, PLY or OFF file")
    parser.add_argument(
        "--scale",
        type=above_zero,
        help="metres per unit of the file (default: of the first unit that is likely)",
    )
    parser.add_argument(
        "--close",
        type=Path,
        metavar="OUT",
        help=(
            "write the repaired mesh to OUT (.stl or .obj), in the file's unit, with holes filled"
            f" that have at most {MOST_EDGES} edges and are at most {MOST_WIDTH:.0%} of its width"
            " broad".replace("%", "%%")
        ),
    )
    add_json(parser)
    parser.set_defaults(run=_run)


def _run(arguments: argparse.Namespace) -> int:
    from nodes.environment.shapes.mesh_report import examine

    out = arguments.close
    if out is not None:
        if out.suffix.lower() not in (".stl", ".obj"):
            raise UsageError(
                f"--close {out}: expected a name that ends with .stl or .obj"
            )
        if out.exists():
            raise UsageError(f"--close {out}: exists already; choose another name")
        refuse_unwritable(out, "--close")
    found = examine(arguments.file, "FILE", arguments.scale)
    figures = _figures(found)
    lines = _lines(found)
    code = 0
    if out is not None:
        left, counts, refusal = _close(found, out)
        filled, pieces = counts["holes"] + counts["narrow"], counts["pieces"]
        figures["close"] = {
            "file": str(out),
            "filled": filled,
            "pieces_left_out": pieces,
            "holes_left": _holes(left),
            "refusal": refusal,
        }
        limit = f"more than {MOST_EDGES} edges or broader than {MOST_WIDTH:.0%} of the width"
        rest = (
            f"{len(left)} left ({limit}, or around a sheet): {_hole(left[0])}"
            if left
            else "the mesh is closed" + (f", but {refusal}" if refusal else "")
        )
        loose = f", {pieces} loose pieces of sheets left out" if pieces else ""
        lines.append(f"close     {filled} holes filled{loose}, {rest}\n{out}")
        code = 1 if refusal else 0
    answer(arguments.json, figures, "\n".join([str(arguments.file), *lines]))
    return code


def _close(found: MeshReport, out: Path) -> tuple[list[Hole], Counts, str]:
    """Write the closed mesh.

    Returns the holes that are left, what was repaired, and why it is no solid then.
    """
    from nodes.environment.shapes.mesh_edges import rims
    from nodes.environment.shapes.mesh_holes import holes
    from nodes.environment.shapes.mesh_repair import JOINS, NARROW, SLIVER, repair
    from nodes.environment.shapes.mesh_report import (
        refusal_of,
        single_precision_error,
        write_mesh,
    )

    closed = repair(
        found.read.corners,
        height=SLIVER / found.scale,
        narrow=NARROW / found.scale,
        widest=MOST_EDGES,
        part=MOST_WIDTH,
    )
    moved = (
        single_precision_error(closed.points) if out.suffix.lower() == ".stl" else 0.0
    )
    if moved > JOINS[-1] * max(found.size):
        raise UsageError(
            f"--close {out}: single precision, as STL has, moves corners by up to {moved:.2g}"
            " units, because the mesh is far from the origin; name it .obj"
        )
    write_mesh(out, closed.points, closed.ids)
    left = holes(closed.points, closed.ids, rims(closed.partner))
    return left, closed.counts, refusal_of(closed, found.scale)


def _holes(found: list[Hole]) -> list[dict[str, float]]:
    return [{"edges": one.edges, "width": one.width} for one in found]


def _hole(one: Hole) -> str:
    return f"the largest has {one.edges} edges and is {one.width:.4g} units wide"


def _figures(found: MeshReport) -> dict[str, Any]:
    mesh = found.repaired
    return {
        "faces": {str(corners): count for corners, count in found.read.faces.items()},
        "triangles": len(mesh.ids),
        "size": list(found.size),
        "units": [one._asdict() for one in found.units],
        "scale": found.scale,
        "shells": len(mesh.closed),
        "closed_shells": int(mesh.closed.sum()),
        "cavities": int(mesh.cavity.sum()),
        "one_sided": mesh.disagreeing,
        "holes": _holes(found.holes),
        "crossings": found.crossings,
        "probes": found.probes,
        "notes": list(found.read.notes),
        "repairs": {kind: count for kind, count in mesh.counts.items() if count},
        "is_solid": not found.verdict,
        "refusal": found.verdict,
        "is_sheet": not found.sheet,
    }


def _lines(found: MeshReport) -> list[str]:
    mesh = found.repaired
    faces = ", ".join(
        f"{count} of {corners} corners" for corners, count in found.read.faces.items()
    )
    size = " x ".join(f"{length:.6g}" for length in found.size)
    units = ", ".join(
        f"{one.unit} {1e3 * one.width:.4g} mm wide" for one in found.units
    )
    likely = [one.unit for one in found.units if one.is_likely]
    known = (
        f"; likely {' or '.join(likely)}: a hand feels 20 to 500 mm" if likely else ""
    )
    lines = [
        f"faces     {faces}; {len(mesh.ids)} triangles after repairs",
        f"size      {size} units of the file, which do not say what they are",
        f"units     {units or 'none gives a width of 1 mm to 2 m; give --scale'}{known}",
        f"shells    {len(mesh.closed)}: {int(mesh.closed.sum())} closed, of which"
        f" {int(mesh.cavity.sum())} cavities",
        f"holes     {f'{len(found.holes)}, {_hole(found.holes[0])}' if found.holes else 'none'}",
    ]
    lines += [
        f"repair    {text}" for text in (*found.read.notes, *mesh.texts(found.scale))
    ]
    if found.probes:
        crossed = (
            f"at {found.crossings} of {found.probes} places of its faces"
            " the mesh crosses itself"
        )
        lines.append(
            f"crossing  {crossed}, or its shells overlap"
            if found.crossings
            else f"crossing  none at {found.probes} places of its faces"
        )
    verdict = "felt as a solid" if not found.verdict else f"refused: {found.verdict}"
    lines.append(f"scene     scale: {found.scale:.6g}: {verdict}")
    if found.verdict:
        sheet = "felt as a sheet" if not found.sheet else f"refused: {found.sheet}"
        lines.append(f"          scale: {found.scale:.6g}, sides: both: {sheet}")
    return lines
