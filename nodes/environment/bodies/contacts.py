"""Contact stiffness of a tool in N/m, measured because MuJoCo's parameters do not give it.

A ball with the tool's contact parameters and mass is pressed on a plane with the contact parameters
of each other geom, under three loads. Geoms with equal parameters are measured once.

Whether the tool then rests is measured too, at the scene's own step and with the tool's own
damping: MuJoCo finds contact forces before it applies damping, and a contact begins a step late. A
light tool of much damping bounces by that alone, whatever the coupling does.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

_OF_CONTACT = ("solref", "solimp", "friction", "solmix", "priority", "condim")
_LOADS = (0.5, 1.5, 4.5)  # contact forces of the measurement [N]
_FINE = 5e-4
# speed at which the ball has settled [m/s]: half a second later it moves less than 5 µm
_STILL = 1e-5
_SHALLOW = 1e-9  # least difference of depths that gives a stiffness [m]
# ratio of stiffnesses at high and low load from which a contact is reported as nonlinear
_CURVED = 1.2
_MOST_NAMES = 6  # geoms of equal stiffness that are named
_HALVINGS = 8  # of the scene's step, in search of one at which the tool rests
_INTEGRATORS = ("Euler", "RK4", "implicit", "implicitfast")  # in MuJoCo's order
_PRESS = """<mujoco>
<option timestep="{step!r}" integrator="{integrator}" cone="{cone}" impratio="{ratio!r}"
 gravity="0 0 0"/>
<worldbody><geom type="plane" size="1 1 0.1" {wall}/>
<body pos="0 0 0.005"><joint type="slide" axis="0 0 1" damping="{damping!r}"/>
<geom type="sphere" size="0.005" mass="{mass!r}" {tip}/></body>
</worldbody></mujoco>"""


class PairStiffness(NamedTuple):
    """Stiffness of a contact between the tool and one geom."""

    geom: str  # the geom that the tool presses on, held fixed
    # force over depth between 0.5 and 1.5 N [N/m]; None if the ball does not settle
    stiffness: float | None
    pressed: float | None = None  # the same between 1.5 and 4.5 N
    # None where the tool rests on it at the scene's own step; else a step at which it would [s], 0
    # if none was found
    rests_at: float | None = None

    @property
    def bounces(self) -> bool:
        """Whether the tool bounces on it by itself: then no coupling is certain there."""
        return self.stiffness is None or self.rests_at is not None


def measure_contacts(
    mujoco: Any, model: Any, of_tool: Sequence[int], mass: float, damping: float
) -> list[PairStiffness]:
    """Measure the contact of a tool's first geom with each geom that it can touch.

    Parameters
    ----------
    mujoco : module
        MuJoCo.
    model : MjModel
        The scene.
    of_tool : sequence of int
        Geoms of the tool.
    mass : float
        Mass of the tool [kg].
    damping : float
        Damping of the tool to ground [N s/m].

    Returns
    -------
    list of PairStiffness
        One for each geom, in the scene's order.
    """
    kinds, affinities = model.geom_contype, model.geom_conaffinity
    tip = next((i for i in of_tool if kinds[i] or affinities[i]), None)
    if tip is None:
        return []
    own = set(of_tool)
    found = []
    pressed: dict[str, tuple[float | None, float | None, float | None]] = {}
    for i in range(model.ngeom):
        if i in own or not (kinds[i] & affinities[tip] or kinds[tip] & affinities[i]):
            continue
        wall = _attributes(model, i)
        if wall not in pressed:
            own_tip = _attributes(model, tip)
            pressed[wall] = (
                *_press(mujoco, model.opt, wall, own_tip, mass),
                _step_of_rest(mujoco, model.opt, wall, own_tip, mass, damping),
            )
        name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_GEOM, i) or f"geom {i}"
        found.append(PairStiffness(name, *pressed[wall]))
    return found


def _attributes(model: Any, geom: int) -> str:
    """Return the contact attributes of a geom as MJCF."""
    found = {name: getattr(model, f"geom_{name}")[geom] for name in _OF_CONTACT}
    return " ".join(
        f'{name}="{" ".join(map(repr, numbers.ravel().tolist()))}"'
        for name, numbers in found.items()
    )


def _press(
    mujoco: Any, option: Any, wall: str, tip: str, mass: float
) -> tuple[float | None, float | None]:
    """Return the stiffness between the first two loads, and between the last two [N/m]."""
    # The friction cone is part of a contact's stiffness.
    model = _ball(
        mujoco, option, wall, tip, mass, min(float(option.timestep), _FINE), 0.0
    )
    data = mujoco.MjData(model)
    depths = []
    for load in _LOADS:
        data.qfrc_applied[0] = -load
        mujoco.mj_step(model, data, round(1.0 / model.opt.timestep))
        depths.append(
            -float(data.qpos[0]) if abs(float(data.qvel[0])) < _STILL else math.nan
        )
    ways = [
        (more - less, deeper - depth)
        for less, more, depth, deeper in zip(_LOADS, _LOADS[1:], depths, depths[1:])  # noqa: B905
    ]
    first, second = (load / way if way > _SHALLOW else None for load, way in ways)
    return first, second


def _step_of_rest(
    mujoco: Any, option: Any, wall: str, tip: str, mass: float, damping: float
) -> float | None:
    """Return a step at which the tool would rest, or 0; None if it does at the scene's [s]."""
    for halvings in range(_HALVINGS):
        step = float(option.timestep) / 2**halvings
        model = _ball(mujoco, option, wall, tip, mass, step, damping)
        if not any(_bounces(mujoco, model, load, mass) for load in _LOADS):
            return step if halvings else None
    return 0.0


