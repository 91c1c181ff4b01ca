"""A MuJoCo scene stepped by the ticks of the loop: device and tool feel the same force.

The coupling acts between two masses, the device and the tool. The negative of the rendered force
acts on the tool from the instant at which the force acts on the device until the next force does,
so that no momentum is created or lost between two steps of the scene. A tool led by a constraint (a
mocap body and a weld) would replace the law by a coupling of its own.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from pathlib import Path

from messages.types import Vector
from nodes.environment.bodies.contacts import PairStiffness, measure_contacts
from nodes.environment.bodies.implicit import euler_step
from nodes.environment.bodies.scene_file import find_tool, load_mujoco, read_scene
from nodes.environment.bodies.start import Keyframe, key_of, reset
from nodes.environment.bodies.tool import ToolParameters, ToolResponse, measure_response
from nodes.parameters.store import ParameterError

# largest radius around a geom of the tool [m]; a larger one was probably drawn in millimetres
WIDEST = 1.0

# longest gap without a state that the scene catches up with [s]; more would make it late
GAP = 0.1

_MOST_STEPS = 1000
# depth in another body from which the tool begins unfelt [m]: MuJoCo would throw it out
_OVERLAP = 1e-4
_LIGHTEST = 1e-6


class MovingScene:
    """A scene and its tool on three slide joints; with `held`, all other bodies are fixed.

    Raises ParameterError if the scene cannot be loaded or used.
    """

    def __init__(
        self,
        file: Path,
        tool: str | ToolParameters,
        period: float,
        where: str,
        held: bool = False,
        lost: float = math.inf,
        keyframe: Keyframe | None = None,
    ) -> None:
        # distance from the device at which the tool is put back to it [m]
        self.lost = lost
        wanted = tool if isinstance(tool, ToolParameters) else ToolParameters(body=tool)
        tool = wanted.body
        self._mujoco = mujoco = load_mujoco(f"{where}.scene")
        self.model = read_scene(mujoco, file, wanted, held, keyframe, where)
        self.data = mujoco.MjData(self.model)
        # number of the keyframe at which it starts; -1 for the state of the file
        self._key = -1 if held else key_of(mujoco, self.model, keyframe, where)
        # the tool's body in the model, and its joints
        self.tool, self._slides = find_tool(mujoco, self.model, tool, file, where)
        first = int(self.model.body_dofadr[self.tool])
        self._speeds = slice(first, first + 3)
        # mass of the tool and everything fixed to it [kg]
        self.mass = float(self.model.body_subtreemass[self.tool])
        if self.mass < _LIGHTEST:
            raise ParameterError(
                f"body {tool!r} weighs {self.mass:g} kg, expected at least {_LIGHTEST:g} kg",
                path=f"{where}.tool",
            )
        widest = max(
            (
                float(self.model.geom_rbound[i])
                for i in range(self.model.ngeom)
                if self._of_tool(i)
            ),
            default=0.0,
        )
        if widest > WIDEST:
            raise ParameterError(
                f"{file}: a geom of body {tool!r} reaches {widest:.4g} m, expected"
                f" at most {WIDEST:g} m; MJCF is in metres",
                path=f"{where}.scene",
            )
        # Its own step, if all behind the tool is solved within it [s]; else None.
        self.euler_step = euler_step(mujoco, self.model)
        # Sub-steps per tick: the scene's step is shortened so that a whole number fits.
        self.steps = max(1, math.ceil(period / float(self.model.opt.timestep) - 1e-9))
        if self.steps > _MOST_STEPS:
            raise ParameterError(
                f"{file}: a step of {self.model.opt.timestep:g} s is {self.steps} a"
                f" tick, at most {_MOST_STEPS}; raise option timestep",
                path=f"{where}.scene",
            )
        self.model.opt.timestep = period / self.steps
        self._most = max(1, round(GAP / period)) * self.steps
        # Forces handed to the device: when they take effect [steps] and their value [N]; zero
        # before.
        self._forces: deque[tuple[int, Vector]] = deque([(-1, (0.0, 0.0, 0.0))])
        self._done = 0
        self.reset_due = False  # whether the next tick starts the scene again
        self._controls_until = -1  # tick at which controls from outside expire
        self._touches = {
            i: (int(self.model.geom_contype[i]), int(self.model.geom_conaffinity[i]))
            for i in self._geoms()
        }
        # whether contacts of the tool are off, because it began inside another body
        self.inside = False
        self.start_again()
        self._home = self.data.ctrl.copy()  # controls at the start
        mujoco.mj_forward(self.model, self.data)

    def _of_tool(self, geom: int) -> bool:
        return int(self.model.body_rootid[self.model.geom_bodyid[geom]]) == self.tool

    def _geoms(self) -> list[int]:
        return [i for i in range(self.model.ngeom) if self._of_tool(i)]

    @property
    def tool_position(self) -> Vector:
        """Position of the tool [m]."""
        x, y, z = self.data.xpos[self.tool].tolist()
        return x, y, z

    def start_again(self) -> None:
        """Reset bodies and controls to the start of the scene."""
        reset(self._mujoco, self.model, self.data, self._key)
        self._bad = 0  # warnings of a diverging scene since then
        self.reset_due = False

    def control(self, controls: Mapping[int, float], until: int) -> None:
        """Set controls of actuators by number; those of the start return at tick `until`."""
        for at, value in controls.items():
            self.data.ctrl[at] = value
        self._controls_until = until

    def begin(self, position: Vector) -> None:
        """Move the tool to the device, at rest: a stretched coupling would throw it.

        If the tool is inside another body there, its contacts are off until it is outside all
        bodies, because they would throw it.
        """
        self._meet_bodies(True)
        for at, wanted, now in zip(
            self._slides, position, self.tool_position, strict=True
        ):
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
        """Return the depth of the tool in other bodies, from the latest contacts [m]."""
        contact = self.data.contact
        of_tool = (
            int(i) in self._touches or int(j) in self._touches for i, j in contact.geom
        )
        return max(
            (
                -float(away)
                for away, own in zip(contact.dist, of_tool, strict=True)
                if own
            ),
            default=0.0,
        )

    def _leave_bodies(self) -> None:
        """Switch contacts on again once the tool is outside all bodies."""
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
        """Step to `tick`, whose state has the last force, the tick it answered and its delay.

        `first` and `jumped` say that the device reached its position without motion. Return why the
        tool was moved back to the device, or an empty string.
        """
        if first:
            self.begin(position)
            # a restarted node continues with the present tick
            self._done = tick * self.steps
            return "the scene begins"
        if 0 <= self._controls_until < tick:
            self._controls_until = -1
            self.data.ctrl[:] = self._home
        self.hand_over(force, since, delay)
        self.advance(tick)
        if self.diverged():
            why = "the scene diverged and was reset; a smaller option timestep may help"
            self.start_again()
        elif self.reset_due:
            why = "the scene was reset on request"
            self.start_again()
        elif jumped:
            why = "the device's position jumped"
        elif (away := math.dist(self.tool_position, position)) > self.lost:
            why = (
                f"the tool was {away:.3g} m away from the device, more than {self.lost:g} m: "
                "it was thrown or left behind"
            )
        else:
            if self.inside:
                self._leave_bodies()
            return ""
        self.data.qvel[self._speeds] = 0.0
        self.begin(position)
        return why

    def hand_over(self, force: Vector, tick: int, delay: float) -> None:
        """Record a force handed to the device at `tick`, which took effect `delay` ticks later."""
        when = (tick + delay) * self.steps
        # To the nearest step; a force of the past acts from now on.
        self._forces.append((max(round(when), self._forces[-1][0]), force))

    def advance(self, tick: int) -> None:
        """Step the scene to the time of a tick; skip what a gap above `GAP` leaves behind."""
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
        # MuJoCo leaves body positions one step behind until they are recomputed.
        self._mujoco.mj_kinematics(model, data)

    def step(self) -> None:
        """Make one step of the scene under the present force."""
        self._mujoco.mj_step(self.model, self.data)

    def diverged(self) -> bool:
        """Return whether MuJoCo has reset a diverging scene since the last call."""
        kinds = self._mujoco.mjtWarning
        bad = kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC
        found = sum(int(self.data.warning[int(kind)].number) for kind in bad)
        new = found > self._bad
        self._bad = found
        return new

    def stiffness(self) -> list[PairStiffness]:
        """Return the stiffness of the tool's contacts (`nodes.environment.bodies.contacts`)."""
        damping = float(self.model.dof_damping[self._speeds].max())
        return measure_contacts(
            self._mujoco, self.model, self._geoms(), self.mass, damping
        )

    def response(self) -> ToolResponse:
        """Return the tool's response to a push (`nodes.environment.bodies.tool`)."""
        period = float(self.model.opt.timestep) * self.steps
        return measure_response(
            self._mujoco, self.model, self.tool, self._speeds, period, self.steps
        )

    @property
    def damping(self) -> float:
        """Least viscous damping of the tool to ground, over its axes [N s/m]."""
        return float(self.model.dof_damping[self._speeds].min())
