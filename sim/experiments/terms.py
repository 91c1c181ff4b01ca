"""The model terms of a scene and how to switch each off or on: one list for all scenes.

Off means that the term does not exist (None, not a small number); on means the value of a Touch X
or a typical loop. A term is declared, left out on purpose (``model.leaves_out`` of the launch
file), or absent.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from nodes.environment.shapes.scene import SLIPPERY, WHOLE, Friction
from nodes.environment.shapes.tables import MESH, PLANE
from sim.experiments import term_scene as of
from sim.experiments.term_scene import Ask, Edit, TermScene

# Touch X: resolution and peak force from the data sheet, friction from memory (THEORY.md §4); the
# response time is the median of four processes on one ordinary machine.
RESOLUTION, FRICTION, PEAK_FORCE, GRAVITY, RESPONSE = 2.3e-5, 0.06, 7.9, 9.81, 250e-6
ROUGH = Friction(0.3, 0.3)  # roughly a smooth hard surface under a hard tip
# Mass along the other axes relative to the first: roughly an arm with its motors on the base.
UNEVEN = {"y": 1.5, "z": 2.0}


@dataclass(frozen=True)
class NeedTerm:
    """One model term."""

    name: str  # as in ``model.leaves_out``
    declared: Ask  # returns whether a scene has the term
    without: Edit  # returns the scene without the term
    # Returns the scene with a typical value; None where adding it would change the scene
    # itself.
    typical: Edit | None = None
    value: str = ""  # that value, as text
    simpler: str = ""  # replacement when the term is off, as text; empty for none


def _weighed(scene: TermScene) -> TermScene:
    return of.with_device(scene, gravity=GRAVITY) if "z" in scene.axes else scene


def _uneven(scene: TermScene) -> TermScene:
    mass = of.devices(scene)[0].mass
    others = {
        axis: {"mass": part * mass}
        for axis, part in UNEVEN.items()
        if axis in scene.axes[1:]
    }
    return of.with_device(scene, axes=others)


def _is_shaped(scene: TermScene) -> bool:
    return any(solid.kind != PLANE for solid in scene.shapes) or len(scene.shapes) > 1


# All terms; ``memory`` is the older half of the longest law's taps.
TERMS: tuple[NeedTerm, ...] = (
    NeedTerm(
        "gravity",
        of.has("gravity"),
        of.set_to(gravity=None),
        _weighed,
        f"{GRAVITY} m/s² on a vertical axis",
    ),
    NeedTerm("damping", of.has("damping"), of.set_to(damping=0.0)),
    NeedTerm(
        "friction",
        of.has("friction"),
        of.set_to(friction=None),
        of.set_to(friction=FRICTION),
        f"{FRICTION} N an axis",
    ),
    NeedTerm(
        "resolution",
        of.has("resolution"),
        of.set_to(resolution=None),
        of.set_to(resolution=RESOLUTION),
        f"{RESOLUTION:g} m",
    ),
    NeedTerm(
        "peak_force",
        of.has("peak_force"),
        of.set_to(peak_force=None),
        of.set_to(peak_force=PEAK_FORCE),
        f"{PEAK_FORCE} N an axis",
    ),
    NeedTerm(
        "delay",
        of.delayed,
        of.without_delay,
        lambda scene: of.with_device(scene, delay=RESPONSE / scene.launch.run.period),
        f"{1e6 * RESPONSE:g} µs",
    ),
    NeedTerm("hand", of.has("hand"), of.let_go),
    NeedTerm(
        "axes",
        of.has("axes"),
        of.set_to(axes={}),
        _uneven,
        ", ".join(f"{axis} {part:g} times as heavy" for axis, part in UNEVEN.items()),
        "alike along all axes",
    ),
    NeedTerm("guard", of.guard_on, of.unguarded),
    NeedTerm("limit", of.limited("peak_force"), of.unlimited("peak_force")),
    NeedTerm("slew", of.limited("slew"), of.unlimited("slew")),
    NeedTerm("workspace", of.limited("workspace"), of.unlimited("workspace")),
    NeedTerm(
        "contact", lambda scene: of.meets(scene).get("kind") != "free", of.untouched
    ),
    NeedTerm("shape", _is_shaped, of.one_face, simpler="the plane that touches it"),
    NeedTerm(
        "triangles",
        lambda scene: any(solid.kind == MESH for solid in scene.shapes),
        of.coarser,
        simpler="half as many at most",
    ),
    NeedTerm(
        "surface_friction",
        lambda scene: any(solid.friction != SLIPPERY for solid in scene.shapes),
        of.reshaped(friction=SLIPPERY),
        of.reshaped(friction=ROUGH),
        f"{ROUGH.static}",
    ),
    NeedTerm(
        "factors",
        lambda scene: any(solid.factors != WHOLE for solid in scene.shapes),
        of.reshaped(factors=WHOLE),
        simpler="the whole law on every shape",
    ),
    NeedTerm(
        "motion",
        lambda scene: any(solid.motion is not None for solid in scene.shapes),
        of.reshaped(motion=None),
        simpler="shapes that stay where they begin",
    ),
    NeedTerm(
        "regions",
        lambda scene: bool(scene.crossed) and scene.has_regions,
        lambda scene: scene._replace(has_regions=False),
    ),
    NeedTerm("field", of.in_field, of.without_field),
    NeedTerm(
        "tool_radius",
        lambda scene: of.tool_radius(scene) > 0.0,
        lambda scene: of.with_surface(scene, {**of.meets(scene), "tool_radius": 0.0}),
        simpler="a point",
    ),
    NeedTerm("bodies", of.bodies_move, of.held, simpler="held where they are"),
    NeedTerm(
        "memory",
        lambda scene: of.longest(scene) > of.SHORTEST,
        lambda scene: scene._replace(shortened=True),
        simpler="the newer half of the taps",
    ),
)
# A choice of one of two where contact has an outside: never superfluous or missing, but
# informative.
CONVENTIONS: Mapping[str, Edit] = {
    "clamp": of.flipped("clamp", True, False),
    "history rule": of.flipped("history", "penetration", "position"),
}
# Terms that may only matter together (buzz at rest, THEORY.md §5).
TOGETHER: tuple[tuple[str, str], ...] = (("friction", "resolution"),)
# Limits of a device: never superfluous merely because a stable loop does not reach them.
PROTECTS = frozenset({"limit", "slew", "workspace"})
# terms that the running processes add, whether or not the scene declares them
BROUGHT = frozenset({"delay"})
