"""Proxy algorithms compared on paths whose ideal force is a closed form.

The method follows Ruffaldi, Morris, Edmunds, Barbagli and Pai (Standardized Evaluation of Haptic
Rendering Systems, 2006), with generated instead of scanned paths. A tool is moved along an analytic
surface at a known depth, so the ideal force is known at every tick: stiffness times depth, along
the normal. Then the same closed path is played there and back: energy lost is friction that the
scene does not have. A plate thinner than a step shows whether a proxy changes sides. A mesh is also
compared with its polyhedron, by brute force over all its triangles, independently of the geometry
under test.
"""

from __future__ import annotations

import math
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nodes.coupling.render import turn
from nodes.environment.bodies.moving_scene import MovingScene
from nodes.environment.shapes.mesh import prepare_mesh
from nodes.environment.shapes.scene import Solid, box, capsule, mesh, plane, sphere
from sim.arrays import Array
from sim.lab.proxy_shapes import icosphere, off_polyhedron, ring
from sim.play.touch import Touched, call_times, touch

RADIUS = 0.05  # of the sphere [m]
PLATE = (0.2, 0.2, 2e-4)  # size of the plate [m]
_TIMED = 4000  # number of single calls timed


@dataclass(frozen=True)
class ProxyError:
    """Errors of a proxy on one shape."""

    name: str  # shape and its description
    triangles: int  # 0 for an analytic shape
    rms_n: float  # root mean square of the force error against the closed form [N]
    max_n: float  # its maximum [N]
    # its part that changes from tick to tick: root mean square of the differences over √2 [N]
    noise_n: float
    proxy_um: float  # largest distance of the proxy from the closed form [µm]
    # Largest distance of the proxy on a mesh from the exact one on the flat triangles [µm];
    # None for other shapes.
    polyhedron_um: float | None
    # work lost on a closed path there and back, over force times path length: apparent
    # friction coefficient
    drag: float
    # Duration of a call: median and 99th percentile, each with the interpreter's overhead,
    # under 1 µs [µs].
    call_us: float
    call_p99_us: float
    rounds: int  # largest number of iterations of a call

    @classmethod
    def of(cls, error: Array, stiffness: float, **others: Any) -> ProxyError:
        """Summarise the force error along a path [N]."""
        size = np.linalg.norm(error, axis=1)
        return cls(
            rms_n=float(np.sqrt(np.mean(size**2))),
            max_n=float(size.max()),
            noise_n=float(
                np.sqrt(np.mean(np.sum(np.diff(error, axis=0) ** 2, axis=1)) / 2.0)
            ),
            proxy_um=float(1e6 * size.max() / stiffness),
            **others,
        )


# name, triangles, solids, points on the surface [m], normals
Case = tuple[str, int, list[Solid], Array, Array]
CLOSED_FORMS = 3  # cases before the first mesh


def case(number: int, ticks: int, speed: float, period: float) -> Case:
    """Return a case: plane, sphere and capsule, then ever finer meshes of the sphere."""
    on_ball, outward = ring(ticks, speed, period, RADIUS)
    if number >= CLOSED_FORMS:
        triangles = icosphere(number - CLOSED_FORMS + 2, RADIUS)
        solid = mesh(prepare_mesh(triangles, False, "sphere"))
        return (
            f"sphere of {len(triangles)} triangles",
            len(triangles),
            [solid],
            on_ball,
            outward,
        )
    flat = np.arange(ticks)[:, None] * speed * period * np.array([1.0, 0.0, 0.0])
    up = np.tile([0.0, 0.0, 1.0], (ticks, 1))
    along = np.array([0.6, 0.8, 0.0])
    turn = np.arange(ticks) * speed * period / RADIUS
    rod_normal = np.cos(turn)[:, None] * np.array([0.0, 0.0, 1.0]) + np.sin(turn)[
        :, None
    ] * np.array([0.8, -0.6, 0.0])
    rod = RADIUS * rod_normal + 0.02 * np.sin(turn)[:, None] * along
    found: list[Case] = [
        ("plane", 0, [plane((0.0, 0.0, 0.0), (0.0, 0.0, 1.0))], flat, up),
        ("sphere", 0, [sphere((0.0, 0.0, 0.0), RADIUS)], on_ball, outward),
        (
            "capsule",
            0,
            [capsule((-0.06, -0.08, 0.0), (0.06, 0.08, 0.0), RADIUS)],
            rod,
            rod_normal,
        ),
    ]
    return found[number]


