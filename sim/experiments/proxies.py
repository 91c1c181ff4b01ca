"""Renderers of proxies compared on paths whose ideal force is a closed form, after Ruffaldi, Morris, Edmunds, Barbagli and Pai.

A tool is led along a surface that a formula describes, a known depth below it, so that the ideal force is known at every tick:
stiffness times depth, along the normal (Standardized Evaluation of Haptic Rendering Systems, 2006; theirs were scanned paths,
these are generated). Then the same closed way there and back: whatever the force costs there it must give back, or it is
friction that nobody asked for. A plate thinner than a step says whether a proxy changes sides.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from nodes.environment.shapes.mesh import prepare_mesh
from nodes.environment.shapes.scene import Solid, box, capsule, mesh, plane, sphere
from sim.arrays import Array
from sim.experiments.polyhedron import off_polyhedron
from sim.scene.touch import Touched, call_times, touch

RADIUS = 0.05
"""Of the sphere that is felt [m]."""

PLATE = (0.2, 0.2, 2e-4)
"""Size of the plate [m]."""

_TIMED = 4000
"""Single calls that are timed."""


@dataclass(frozen=True)
class ProxyError:
    """How a proxy did on one shape."""

    name: str  # shape and how it is described
    triangles: int  # 0 for a shape of a few floats
    rms_n: float  # root mean square of the force's error against the closed form [N]
    max_n: float  # the largest [N]
    noise_n: float  # what of it changes from tick to tick: root mean square of its differences over √2 [N]
    proxy_um: float  # largest distance of the proxy from the closed form [µm]
    # Largest distance of the proxy on a mesh from where it is on the flat triangles, exactly [µm]; None for other shapes.
    polyhedron_um: float | None
    drag: float  # work lost on a closed way there and back, over force times way: the apparent coefficient of friction
    # Time of a call: median and 99th percentile, each with what the interpreter adds to it, under 1 µs [µs].
    call_us: float
    call_p99_us: float
    rounds: int  # most rounds that a call took


def icosphere(halvings: int, radius: float) -> Array:
    """Make triangles of a sphere, 20·4ⁿ of them; shape (n, 3, 3)."""
    from scipy.spatial import ConvexHull

    golden = (1.0 + 5.0**0.5) / 2.0
    corners = np.array([(a, b * golden, 0.0) for b in (-1.0, 1.0) for a in (-1.0, 1.0)])
    corners = np.concatenate([np.roll(corners, n, axis=1) for n in range(3)])
    triangles = corners[ConvexHull(corners).simplices]
    outward = np.einsum("ij,ij->i", np.cross(*(triangles[:, i] - triangles[:, 0] for i in (1, 2))), triangles[:, 0])
    triangles[outward < 0.0] = triangles[outward < 0.0][:, ::-1]
    triangles /= np.linalg.norm(triangles, axis=2, keepdims=True)
    for _ in range(halvings):
        middle = triangles + np.roll(triangles, -1, axis=1)
        middle /= np.linalg.norm(middle, axis=2, keepdims=True)
        (a, b, c), (ab, bc, ca) = np.moveaxis(triangles, 1, 0), np.moveaxis(middle, 1, 0)
        parts = [(a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca)]
        triangles = np.concatenate([np.stack(part, axis=1) for part in parts])
    return np.ascontiguousarray(radius * triangles)


def ring(ticks: int, speed: float, period: float, radius: float) -> tuple[Array, Array]:
    """Go round a sphere, in a plane that is none of the axes: points on it [m] and their normals."""
    angle = 0.1 + np.arange(ticks) * speed * period / radius
    normal = np.stack([np.cos(angle), np.sin(angle) * math.cos(0.3), np.sin(angle) * math.sin(0.3)], axis=1)
    return radius * normal, normal


Case = tuple[str, int, list[Solid], Array, Array]
"""Name, triangles, solids, points on the surface [m], normals."""

CLOSED_FORMS = 3
"""Cases before the first mesh."""


def case(number: int, ticks: int, speed: float, period: float) -> Case:
    """Make what is compared: plane, sphere and capsule, then ever finer meshes of the sphere."""
    on_ball, outward = ring(ticks, speed, period, RADIUS)
    if number >= CLOSED_FORMS:
        triangles = icosphere(number - CLOSED_FORMS + 2, RADIUS)
        solid = mesh(prepare_mesh(triangles, False, "sphere"))
        return f"sphere of {len(triangles)} triangles", len(triangles), [solid], on_ball, outward
    flat = np.arange(ticks)[:, None] * speed * period * np.array([1.0, 0.0, 0.0])
    up = np.tile([0.0, 0.0, 1.0], (ticks, 1))
    along = np.array([0.6, 0.8, 0.0])
    turn = np.arange(ticks) * speed * period / RADIUS
    rod_normal = np.cos(turn)[:, None] * np.array([0.0, 0.0, 1.0]) + np.sin(turn)[:, None] * np.array([0.8, -0.6, 0.0])
    rod = RADIUS * rod_normal + 0.02 * np.sin(turn)[:, None] * along
    found: list[Case] = [
        ("plane", 0, [plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))], flat, up),
        ("sphere", 0, [sphere((0.0, 0.0, 0.0), RADIUS)], on_ball, outward),
        ("capsule", 0, [capsule((-0.06, -0.08, 0.0), (0.06, 0.08, 0.0), RADIUS)], rod, rod_normal),
    ]
    return found[number]


def compare_proxies(
    finest: int = 5,
    ticks: int = 5000,
    stiffness: float = 500.0,
    depth: float = 4e-3,
    speed: float = 0.2,
    period: float = 1e-3,
    tool_radius: float = 0.0,
) -> list[ProxyError]:
    """Lead the tool along each surface and compare.

    `finest`: the sphere's finest mesh has 20·4ⁿ triangles. `depth`: how deep below the surface the tool is led [m]; it swells
    from nothing, so that the tool enters from outside.
    """
    ways = [Way(number, ticks, depth, speed, period, tool_radius) for number in range(count(finest))]
    return [timed(compared(way, stiffness), way) for way in ways]


def count(finest: int) -> int:
    """Count the cases up to the finest mesh."""
    return CLOSED_FORMS + finest - 1


class Way(NamedTuple):
    """How a tool is led along the surface of a case; as for `compare_proxies`."""

    number: int
    ticks: int
    depth: float
    speed: float
    period: float
    tool_radius: float

    def below(self) -> Array:
        """Give how deep below the surface each point is [m]."""
        return self.depth * np.minimum(np.arange(self.ticks) / (0.05 * self.ticks), 1.0) - 1e-4

    def led(self) -> tuple[Case, Array]:
        """Make the case, and the path of the tool's middle [m]."""
        made = case(self.number, self.ticks, self.speed, self.period)
        *_, surface, normal = made
        return made, surface + (self.tool_radius - self.below()[:, None]) * normal


