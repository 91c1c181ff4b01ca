"""Contact stiffness of a tool in N/m, measured because MuJoCo's parameters do not give it.

A ball with the tool's contact parameters and mass is pressed on a plane with the contact parameters
of each other geom, under three loads. Geoms with equal parameters are measured once.
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
_PRESS = """<mujoco><option timestep="{step!r}" cone="{cone}" impratio="{ratio!r}" gravity="0 0 0"/>
<worldbody><geom type="plane" size="1 1 0.1" {wall}/>
<body pos="0 0 0.005"><joint type="slide" axis="0 0 1"/>
<geom type="sphere" size="0.005" mass="{mass!r}" {tip}/></body>
</worldbody></mujoco>"""


class PairStiffness(NamedTuple):
    """Stiffness of a contact between the tool and one geom."""

    geom: str  # the geom that the tool presses on, held fixed
    # force over depth between 0.5 and 1.5 N [N/m]; None if the ball does not settle
    stiffness: float | None
    pressed: float | None = None  # the same between 1.5 and 4.5 N


def measure_contacts(
    mujoco: Any, model: Any, of_tool: Sequence[int], mass: float
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

    Returns
    -------
    list of PairStiffness
        One for each geom, in the scene's order.
    """
    kinds, affinities = model.geom_contype, model.geom_conaffinity
    tip = next((i for i in of_tool if kinds[i] or affinities[i]), None)
    if tip is None:
        return []
    own, found = set(of_tool), []
    pressed: dict[str, tuple[float | None, float | None]] = {}
    for i in range(model.ngeom):
        if i in own or not (kinds[i] & affinities[tip] or kinds[tip] & affinities[i]):
            continue
        wall = _attributes(model, i)
        if wall not in pressed:
            pressed[wall] = _press(mujoco, model.opt, wall, _attributes(model, tip), mass)
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
    # The friction cone is part of a contact's stiffness.
    scene = {
        "cone": "elliptic" if option.cone else "pyramidal",
        "ratio": float(option.impratio),
        "mass": mass,
    }
    model = mujoco.MjModel.from_xml_string(
        _PRESS.format(step=min(option.timestep, _FINE), wall=wall, tip=tip, **scene)
    )
    data = mujoco.MjData(model)
    depths = []
    for load in _LOADS:
        data.qfrc_applied[0] = -load
        mujoco.mj_step(model, data, round(1.0 / model.opt.timestep))
        depths.append(-float(data.qpos[0]) if abs(float(data.qvel[0])) < _STILL else math.nan)
    ways = [
        (more - less, deeper - depth)
        for less, more, depth, deeper in zip(_LOADS, _LOADS[1:], depths, depths[1:])  # noqa: B905
    ]
    first, second = (load / way if way > _SHALLOW else None for load, way in ways)
    return first, second


def contacts_text(found: Sequence[PairStiffness]) -> str:
    """Return contact stiffnesses as text; geoms of equal stiffness share an entry."""
    groups: dict[tuple[float | None, float | None], list[str]] = {}
    for pair in found:
        groups.setdefault(pair[1:], []).append(pair.geom)
    told = []
    for (stiffness, pressed), names in groups.items():
        more = f" and {len(names) - _MOST_NAMES} more" if len(names) > _MOST_NAMES else ""
        who = ", ".join(names[:_MOST_NAMES]) + more
        if stiffness is None:
            told.append(f"{who} does not settle under {_LOADS[0]:g} to {_LOADS[1]:g} N")
            continue
        curved = pressed is not None and not 1.0 / _CURVED < pressed / stiffness < _CURVED
        told.append(
            f"{who} {stiffness:.3g} N/m"
            + (f", {pressed:.3g} N/m under {_LOADS[2]:g} N: it is nonlinear" if curved else "")
        )
    return "; ".join(told) or "none"
