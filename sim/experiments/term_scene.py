"""A chain of a launch file whose model terms can be switched by edits."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import msgspec
import numpy as np

from nodes.driver.limits import SafetyParameters
from nodes.environment.shapes.scene import FeltRegion, Solid, plane
from nodes.environment.shapes.touchable import TOOL_RADIUS, Touchable
from nodes.environment.surfaces import parse_surface
from nodes.launcher.launch_spec import Launch, NodeSpec
from nodes.laws import CompiledLaw
from nodes.parameters.store import ParameterError, convert
from sim.device.driver import SimDriverParameters
from sim.device.model import DeviceModel
from sim.experiments.detail import decimated
from sim.play.chain import Instead
from sim.play.hops import UNJUDGED, Hops, hops_of
from sim.play.launched import LawsOfRun, laws_of
from sim.play.player import How, play, prepare
from sim.play.trace import ChainTrace

_GRIDS = (48, 24, 16, 12, 8, 6, 4)
SHORTEST = 3  # minimum number of taps of a shortened law


class TermScene(NamedTuple):
    """A chain with optional replacement shapes and optionally halved laws."""

    launch: Launch
    namespace: str
    hops: Hops
    own: tuple[Solid, ...]  # shapes of the launch file
    solids: tuple[Solid, ...] | None = None  # shapes that replace them
    shortened: bool = False
    crossed: tuple[FeltRegion, ...] = ()  # regions of the launch file
    has_regions: bool = True  # whether they are there

    @property
    def shapes(self) -> tuple[Solid, ...]:
        """Shapes in the scene; empty for bodies or a flat surface."""
        return self.own if self.solids is None else self.solids

    @property
    def axes(self) -> list[str]:
        """Axes that the chain computes."""
        return list(self.launch.axes.get(self.namespace) or self.launch.run.axes)

    @property
    def instead(self) -> Instead:
        """Replacements for parts of the launch file."""
        regions = None if self.has_regions else ()
        if not self.shortened:
            return Instead(solids=self.solids, regions=regions)
        laws = self.laws
        swaps = [replace(swap, law=half(swap.law)) for swap in laws.swaps]
        law = half(laws.law)
        return Instead(law=law, swaps=swaps, solids=self.solids, regions=regions)

    @property
    def laws(self) -> LawsOfRun:
        """Laws that render, as in the launch file."""
        return laws_of(self.launch, self.hops)

    def ready(self, how: How) -> Callable[[], ChainTrace]:
        """Return a function that plays the scene, with all checks done."""
        return prepare(self.launch, self.namespace, instead=self.instead, how=how)

    def play(self, how: How = "interpreted") -> ChainTrace:
        """Play the scene."""
        return play(self.launch, self.namespace, instead=self.instead, how=how)

    def parameters(self, name: str) -> dict[str, Any]:
        """Return the parameters of a node, as written."""
        return self.launch.nodes[name].parameters


Edit = Callable[[TermScene], TermScene]
Ask = Callable[[TermScene], bool]


def term_scene(launch: Launch, namespace: str = "") -> TermScene:
    """Return the unchanged chain of a launch."""
    hops = hops_of(launch, namespace)
    spec = launch.nodes[hops.environment]
    own: tuple[Solid, ...] = ()
    crossed: tuple[FeltRegion, ...] = ()
    if spec.kind == "environment":
        where = f"{hops.environment}.surface"
        surface = parse_surface(spec.parameters.get("surface", {"kind": "free"}), where)
        if isinstance(surface, Touchable):
            own, crossed = (tuple(surface.solids(where)), tuple(surface.regions(where)))
    # A switch may change the device or make the loop unstable: play it without judging.
    return with_parameters(
        TermScene(launch, namespace, hops, own, crossed=crossed),
        hops.coupling,
        UNJUDGED,
    )


def half(law: CompiledLaw) -> CompiledLaw:
    """Return a law with the newer half of its taps, at least `SHORTEST`."""
    return replace(law, taps=law.taps[: max(SHORTEST, (len(law.taps) + 1) // 2)])


def longest(scene: TermScene) -> int:
    """Return the number of taps of the longest law that renders."""
    laws = scene.laws
    found = [law if not scene.shortened else half(law) for law in laws.all]
    return max(len(law.taps) for law in found)


def with_node(scene: TermScene, name: str, spec: NodeSpec) -> TermScene:
    """Replace a node."""
    nodes = {**scene.launch.nodes, name: spec}
    return scene._replace(launch=msgspec.structs.replace(scene.launch, nodes=nodes))


def with_parameters(
    scene: TermScene, name: str, changes: Mapping[str, Any]
) -> TermScene:
    """Change parameters of a node."""
    spec = scene.launch.nodes[name]
    changed = {**spec.parameters, **changes}
    return with_node(scene, name, msgspec.structs.replace(spec, parameters=changed))


# -- the device, or both of a pair
_MEMBERS = ("first", "second")


def drivers(scene: TermScene) -> list[SimDriverParameters]:
    """Return the parameters of each virtual device: the driver's, or both pair members'."""
    name = scene.hops.driver
    given = scene.parameters(name)
    if scene.launch.nodes[name].kind != "paired_driver":
        return [convert(given, SimDriverParameters, name)]
    return [
        convert(
            given[which].get("parameters", {}), SimDriverParameters, f"{name}.{which}"
        )
        for which in _MEMBERS
    ]


def devices(scene: TermScene) -> list[DeviceModel]:
    """Return the virtual device, or both of a pair."""
    return [driver.device for driver in drivers(scene)]


def with_drivers(scene: TermScene, changes: list[dict[str, Any]]) -> TermScene:
    """Change driver parameters of each virtual device."""
    name = scene.hops.driver
    if scene.launch.nodes[name].kind != "paired_driver":
        return with_parameters(scene, name, changes[0])
    given = scene.parameters(name)
    changed = {
        which: {
            **given[which],
            "parameters": {**given[which].get("parameters", {}), **change},
        }
        for which, change in zip(_MEMBERS, changes, strict=True)
    }
    return with_parameters(scene, name, changed)


def with_device(scene: TermScene, **changes: Any) -> TermScene:
    """Change fields of the virtual device, or of both of a pair."""
    models = [msgspec.structs.replace(device, **changes) for device in devices(scene)]
    return with_drivers(
        scene,
        [{"device": msgspec.to_builtins(model), "preset": ""} for model in models],
    )


def set_to(**changes: Any) -> Edit:
    """Return the edit that sets fields of the device."""
    return lambda scene: with_device(scene, **changes)


def let_go(scene: TermScene) -> TermScene:
    """Remove the hand, and the page that could drag it."""
    scene = with_device(scene, hand=None)
    return with_drivers(scene, [{"pointer": None} for _ in drivers(scene)])


def has(name: str) -> Ask:
    """Return a predicate: whether a device has a field that is not 0 or empty."""
    return lambda scene: any(bool(getattr(device, name)) for device in devices(scene))


def guard_on(scene: TermScene) -> bool:
    """Return whether the driver guards passivity."""
    passivity = scene.parameters(scene.hops.driver).get("passivity") or {"guard": "off"}
    return bool(passivity.get("guard", "on") == "on")


def unguarded(scene: TermScene) -> TermScene:
    """Remove the guard."""
    return with_parameters(scene, scene.hops.driver, {"passivity": None})


def _own_safety(scene: TermScene) -> SafetyParameters:
    """Return the driver's own safety parameters, or the pair's."""
    name = scene.hops.driver
    if scene.launch.nodes[name].kind != "paired_driver":
        return drivers(scene)[0].safety
    own = scene.parameters(name).get("safety", {})
    safety: SafetyParameters = convert(own, SafetyParameters, f"{name}.safety")
    return safety


def limited(name: str) -> Ask:
    """Return a predicate: whether the driver has a limit of this name."""
    return lambda scene: getattr(_own_safety(scene), name) is not None


def unlimited(name: str) -> Edit:
    """Return the edit that removes a limit, including a virtual device's default."""

    def free(safety: SafetyParameters) -> dict[str, Any]:
        without = sorted({*safety.without, name})
        changed = msgspec.structs.replace(safety, **{name: None, "without": without})
        return {"safety": msgspec.to_builtins(changed)}

    def edit(scene: TermScene) -> TermScene:
        scene = with_drivers(scene, [free(driver.safety) for driver in drivers(scene)])
        return with_parameters(scene, scene.hops.driver, free(_own_safety(scene)))

    return edit


