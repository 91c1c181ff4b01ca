"""The tool of a scene: adding or damping it, and measuring its response to a push.

A scene is stepped after the force, so the tool answers late: by 1 − 1/(2n) ticks with n steps of
Euler's method per tick, and by one tick with an exact step. With such a lag, only damping of the
tool to ground makes a loop provably stable, whatever it touches
(`nodes.stability.worlds.SteppedTool`).
"""

from __future__ import annotations

from typing import Annotated, Any, NamedTuple

import msgspec
import numpy as np

from messages.types import ZERO, Vector
from nodes.parameters.checked import NonNegative
from nodes.parameters.store import ParameterError

AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
# Numbers of a joint that a scene's defaults may set.
_OF_DEFAULTS = (
    *("actfrclimited", "actfrcrange", "actgravcomp", "armature", "damping", "limited"),
    *("frictionloss", "margin", "range", "ref", "springdamper", "springref"),
    *("stiffness", "solref_friction", "solimp_friction"),
)
_TICKS = 40  # ticks after the push over which mass and damping are fitted
_SPEED = 1e-3  # speed that the push gives the tool [m/s]


class ToolParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """The tool that the coupling connects to the device.

    body: Name of its body in the scene.
    mass: Mass of a ball that is added as the tool [kg]; None for a body of the scene.
    radius: Radius of that ball [m].
    position: Position until the device's is known [m].
    damping: Viscous damping to ground along each axis [N s/m]; None for the scene's own.
    """

    body: str = "tool"
    mass: Annotated[float, msgspec.Meta(ge=1e-6, le=1e6)] | None = None
    radius: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)] = 0.005
    position: Vector = ZERO
    damping: NonNegative | None = None


class ToolResponse(NamedTuple):
    """Response of a tool to a push of one tick, without contacts, gravity and constraints."""

    mass: float  # [kg]
    damping: float  # to ground, along the axis with the least [N s/m]
    # delay relative to the lossless mass that answers in the same tick [ticks]
    lag: float


def add_tool(mujoco: Any, spec: Any, tool: ToolParameters, where: str) -> None:
    """Add a ball on three slide joints to a scene, or set the damping of an existing tool.

    Parameters
    ----------
    mujoco : module
        MuJoCo.
    spec : MjSpec
        The scene, changed in place.
    tool : ToolParameters
        The wanted tool.
    where : str
        Parameter path of the tool, for errors.

    Raises
    ------
    ParameterError
        If a tool is to be added and the scene has a body of that name.
    """
    body = spec.body(tool.body)
    if tool.mass is not None:
        if body is not None:
            raise ParameterError(
                f"the scene has a body {tool.body!r} already; leave mass out to use"
                f" it, or give another {where}.body",
                path=f"{where}.mass",
            )
        weight = tool.mass / _mass_scale(spec, tool.mass)
        body = spec.worldbody.add_body(
            name=tool.body, pos=list(tool.position), gravcomp=1.0
        )
        for axis in AXES:
            slide = body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=list(axis))
            _set_fresh(mujoco, slide)
        body.add_geom(
            type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[tool.radius, 0.0, 0.0], mass=weight
        )
        # Some scenes take no inertia from shapes; a ball's is 2/5 m r².
        body.mass = weight
        body.inertia = [0.4 * weight * tool.radius**2] * 3
        body.explicitinertial = True
    if tool.damping is not None and body is not None:
        for joint in body.joints:
            joint.damping[0] = tool.damping


def _set_fresh(mujoco: Any, slide: Any) -> None:
    """Free a joint of the scene's defaults: limits, springs and dampers of another mechanism."""
    fresh = mujoco.MjSpec().worldbody.add_body().add_joint(type=slide.type)
    for name in _OF_DEFAULTS:
        if hasattr(fresh, name):
            setattr(slide, name, getattr(fresh, name))