def compare_proxies(finest: int, ticks: int) -> list[ProxyError]:
    """Move a point along each surface at 4 mm depth, 0.2 m/s, 1 kHz and 500 N/m.

    The finest mesh has 20·4ⁿ triangles, n = `finest`, over `ticks` ticks.
    """
    ways = [Way(number, ticks, 4e-3, 0.2, 1e-3, 0.0) for number in range(count(finest))]
    return [timed(compared(way, 500.0), way) for way in ways]


def count(finest: int) -> int:
    """Count the cases up to the finest mesh."""
    return CLOSED_FORMS + finest - 1


class Way(NamedTuple):
    """Motion of a tool along the surface of a case; as for `compare_proxies`."""

    number: int
    ticks: int
    depth: float
    speed: float
    period: float
    tool_radius: float

    def below(self) -> Array:
        """Return the depth of each point below the surface [m]."""
        return (
            self.depth * np.minimum(np.arange(self.ticks) / (0.05 * self.ticks), 1.0)
            - 1e-4
        )

    def led(self) -> tuple[Case, Array]:
        """Return the case, and the path of the tool's centre [m]."""
        made = case(self.number, self.ticks, self.speed, self.period)
        *_, surface, normal = made
        return made, surface + (self.tool_radius - self.below()[:, None]) * normal


