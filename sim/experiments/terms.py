"""The terms a scene's model is made of, and how to switch each one off or on.

Off means that the term does not exist (None, not a small number), on means what a Touch X or a
usual loop would bring. A term is declared, left out on purpose (``model.leaves_out`` of the launch
file), or simply not there.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import msgspec

from nodes.laws import CompiledLaw
from sim.device.model import DeviceModel
from sim.play.launched import LaunchedScene
from sim.play.one_axis import SceneSurface

S = TypeVar("S")

Switch = Callable[[LaunchedScene], LaunchedScene]

# Touch X: resolution and peak force from the data sheet, friction from memory (THEORY.md §4); the
# response time is the median of four processes on one ordinary machine.
RESOLUTION, FRICTION, PEAK_FORCE, GRAVITY, RESPONSE = 2.3e-5, 0.06, 7.9, 9.81, 250e-6
_VERTICAL = 2
_SHORTEST = 3


@dataclass(frozen=True)
class NeedTerm(Generic[S]):
    """One term of a model, of whatever describes the scene."""

    name: str  # as in ``model.leaves_out``
    declared: Callable[[S], bool]  # from a scene to whether it has the term
    without: Callable[[S], S]  # from a scene to the same scene without the term
    # From a scene to the same scene with a typical value; None where adding it would make another
    # scene.
    typical: Callable[[S], S] | None = None
    value: str = ""  # that value, for people
    simpler: str = ""  # what the scene has in its place without it, for people; empty for nothing


def _device(scene: LaunchedScene, **changes: object) -> LaunchedScene:
    device: DeviceModel = msgspec.structs.replace(scene.scene.device, **changes)
    return replace(scene, scene=replace(scene.scene, device=device))


def _has(name: str) -> Callable[[LaunchedScene], bool]:
    return lambda scene: getattr(scene.scene.device, name) is not None


def _set(name: str, value: object) -> Switch:
    return lambda scene: _device(scene, **{name: value})


def _driver(**changes: object) -> Switch:
    return lambda scene: replace(scene, scene=replace(scene.scene, **changes))  # type: ignore[arg-type]


def _without_delay(scene: LaunchedScene) -> LaunchedScene:
    return _driver(next_tick=False)(_device(scene, delay=0.0))


def _shortened(scene: LaunchedScene) -> LaunchedScene:
    def half(law: CompiledLaw) -> CompiledLaw:
        return replace(law, taps=law.taps[: max(_SHORTEST, (len(law.taps) + 1) // 2)])

    return replace(
        scene,
        law=half(scene.law),
        swaps=tuple(replace(swap, law=half(swap.law)) for swap in scene.swaps),
    )


def _longest(scene: LaunchedScene) -> int:
    return max(len(law.taps) for law in (scene.law, *(swap.law for swap in scene.swaps)))


# All terms; ``memory`` stands for the older half of the longest law's taps.
TERMS: tuple[NeedTerm[LaunchedScene], ...] = (
    NeedTerm(
        "gravity",
        lambda scene: bool(scene.scene.device.gravity),
        _set("gravity", None),
        lambda scene: _device(scene, gravity=GRAVITY) if scene.axis == _VERTICAL else scene,
        f"{GRAVITY} m/s² on a vertical axis",
    ),
    NeedTerm("damping", lambda scene: scene.scene.device.damping > 0.0, _set("damping", 0.0)),
    NeedTerm(
        "friction",
        _has("friction"),
        _set("friction", None),
        _set("friction", FRICTION),
        f"{FRICTION} N",
    ),
    NeedTerm(
        "resolution",
        _has("resolution"),
        _set("resolution", None),
        _set("resolution", RESOLUTION),
        f"{RESOLUTION:g} m",
    ),
    NeedTerm(
        "peak_force",
        _has("peak_force"),
        _set("peak_force", None),
        _set("peak_force", PEAK_FORCE),
        f"{PEAK_FORCE} N",
    ),
    NeedTerm(
        "delay",
        lambda scene: scene.scene.device.delay > 0.0 or scene.scene.next_tick,
        _without_delay,
        lambda scene: _device(scene, delay=RESPONSE / scene.scene.period),
        f"{1e6 * RESPONSE:g} µs",
    ),
    NeedTerm("hand", _has("hand"), _set("hand", None)),
    NeedTerm(
        "contact",
        lambda scene: scene.scene.surface.kind != "free",
        lambda scene: _driver(surface=SceneSurface("free"))(scene),
    ),
    NeedTerm("limit", lambda scene: scene.scene.peak is not None, _driver(peak=None)),
    NeedTerm("slew", lambda scene: scene.scene.slew is not None, _driver(slew=None)),
    NeedTerm("workspace", lambda scene: scene.scene.workspace is not None, _driver(workspace=None)),
    NeedTerm(
        "guard",
        lambda scene: scene.scene.passivity is not None and scene.scene.passivity.guard == "on",
        _driver(passivity=None),
    ),
    NeedTerm("memory", lambda scene: _longest(scene) > _SHORTEST, _shortened),
)
# What must be one way or the other: never superfluous and never missing, but worth knowing.
CONVENTIONS: dict[str, Switch] = {
    "clamp": lambda scene: replace(scene, scene=replace(scene.scene, clamp=not scene.scene.clamp)),
    "history rule": lambda scene: replace(
        scene, scene=replace(scene.scene, raw=not scene.scene.raw)
    ),
}
# Terms that may only matter together (buzz at rest, THEORY.md §5).
TOGETHER: tuple[tuple[str, str], ...] = (("friction", "resolution"),)
# Limits that a device would have: never superfluous because a stable loop does not meet them.
PROTECTS = frozenset({"limit", "slew", "workspace"})
# what the running processes bring by themselves, whether or not the scene has it
BROUGHT = frozenset({"delay"})
