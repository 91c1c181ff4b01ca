"""A law on a curved surface: rendering along a curved path, in world and turning axes.

Along a closed path below a surface a spring alone returns the energy it absorbed. Any excess comes
from the law's history: in world axes a deflection that only turns looks like a change (THEORY.md
§15).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec
import numpy as np
from numpy.typing import NDArray

from messages.types import Proxy
from nodes.coupling.render import begin_turning
from nodes.coupling.renderer import ActiveLaw, Renderer
from nodes.environment.shapes.mesh import prepare_mesh
from nodes.environment.shapes.scene import Solid, capsule, mesh, plane, sphere
from nodes.launcher.launch_spec import Launch
from nodes.laws import CompiledLaw
from nodes.laws.pd import PD
from nodes.stability.k_max import k_max, without_spring
from nodes.stability.plant import Plant
from sim.arrays import Array
from sim.lab.proxy_shapes import icosphere
from sim.play.player import play
from sim.play.touch import touch

FRAMES = ("world", "surface")
SEARCHED = (
    0.5,
    1.5,
)  # search range of K_max of a sliding contact, relative to that of one axis

_RADIUS, _THIN = 0.035, 0.006
# Mass, damping and stiffness of device and hand together [kg], [N s/m], [N/m]; damper of the law
# [N s/m].
_MASS, _DAMPING, _GRIP, _GAIN = 0.15, 3.0, 150.0, 2.0
# depth of the hand's pull below the top [m], and duration of a slide [s]
_PRESS, _SLIDES = 0.01, 0.5
_ENTER = 40  # ticks to reach the depth


@dataclass(frozen=True)
class AlongTheWay:
    """Rendering of a law along a closed path at constant depth."""

    # Identification.
    surface: str
    law: str
    frame: str
    # Energy that the device gained on the path there and back, over force times path length;
    # negative for friction.
    given_out: float
    # Root mean square of the force's change per tick, minus that of a spring alone [N].
    kicks_n: float
    largest_n: float  # largest difference of the force from that of a spring alone [N]


def ways(
    ticks: int, speed: float, period: float, depth: float
) -> list[tuple[str, list[Solid], Array]]:
    """Return surfaces, each with a path below it that starts outside and returns [m]."""
    s = np.arange(ticks) * speed * period
    there = np.concatenate([np.full(_ENTER, s[0]), s])
    down = np.concatenate([np.linspace(-1e-4, depth, _ENTER), np.full(ticks, depth)])

    def round_way(radius: float) -> Array:
        angle = there / radius
        normal = np.stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)], axis=1)
        return np.asarray((radius - down)[:, None] * normal)

    def back(path: Array) -> Array:
        return np.concatenate([path, path[:_ENTER:-1]])

    origin = (0.0, 0.0, 0.0)
    steep = math.radians(30.0)
    groove = [
        plane(origin, (side * math.sin(steep), 0.0, math.cos(steep)))
        for side in (1.0, -1.0)
    ]
    x = there - 0.5 * s[-1]
    across = np.stack(
        [x, np.zeros_like(x), np.abs(x) * math.tan(steep) - down / math.cos(steep)],
        axis=1,
    )
    flat = np.stack([x, np.zeros_like(x), -down], axis=1)
    found = [
        ("plane", [plane(origin, (0.0, 0.0, 1.0))], flat),
        ("sphere of 35 mm", [sphere(origin, _RADIUS)], round_way(_RADIUS)),
        (
            "rod of 6 mm",
            [capsule((0.0, -0.1, 0.0), (0.0, 0.1, 0.0), _THIN)],
            round_way(_THIN),
        ),
        ("groove of 120°", groove, across),
    ]
    for halvings in (2, 4):
        solid = mesh(prepare_mesh(icosphere(halvings, _RADIUS), False, "sphere"))
        found.append(
            (f"sphere of {20 * 4**halvings} triangles", [solid], round_way(_RADIUS))
        )
    return [(name, solids, back(path)) for name, solids, path in found]


def forces(
    law: CompiledLaw,
    frame: str,
    positions: Array,
    proxies: Array,
    normals: Array,
    contact: NDArray[np.bool_],
) -> Array:
    """Return the force of a law over a given path [N]."""
    renderer = Renderer([0, 1, 2], max(2, len(law.taps)))
    begin_turning(renderer.state, frame)
    renderer.law = ActiveLaw("law", "", law, renderer.histories)
    found = np.zeros_like(positions)
    rows = zip(
        positions.tolist(),
        proxies.tolist(),
        normals.tolist(),
        contact.tolist(),
        strict=True,
    )
    for k, (position, proxy, normal, touched) in enumerate(rows):
        place, away = (proxy, -1.0) if touched else (position, 1.0)
        at, proxied, turned = tuple(position), tuple(place), tuple(normal)
        met = Proxy(
            seq=k,
            stamp=0.0,
            position=at,
            proxy=proxied,
            normal=turned,
            distance=away,
            contact=touched,
        )
        found[k] = renderer.render(met)
    return found


def along_ways(
    laws: Sequence[tuple[str, CompiledLaw]],
    period: float = 0.002,
    speed: float = 0.2,
    depth: float = 2e-3,
    ticks: int = 400,
) -> list[AlongTheWay]:
    """Move a device along each surface and back, with each law in both frames."""
    found = []
    for surface, solids, path in ways(ticks, speed, period, depth):
        met = touch(solids, path, 0.0, period)
        moved = np.diff(path, axis=0)
        for name, law in laws:
            spring = law.h1 * np.where(met.contact[:, None], met.proxy - path, 0.0)
            # Start of the evaluation: the longest law has forgotten the entry.
            steady = slice(_ENTER + len(law.taps) + 2, None)
            for frame in FRAMES:
                force = forces(law, frame, path, met.proxy, met.normal, met.contact)
                beyond = force - spring
                mean, way = 0.5 * (force[1:] + force[:-1])[steady], moved[steady]
                work = float(np.einsum("ij,ij->", mean, way))
                scale = float(
                    np.linalg.norm(mean, axis=1) @ np.linalg.norm(way, axis=1)
                )
                kicks = float(
                    np.sqrt(
                        np.mean(np.sum(np.diff(beyond[steady], axis=0) ** 2, axis=1))
                    )
                )
                most = float(np.linalg.norm(beyond[steady], axis=1).max())
                found.append(
                    AlongTheWay(surface, name, frame, work / scale, kicks, most)
                )
    return found


def sliding(
    launch: Launch, stiffness: float, speed: float, frame: str, radius: float = _RADIUS
) -> Launch:
    """Return a launch with a hand that slides the device over a sphere.

    The chain's law has H(1) = `stiffness` [N/m].
    """
    deep = _GRIP * _PRESS / (_GRIP + stiffness)
    hand = {"mass": _MASS / 3.0, "damping": 2.0 * _DAMPING / 3.0, "stiffness": _GRIP}
    begin = -1.2 * deep
    device = {
        "mass": 2.0 * _MASS / 3.0,
        "damping": _DAMPING / 3.0,
        "hand": {**hand, "path": [[0.0, 0.0], [_SLIDES, speed * _SLIDES]]},
        "axes": {"z": {"position": begin, "hand": {"path": [[0.0, -_PRESS]]}}},
    }
    surface = {"kind": "sphere", "radius": radius, "position": [0.0, 0.0, -radius]}
    law = {"kind": "pd", "stiffness": stiffness, "damping": _GAIN}
    given: dict[str, dict[str, object]] = {
        "sim_driver": {"device": device, "pointer": None},
        "environment": {"surface": surface},
        "coupling": {
            "frame": frame,
            "stability": "off",
            "law": "law",
            "schedule": [],
            "laws": {"law": law},
        },
    }
    driver = next(spec for spec in launch.nodes.values() if spec.kind == "sim_driver")
    # The run starts in contact; a force ramp would change that contact.
    given["sim_driver"]["safety"] = {**driver.parameters.get("safety", {}), "ramp": 0.0}
    nodes = {
        name: msgspec.structs.replace(
            spec, parameters={**spec.parameters, **given.get(spec.kind, {})}
        )
        for name, spec in launch.nodes.items()
    }
    run = msgspec.structs.replace(launch.run, duration=_SLIDES, axes=["x", "y", "z"])
    return msgspec.structs.replace(launch, nodes=nodes, run=run)


def growth(position: Array, proxy: Array, contact: NDArray[np.bool_]) -> float:
    """Return the growth of the depth's ripple over a slide.

    The ripple is the second difference of the depth; the growth is its late over its early root
    mean square.
    """
    ripple = np.diff(
        np.where(contact, np.linalg.norm(proxy - position, axis=1), 0.0), n=2
    )
    tenth = len(ripple) // 10
    early, late = ripple[tenth : 4 * tenth], ripple[6 * tenth : 9 * tenth]
    return float(np.sqrt(np.mean(late**2) / max(np.mean(early**2), 1e-300)))


def sliding_k_max(
    launch: Launch,
    speed: float,
    frame: str,
    radius: float = _RADIUS,
    precision: float = 2e-3,
) -> float:
    """Return the stiffness from which the ripple of a sliding contact grows [N/m].

    It is searched between `SEARCHED[0]` and `SEARCHED[1]` of the one-axis limit. 0 if it grows
    at the softest, infinite if it does not grow at the stiffest.
    """

    def calms(stiffness: float) -> bool:
        found = play(sliding(launch, stiffness, speed, frame, radius))
        # A run that overflowed has a NaN growth: its ripple grew.
        return growth(found.measured, found.proxy, found.contact) <= 1.0

    low, high = (part * theory(launch.run.period) for part in SEARCHED)
    if not calms(low):
        return 0.0
    if calms(high):
        return math.inf
    while high > (1.0 + precision) * low:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if calms(middle) else (low, middle)
    return math.sqrt(low * high)


def theory(period: float) -> float:
    """Return K_max of the same law and device in one axis [N/m]."""
    rest = without_spring(PD(stiffness=1.0, damping=_GAIN), period)
    found = k_max(rest, Plant(period, _MASS, _DAMPING, 0.0, _GRIP)).h1_max_n_per_m
    assert found is not None  # noqa: S101  # every law of this kind has one
    return found