def delayed(scene: TermScene) -> bool:
    """Return whether forces act with a delay."""
    next_tick = scene.launch.run.apply == "next_tick"
    return next_tick or any(device.delay > 0.0 for device in devices(scene))


def without_delay(scene: TermScene) -> TermScene:
    """Remove the delay of forces."""
    scene = with_device(scene, delay=0.0)
    run = msgspec.structs.replace(scene.launch.run, apply="on_arrival")
    return scene._replace(launch=msgspec.structs.replace(scene.launch, run=run))


# -- the environment
def meets(scene: TermScene) -> dict[str, Any]:
    """Return the surface as written; kind ``free`` if the chain has none."""
    free = {"kind": "free"}
    if scene.launch.nodes[scene.hops.environment].kind != "environment":
        return free
    surface: dict[str, Any] = scene.parameters(scene.hops.environment).get(
        "surface", free
    )
    return surface


def has_normal(scene: TermScene) -> bool:
    """Return whether the surface has an outside: only then do contact conventions apply."""
    return meets(scene).get("kind") not in ("free", "anchor")


def with_surface(scene: TermScene, surface: dict[str, Any]) -> TermScene:
    """Replace the chain's surface."""
    return with_parameters(scene, scene.hops.environment, {"surface": surface})


def untouched(scene: TermScene) -> TermScene:
    """Remove the surface."""
    return with_surface(scene, {"kind": "free"})._replace(solids=None)