def _mass_scale(spec: Any, mass: float) -> float:
    """Return by what a scene scales all masses; its own total then grows by that of the tool."""
    total = float(spec.compiler.settotalmass)
    if total <= 0.0:
        return 1.0
    unscaled = spec.copy()
    unscaled.compiler.settotalmass = -1.0
    model = unscaled.compile()
    spec.compiler.settotalmass = total + mass
    return total / float(model.body_mass.sum())


def measure_response(
    mujoco: Any, model: Any, body: int, dofs: slice, period: float, steps: int
) -> ToolResponse:
    """Measure a tool's response to a push of one tick along each axis, in separate data.

    p = m v + b y holds at every tick for a push p, whatever the integrator, as long as the damper
    is implicit or exact; mass and damping are its least squares.

    Parameters
    ----------
    mujoco : module
        MuJoCo.
    model : MjModel
        The scene.
    body : int
        The tool.
    dofs : slice
        Its three degrees of freedom.
    period : float
        Sampling period [s].
    steps : int
        Steps of the scene per tick.

    Returns
    -------
    ToolResponse
        Mass, damping and lag.
    """
    disabled = model.opt.disableflags
    found = []
    try:
        # Contacts, dry joint friction and equalities are not properties of the tool itself.
        model.opt.disableflags = (
            disabled
            | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
            | mujoco.mjtDisableBit.mjDSBL_GRAVITY
        )
        mass = float(model.body_subtreemass[body])
        push = mass * _SPEED / period
        ways = [
            _moved(mujoco, model, body, dofs, steps, axis, force)
            for axis in range(3)
            for force in (0.0, push)
        ]
        for still, pushed in zip(ways[::2], ways[1::2], strict=True):
            v, y = (pushed - still).T
            (inertia, damping), *_ = np.linalg.lstsq(
                np.column_stack([v, y]), np.full(len(v), push * period), rcond=None
            )
            # An exact step under a held force lags one tick: y = p T/(2 m) (1 − b T/(3 m)) to
            # second order.
            exact = (
                push
                * period**2
                / (2.0 * inertia)
                * (1.0 - damping * period / (3.0 * inertia))
            )
            found.append(
                (inertia, damping, 1.0 - (y[0] - exact) * inertia / (push * period**2))
            )
    finally:
        model.opt.disableflags = disabled
    masses, dampings, lags = zip(*found, strict=True)
    least = max(min(dampings), 0.0)
    if model.opt.density == 0.0 and model.opt.viscosity == 0.0:
        # Without a fluid only its joints damp the tool to ground; other damping acts between
        # bodies.
        least = min(least, float(model.dof_damping[dofs].min()))
    return ToolResponse(float(np.mean(masses)), least, float(max(lags)))


def _moved(
    mujoco: Any, model: Any, body: int, dofs: slice, steps: int, axis: int, force: float
) -> Any:
    """Return speed [m/s] and position [m] along an axis after a one-tick push, shape (n, 2)."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    begin = float(data.xpos[body][axis])
    found = []
    data.xfrc_applied[body][axis] = force
    for _ in range(_TICKS):
        mujoco.mj_step(model, data, steps)
        mujoco.mj_kinematics(model, data)
        data.xfrc_applied[body][axis] = 0.0
        found.append(
            (float(data.qvel[dofs][axis]), float(data.xpos[body][axis]) - begin)
        )
    return np.array(found)


def response_text(found: ToolResponse, step: float | None = None) -> str:
    """Return a tool's response as text, and what it means for stability.

    `step`: of the scene, where all behind the tool is solved within it [s].
    """
    text = (
        f"it answers a push {found.lag:.2f} ticks late, damped to ground by {found.damping:.3g}"
        " N s/m"
    )
    if found.damping > 0.0:
        return text
    if step is not None:
        return f"{text}: only its mass makes a law provably stable with what it touches"
    return (
        f"{text}: no law is provably stable with what it touches until tool.damping is above 0"
        " (nor by its mass: something in the scene is not solved within a"
        " step, such as a spring on a joint, a motor, or a contact with too little damping)"
    )
