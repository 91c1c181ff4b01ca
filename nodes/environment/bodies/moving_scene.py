"""A MuJoCo scene that is stepped by the ticks of the loop: the tool feels what the device feels, at the same instants.

The coupling is between two masses, the device and the tool. So the force that a law renders acts on
the tool with the other sign, from when it acts on the device to when the next one does: between two
steps of the scene no momentum is made or lost. A body that is led by a constraint (a mocap body and
a weld) would be a coupling of its own in place of the law.
"""

from __future__ import annotations

import contextlib
import math
import os
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from messages.types import Vector
from nodes.environment.bodies.contacts import PairStiffness, measure_contacts
from nodes.environment.bodies.tool import (
    AXES,
    ToolParameters,
    ToolResponse,
    add_tool,
    measure_response,
)
from nodes.parameters.store import ParameterError

EXTRA = "pip install 'haptic-nodes[mujoco]'"
LARGEST = 64_000_000  # largest MJCF file that is read [bytes]
# largest radius around a geom of the tool [m]: what is larger was probably drawn in millimetres
WIDEST = 1.0

# of a longer time without a state only so much is stepped: a scene that made up for all of it would
# be late [s]
GAP = 0.1

HEAVIEST = 1e6  # heaviest body [kg]
LARGEST_NUMBER = 1e10  # largest number of a scene: MuJoCo's own limit of what it steps

_NUMBERS = (  # of a model: with one that is none the scene diverges at its first step
    *("gravity", "body_inertia", "body_pos", "geom_size", "geom_pos", "qpos0", "qpos_spring"),
    *("jnt_stiffness", "dof_damping", "dof_armature", "dof_frictionloss"),
)
_MOST_STEPS = 1000
# deeper than this in another body the tool begins unfelt [m]: MuJoCo would throw it out
_OVERLAP = 1e-4
_LIGHTEST = 1e-6


def load_mujoco(where: str) -> Any:
    """Import MuJoCo, or say how it is had."""
    try:
        import mujoco
    except ImportError as error:
        raise ParameterError(f"{where}: {error}; install it with: {EXTRA}") from error
    return mujoco


