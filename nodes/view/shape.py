"""Shape of a scene in 3D: triangles of its parts, sent once; poses come per frame."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from nodes.base.setup import AXIS_INDEX
from nodes.environment.shapes.touchable import Touchable
from nodes.environment.surfaces import Surface, parse_surface
from nodes.view.tessellation import Patch, geom_patch, patch_of, plane_patch

if TYPE_CHECKING:
    from nodes.environment.bodies.moving_scene import MovingScene

_NO_COLOUR = (0.5, 0.5, 0.5, 1.0)  # the engine's own for a geom without a colour
_UNSEEN = 0.02  # opacity below which a geom is not drawn


def patches_of(parameters: Mapping[str, Any]) -> list[Patch]:
    """Return the triangles of each solid of an environment's surface; none if it is free."""
    return _patches(
        parse_surface(parameters.get("surface", {"kind": "free"}), "surface")
    )


def _patches(surface: Surface) -> list[Patch]:
    if isinstance(surface, Touchable):
        return [patch_of(solid) for solid in surface.solids("surface")]
    axis = getattr(surface, "axis", None)
    position = getattr(surface, "position", None)
    if axis is None or position is None:
        return []
    point = np.zeros(3)
    normal = np.zeros(3)
    point[AXIS_INDEX[axis]] = float(position)
    normal[AXIS_INDEX[axis]] = float(getattr(surface, "normal", 1.0))
    return [plane_patch(point, normal)]


def tool_radius_of(parameters: Mapping[str, Any]) -> float:
    """Return the radius of the ball that touches an environment's surface [m]."""
    surface = parse_surface(parameters.get("surface", {"kind": "free"}), "surface")
    return surface.tool_radius if isinstance(surface, Touchable) else 0.0


def shape_of(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return the shape of an environment's surface; empty if nothing is visible.

    Returns
    -------
    dict
        ``parts``: one per solid, see `_part`; ``tool_radius`` [m]; ``friction``, the largest
        coefficient.

    Raises
    ------
    ParameterError
        As the surface raises it.
    """
    surface = parse_surface(parameters.get("surface", {"kind": "free"}), "surface")
    if not isinstance(surface, Touchable):
        drawn = [_part(patch) for patch in _patches(surface)]
        return {"parts": drawn, "tool_radius": 0.0, "friction": 0.0} if drawn else {}
    solids = surface.solids("surface")
    moving = [solid.motion is not None for solid in solids]
    numbers = np.cumsum(moving) - 1
    parts = [
        _part(patch_of(solid), pose=int(number) if moves else -1)
        for solid, number, moves in zip(solids, numbers, moving, strict=True)
    ]
    return {
        "parts": parts,
        "tool_radius": surface.tool_radius,
        "friction": max(solid.friction.static for solid in solids),
    }


def moves(shape: Mapping[str, Any]) -> bool:
    """Return whether a shape has parts that move."""
    return any(part["pose"] >= 0 for part in shape.get("parts", []))


def bodies_of(world: MovingScene) -> dict[str, Any]:
    """Return the parts of a scene with moving bodies, each in its geom's frame.

    The pose of each is that of its geom.
    """
    import mujoco

    model = world.model
    parts = []
    for i in range(model.ngeom):
        material = int(model.geom_matid[i])
        rgba = (
            model.geom_rgba[i] if material < 0 else model.mat_rgba[material]
        ).tolist()
        patch = geom_patch(model, i, mujoco.mjtGeom)
        if patch is None or rgba[3] < _UNSEEN:
            continue
        body = int(model.geom_bodyid[i])
        is_given = not np.allclose(rgba, _NO_COLOUR, atol=1e-3)
        parts.append(
            _part(
                patch,
                pose=i,
                name=model.geom(i).name or model.body(body).name,
                tool=int(model.body_rootid[body]) == world.tool,
                colour=[round(one, 3) for one in rgba[:3]] if is_given else None,
            )
        )
    return {"parts": parts, "bodies": True, "tool_radius": 0.0, "friction": 0.0}


def _part(
    patch: Patch,
    pose: int = -1,
    name: str = "",
    tool: bool = False,
    colour: Sequence[float] | None = None,
) -> dict[str, Any]:
    """Return a part as a page reads it.

    ``points`` [m] as float32 and ``faces`` as uint16 or uint32, little endian in base64; ``pose``:
    its place among the poses, −1 for a part that stays; ``closed``: whether its inside is never
    seen; ``colour``: red, green and blue of 1, or
    None for the page's own.
    """
    small = len(patch.points) <= 1 << 16
    faces = patch.faces.astype("<u2" if small else "<u4")
    return {
        "name": name,
        "tool": tool,
        "pose": pose,
        "flat": patch.flat,
        "closed": patch.closed,
        "colour": colour,
        "points": base64.b64encode(patch.points.astype("<f4").tobytes()).decode(),
        "faces": base64.b64encode(faces.tobytes()).decode(),
        "wide": not small,
    }
