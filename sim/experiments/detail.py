"""Compare levels of detail of a shape by the force rendered along one path.

Each level is played along the device path of a real run, and its force is compared with the finest
level's. A level is good enough if its force error is below the device's own force step, or below a
stated fraction of the largest force; the coarsest such level is the result.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from messages.types import Vector
from nodes.environment.bodies.moving_scene import MovingScene
from nodes.environment.bodies.node import MujocoParameters
from nodes.environment.shapes.mesh import PreparedMesh, prepare_mesh
from nodes.environment.shapes.scene import (
    SLIPPERY,
    WHOLE,
    Factors,
    FeltRegion,
    Solid,
    capsule,
    plane,
    sphere,
)
from nodes.environment.shapes.tables import BOX, MESH, PLANE
from nodes.launcher.launch_spec import Launch
from nodes.laws import CompiledLaw
from nodes.parameters.store import ParameterError
from sim.arrays import Array
from sim.device.filters import filtered
from sim.play.launched import parameters_of
from sim.play.touch import Touched, call_times, touch
from sim.play.trace import ChainTrace

# grid cells along the longest side, for merging mesh vertices
_GRIDS = (24, 16, 12, 8)
_PIECES = (8, 4, 2, 1)
_FEWEST = 8  # minimum number of points to fit a primitive to
_PLACE = 10  # consecutive ticks without a difference that end a stretch
_TIMED = 2000
_WITHOUT_REGIONS = "without regions"


@dataclass(frozen=True)
class Level:
    """One description of a scene, its cost and its error."""

    name: str  # description
    solids: int  # number of shapes
    triangles: int  # number of triangles, summed over all meshes
    force_n: float  # largest force difference from the finest level [N]
    rms_n: float  # its root mean square over ticks where either is in contact [N]
    proxy_um: float  # largest distance of the proxy from the finest level's [µm]
    places: int  # separate stretches of the path with a difference above the limit
    # Duration of a call: median and 99th percentile [µs].
    call_us: float
    call_p99_us: float
    enough: bool  # whether the force error stays within the limit

    @classmethod
    def measured(
        cls,
        name: str,
        solids: int,
        triangles: int,
        difference: Array,
        counted: Array,
        away: Array,
        times: Array,
        limit: float,
    ) -> Level:
        """Summarise a path: force differences [N], proxy distances [m] and call times [µs]."""
        largest = float(difference.max())
        rms = float(np.sqrt(np.mean(counted**2)))
        proxy = float(1e6 * away.max())
        calls = float(np.median(times)), float(np.percentile(times, 99))
        return cls(
            name,
            solids,
            triangles,
            largest,
            rms,
            proxy,
            places(difference > limit),
            *calls,
            largest <= limit,
        )


@dataclass(frozen=True)
class Detail:
    """Result of comparing all levels of detail."""

    levels: tuple[Level, ...]  # from the finest (first) to the coarsest
    limit_n: float  # force difference that counts as none [N]
    force_step_n: float  # force step of the device: stiffness times encoder step [N]
    largest_n: float  # largest force of the finest level [N]
    left_out: tuple[str, ...]  # levels that could not be built, with the reason

    @property
    def coarsest(self) -> Level:
        """The coarsest level whose error stays within the limit."""
        return [level for level in self.levels if level.enough][-1]


def detail(
    solids: Sequence[Solid],
    path: Array,
    tool_radius: float,
    period: float,
    stiffness: float,
    resolution: float,
    fraction: float,
    step: Callable[[str], None] = lambda _: None,
    regions: Sequence[FeltRegion] = (),
    law: CompiledLaw | None = None,
) -> Detail:
    """Play a path, shape (ticks, 3) [m], through all levels of detail.

    A force difference below `fraction` of the largest force counts as none. The regions are
    the same in all levels of the shapes, and left out of one. Factors of a shape scale the
    stiffness, and those of damping the rest of `law`, which is none without it.
    """
    finest = touch(solids, path, tool_radius, period, regions=regions)
    if not finest.contact.any():
        raise ValueError(
            "the path touches nothing: let it run longer, or lead the hand further"
        )
    felt = _at_rest(finest, stiffness)
    moving = _moving(finest, law)
    largest = float(np.linalg.norm(felt, axis=1).max())
    limit = max(stiffness * resolution, fraction * largest)
    # Points on the surface, not the tool's centre. A region has no normal.
    on_shape = finest.contact & (np.abs(finest.normal).max(axis=1) > 0.0)
    touched = (finest.proxy - tool_radius * finest.normal)[on_shape]
    levels = []
    left_out = []
    mean = finest.factors[on_shape].mean(axis=0) if on_shape.any() else WHOLE
    shape = touched, finest.normal[on_shape], Factors(*map(float, mean))
    for name, made in _levels(solids, *shape, bool(regions)):
        step(name)
        if isinstance(made, str):
            left_out.append(f"{name}: {made}")
            continue
        acting = () if name == _WITHOUT_REGIONS else regions
        found = touch(made, path, tool_radius, period, regions=acting)
        either = finest.contact | found.contact
        away = np.linalg.norm(
            np.where(found.contact[:, None], found.proxy, path)
            - np.where(finest.contact[:, None], finest.proxy, path),
            axis=1,
        )
        damping = finest.factors[:, 1:] - found.factors[:, 1:]
        apart = felt - _at_rest(found, stiffness) + damping * moving
        difference = np.linalg.norm(apart, axis=1)
        times = 1e6 * call_times(made, path, tool_radius, period, _TIMED, acting)
        triangles = sum(
            len(solid.mesh.corners) for solid in made if solid.mesh is not None
        )
        levels.append(
            Level.measured(
                name,
                len(made),
                triangles,
                difference,
                difference[either],
                away,
                times,
                limit,
            )
        )
    return Detail(
        tuple(levels), limit, stiffness * resolution, largest, tuple(left_out)
    )


def _deflection(found: Touched) -> Array:
    """Return the way from device to proxy, zero in the air [m], shape (ticks, 3)."""
    return np.where(found.contact[:, None], found.proxy - found.path, 0.0)


def _at_rest(found: Touched, stiffness: float) -> Array:
    """Return the force of a law's stiffness, with the factors of what is touched [N]."""
    return np.asarray(stiffness * found.factors[:, :1] * _deflection(found))