class MovingScene:
    """A scene and its tool on three slide joints; `held`: all else is held. ParameterError says why it cannot be had."""

    def __init__(
        self,
        file: Path,
        tool: str | ToolParameters,
        period: float,
        where: str,
        held: bool = False,
        lost: float = math.inf,
    ) -> None:
        self.lost = lost  # distance from the device at which the tool is put back to it [m]
        wanted = tool if isinstance(tool, ToolParameters) else ToolParameters(body=tool)
        tool = wanted.body
        self._mujoco = mujoco = load_mujoco(f"{where}.scene")
        if file.exists() and not (file.is_file() or file.is_dir()):
            # A pipe would be waited for, and a device has no end.
            raise ParameterError(f"{where}.scene: {file} is no regular file")
        try:
            # Opened here: the words of the operating system are clearer.
            with open(file, "rb") as opened:
                size = opened.seek(0, os.SEEK_END)
        except OSError as error:
            raise ParameterError(
                f"{where}.scene: {file} cannot be read: {error.strerror}"
            ) from error
        if size > LARGEST:
            raise ParameterError(
                f"{where}.scene: {file} has {size / 1e6:.0f} MB, more than {LARGEST / 1e6:.0f};"
                " meshes and textures belong in files of their own"
            )
        try:
            with _heard(mujoco) as warnings:
                self.model = _model(mujoco, file, wanted, held, where)
        except ValueError as error:
            raise ParameterError(
                f"{where}.scene: {file}: {' '.join(str(error).split())}"
            ) from error
        if warnings:
            # MuJoCo would go on without the value: a mass that is not a number becomes that of
            # water.
            raise ParameterError(f"{where}.scene: {file}: {' '.join(' '.join(warnings).split())}")
        self._refuse_odd_numbers(file, where)
        self.data = mujoco.MjData(self.model)
        self.tool, self._slides = self._find_tool(tool, file, where)  # the tool's body in the model
        first = int(self.model.body_dofadr[self.tool])
        self._speeds = slice(first, first + 3)
        # of the tool, with what is fixed to it [kg]
        self.mass = float(self.model.body_subtreemass[self.tool])
        if self.mass < _LIGHTEST:
            raise ParameterError(
                f"{where}.tool: body {tool!r} weighs {self.mass:g} kg, expected at least"
                f" {_LIGHTEST:g} kg"
            )
        widest = max(
            (float(self.model.geom_rbound[i]) for i in range(self.model.ngeom) if self._of_tool(i)),
            default=0.0,
        )
        if widest > WIDEST:
            raise ParameterError(
                f"{where}.scene: {file}: a geom of body {tool!r} reaches {widest:.4g} m, expected"
                f" at most {WIDEST:g} m; MJCF is in metres"
            )
        # Steps of the scene in a tick: its own step, made shorter so that a whole number fits.
        self.steps = max(1, math.ceil(period / float(self.model.opt.timestep) - 1e-9))
        if self.steps > _MOST_STEPS:
            raise ParameterError(
                f"{where}.scene: {file}: a step of {self.model.opt.timestep:g} s is {self.steps} a"
                f" tick, at most {_MOST_STEPS}; raise option timestep"
            )
        self.model.opt.timestep = period / self.steps
        self._most = max(1, round(GAP / period)) * self.steps
        # Forces handed to the device: when they take effect [steps], and what they are [N]. Before
        # the first, none.
        self._forces: deque[tuple[int, Vector]] = deque([(-1, (0.0, 0.0, 0.0))])
        self._done = 0
        self.resets = 0  # how often the scene diverged and was put back to its beginning
        self._touches = {
            i: (int(self.model.geom_contype[i]), int(self.model.geom_conaffinity[i]))
            for i in self._geoms()
        }
        # whether the tool meets nothing, because it began inside of another body
        self.inside = False
        mujoco.mj_forward(self.model, self.data)

    def _refuse_odd_numbers(self, file: Path, where: str) -> None:
        """Refuse what MuJoCo takes, and no step can be made with."""
        model = self.model
        step = float(model.opt.timestep)
        if not (math.isfinite(step) and step > 0.0):
            raise ParameterError(
                f"{where}.scene: {file}: option timestep is {step:g} s, expected a time above 0"
            )
        for i in range(1, model.nbody):
            mass = float(model.body_mass[i])
            if not mass <= HEAVIEST:
                raise ParameterError(
                    f"{where}.scene: {file}: body {model.body(i).name!r} weighs {mass:g} kg,"
                    f" expected at most {HEAVIEST:g} kg"
                )
        for name in _NUMBERS:
            values = getattr(model.opt if name == "gravity" else model, name).ravel().tolist()
            odd = next((value for value in values if not abs(value) <= LARGEST_NUMBER), None)
            if odd is not None:
                raise ParameterError(
                    f"{where}.scene: {file}: a number of {name} is {odd:g}, expected at most"
                    f" {LARGEST_NUMBER:g}"
                )

    def _find_tool(self, tool: str, file: Path, where: str) -> tuple[int, list[int]]:
        model, mujoco = self.model, self._mujoco
        body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, tool)
        if body < 0:
            names = [model.body(i).name for i in range(1, model.nbody)]
            raise ParameterError(
                f"{where}.tool: no body {tool!r} in {file}; its bodies are"
                f" {', '.join(names) or 'none'}; {where}.tool: {{mass: 0.05, radius: 0.005}}"
                " adds one"
            )
        first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
        kind = mujoco.mjtJoint.mjJNT_SLIDE
        slides = [
            i
            for i in range(first, first + count)
            if model.jnt_type[i] == kind and not model.jnt_limited[i]
        ]
        axes = [tuple(model.jnt_axis[i].tolist()) for i in slides]
        if count != 3 or axes != list(AXES) or model.body_parentid[body] != 0:
            raise ParameterError(
                f"{where}.tool: body {tool!r} must be a child of the world with three slide joints"
                " without limits, along x, y and z: the device has three axes, and its own"
                f" workspace; or {where}.tool: {{body: NAME, mass: 0.05}} adds one"
            )
        return body, [int(model.jnt_qposadr[i]) for i in slides]

    def _of_tool(self, geom: int) -> bool:
        return int(self.model.body_rootid[self.model.geom_bodyid[geom]]) == self.tool

    def _geoms(self) -> list[int]:
        return [i for i in range(self.model.ngeom) if self._of_tool(i)]

    @property
    def tool_position(self) -> Vector:
        """Where the tool is now [m]."""
        x, y, z = self.data.xpos[self.tool].tolist()
        return x, y, z

    def begin(self, position: Vector) -> None:
        """Put the tool where the device is, at rest: a coupling that begins stretched would throw it.

        A tool that is inside of another body there meets nothing until it is outside of all: its
        contacts would throw it.
        """
        self._meet_bodies(True)
        for at, wanted, now in zip(self._slides, position, self.tool_position, strict=True):
            self.data.qpos[at] += wanted - now
        self._mujoco.mj_forward(self.model, self.data)
        self.inside = self._deepest() > _OVERLAP
        if self.inside:
            self._meet_bodies(False)
            self._mujoco.mj_forward(self.model, self.data)

    def _meet_bodies(self, meets: bool) -> None:
        """Switch the contacts of the tool on or off."""
        for i, (kind, affinity) in self._touches.items():
            self.model.geom_contype[i], self.model.geom_conaffinity[i] = (
                (kind, affinity) if meets else (0, 0)
            )

    def _deepest(self) -> float:
        """Depth of the tool in other bodies, by the contacts that were found last [m]."""
        contact = self.data.contact
        of_tool = (int(i) in self._touches or int(j) in self._touches for i, j in contact.geom)
        return max(
            (-float(away) for away, own in zip(contact.dist, of_tool, strict=True) if own),
            default=0.0,
        )

    def _leave_bodies(self) -> None:
        """Meet other bodies again as soon as the tool is wholly outside of them."""
        self._meet_bodies(True)
        self._mujoco.mj_collision(self.model, self.data)
        self.inside = self._deepest() > 0.0
        if self.inside:
            self._meet_bodies(False)

    def follow(
        self,
        tick: int,
        position: Vector,
        force: Vector,
        since: int,
        delay: float,
        first: bool,
        jumped: bool = False,
    ) -> str:
        """Go to a tick whose state tells the last force, the tick it answered and its delay.

        `first` and `jumped` say that no motion led the device to its position. Return why the tool
        was put back to the device; empty where it was not.
        """
        if first:
            self.begin(position)
            self._done = tick * self.steps  # A node that was killed goes on with the present
            return "the scene begins"
        self.hand_over(force, since, delay)
        self.advance(tick)
        if self.diverged():
            why = (
                "the scene diverged and was put back to its beginning; a smaller option timestep"
                " may help"
            )
        elif jumped:
            why = "the device's position jumped"
        elif (away := math.dist(self.tool_position, position)) > self.lost:
            why = (
                f"the tool was {away:.3g} m away from the device, more than {self.lost:g} m: it was"
                " thrown, or left behind"
            )
        else:
            if self.inside:
                self._leave_bodies()
            return ""
        self.data.qvel[self._speeds] = 0.0
        self.begin(position)
        return why

    def hand_over(self, force: Vector, tick: int, delay: float) -> None:
        """Note a force that was handed to the device at a tick, and how much later it took effect [ticks]."""
        when = (tick + delay) * self.steps
        # To the nearest step; what took effect before the scene's present acts from now on.
        self._forces.append((max(round(when), self._forces[-1][0]), force))

    def advance(self, tick: int) -> None:
        """Step the scene up to the time of a tick; after a gap of more than `GAP` it has stood still meanwhile."""
        model, data = self.model, self.data
        self._done = max(self._done, tick * self.steps - self._most)
        push = data.xfrc_applied[self.tool]
        forces = self._forces
        while self._done < tick * self.steps:
            while len(forces) > 1 and forces[1][0] <= self._done:
                forces.popleft()
            x, y, z = forces[0][1]
            push[0], push[1], push[2] = -x, -y, -z
            self.step()
            self._done += 1
        # Positions of bodies are those before the last step until they are computed anew.
        self._mujoco.mj_kinematics(model, data)

    def step(self) -> None:
        """Go one step of the scene further, with the force that acts now."""
        self._mujoco.mj_step(self.model, self.data)

    def diverged(self) -> bool:
        """Tell whether the scene had to be put back to its beginning since the last call: MuJoCo does so by itself."""
        kinds = self._mujoco.mjtWarning
        bad = kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC
        found = sum(int(self.data.warning[int(kind)].number) for kind in bad)
        new, self.resets = found > self.resets, found
        return new

    def stiffness(self) -> list[PairStiffness]:
        """Measure the tool's contacts in N/m (`nodes.environment.bodies.contacts`)."""
        return measure_contacts(self._mujoco, self.model, self._geoms(), self.mass)

    def response(self) -> ToolResponse:
        """Measure what the tool answers to a push (`nodes.environment.bodies.tool`)."""
        period = float(self.model.opt.timestep) * self.steps
        return measure_response(
            self._mujoco, self.model, self.tool, self._speeds, period, self.steps
        )

    @property
    def damping(self) -> float:
        """Viscous damping of the tool to ground, along the axis that has least [N s/m]."""
        return float(self.model.dof_damping[self._speeds].min())


@contextlib.contextmanager
def _heard(mujoco: Any) -> Iterator[list[str]]:
    """Collect what MuJoCo warns of, which it writes to the terminal otherwise."""
    found: list[str] = []
    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(found.append)
    try:
        yield found
    finally:
        mujoco.set_mju_user_warning(before)


def _model(mujoco: Any, file: Path, tool: ToolParameters, held: bool, where: str) -> Any:
    """Read a scene; its tool is added or damped if asked for, and `held` leaves out the joints of all other bodies."""
    if tool.mass is None and tool.damping is None and not held:
        return mujoco.MjModel.from_xml_path(str(file))
    spec = mujoco.MjSpec.from_file(str(file))
    add_tool(mujoco, spec, tool, f"{where}.tool")
    for body in spec.bodies if held else ():
        line = body
        while line is not None and line.name not in (tool.body, "world"):
            line = line.parent
        if line is None or line.name != tool.body:
            for joint in body.joints:
                spec.delete(joint)
    return spec.compile()
