"""The terms of a scene with several axes, each an edit of the launch: the device, shapes, friction, the tool and bodies."""

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import msgspec
import numpy as np

from nodes.driver.limits import SafetyParameters
from nodes.environment.shapes.kinds import TOOL_RADIUS, Touchable
from nodes.environment.shapes.scene import SLIPPERY, Friction, Solid, plane
from nodes.environment.shapes.tables import MESH, PLANE
from nodes.environment.surfaces import parse_surface
from nodes.launcher.launch_spec import Launch
from nodes.parameters.store import ParameterError
from sim.device.driver import SimDriverParameters
from sim.device.model import DeviceModel
from sim.experiments.detail import decimated
from sim.experiments.terms import FRICTION, GRAVITY, PEAK_FORCE, RESOLUTION, RESPONSE, NeedTerm
from sim.play.chain import SpatialTrace, play
from sim.play.launched import parameters_of

ROUGH = Friction(0.3, 0.3)  # of a smooth hard surface under a hard tip, about
_GRIDS = (48, 24, 16, 12, 8, 6, 4)
# Mass along the other axes over that along the first: about what an arm with its motors on the base
# has.
_UNEVEN = {"y": 1.5, "z": 2.0}


class SpatialScene(NamedTuple):
    """A launch file of several axes, the shapes in place of its own, and the shapes that it has."""

    launch: Launch
    solids: tuple[Solid, ...] | None
    own: tuple[Solid, ...]

    @property
    def shapes(self) -> tuple[Solid, ...]:
        """What is touched; empty for a scene of bodies or of a flat surface."""
        return self.own if self.solids is None else self.solids

    def play(self) -> SpatialTrace:
        """Play it."""
        return play(self.launch, solids=self.solids)


Edit = Callable[[SpatialScene], SpatialScene]


def spatial_scene(launch: Launch) -> SpatialScene:
    """Take a launch file of one chain with a virtual device."""
    kinds = {spec.kind: (name, spec.parameters) for name, spec in launch.nodes.items()}
    for kind in ("sim_driver", "coupling"):
        if kind not in kinds:
            raise ParameterError(
                f"{launch.scenario}.nodes: no node of kind {kind}; one process cannot play it"
            )
    name, given = kinds.get("environment", ("", {}))
    surface = parse_surface(given.get("surface", {"kind": "free"}), f"{name}.surface")
    own = tuple(surface.solids(f"{name}.surface")) if isinstance(surface, Touchable) else ()
    return SpatialScene(launch, None, own)


def _node(kind: str, change: Callable[[dict[str, Any]], Mapping[str, Any]]) -> Edit:
    """Change parameters of the one node of a kind."""

    def edit(scene: SpatialScene) -> SpatialScene:
        nodes = {
            name: (
                msgspec.structs.replace(
                    spec, parameters={**spec.parameters, **change(spec.parameters)}
                )
                if spec.kind == kind
                else spec
            )
            for name, spec in scene.launch.nodes.items()
        }
        return scene._replace(launch=msgspec.structs.replace(scene.launch, nodes=nodes))

    return edit


def _driver(scene: SpatialScene) -> SimDriverParameters:
    found: SimDriverParameters = parameters_of(scene.launch, "sim_driver", SimDriverParameters)[1]
    return found


def device_of(scene: SpatialScene) -> DeviceModel:
    """Give its virtual device."""
    return _driver(scene).device


def with_device(scene: SpatialScene, **changes: Any) -> SpatialScene:
    """Change fields of its virtual device."""
    model = msgspec.to_builtins(msgspec.structs.replace(device_of(scene), **changes))
    return _node("sim_driver", lambda _: {"device": model, "preset": ""})(scene)


def _set(**changes: Any) -> Edit:
    return lambda scene: with_device(scene, **changes)


def _has(name: str) -> Callable[[SpatialScene], bool]:
    return lambda scene: bool(getattr(device_of(scene), name))


def _limited(name: str) -> Callable[[SpatialScene], bool]:
    return lambda scene: getattr(_driver(scene).safety, name) is not None


def _unlimited(name: str) -> Edit:
    def edit(scene: SpatialScene) -> SpatialScene:
        safety: SafetyParameters = _driver(scene).safety
        fields = msgspec.to_builtins(msgspec.structs.replace(safety, **{name: None}))
        return _node("sim_driver", lambda _: {"safety": fields})(scene)

    return edit


def _uneven(scene: SpatialScene) -> SpatialScene:
    device, axes = device_of(scene), scene.launch.run.axes
    return with_device(
        scene,
        axes={
            axis: {"mass": part * device.mass} for axis, part in _UNEVEN.items() if axis in axes[1:]
        },
    )


def _without_delay(scene: SpatialScene) -> SpatialScene:
    scene = with_device(scene, delay=0.0)
    run = msgspec.structs.replace(scene.launch.run, apply="on_arrival")
    return scene._replace(launch=msgspec.structs.replace(scene.launch, run=run))


def _is_meant(kind: str, name: str, value: Any) -> Callable[[SpatialScene], bool]:
    def declared(scene: SpatialScene) -> bool:
        return any(
            s.kind == kind and s.parameters.get(name, value) == value
            for s in scene.launch.nodes.values()
        )

    return declared


