"""Meshes of other people: how a scene feels each, and whether it feels it rightly.

Each mesh is scaled to one width, prepared as by a launch, and touched by the compiled
proxy. The truth comes from the triangles as the file has them, before any repair (but with
the lids of holes that were filled on request), by two ways that the geometry under test
does not use: the solid angle of all triangles (van Oosterom and Strackee 1983), and where
the orientations of the file disagree, the parity of crossings along three rays. Places at
which neither is certain are not judged.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from hashlib import sha256
from importlib import metadata
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from messages.errors import UsageError
from nodes.environment.shapes import tables as t
from nodes.environment.shapes.mesh import PreparedMesh, prepare_mesh
from nodes.environment.shapes.mesh_edges import Flags
from nodes.environment.shapes.mesh_file import MOST_EDGES, MOST_WIDTH, read_triangles
from nodes.environment.shapes.mesh_repair import repair
from nodes.environment.shapes.mesh_shells import winding_number
from nodes.environment.shapes.scene import mesh, new_memory, scene_table
from nodes.environment.shapes.touchable import TOOL_RADIUS
from nodes.parameters.store import ParameterError
from sim.arrays import Array
from sim.play.touch import meet

FORMATS: Final = (".stl", ".obj", ".ply", ".off")
WIDTH: Final = 0.08  # of each mesh in the scene [m]

_PLACES = (16, 96)  # least and most places of a mesh at which a tool begins
_WORK = 1_500_000  # triangles times places, above the least number of places
_OFF = (1e-3, 0.05)  # distance of most places from a face [of the width]
_CHORDS = 4  # straight paths through the mesh
_STEP = 5e-4  # of a path in a tick [m]
_CHECKED = 6  # ticks in contact of each path at which the proxy is checked
_WHOLE = 0.02  # largest distance of a certain winding number from a whole one
_NEAR = 2e-5  # distance from a face below which a place is not judged [m]
_RAYS = np.array([[0.31, 0.52, 0.80], [-0.77, 0.21, 0.60], [0.45, -0.84, 0.29]])


class MeshFelt(StrEnum):
    """How a scene feels a mesh."""

    SOLID = "as it is"
    CLOSED = "with --close"
    SHEET = "as a sheet"
    REFUSED = "refused"
    FAILED = "failed"


@dataclass(frozen=True)
class MeshJudged:
    """One mesh file in the survey."""

    file: str
    felt: MeshFelt
    triangles: int = 0
    places: int = 0  # judged places and ticks
    wrong: int = 0  # of those, felt otherwise than the truth
    reason: str = ""  # of a refusal or a failure, or what was felt wrongly


class MeshSource(NamedTuple):
    """A folder or an installed package, and its mesh files."""

    name: str  # with the version of a package
    files: list[Path]


def sources(names: list[str], largest: float) -> list[MeshSource]:
    """Return the mesh files of folders, files and installed packages, each file once.

    Parameters
    ----------
    names : list of str
        Path of a folder or a file, or name of an installed package.
    largest : float
        Size above which a file is left out [bytes].

    Raises
    ------
    UsageError
        If a name is neither.
    """
    seen: set[bytes] = set()
    found = []
    for name in names:
        told, paths = _paths(name)
        mine = []
        for path in sorted(paths):
            if not path.is_file() or path.stat().st_size > largest:
                continue
            digest = sha256(path.read_bytes()).digest()
            if digest not in seen:
                seen.add(digest)
                mine.append(path)
        found.append(MeshSource(told, mine))
    return found


def _paths(name: str) -> tuple[str, Iterator[Path]]:
    path = Path(name)
    if path.exists():
        inner = path.rglob("*") if path.is_dir() else iter([path])
        return name, (one for one in inner if one.suffix.lower() in FORMATS)
    try:
        package = metadata.distribution(name)
    except (metadata.PackageNotFoundError, ValueError) as error:
        raise UsageError(
            f"{name}: expected a folder, a file, or an installed package"
        ) from error
    inside = (Path(str(one.locate())) for one in package.files or ())
    return (
        f"{package.name} {package.version}",
        (one for one in inside if one.suffix.lower() in FORMATS),
    )


def judge(path: Path, seed: int = 0) -> MeshJudged:
    """Read a mesh, feel it, and compare what is felt with the truth."""
    name = str(path)
    try:
        raw = read_triangles(path, "file")
        low, high = raw.reshape(-1, 3).min(axis=0), raw.reshape(-1, 3).max(axis=0)
        width = float((high - low).max())
        if not 0.0 < width < 1e30:
            raise ParameterError(
                f"is {width:g} units wide; export the mesh again", path="file"
            )
        raw = WIDTH / width * (raw - 0.5 * (low + high))
        with np.errstate(divide="raise", invalid="raise"):
            felt, made = _felt(raw)
        if felt is MeshFelt.SHEET:
            return MeshJudged(name, felt, len(raw))
        # Only the triangles over holes that were filled are not in the file.
        truth = raw if felt is MeshFelt.SOLID else made.corners
        return compare(name, felt, made, truth, np.random.default_rng(seed))
    except ParameterError as error:
        return MeshJudged(name, MeshFelt.REFUSED, reason=error.text)
    except Exception as error:  # noqa: BLE001 - the survey goes on and names the file
        return MeshJudged(name, MeshFelt.FAILED, reason=repr(error))


def _felt(raw: Array) -> tuple[MeshFelt, PreparedMesh]:
    """Prepare triangles as a launch does: as they are, closed on request, as a sheet."""
    try:
        return MeshFelt.SOLID, prepare_mesh(raw, False, "file")
    except ParameterError:
        closed = repair(raw, widest=MOST_EDGES, part=MOST_WIDTH)
    if len(closed.ids) and closed.is_solid:
        with suppress(ParameterError):  # a part is inside out
            made = prepare_mesh(closed.points[closed.ids], False, "file")
            return MeshFelt.CLOSED, made
    return MeshFelt.SHEET, prepare_mesh(raw, True, "file")


class _Play:
    """A tool over one mesh; each start has a new proxy."""

    def __init__(self, made: PreparedMesh) -> None:
        self._table = np.array(scene_table([mesh(made)], TOOL_RADIUS, 1e-3))
        self._new = np.array(new_memory(1))

    def path(self, places: Array) -> tuple[Array, Flags, bool]:
        """Return the proxy along a path, where it touches, and whether it began inside."""
        memory = self._new.copy()
        proxies, contact = np.empty_like(places), np.empty(len(places), dtype=bool)
        inside = False
        for n, (x, y, z) in enumerate(places.tolist()):
            meet(self._table, memory, x, y, z)
            proxies[n] = memory[t.PROXY : t.PROXY + 3]
            contact[n] = memory[t.IN_CONTACT] == 1.0
            inside = inside or (n == 0 and memory[t.INSIDE] > 0.0)
        return proxies, contact, inside


def compare(
    name: str, felt: MeshFelt, made: PreparedMesh, raw: Array, rng: np.random.Generator
) -> MeshJudged:
    """Begin at random places, and go along straight paths; count what is felt wrongly."""
    play = _Play(made)
    count = int(np.clip(_WORK // len(raw), *_PLACES))
    places = _near_faces(raw, count, rng)
    truth = inside(raw, places)
    wrong, judged, reason = 0, 0, ""
    for place, true in zip(places, truth.tolist(), strict=True):
        if true < 0:
            continue
        judged += 1
        _, contact, began = play.path(place[None])
        if (began or bool(contact[0])) != (true == 1) and _clear(raw, place):
            wrong += 1
            reason = f"{'inside' if true else 'outside'} at {place.tolist()}"
    for _ in range(_CHORDS):
        far = rng.normal(size=(2, 3))
        begin, end = WIDTH * far / np.linalg.norm(far, axis=1)[:, None]
        middle = places[rng.integers(0, len(places))]
        way = np.concatenate([_line(begin, middle), _line(middle, end)])
        proxies, contact, began = play.path(way)
        judged += len(way)
        entered = _first_crossing(raw, begin, middle)
        ticks = np.flatnonzero(contact)
        first = int(ticks[0]) if len(ticks) else len(way)
        at = entered * len(_line(begin, middle))
        if began or (first < at - 2.0 and _clear(raw, way[first])):
            wrong += 1
            reason = f"felt in free air on the way from {begin.tolist()}"
        # A proxy in contact is outside of the solid.
        shown = (
            ticks[np.linspace(0, len(ticks) - 1, _CHECKED).astype(int)]
            if first < len(way)
            else ticks
        )
        for k, true in zip(shown, inside(raw, proxies[shown]).tolist(), strict=True):
            if true == 1 and _clear(raw, proxies[k]):
                wrong += 1
                reason = f"a proxy inside at {proxies[k].tolist()}"
    return MeshJudged(name, felt, len(raw), judged, wrong, reason)


def _near_faces(raw: Array, count: int, rng: np.random.Generator) -> Array:
    """Return places near the faces of a mesh, and one in four anywhere in its box."""
    across = np.cross(raw[:, 1] - raw[:, 0], raw[:, 2] - raw[:, 0])
    area = np.linalg.norm(across, axis=1)
    chosen = rng.choice(len(raw), count, p=area / area.sum())
    on = np.einsum("ij,ijk->ik", rng.dirichlet((1.0, 1.0, 1.0), count), raw[chosen])
    way = rng.normal(size=(count, 3))
    way /= np.linalg.norm(way, axis=1)[:, None]
    off = WIDTH * np.exp(rng.uniform(math.log(_OFF[0]), math.log(_OFF[1]), count))
    places: Array = on + off[:, None] * way
    low, high = raw.reshape(-1, 3).min(axis=0), raw.reshape(-1, 3).max(axis=0)
    places[::4] = rng.uniform(low, high, (len(places[::4]), 3))
    return places


def _line(begin: Array, end: Array) -> Array:
    steps = max(2, int(np.linalg.norm(end - begin) / _STEP))
    return begin + np.linspace(0.0, 1.0, steps, endpoint=False)[:, None] * (end - begin)


def inside(raw: Array, places: Array) -> Array:
    """Return 1 for places inside of triangles, shape (n, 3, 3), 0 outside, −1 uncertain.

    Inside is where the winding number is not 0. Where it is far from a whole number, because
    faces disagree about outside or the mesh has a hole, the parity of crossings along three
    rays decides if all agree.
    """
    turns = winding_number(raw, places)
    whole = np.rint(turns)
    found: Array = (whole != 0.0).astype(np.float64)
    for n in np.flatnonzero(np.abs(turns - whole) > _WHOLE):
        parities = {
            int((_crossings(raw, places[n], ray) > 0.0).sum()) % 2 for ray in _RAYS
        }
        found[n] = parities.pop() if len(parities) == 1 else -1.0
    return found


def _crossings(raw: Array, place: Array, ray: Array) -> Array:
    """Return where a ray crosses triangles, in multiples of it (Möller and Trumbore 1997)."""
    u, v, from_corner = raw[:, 1] - raw[:, 0], raw[:, 2] - raw[:, 0], place - raw[:, 0]
    p, q = np.cross(ray, v), np.cross(from_corner, u)
    with np.errstate(divide="ignore", invalid="ignore"):
        over = 1.0 / np.einsum("ij,ij->i", u, p)
        first = np.einsum("ij,ij->i", from_corner, p) * over
        second = q @ ray * over
        part = np.einsum("ij,ij->i", v, q) * over
        within = (first >= 0.0) & (second >= 0.0) & (first + second <= 1.0)
    return np.asarray(part[within & np.isfinite(part)])


def _first_crossing(raw: Array, begin: Array, end: Array) -> float:
    """Return the part of a straight path before it comes near a triangle; 1 for none."""
    found = _crossings(raw, begin, end - begin)
    return float(np.min(found[(found >= 0.0) & (found <= 1.0)], initial=1.0))


def _clear(raw: Array, place: Array) -> bool:
    """Whether a place is not within rounding or the tool's radius of a face."""
    from sim.lab.proxy_shapes import nearest_on

    area = np.linalg.norm(
        np.cross(raw[:, 1] - raw[:, 0], raw[:, 2] - raw[:, 0]), axis=1
    )
    near = nearest_on(raw[area > 0.0], place)
    return bool(np.linalg.norm(near - place, axis=1).min() > _NEAR)
