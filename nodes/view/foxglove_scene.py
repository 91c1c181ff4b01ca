"""The 3D scene for Foxglove and Lichtblick, live or in a recording with ``/scene``.

The scene is Foxglove's ``foxglove.SceneUpdate`` as JSON: the surface once, as triangles, then
device, proxy and force, at most 60 times a second. A recording does not contain moving bodies:
their scene is stepped again as the node did, if MuJoCo and the scene file are available.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from messages.topics import DEVICE_STATE, PROXY, message_type
from messages.types import DeviceState, Event, Proxy, Vector
from nodes.parameters.store import ParameterError
from nodes.recording.facts import parameters_of, period_of, refuse_foreign_files
from nodes.recording.reader import Recording
from nodes.recording.recover import Copy
from nodes.recording.writer import RecordError, mcap_writer, written
from nodes.view.drawn_bodies import RecordedBodies, met_ticks, scene_changes
from nodes.view.shape import patches_of, tool_radius_of
from nodes.view.tessellation import Patch

SCENE, FRAME = "/scene", "haptic"

RATE_LIMIT = 60.0  # scene updates per second of the run [1/s]
# Ticks that may be missed before moving bodies are first stepped: no hand has reached them yet.
LATE = 50
DEFAULT_PERIOD = 0.002  # sampling period if the manifest has none [s]
PER_NEWTON = 0.01  # drawn length of a force [m/N]
_SMALLEST = 0.001
_UNSEEN = "surface.friction"  # parameters of a surface that change no picture
_NO_TURN = (0.0, 0.0, 0.0, 1.0)
_LISTS = (
    "arrows",
    "cubes",
    "spheres",
    "cylinders",
    "lines",
    "triangles",
    "texts",
    "models",
    "metadata",
)

_TIME = {
    "type": "object",
    "properties": {"sec": {"type": "integer"}, "nsec": {"type": "integer"}},
}
_ENTITY = {
    "type": "object",
    "properties": {
        "timestamp": _TIME,
        "frame_id": {"type": "string"},
        "id": {"type": "string"},
        "lifetime": _TIME,
        "frame_locked": {"type": "boolean"},
        **{name: {"type": "array", "items": {"type": "object"}} for name in _LISTS},
    },
    "required": ["timestamp", "frame_id", "id", "lifetime", "frame_locked", *_LISTS],
}
SCHEMA: dict[str, Any] = {  # the part of Foxglove's schema that is used here
    "title": "foxglove.SceneUpdate",
    "type": "object",
    "properties": {
        "deletions": {"type": "array", "items": {"type": "object"}},
        "entities": {"type": "array", "items": _ENTITY},
    },
    "required": ["deletions", "entities"],
}

_STATE: msgspec.json.Decoder[DeviceState | Proxy] = msgspec.json.Decoder(DeviceState)
_EVENT: msgspec.json.Decoder[Event] = msgspec.json.Decoder(Event)
_PROXY: msgspec.json.Decoder[DeviceState | Proxy] = msgspec.json.Decoder(Proxy)

# Okabe and Ito's sky blue, orange, green, and grey: colour-blind safe, as in the figures.
_SURFACE = {"r": 0.34, "g": 0.71, "b": 0.91, "a": 0.6}
_DEVICE = {"r": 0.3, "g": 0.3, "b": 0.3, "a": 1.0}
_TOOL = {"r": 0.9, "g": 0.62, "b": 0.0, "a": 1.0}
_FORCE = {"r": 0.0, "g": 0.62, "b": 0.45, "a": 1.0}


def _point(place: Any) -> dict[str, float]:
    x, y, z = (float(value) for value in place)
    return {"x": x, "y": y, "z": z}


def _pose(place: Any, turn: Any = _NO_TURN) -> dict[str, Any]:
    return {
        "position": _point(place),
        "orientation": dict(zip("xyzw", map(float, turn), strict=True)),
    }


def _entity(at: int, name: str, **primitives: list[dict[str, Any]]) -> dict[str, Any]:
    stamp = {"sec": at // 10**9, "nsec": at % 10**9}
    none: dict[str, list[dict[str, Any]]] = {kind: [] for kind in _LISTS}
    # A lifetime of 0 lasts until the next entity with this name.
    whole = {
        "timestamp": stamp,
        "frame_id": FRAME,
        "id": name,
        "lifetime": {"sec": 0, "nsec": 0},
        "frame_locked": False,
    }
    return {**whole, **none, **primitives}


def _ball(place: Any, radius: float, colour: dict[str, float]) -> dict[str, Any]:
    return {
        "pose": _pose(place),
        "size": _point([2.0 * max(radius, _SMALLEST)] * 3),
        "color": colour,
    }


def _surface(at: int, name: str, patches: Sequence[Patch]) -> dict[str, Any]:
    drawn = [
        {
            "pose": _pose((0.0, 0.0, 0.0)),
            "points": [_point(point) for point in np.round(patch.points, 6).tolist()],
            "color": _SURFACE,
            "colors": [],
            "indices": patch.faces.ravel().tolist(),
        }
        for patch in patches
    ]
    return _entity(at, name, triangles=drawn)


class _Bodies(RecordedBodies):
    """Geoms of a scene with moving bodies, for Foxglove."""

    def entity(self, at: int, name: str) -> dict[str, Any]:
        """Return an entity with all geoms of simple kinds."""
        import mujoco

        model = self.world.model
        data = self.world.data
        kinds = mujoco.mjtGeom
        found: dict[str, list[dict[str, Any]]] = {
            "cubes": [],
            "spheres": [],
            "cylinders": [],
        }
        turn = np.empty(4)
        for i in range(model.ngeom):
            mujoco.mju_mat2Quat(turn, data.geom_xmat[i])
            size = model.geom_size[i].tolist()
            kind = kinds(int(model.geom_type[i]))
            drawn = {
                "pose": _pose(data.geom_xpos[i], (*turn[1:], turn[0])),
                "color": _SURFACE,
            }
            if kind == kinds.mjGEOM_BOX:
                found["cubes"].append(
                    {**drawn, "size": _point([2.0 * side for side in size])}
                )
            elif kind == kinds.mjGEOM_PLANE:
                found["cubes"].append(
                    {
                        **drawn,
                        "size": _point(
                            [2.0 * (size[0] or 1.0), 2.0 * (size[1] or 1.0), 1e-4]
                        ),
                    }
                )
            elif kind == kinds.mjGEOM_SPHERE:
                found["spheres"].append({**drawn, "size": _point([2.0 * size[0]] * 3)})
            elif kind in (kinds.mjGEOM_CYLINDER, kinds.mjGEOM_CAPSULE):
                whole = [2.0 * size[0], 2.0 * size[0], 2.0 * size[1]]
                found["cylinders"].append(
                    {
                        **drawn,
                        "size": _point(whole),
                        "bottom_scale": 1.0,
                        "top_scale": 1.0,
                    }
                )
        return _entity(at, name, **found)


class DrawnScene:
    """Builds the scene's entities for all chains of a run, live or recorded.

    For a recording, only positions that reached the environment step its bodies.
    """

    def __init__(
        self,
        nodes: Mapping[str, Mapping[str, Any]],
        period: float,
        recording: Recording | None = None,
    ) -> None:
        self.left_out: list[str] = []  # what cannot be drawn, and why
        self._replaced: set[str] = set()  # environments whose surface was replaced
        self._surfaces: dict[str, list[Patch]] = {}
        self._radius: dict[str, float] = {}
        self._bodies: dict[str, _Bodies] = {}
        self._next: dict[str, float] = {}
        for node, parameters in nodes.items():
            chain = node.rpartition("/")[0]
            try:
                if recording is not None and (
                    "surface" in parameters or "scene" in parameters
                ):
                    refuse_foreign_files(recording, parameters, node)
                if "surface" in parameters:
                    self._surfaces[node] = patches_of(parameters)
                    self._radius[chain] = tool_radius_of(parameters)
                elif "scene" in parameters:
                    topic = f"/{chain}{PROXY}" if chain else PROXY
                    met = None
                    changes = []
                    if recording is not None:
                        met = met_ticks(recording, topic)
                        changes = scene_changes(recording, node)
                    self._bodies[chain] = _Bodies(
                        dict(parameters), period, node, met, changes
                    )
            except (ParameterError, RecordError, OSError) as error:
                self.left_out.append(f"{node}: {error}")

    def still(self, at: int) -> list[dict[str, Any]]:
        """Return the static entities and the text about omissions, at a time [ns]."""
        drawn = [
            _surface(at, node, found)
            for node, found in self._surfaces.items()
            if found or node in self._replaced
        ]
        return [*drawn, *self._words(at)]

    def replace(self, node: str, parameters: Mapping[str, Any]) -> None:
        """Replace the surface of environment `node`; `still` draws it from then on."""
        self._replaced.add(node)
        self._surfaces[node] = patches_of(parameters)
        self._radius[node.rpartition("/")[0]] = tool_radius_of(parameters)

    def forget(self, event: Event, at: int) -> list[dict[str, Any]]:
        """Return the entities after a recorded replacement, whose surface is not recorded."""
        node = event.node
        paths = re.findall(r"surface[.\w\[\]]*", event.reason)
        looks_the_same = paths and all(path.startswith(_UNSEEN) for path in paths)
        if node not in self._surfaces or looks_the_same:
            return []
        self._replaced.add(node)
        self._surfaces[node] = []
        self.left_out.append(
            f"{node}: its surface was replaced at {event.stamp:.1f} s; a recording has only the"
            " first one"
        )
        return self.still(at)

    def _words(self, at: int) -> list[dict[str, Any]]:
        return (
            [_entity(at, "left out", texts=[_text("; ".join(self.left_out))])]
            if self.left_out
            else []
        )

    def moving(
        self, topic: str, message: DeviceState | Proxy, at: int
    ) -> Iterator[dict[str, Any]]:
        """Yield the moving entities due for a message at a time [ns]; needs every state."""
        chain = topic.removesuffix(DEVICE_STATE).removesuffix(PROXY).strip("/")
        before = f"{chain}/" if chain else ""
        if isinstance(message, Proxy):
            if self._is_due(topic, message.stamp):
                yield _entity(
                    at,
                    f"{before}proxy",
                    spheres=[_ball(message.proxy, self._radius.get(chain, 0.0), _TOOL)],
                )
            return
        left_out = len(self.left_out)
        bodies = self._follow(chain, message)
        if len(self.left_out) > left_out:
            yield from self._words(at)
        if self._is_due(topic, message.stamp):
            yield _entity(
                at, f"{before}device", spheres=[_ball(message.position, 0.0, _DEVICE)]
            )
            yield _entity(
                at, f"{before}force", lines=[_line(message.position, message.force)]
            )
            if bodies is not None:
                yield bodies.entity(at, f"{before}bodies")

    def _follow(self, chain: str, state: DeviceState) -> _Bodies | None:
        """Step the bodies of a chain; drop them if the first ticks were missed."""
        bodies = self._bodies.get(chain)
        if bodies is None:
            return None
        if not bodies.asked and state.seq > LATE:
            del self._bodies[chain]
            self.left_out.append(
                f"{chain or 'bodies'}: poses are known only to a view started with the run;"
                " launch it with --view"
            )
            return None
        bodies.follow(state)
        return bodies

    def _is_due(self, topic: str, stamp: float) -> bool:
        """Whether the topic's rate limit allows a message now."""
        if stamp < self._next.get(topic, stamp):
            return False
        self._next[topic] = stamp + 1.0 / RATE_LIMIT - 1e-9
        return True