def _one_face(scene: SpatialScene) -> SpatialScene:
    """Put the plane that touches the shape where the device comes deepest in its place."""
    found = scene.play()
    depth = np.where(found.contact, np.linalg.norm(found.proxy - found.position, axis=1), -1.0)
    deepest = int(np.argmax(depth))
    if depth[deepest] < 0.0:
        raise ParameterError(
            f"{scene.launch.scenario}: the device touches nothing, so nothing can be said of what"
            " it needs"
        )
    normal = found.normal[deepest]
    point = found.proxy[deepest] - _tool_radius(scene) * normal
    return scene._replace(
        solids=(plane(tuple(point.tolist()), tuple(normal.tolist()), scene.shapes[0].friction),)
    )


def _coarser(scene: SpatialScene) -> SpatialScene:
    return scene._replace(solids=tuple(_half(solid) for solid in scene.shapes))


def _half(solid: Solid) -> Solid:
    """Draw a mesh's corners together until at most half of its triangles are left."""
    if solid.mesh is not None:
        found = (
            made
            for cells in _GRIDS
            for _, made in decimated(solid, cells)
            if not isinstance(made, str)
        )
        for (made,) in found:
            if made.mesh is not None and 2 * len(made.mesh.corners) <= len(solid.mesh.corners):
                return made
    return solid


def _rubbed(friction: Friction) -> Edit:
    return lambda scene: scene._replace(
        solids=tuple(solid._replace(friction=friction) for solid in scene.shapes)
    )


def _surface(change: Callable[[dict[str, Any]], dict[str, Any]]) -> Edit:
    return _node(
        "environment", lambda given: {"surface": change(given.get("surface", {"kind": "free"}))}
    )


def _tool_radius(scene: SpatialScene) -> float:
    for spec in scene.launch.nodes.values():
        if spec.kind == "environment":
            return float(spec.parameters.get("surface", {}).get("tool_radius", TOOL_RADIUS))
    return 0.0


# All terms of a scene with several axes.
SPATIAL_TERMS: tuple[NeedTerm[SpatialScene], ...] = (
    NeedTerm(
        "gravity", _has("gravity"), _set(gravity=None), _set(gravity=GRAVITY), f"{GRAVITY} m/s²"
    ),
    NeedTerm("damping", _has("damping"), _set(damping=0.0)),
    NeedTerm(
        "friction",
        _has("friction"),
        _set(friction=None),
        _set(friction=FRICTION),
        f"{FRICTION} N an axis",
    ),
    NeedTerm(
        "resolution",
        _has("resolution"),
        _set(resolution=None),
        _set(resolution=RESOLUTION),
        f"{RESOLUTION:g} m",
    ),
    NeedTerm(
        "peak_force",
        _has("peak_force"),
        _set(peak_force=None),
        _set(peak_force=PEAK_FORCE),
        f"{PEAK_FORCE} N an axis",
    ),
    NeedTerm(
        "delay",
        lambda scene: device_of(scene).delay > 0.0 or scene.launch.run.apply == "next_tick",
        _without_delay,
        lambda scene: with_device(scene, delay=RESPONSE / scene.launch.run.period),
        f"{1e6 * RESPONSE:g} µs",
    ),
    NeedTerm("hand", _has("hand"), _set(hand=None)),
    NeedTerm(
        "axes",
        _has("axes"),
        _set(axes={}),
        _uneven,
        ", ".join(f"{axis} {part:g} times as heavy" for axis, part in _UNEVEN.items()),
        "alike along all axes",
    ),
    NeedTerm(
        "guard",
        lambda scene: _driver(scene).passivity is not None,
        _node("sim_driver", lambda _: {"passivity": None}),
    ),
    NeedTerm("limit", _limited("peak_force"), _unlimited("peak_force")),
    NeedTerm("slew", _limited("slew"), _unlimited("slew")),
    NeedTerm("workspace", _limited("workspace"), _unlimited("workspace")),
    NeedTerm(
        "contact",
        lambda scene: bool(scene.shapes),
        lambda scene: _surface(lambda _: {"kind": "free"})(scene)._replace(solids=None),
    ),
    NeedTerm(
        "shape",
        lambda scene: any(solid.kind != PLANE for solid in scene.shapes) or len(scene.shapes) > 1,
        _one_face,
        simpler="the plane that touches it",
    ),
    NeedTerm(
        "triangles",
        lambda scene: any(solid.kind == MESH for solid in scene.shapes),
        _coarser,
        simpler="half as many at most",
    ),
    NeedTerm(
        "surface_friction",
        lambda scene: any(solid.friction != SLIPPERY for solid in scene.shapes),
        _rubbed(SLIPPERY),
        _rubbed(ROUGH),
        f"{ROUGH.static}",
    ),
    NeedTerm(
        "tool_radius",
        lambda scene: bool(scene.shapes) and _tool_radius(scene) > 0.0,
        _surface(lambda given: {**given, "tool_radius": 0.0}),
        simpler="a point",
    ),
    NeedTerm(
        "bodies",
        _is_meant("mujoco", "bodies", "dynamic"),
        _node("mujoco", lambda _: {"bodies": "fixed"}),
        simpler="held where they are",
    ),
)


def _flip(name: str, usual: Any, other: Any) -> Edit:
    return _node(
        "coupling", lambda given: {name: other if given.get(name, usual) == usual else usual}
    )


# What must be one way or the other, for scenes with several axes.
SPATIAL_CONVENTIONS: dict[str, Edit] = {
    "clamp": _flip("clamp", True, False),
    "history rule": _flip("history", "penetration", "position"),
}
