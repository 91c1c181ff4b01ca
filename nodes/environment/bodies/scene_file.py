"""Read a MuJoCo scene: its file, its tool, and values that MuJoCo accepts but cannot step."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from nodes.environment.bodies.start import Keyframe, fix_bodies
from nodes.environment.bodies.tool import AXES, ToolParameters, add_tool
from nodes.parameters.store import ParameterError

EXTRA = "pip install 'haptic-nodes[mujoco]'"
LARGEST = 64_000_000  # largest MJCF file [bytes]

HEAVIEST = 1e6  # largest mass of a body [kg]
LARGEST_NUMBER = 1e10  # largest number in a scene, MuJoCo's own limit

_NUMBERS = (  # of a model: with one that is none the scene diverges at its first step
    *(
        "gravity",
        "body_inertia",
        "body_pos",
        "geom_size",
        "geom_pos",
        "qpos0",
        "qpos_spring",
    ),
    *("jnt_stiffness", "dof_damping", "dof_armature", "dof_frictionloss"),
)


def load_mujoco(where: str) -> Any:
    """Return the module mujoco, or raise ParameterError with how to install it."""
    try:
        import mujoco
    except ImportError as error:
        raise ParameterError(
            f"{error}; install it with: {EXTRA}", path=where
        ) from error
    return mujoco


def read_scene(
    mujoco: Any,
    file: Path,
    tool: ToolParameters,
    held: bool,
    keyframe: Keyframe | None,
    where: str,
) -> Any:
    """Return the model of a scene with its tool; with `held`, all other bodies are fixed.

    Raises ParameterError if the scene cannot be loaded or stepped.
    """
    if file.exists() and not (file.is_file() or file.is_dir()):
        # Reading a pipe would block, and a device has no end.
        raise ParameterError(f"{file} is not a regular file", path=f"{where}.scene")
    try:
        # Opened here because the operating system's message is clearer than MuJoCo's.
        with open(file, "rb") as opened:
            size = opened.seek(0, os.SEEK_END)
    except OSError as error:
        raise ParameterError(
            f"{file} cannot be read: {error.strerror}", path=f"{where}.scene"
        ) from error
    if size > LARGEST:
        raise ParameterError(
            f"{file} has {size / 1e6:.0f} MB, more than {LARGEST / 1e6:.0f};"
            " meshes and textures belong in files of their own",
            path=f"{where}.scene",
        )
    try:
        with _heard(mujoco) as warnings:
            model = _model(mujoco, file, tool, held, keyframe, where)
    except ParameterError:
        raise  # of another parameter than the file
    except ValueError as error:
        raise ParameterError(
            f"{file}: {' '.join(str(error).split())}", path=f"{where}.scene"
        ) from error
    if warnings:
        # MuJoCo would continue without the value: a mass of NaN becomes that of water.
        raise ParameterError(
            f"{file}: {' '.join(' '.join(warnings).split())}", path=f"{where}.scene"
        )
    _refuse_odd_numbers(model, file, where)
    return model


def _refuse_odd_numbers(model: Any, file: Path, where: str) -> None:
    """Reject values that MuJoCo accepts but cannot step."""
    step = float(model.opt.timestep)
    if not (math.isfinite(step) and step > 0.0):
        raise ParameterError(
            f"{file}: option timestep is {step:g} s, expected a time above 0",
            path=f"{where}.scene",
        )
    for i in range(1, model.nbody):
        mass = float(model.body_mass[i])
        if not mass <= HEAVIEST:
            raise ParameterError(
                f"{file}: body {model.body(i).name!r} weighs {mass:g} kg,"
                f" expected at most {HEAVIEST:g} kg",
                path=f"{where}.scene",
            )
    for name in _NUMBERS:
        values = (
            getattr(model.opt if name == "gravity" else model, name).ravel().tolist()
        )
        odd = next(
            (value for value in values if not abs(value) <= LARGEST_NUMBER), None
        )
        if odd is not None:
            raise ParameterError(
                f"{file}: a number of {name} is {odd:g}, expected at most {LARGEST_NUMBER:g}",
                path=f"{where}.scene",
            )


def find_tool(
    mujoco: Any, model: Any, tool: str, file: Path, where: str
) -> tuple[int, list[int]]:
    """Return the body of the tool, and the places of its three joints in the positions."""
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, tool)
    if body < 0:
        names = [model.body(i).name for i in range(1, model.nbody)]
        raise ParameterError(
            f"no body {tool!r} in {file}; its bodies are"
            f" {', '.join(names) or 'none'}; {where}.tool: {{mass: 0.05, radius: 0.005}}"
            " adds one",
            path=f"{where}.tool",
        )
    first = int(model.body_jntadr[body])
    count = int(model.body_jntnum[body])
    kind = mujoco.mjtJoint.mjJNT_SLIDE
    slides = [
        i
        for i in range(first, first + count)
        if model.jnt_type[i] == kind and not model.jnt_limited[i]
    ]
    axes = [tuple(model.jnt_axis[i].tolist()) for i in slides]
    if count != 3 or axes != list(AXES) or model.body_parentid[body] != 0:
        raise ParameterError(
            f"body {tool!r} must be a child of the world with three slide joints"
            " without limits, along x, y and z: the device has three axes, and its own"
            f" workspace; or {where}.tool: {{body: NAME, mass: 0.05}} adds one",
            path=f"{where}.tool",
        )
    return body, [int(model.jnt_qposadr[i]) for i in slides]


@contextlib.contextmanager
def _heard(mujoco: Any) -> Iterator[list[str]]:
    """Collect MuJoCo's warnings, which it would print to the terminal."""
    found: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(found.append)
    try:
        yield found
    finally:
        mujoco.set_mju_user_warning(before)


def _model(
    mujoco: Any,
    file: Path,
    tool: ToolParameters,
    held: bool,
    keyframe: Keyframe | None,
    where: str,
) -> Any:
    """Load a scene, add or damp its tool, and with `held` delete the joints of other bodies."""
    if tool.mass is None and tool.damping is None and not held:
        return mujoco.MjModel.from_xml_path(str(file))
    spec = mujoco.MjSpec.from_file(str(file))
    add_tool(mujoco, spec, tool, f"{where}.tool")
    if held:
        fix_bodies(mujoco, spec, keyframe, tool.body, where)
    return spec.compile()