def tool_radius(scene: TermScene) -> float:
    """Return the tool radius [m]; 0 without shapes."""
    return float(meets(scene).get("tool_radius", TOOL_RADIUS)) if scene.shapes else 0.0


def one_face(scene: TermScene) -> TermScene:
    """Replace the shape by its tangent plane at the deepest point of the path."""
    found = scene.play()
    depth = np.where(
        found.contact, np.linalg.norm(found.proxy - found.measured, axis=1), -1.0
    )
    deepest = int(np.argmax(depth))
    if depth[deepest] < 0.0:
        raise ParameterError(
            "the device touches nothing, so nothing can be said of what it needs",
            path=scene.launch.scenario,
        )
    normal = found.normal[deepest]
    point = found.proxy[deepest] - tool_radius(scene) * normal
    first = scene.shapes[0]
    face = plane(tuple(point.tolist()), tuple(normal.tolist()), first.friction)
    return scene._replace(
        solids=(face._replace(factors=first.factors, motion=first.motion),)
    )


def coarser(scene: TermScene) -> TermScene:
    """Merge vertices of meshes until at most half of the triangles remain."""
    return scene._replace(solids=tuple(_halved(solid) for solid in scene.shapes))


def _halved(solid: Solid) -> Solid:
    if solid.mesh is not None:
        found = (
            made
            for cells in _GRIDS
            for _, made in decimated(solid, cells)
            if not isinstance(made, str)
        )
        for (made,) in found:
            if made.mesh is not None and 2 * len(made.mesh.corners) <= len(
                solid.mesh.corners
            ):
                return made
    return solid


def reshaped(**changes: Any) -> Edit:
    """Return the edit that sets fields of all shapes."""
    return lambda scene: scene._replace(
        solids=tuple(solid._replace(**changes) for solid in scene.shapes)
    )


def in_field(scene: TermScene) -> bool:
    """Return whether a force field by formula acts."""
    field = scene.parameters(scene.hops.coupling).get("field") or {"kind": "none"}
    return bool(field["kind"] != "none")


def without_field(scene: TermScene) -> TermScene:
    """Remove the force field."""
    return with_parameters(scene, scene.hops.coupling, {"field": {"kind": "none"}})


def bodies_move(scene: TermScene) -> bool:
    """Return whether the environment moves: bodies of a MuJoCo scene, or one felt body."""
    spec = scene.launch.nodes[scene.hops.environment]
    return spec.kind == "world" or (
        spec.kind == "mujoco" and spec.parameters.get("bodies", "dynamic") == "dynamic"
    )


def held(scene: TermScene) -> TermScene:
    """Fix all bodies at their start positions."""
    name = scene.hops.environment
    spec = scene.launch.nodes[name]
    if spec.kind == "mujoco":
        return with_parameters(scene, name, {"bodies": "fixed"})
    begin = [0.0, 0.0, 0.0]
    begin["xyz".index(scene.axes[0])] = devices(scene)[0].position
    surface = {"kind": "anchor", "position": spec.parameters.get("position") or begin}
    return with_node(
        scene, name, NodeSpec(kind="environment", parameters={"surface": surface})
    )


def flipped(name: str, usual: Any, other: Any) -> Edit:
    """Return the edit that flips a two-valued parameter of the coupling."""

    def edit(scene: TermScene) -> TermScene:
        now = scene.parameters(scene.hops.coupling).get(name, usual)
        return with_parameters(
            scene, scene.hops.coupling, {name: other if now == usual else usual}
        )

    return edit