def _moving(found: Touched, law: CompiledLaw | None) -> Array:
    """Return the part of a law's force that is none at rest, without factors [N]."""
    way = _deflection(found)
    if law is None:
        return np.zeros_like(way)
    force = filtered(law.taps, [1.0], way.T)
    for b0, b1, a1, a2 in law.sections:
        force += filtered([b0, b1], [1.0, a1, a2], way.T)
    return np.asarray(force.T - law.h1 * way)


def places(over: NDArray[np.bool_]) -> int:
    """Count the separate stretches of a path where `over` is true."""
    at = np.flatnonzero(over)
    return 0 if not len(at) else 1 + int((np.diff(at) > _PLACE).sum())


def _levels(
    solids: Sequence[Solid],
    touched: Array,
    normals: Array,
    felt_as: Factors,
    regions: bool,
) -> Iterator[tuple[str, list[Solid] | str]]:
    """Yield the levels from the finest: name, and shapes or the reason why there are none."""
    rough = any(solid.friction != SLIPPERY for solid in solids)
    yield "as it is", list(solids)
    if regions:
        yield _WITHOUT_REGIONS, list(solids)
    if not len(touched):
        yield "coarser shapes", "the path touches no shape"
        return
    if rough:
        yield (
            "without friction",
            [solid._replace(friction=SLIPPERY) for solid in solids],
        )
    if any(solid.factors != WHOLE for solid in solids):
        yield "without factors", [solid._replace(factors=WHOLE) for solid in solids]
    meshes = [solid for solid in solids if solid.kind == MESH]
    if len(solids) == 1 and meshes:
        found = meshes[0].mesh
        assert found is not None  # noqa: S101  # it is one
        for cells in _GRIDS:
            yield from decimated(meshes[0], cells)
        for pieces in _PIECES:
            yield (
                f"{pieces} convex piece{'s' if pieces > 1 else ''}",
                _pieces(found, pieces, meshes[0]),
            )
    points = np.concatenate(
        [
            solid.mesh.corners.reshape(-1, 3)
            for solid in meshes
            if solid.mesh is not None
        ]
        or [touched]
    )
    friction = solids[0].friction
    several = {solid.factors for solid in solids}
    factors = felt_as if len(several) > 1 else solids[0].factors

    def alone(shape: Solid) -> list[Solid]:
        return [shape._replace(friction=friction, factors=factors)]

    # Unique vertices: the number of triangles at a vertex does not change the shape.
    points = np.unique(points, axis=0)
    if len(points) >= _FEWEST:
        if meshes:
            yield "box", alone(_box(points))
            yield "capsule", alone(_capsule(points))
        if not (len(solids) == 1 and solids[0].kind == PLANE):
            yield "sphere", alone(_sphere(points))
    if len(solids) > 1 or solids[0].kind != PLANE:
        normal = normals.mean(axis=0)
        point = tuple(touched.mean(axis=0).tolist())
        yield "plane", alone(plane(point, tuple(normal.tolist())))


def decimated(whole: Solid, cells: int) -> Iterator[tuple[str, list[Solid] | str]]:
    """Merge the vertices in each grid cell and drop degenerate triangles.

    Yield nothing if no triangle is saved.
    """
    found = whole.mesh
    if found is None:
        return
    corners = found.corners
    low = corners.reshape(-1, 3).min(axis=0)
    size = float(np.ptp(corners.reshape(-1, 3), axis=0).max()) / cells
    cell = np.floor((corners.reshape(-1, 3) - low) / size).astype(np.int64)
    _, ids, counts = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    ids = ids.ravel()
    means = (
        np.stack(
            [np.bincount(ids, corners.reshape(-1, 3)[:, k]) for k in range(3)], axis=1
        )
        / counts[:, None]
    )
    faces = ids.reshape(-1, 3)
    faces = faces[
        (faces[:, 0] != faces[:, 1])
        & (faces[:, 1] != faces[:, 2])
        & (faces[:, 2] != faces[:, 0])
    ]
    # A flattened part has each triangle twice, back to back: both are dropped.
    key = np.sort(faces, axis=1)
    _, at, times = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    faces = faces[times[at.ravel()] == 1]
    name = f"decimated to {len(faces)} triangles"
    if len(faces) >= len(corners):
        return
    try:
        yield (
            name,
            [
                whole._replace(
                    mesh=prepare_mesh(means[faces], not found.closed, "detail")
                )
            ],
        )
    except ParameterError as error:
        yield name, f"is no solid any more: {error}"


