"""From the device into the scene (axes, mount, scale, centre, clutch), as one matrix.

A position p of the device is at s R A p + origin in the scene: A selects the device's axes that
point forward, left and up, R is the orientation of the device, s the scale. A force F goes back as
s Aᵀ Rᵀ F, so that force times velocity is the same on both sides: a scene of twice the size is felt
with twice the force for the same law, and a passive loop stays passive.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from messages.types import Vector
from nodes.driver.device import DeviceLimits, Workspace

AxisName = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
Turn = tuple[Vector, Vector, Vector]


class Mapping(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Mapping of device positions to scene positions.

    axes: Axes of the device, in its vendor's directions, that point forward, left and up, e.g.
        ``["-z", "-x", "+y"]``; None for those of a device standing upright on a table.
    rotation: Rotation of the device from there, about x, then y, then z of the scene [degrees].
    scale: Metres of the scene per metre of the device; forces on the device are those of the scene
        times it.
    centre: Position of the device's origin in the scene [m].
    recentre: Whether ``centre`` is where the device is when it is opened.
    clutch: Number of the button, from 0, that freezes the scene's position while the device is
        moved; None for none.
    reach: Largest shift by the clutch, along an axis [m].
    clutch_ramp: Time over which the force returns after the clutch [s].
    """

    axes: tuple[AxisName, AxisName, AxisName] | None = None
    rotation: Vector = (0.0, 0.0, 0.0)
    scale: Annotated[float, msgspec.Meta(ge=0.01, le=100.0)] = 1.0
    centre: Vector = (0.0, 0.0, 0.0)
    recentre: bool = False
    clutch: Annotated[int, msgspec.Meta(ge=0, le=31)] | None = None
    reach: Annotated[float, msgspec.Meta(gt=0.0, le=10.0)] = 0.2
    clutch_ramp: Annotated[float, msgspec.Meta(ge=0.0, le=10.0)] = 0.15

    def __post_init__(self) -> None:
        if self.axes is not None and len({name[1] for name in self.axes}) != 3:
            raise ValueError(
                f"axes is {list(self.axes)}: each of x, y and z must stand in it once"
            )
        if self.axes is not None and np.linalg.det(_rows(self.axes)) < 0.0:
            raise ValueError(
                f"axes is {list(self.axes)}: a mirror of the scene; turn one sign round, or"
                " swap two"
            )


def _rows(names: Sequence[str]) -> NDArray[np.float64]:
    return np.array(
        [
            [
                (1.0 if name[0] == "+" else -1.0) * (letter == name[1])
                for letter in "xyz"
            ]
            for name in names
        ]
    )


def _cosine_sine(degrees: float) -> tuple[float, float]:
    """Return cosine and sine of an angle, exact at right angles, so that axes stay exact."""
    if degrees % 90.0 == 0.0:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[
            int(degrees // 90.0) % 4
        ]
    angle = math.radians(degrees)
    return math.cos(angle), math.sin(angle)


def matrix(mapping: Mapping, usual: Sequence[str]) -> Turn:
    """Return s R A by rows; `usual` are the axes if none are given."""
    turned = _rows(mapping.axes or usual)
    for axis, degrees in enumerate(mapping.rotation):
        cosine, sine = _cosine_sine(degrees)
        j = (axis + 1) % 3
        k = (axis + 2) % 3
        turn = np.eye(3)
        turn[j, j] = cosine
        turn[j, k] = -sine
        turn[k, j] = sine
        turn[k, k] = cosine
        turned = turn @ turned
    made: Turn = msgspec.convert((mapping.scale * turned).tolist(), Turn)
    return made


def limits_in_scene(limits: DeviceLimits, mapping: Mapping, turn: Turn) -> DeviceLimits:
    """Return a device's limits in the scene's axes, whatever the direction of a force."""
    rows = np.array(turn)
    # axis j of the device gets Σ turn[i][j] F[i]
    worst = float(np.abs(rows).sum(axis=0).max())
    # an unused axis adds nothing, even if it is unbounded
    ends = np.multiply(
        rows[:, :, None],
        limits.workspace,
        out=np.zeros((3, 3, 2)),
        where=rows[:, :, None] != 0.0,
    )
    low = ends.min(axis=2).sum(axis=1)
    high = ends.max(axis=2).sum(axis=1)
    # the device's position at opening is not known yet
    beyond = (mapping.reach if mapping.clutch is not None else 0.0) + (
        high - low if mapping.recentre else 0.0
    )
    workspace = (
        np.stack([low - beyond, high + beyond], axis=1)
        + np.array(mapping.centre)[:, None]
    )
    return msgspec.structs.replace(
        limits,
        peak_force=limits.peak_force / worst,
        continuous_force=limits.continuous_force / worst,
        slew=limits.slew / worst,
        workspace=msgspec.convert(workspace.tolist(), Workspace),
    )
