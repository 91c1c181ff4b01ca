"""A tool that is a body, against the proxy that it stands for: led along a sphere as `sim.experiments.proxies` leads a proxy.

A proxy without mass is on the surface at once; a tool has mass, sinks into the contact and is stepped. So its error is what a
scene with things that move costs where nothing moves.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import numpy as np

from nodes.coupling.render import turn
from nodes.environment.bodies.moving_scene import MovingScene
from sim.experiments.proxies import RADIUS, ProxyError, ring

STEPS = (1e-3, 5e-4, 1e-4)
"""Steps of the scene that are compared [s]."""

_TIP, _MASS = 0.005, 0.05
_SCENE = """<mujoco><option timestep="{step!r}" integrator="implicitfast" cone="elliptic" gravity="0 0 0"/><worldbody>
<geom type="sphere" size="{radius!r}" friction="0 0 0" {contact}/>
<body name="tool" pos="{begin}"><joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/>
<joint type="slide" axis="0 0 1"/><geom type="sphere" size="{tip!r}" mass="{mass!r}" friction="0 0 0" {contact}/></body>
</worldbody></mujoco>"""


def body_error(
    step: float, ticks: int, stiffness: float, depth: float, speed: float, period: float, stiff: bool = False
) -> ProxyError:
    """Lead a tool that is a body along the sphere.

    `stiffness`: K of the coupling, which has a damper that makes it critical with the tool [N/m]. `depth`: how deep below the
    surface the device is led [m]. `stiff`: whether contacts are as stiff as the step lets them be; else as MuJoCo makes them
    when nothing is said. Returns: as of a proxy; a call is a tick of the scene. Raises ParameterError when MuJoCo is not
    installed.
    """
    surface, normal = ring(ticks, speed, period, RADIUS)
    ideal = surface + _TIP * normal
    below = depth * np.minimum(np.arange(ticks) / (0.05 * ticks), 1.0)
    path = ideal - below[:, None] * normal
    contact = f'solref="{2.0 * step!r} 1" solimp="0.99 0.9999 0.0001"' if stiff else ""
    begin = " ".join(repr(x) for x in path[0].tolist())
    text = _SCENE.format(step=step, radius=RADIUS, tip=_TIP, mass=_MASS, contact=contact, begin=begin)
    with tempfile.TemporaryDirectory(prefix="haptic-") as folder:
        file = Path(folder) / "sphere.xml"
        file.write_text(text, encoding="utf-8")
        world = MovingScene(file, "tool", period, "sphere")
    damping = 2.0 * np.sqrt(stiffness * _MASS)
    tools, times, force, before = np.empty((ticks, 3)), np.empty(ticks), np.zeros(3), np.zeros(3)
    turned, upright = np.eye(3).ravel().tolist(), [0.0, 0.0, 0.0]
    for k, (x, y, z) in enumerate(path.tolist()):
        handed = (float(force[0]), float(force[1]), float(force[2]))
        start = time.perf_counter_ns()
        world.follow(k, (x, y, z), handed, k - 1, 0.0, k == 0)
        times[k] = time.perf_counter_ns() - start
        tools[k] = world.tool_position
        stretch = tools[k] - path[k]
        # In axes that turn with the surface: in the world's a damper would push the tool on along the way (THEORY.md §15).
        turn(turned, upright, normal[k].tolist(), True)
        axes = np.reshape(turned, (3, 3))
        stretch = axes @ stretch
        force = axes.T @ (stiffness * stretch + damping * (stretch - before) / period)
        before = stretch
    # From when the depth is steady and the tool has come to rest on it.
    steady = slice(ticks // 5, None)
    error = stiffness * (tools - ideal)[steady]
    size = np.linalg.norm(error, axis=1)
    pull, way = stiffness * (tools - path)[steady], np.diff(path[steady], axis=0)
    work = float(np.einsum("ij,ij->", 0.5 * (pull[1:] + pull[:-1]), way))
    return ProxyError(
        name=f"body, {1e3 * step:g} ms steps{', stiff' if stiff else ''}",
        triangles=0,
        rms_n=float(np.sqrt(np.mean(size**2))),
        max_n=float(size.max()),
        noise_n=float(np.sqrt(np.mean(np.sum(np.diff(error, axis=0) ** 2, axis=1)) / 2.0)),
        proxy_um=float(1e6 * size.max() / stiffness),
        polyhedron_um=None,
        drag=abs(work) / float(np.linalg.norm(pull[1:], axis=1) @ np.linalg.norm(way, axis=1)),
        call_us=float(np.median(times) / 1e3),
        call_p99_us=float(np.percentile(times, 99) / 1e3),
        rounds=world.steps,
    )