def compared(way: Way, stiffness: float) -> ProxyError:
    """Lead the tool along one surface: all but the times of the calls, which are of one machine (`timed`)."""
    (name, triangles, solids, surface, normal), path = way.led()
    ticks, depth, period, tool_radius, below = way.ticks, way.depth, way.period, way.tool_radius, way.below()
    ideal = surface + tool_radius * normal
    found = touch(solids, path, tool_radius, period)
    inside = found.contact & (below > 0.1 * depth)
    error = stiffness * (found.proxy - ideal)[inside]
    size = np.linalg.norm(error, axis=1)
    return ProxyError(
        name=name,
        triangles=triangles,
        rms_n=float(np.sqrt(np.mean(size**2))),
        max_n=float(size.max()),
        noise_n=float(np.sqrt(np.mean(np.sum(np.diff(error, axis=0) ** 2, axis=1)) / 2.0)),
        proxy_um=float(1e6 * size.max() / stiffness),
        polyhedron_um=None
        if solids[0].mesh is None
        else 1e6 * off_polyhedron(solids[0].mesh.corners, path[inside], found.proxy[inside], tool_radius),
        drag=drag(solids, path[ticks // 10 :], tool_radius, period, found),
        call_us=math.nan,
        call_p99_us=math.nan,
        rounds=int(found.rounds.max()),
    )


def timed(row: ProxyError, way: Way) -> ProxyError:
    """Time the calls of a case on this machine."""
    (_, _, solids, _, _), path = way.led()
    single = call_times(solids, path, way.tool_radius, way.period, _TIMED)
    return replace(row, call_us=float(1e6 * np.median(single)), call_p99_us=float(1e6 * np.percentile(single, 99)))


def drag(
    solids: Sequence[Solid], path: Array, tool_radius: float, period: float, before: Touched | None = None
) -> float:
    """Find the apparent friction of a way there and back that stays in contact: work lost over force times way."""
    there = path if before is None else np.concatenate([before.path[: len(before.path) - len(path)], path])
    found = touch(solids, np.concatenate([there, path[::-1]]), tool_radius, period)
    lead = len(there) - len(path)
    force, way = (found.proxy - found.path)[lead:], np.diff(found.path[lead:], axis=0)
    work = np.einsum("ij,ij->", 0.5 * (force[1:] + force[:-1]), way)
    return float(abs(work) / (np.linalg.norm(force[1:], axis=1) @ np.linalg.norm(way, axis=1)))


def wrong_sides(steps: int, step: float, seed: int, tool_radius: float = 0.0) -> tuple[int, float]:
    """Walk at random through a plate: how often the proxy was below its top, and how far at most beside the device [m]."""
    rng = np.random.default_rng(seed)
    way = rng.normal(size=(steps, 3))
    way *= rng.uniform(0.0, step, (steps, 1)) / np.linalg.norm(way, axis=1, keepdims=True)
    limits = np.array([0.03, 0.03, 0.004])
    far = np.cumsum(way, axis=0) + limits + np.array([0.0, 0.0, 0.002])
    path = np.abs((far + 2.0 * limits) % (4.0 * limits) - 2.0 * limits) - limits
    found = touch([box((0.0, 0.0, 0.0), PLATE)], path, tool_radius)
    top = 0.5 * PLATE[2] + tool_radius
    aside = np.linalg.norm(found.proxy[:, :2] - path[:, :2], axis=1)
    return int((found.proxy[:, 2] < top).sum()), float(aside.max())