def compared(way: Way, stiffness: float) -> ProxyError:
    """Move the tool along one surface; return all errors.

    Call times, which depend on the machine, are left to `timed`.
    """
    (name, triangles, solids, surface, normal), path = way.led()
    ticks, depth, period, tool_radius, below = (
        way.ticks,
        way.depth,
        way.period,
        way.tool_radius,
        way.below(),
    )
    ideal = surface + tool_radius * normal
    found = touch(solids, path, tool_radius, period)
    inside = found.contact & (below > 0.1 * depth)
    off = None
    if solids[0].mesh is not None:
        off = 1e6 * off_polyhedron(
            solids[0].mesh.corners, path[inside], found.proxy[inside], tool_radius
        )
    lost, error = (
        drag(solids, path[ticks // 10 :], tool_radius, period, found),
        stiffness * (found.proxy - ideal)[inside],
    )
    told = {
        "name": name,
        "triangles": triangles,
        "polyhedron_um": off,
        "drag": lost,
        "rounds": int(found.rounds.max()),
    }
    return ProxyError.of(
        error, stiffness, **told, call_us=math.nan, call_p99_us=math.nan
    )


def timed(row: ProxyError, way: Way) -> ProxyError:
    """Time the calls of a case on this machine."""
    (_, _, solids, _, _), path = way.led()
    single = call_times(solids, path, way.tool_radius, way.period, _TIMED)
    return replace(
        row,
        call_us=float(1e6 * np.median(single)),
        call_p99_us=float(1e6 * np.percentile(single, 99)),
    )


def drag(
    solids: Sequence[Solid],
    path: Array,
    tool_radius: float,
    period: float,
    before: Touched | None = None,
) -> float:
    """Return the apparent friction of a path there and back in contact.

    It is the work lost over force times path length.
    """
    there = (
        path
        if before is None
        else np.concatenate([before.path[: len(before.path) - len(path)], path])
    )
    found = touch(solids, np.concatenate([there, path[::-1]]), tool_radius, period)
    lead = len(there) - len(path)
    return lost((found.proxy - found.path)[lead:], np.diff(found.path[lead:], axis=0))


def lost(force: Array, way: Array) -> float:
    """Return the work lost on a closed path, over force times path length."""
    work = np.einsum("ij,ij->", 0.5 * (force[1:] + force[:-1]), way)
    return float(
        abs(work) / (np.linalg.norm(force[1:], axis=1) @ np.linalg.norm(way, axis=1))
    )


def wrong_sides(
    steps: int, step: float, seed: int, tool_radius: float = 0.0
) -> tuple[int, float]:
    """Walk at random through a plate; count proxies below its top.

    Also return the largest sideways distance of a proxy from the device [m].
    """
    rng = np.random.default_rng(seed)
    way = rng.normal(size=(steps, 3))
    way *= rng.uniform(0.0, step, (steps, 1)) / np.linalg.norm(
        way, axis=1, keepdims=True
    )
    limits = np.array([0.03, 0.03, 0.004])
    far = np.cumsum(way, axis=0) + limits + np.array([0.0, 0.0, 0.002])
    path = np.abs((far + 2.0 * limits) % (4.0 * limits) - 2.0 * limits) - limits
    found = touch([box((0.0, 0.0, 0.0), PLATE)], path, tool_radius)
    top = 0.5 * PLATE[2] + tool_radius
    aside = np.linalg.norm(found.proxy[:, :2] - path[:, :2], axis=1)
    return int((found.proxy[:, 2] < top).sum()), float(aside.max())


STEPS = (1e-3, 5e-4, 1e-4)  # steps of the compared scenes [s]
_TIP, _MASS = 0.005, 0.05
_SCENE = """<mujoco><option timestep="{step!r}" integrator="implicitfast" cone="elliptic" \
gravity="0 0 0"/><worldbody>
<geom type="sphere" size="{radius!r}" friction="0 0 0" {contact}/>
<body name="tool" pos="{begin}"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
<joint type="slide" axis="0 0 1"/><geom type="sphere" size="{tip!r}" mass="{mass!r}" \
friction="0 0 0" {contact}/></body>
</worldbody></mujoco>"""


def body_error(
    step: float,
    ticks: int,
    stiffness: float,
    depth: float,
    speed: float,
    period: float,
    stiff: bool = False,
) -> ProxyError:
    """Move a dynamic tool along the sphere at a depth [m].

    `stiff` contacts are as stiff as the step allows.
    """
    surface, normal = ring(ticks, speed, period, RADIUS)
    ideal = surface + _TIP * normal
    below = depth * np.minimum(np.arange(ticks) / (0.05 * ticks), 1.0)
    path = ideal - below[:, None] * normal
    contact = f'solref="{2.0 * step!r} 1" solimp="0.99 0.9999 0.0001"' if stiff else ""
    begin = " ".join(repr(x) for x in path[0].tolist())
    text = _SCENE.format(
        step=step, radius=RADIUS, tip=_TIP, mass=_MASS, contact=contact, begin=begin
    )
    with tempfile.TemporaryDirectory(prefix="haptic-") as folder:
        file = Path(folder) / "sphere.xml"
        file.write_text(text, encoding="utf-8")
        world = MovingScene(file, "tool", period, "sphere")
    damping = 2.0 * np.sqrt(stiffness * _MASS)
    tools, times, force, before = (
        np.empty((ticks, 3)),
        np.empty(ticks),
        np.zeros(3),
        np.zeros(3),
    )
    turned, upright = np.eye(3).ravel().tolist(), [0.0, 0.0, 0.0]
    for k, (x, y, z) in enumerate(path.tolist()):
        handed = (float(force[0]), float(force[1]), float(force[2]))
        start = time.perf_counter_ns()
        world.follow(k, (x, y, z), handed, k - 1, 0.0, k == 0)
        times[k] = time.perf_counter_ns() - start
        tools[k] = world.tool_position
        stretch = tools[k] - path[k]
        # In turning axes: in world axes a damper would push the tool along the path
        # (THEORY.md §15).
        turn(turned, upright, normal[k].tolist(), True)
        axes = np.reshape(turned, (3, 3))
        stretch = axes @ stretch
        force = axes.T @ (stiffness * stretch + damping * (stretch - before) / period)
        before = stretch
    # Start of the evaluation: the depth is constant and the tool rests on it.
    steady = slice(ticks // 5, None)
    return ProxyError.of(
        stiffness * (tools - ideal)[steady],
        stiffness,
        name=f"body, {1e3 * step:g} ms steps{', stiff' if stiff else ''}",
        triangles=0,
        polyhedron_um=None,
        drag=lost(stiffness * (tools - path)[steady], np.diff(path[steady], axis=0)),
        call_us=float(np.median(times) / 1e3),
        call_p99_us=float(np.percentile(times, 99) / 1e3),
        rounds=world.steps,
    )
