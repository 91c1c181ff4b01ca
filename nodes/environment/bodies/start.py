"""Start of a scene: its file, or a keyframe; and controls of its actuators.

A keyframe of a file without a tool grows with the tool that is added: MuJoCo resizes it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, TypeAlias

import msgspec
import numpy as np

from nodes.parameters.refusals import choices
from nodes.parameters.store import ParameterError

Keyframe: TypeAlias = str | Annotated[int, msgspec.Meta(ge=0)]
# largest control of an actuator without ctrlrange, MuJoCo's own limit
LARGEST_CONTROL = 1e10


class ControlParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Controls of actuators that a scene accepts from outside.

    age: Time without new controls after which those of the start return [s].
    """

    age: Annotated[float, msgspec.Meta(gt=0.0, le=1e4)] = 0.1


def key_of(mujoco: Any, model: Any, keyframe: Keyframe | None, where: str) -> int:
    """Return the number of a keyframe of a scene, -1 for None.

    Raises ParameterError if the scene has no such keyframe.
    """
    if keyframe is None:
        return -1
    names = [model.key(i).name or str(i) for i in range(model.nkey)]
    if isinstance(keyframe, int):
        found = keyframe if keyframe < model.nkey else -1
    else:
        found = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, keyframe)
    if found < 0:
        raise ParameterError(
            f"no keyframe {keyframe!r}; the scene has {', '.join(names) or 'none'}",
            path=f"{where}.keyframe",
        )
    return int(found)


def reset(mujoco: Any, model: Any, data: Any, key: int) -> None:
    """Reset a scene to keyframe `key`, or to its file's state for -1."""
    if key < 0:
        mujoco.mj_resetData(model, data)
    else:
        mujoco.mj_resetDataKeyframe(model, data, key)


def fix_bodies(
    mujoco: Any, spec: Any, keyframe: Keyframe | None, tool: str, where: str
) -> None:
    """Fix all bodies but the tool where a scene starts: delete their joints from `spec`."""
    model = spec.compile() if keyframe is not None else None
    if model is not None:
        data = mujoco.MjData(model)
        reset(mujoco, model, data, key_of(mujoco, model, keyframe, where))
        mujoco.mj_kinematics(model, data)
    for body in spec.bodies:
        line = body
        while line is not None and line.name not in (tool, "world"):
            line = line.parent
        if line is not None and line.name == tool:
            continue
        if model is not None and body.name != "world" and list(body.joints):
            _move_to(mujoco, body, data)
        for joint in body.joints:
            spec.delete(joint)
    _delete_drives(mujoco, spec)
    for key in list(spec.keys):  # of joints that are gone
        spec.delete(key)


def _delete_drives(mujoco: Any, spec: Any) -> None:
    """Delete sensors, and what would move deleted joints: tendons, motors, couplings."""
    left = {joint.name for body in spec.bodies for joint in body.joints}
    of_joints = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
    couplings = (mujoco.mjtEq.mjEQ_JOINT, mujoco.mjtEq.mjEQ_TENDON)
    drives = [
        one
        for one in spec.actuators
        if one.trntype == mujoco.mjtTrn.mjTRN_TENDON
        or (one.trntype in of_joints and one.target not in left)
    ]
    drives += [one for one in spec.equalities if one.type in couplings]
    for one in (*spec.sensors, *drives, *spec.tendons):
        spec.delete(one)


def _move_to(mujoco: Any, body: Any, data: Any) -> None:
    """Move a body to its pose relative to its parent in `data`."""
    at = body.id
    parent = body.parent.id
    back, turn, place = np.zeros(4), np.zeros(4), np.zeros(3)
    mujoco.mju_negQuat(back, data.xquat[parent])
    mujoco.mju_mulQuat(turn, back, data.xquat[at])
    mujoco.mju_rotVecQuat(place, data.xpos[at] - data.xpos[parent], back)
    body.pos, body.quat = place, turn


def controls_of(model: Any, given: Any, where: str) -> dict[int, float]:
    """Return controls by actuator number, from a mapping of names or a list of all.

    Raises ParameterError with the actuators of the scene if one does not fit.
    """
    names = [model.actuator(i).name or str(i) for i in range(model.nu)]
    if not names:
        raise ParameterError("the scene has no actuators", path=f"{where}.controls")
    if isinstance(given, Mapping):
        unknown = next((name for name in given if str(name) not in names), None)
        if unknown is not None:
            raise ParameterError(
                f"no actuator {unknown!r}; {choices(str(unknown), names)}",
                path=f"{where}.controls",
            )
        found = {names.index(str(name)): value for name, value in given.items()}
    elif isinstance(given, list | tuple) and len(given) == len(names):
        found = dict(enumerate(given))
    else:
        raise ParameterError(
            f"{given!r}, expected a mapping of actuators to numbers, or"
            f" {len(names)} numbers, for {', '.join(names)}",
            path=f"{where}.controls",
        )
    for at, value in found.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ParameterError(
                f"{value!r} is no number", path=f"{where}.controls.{names[at]}"
            )
        if not (math.isfinite(value) and abs(value) <= LARGEST_CONTROL):
            raise ParameterError(
                f"{value!r}, expected at most {LARGEST_CONTROL:g}",
                path=f"{where}.controls.{names[at]}",
            )
    return {at: float(value) for at, value in found.items()}