def _text(text: str) -> dict[str, Any]:
    style = {
        "billboard": True,
        "font_size": 12.0,
        "scale_invariant": True,
        "color": _DEVICE,
    }
    return {"pose": _pose((0.0, 0.0, 0.05)), "text": text, **style}


def _line(begin: Vector, force: Vector) -> dict[str, Any]:
    end = [a + PER_NEWTON * b for a, b in zip(begin, force, strict=True)]
    return {
        "type": 0,
        "pose": _pose((0.0, 0.0, 0.0)),
        "thickness": _SMALLEST,
        "scale_invariant": False,
        "points": [_point(begin), _point(end)],
        "color": _FORCE,
        "colors": [],
        "indices": [],
    }


def export_foxglove(
    recording: Recording, out: str | Path, *, overwrite: bool = False
) -> list[Path]:
    """Write a copy of the recording with its scene.

    Without a surface or bodies the scene contains device, proxy and force.
    """
    out = Path(out)
    if out.exists() and out.samefile(recording.path):
        raise RecordError(f"{out}: is the recording itself; choose another name")
    period = period_of(recording) if "rate_hz" in recording.manifest else DEFAULT_PERIOD
    scene = DrawnScene(parameters_of(recording), period, recording)
    begun = False
    with written(out, overwrite) as output:
        writer = mcap_writer(output)
        copy = Copy(writer, recording.schemas, recording.channels)
        for name, values in recording.metadata.items():
            writer.add_metadata(name, values)
        if scene.left_out:
            writer.add_metadata("scene", {"left_out": "; ".join(scene.left_out)})
        schema = writer.register_schema(
            "foxglove.SceneUpdate", "jsonschema", msgspec.json.encode(SCHEMA)
        )
        channel = writer.register_channel(SCENE, "json", schema)
        for topic, raw, offset in recording.raw():
            copy.message(raw)
            entities = [] if begun else scene.still(raw.publish_time)
            begun = True
            decoder = (
                _STATE
                if topic.endswith(DEVICE_STATE)
                else _PROXY
                if topic.endswith(PROXY)
                else None
            )
            if decoder is not None:
                entities += scene.moving(
                    topic, recording.decode(decoder, raw, offset), raw.publish_time
                )
            if message_type(topic) is Event:
                change = recording.decode(_EVENT, raw, offset)
                if change.kind == "surface":
                    entities += scene.forget(change, raw.publish_time)
            if entities:
                update = msgspec.json.encode({"deletions": [], "entities": entities})
                writer.add_message(channel, raw.log_time, update, raw.publish_time)
        writer.finish()
    return [out]