def hull(points: Array) -> Array:
    """Return the outward-facing triangles of a convex hull, shape (n, 3, 3)."""
    from scipy.spatial import ConvexHull

    found = ConvexHull(points)
    triangles = points[found.simplices]
    across = np.cross(
        triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    )
    inward = np.einsum("ij,ij->i", across, found.equations[:, :3]) < 0.0
    triangles[inward] = triangles[inward][:, ::-1]
    return np.asarray(triangles, dtype=np.float64)


def _pieces(found: PreparedMesh, count: int, whole: Solid) -> list[Solid] | str:
    """Split a mesh along its longest side into `count` parts; return their convex hulls."""
    parts = [found.corners]
    while len(parts) < count:
        halves = []
        for part in parts:
            centres = part.mean(axis=1)
            axis = int(np.argmax(np.ptp(centres, axis=0)))
            order = np.argsort(centres[:, axis], kind="stable")
            halves += [part[order[: len(order) // 2]], part[order[len(order) // 2 :]]]
        parts = halves
    made = []
    for part in parts:
        try:
            made.append(
                whole._replace(
                    mesh=prepare_mesh(
                        hull(np.unique(part.reshape(-1, 3), axis=0)), False, "detail"
                    )
                )
            )
        except (ParameterError, ValueError, RuntimeError) as error:
            return f"a piece is flat: {' '.join(str(error).split())[:120]}"
    return made


def _sphere(points: Array) -> Solid:
    """Fit a sphere by linear least squares to |x|² = 2 x·c + (r² − c²)."""
    solution = np.linalg.lstsq(
        np.column_stack([2.0 * points, np.ones(len(points))]),
        np.sum(points**2, axis=1),
        rcond=None,
    )[0]
    centre = solution[:3]
    return sphere(
        tuple(centre.tolist()),
        float(np.sqrt(max(solution[3] + centre @ centre, 1e-12))),
    )


def _main_axes(points: Array) -> tuple[Array, Array, Array]:
    """Return centre, principal directions (rows) and half extents [m]."""
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    along = points @ axes.T
    low = along.min(axis=0)
    high = along.max(axis=0)
    return 0.5 * (low + high) @ axes, axes, 0.5 * (high - low)


def _box(points: Array) -> Solid:
    middle, axes, half = _main_axes(points)
    return Solid(BOX, (*middle.tolist(), *axes.ravel().tolist(), *half.tolist()))


def _capsule(points: Array) -> Solid:
    middle, axes, half = _main_axes(points)
    radius = float(0.5 * (half[1] + half[2]))
    end = max(float(half[0]) - radius, 1e-6) * axes[0]
    return capsule(
        tuple((middle - end).tolist()), tuple((middle + end).tolist()), radius
    )


HEAVY = 1e6  # mass factor of a prescribed body: contacts do not move it


class Watched(MovingScene):
    """A scene that times its ticks and records its bodies at every step."""

    def __init__(self, launch: Launch, held: bool = False) -> None:
        name, given = parameters_of(launch, "mujoco", MujocoParameters)
        super().__init__(
            Path(given.scene).expanduser(),
            given.tool,
            launch.run.period,
            name,
            held,
            keyframe=given.keyframe,
        )
        self.times: list[int] = []
        self.went: list[tuple[Array, Array]] = []

    def follow(
        self,
        tick: int,
        position: Vector,
        force: Vector,
        since: int,
        delay: float,
        first: bool,
        jumped: bool = False,
    ) -> str:
        """Advance the scene to a tick."""
        begin = time.perf_counter_ns()
        told = super().follow(tick, position, force, since, delay, first, jumped)
        self.times.append(time.perf_counter_ns() - begin)
        return told

    def step(self) -> None:
        """Advance by one step."""
        self.went.append((self.data.qpos.copy(), self.data.qvel.copy()))
        super().step()


def level(
    name: str, world: Watched, found: ChainTrace, ideal: ChainTrace, limit: float
) -> Level:
    """Return a level with its error against the finest."""
    difference = np.linalg.norm(found.force - ideal.force, axis=1)
    away = np.linalg.norm(found.proxy - ideal.proxy, axis=1)
    times = np.array(world.times, dtype=np.float64) / 1e3
    return Level.measured(
        name, int(world.model.ngeom), 0, difference, difference, away, times, limit
    )