def _bounces(mujoco: Any, model: Any, load: float, mass: float) -> bool:
    """Return whether a ball that fell for three steps still leaves the plane after 0.75 s."""
    data = mujoco.MjData(model)
    step = float(model.opt.timestep)
    data.qpos[0] = load / mass * (3.0 * step) ** 2 / 2.0
    data.qfrc_applied[0] = -load
    mujoco.mj_step(model, data, round(0.75 / step))
    for _ in range(round(0.25 / step)):
        mujoco.mj_step(model, data)
        if not data.ncon:
            return True
    return False


def _ball(
    mujoco: Any,
    option: Any,
    wall: str,
    tip: str,
    mass: float,
    step: float,
    damping: float,
) -> Any:
    """Return a ball of the tool's mass on a plane; the scene's integrator, cone and contacts."""
    return mujoco.MjModel.from_xml_string(
        _PRESS.format(
            step=step,
            integrator=_INTEGRATORS[int(option.integrator)],
            cone="elliptic" if option.cone else "pyramidal",
            ratio=float(option.impratio),
            wall=wall,
            tip=tip,
            mass=mass,
            damping=damping,
        )
    )


def contacts_text(found: Sequence[PairStiffness]) -> str:
    """Return contact stiffnesses as text; geoms of equal stiffness share an entry."""
    groups: dict[tuple[float | None, ...], list[str]] = {}
    for pair in found:
        groups.setdefault(pair[1:], []).append(pair.geom)
    told = []
    for (stiffness, pressed, rests_at), names in groups.items():
        more = (
            f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
        )
        who = ", ".join(names[:_MOST_NAMES]) + more
        if stiffness is None:
            told.append(f"{who} does not settle under {_LOADS[0]:g} to {_LOADS[1]:g} N")
            continue
        curved = (
            pressed is not None and not 1.0 / _CURVED < pressed / stiffness < _CURVED
        )
        told.append(
            f"{who} {stiffness:.3g} N/m"
            + (
                f", {pressed:.3g} N/m under {_LOADS[2]:g} N: it is nonlinear"
                if curved
                else ""
            )
            + _bounce_text(rests_at)
        )
    return "; ".join(told) or "none"


def _bounce_text(rests_at: float | None) -> str:
    """Return that a tool bounces by itself, and the step at which it would not."""
    if rests_at is None:
        return ""
    remedy = (
        f"a step of {rests_at:.3g} s" if rests_at else "a heavier or less damped tool"
    )
    return (
        ", on which the pressed tool bounces by itself: that contact is not passive at this step,"
        f" and no certificate of a law is about it; {remedy} mends it"
    )
