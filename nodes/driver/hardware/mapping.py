"""From the device into the scene: axes, mount, scale, centre and clutch, as one matrix that forces go back through.

A position p of the device is at s R A p + origin in the scene: A says which of the device's axes is forward, left and up, R how
the device stands, s the scale. A force F goes back as s Aᵀ Rᵀ F, so that force times velocity is the same on both sides: a
scene that is drawn twice as large is felt with twice the force for the same law, and a loop that is passive stays so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Final, Literal

import msgspec

from messages.types import Vector
from nodes.driver.device import Bounds, DeviceLimits, Workspace

AxisName = Literal["+x", "-x", "+y", "-y", "+z", "-z"]
Turn = tuple[Vector, Vector, Vector]
_LETTERS: Final = "xyz"


class Mapping(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How positions of the device become positions of the scene.

    axes: Which axis of the device, in its vendor's directions, is forward, left and up here, e.g. ``["-z", "-x", "+y"]``; None
        for those of the device as it stands upright on a table.
    rotation: How the device is turned from there: about x, then y, then z of the scene [degrees].
    scale: Metres of the scene for a metre of the device; forces on the device are those of the scene times it.
    centre: Where the middle of the device is in the scene [m].
    recentre: Whether ``centre`` is where the device stands when it is opened.
    clutch: Number of the button, from 0, that holds the scene still while the device is moved; None for none.
    reach: How far the clutch may move the device against the scene, along an axis [m].
    clutch_ramp: Time in which the force comes back after the clutch [s].
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
            raise ValueError(f"axes is {list(self.axes)}: each of x, y and z must stand in it once")
        if self.axes is not None and _handed(self.axes) < 0.0:
            raise ValueError(f"axes is {list(self.axes)}: a mirror of the scene; turn one sign round, or swap two")


def _rows(names: Sequence[str]) -> Turn:
    x, y, z = (tuple((1.0 if name[0] == "+" else -1.0) * (letter == name[1]) for letter in _LETTERS) for name in names)
    return x, y, z  # type: ignore[return-value]  # each is three long


def _handed(names: Sequence[str]) -> float:
    (a, b, c), (d, e, f), (g, h, i) = _rows(names)
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def _product(a: Turn, b: Turn) -> Turn:
    def row(i: int) -> Vector:
        x, y, z = (sum(a[i][k] * b[k][j] for k in range(3)) for j in range(3))
        return x, y, z

    return row(0), row(1), row(2)


def _cosine_sine(degrees: float) -> tuple[float, float]:
    """Take both of an angle, exactly at right angles: a device that stands on its side has no rounding in its axes."""
    if degrees % 90.0 == 0.0:
        return ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[int(degrees // 90.0) % 4]
    angle = math.radians(degrees)
    return math.cos(angle), math.sin(angle)


def matrix(mapping: Mapping, usual: Sequence[str]) -> Turn:
    """Make s R A by rows, from the axes that are forward, left and up (`usual`: where none are asked for) into the scene's."""
    turned = _rows(mapping.axes or usual)
    for axis, degrees in enumerate(mapping.rotation):
        cosine, sine = _cosine_sine(degrees)
        j, k = (axis + 1) % 3, (axis + 2) % 3
        rows = [[1.0 if m == n else 0.0 for n in range(3)] for m in range(3)]
        rows[j][j], rows[j][k], rows[k][j], rows[k][k] = cosine, -sine, sine, cosine
        turned = _product(tuple(map(tuple, rows)), turned)  # type: ignore[arg-type]  # each is three long
    s = mapping.scale
    first, second, third = ((s * row[0], s * row[1], s * row[2]) for row in turned)
    return first, second, third


def limits_in_scene(limits: DeviceLimits, mapping: Mapping, turn: Turn) -> DeviceLimits:
    """Turn what the device bears along its own axes into what a scene may ask for.

    `turn`, shape (3, 3): as from `matrix`. Returns: forces: so low that no axis of the device gets more than it bears,
    whatever the direction. Workspace: the box round the device's own, and where there is a clutch what it can reach beyond.
    """
    # On axis j of the device acts Σ turn[i][j] F[i].
    worst = max(sum(abs(turn[i][j]) for i in range(3)) for j in range(3))
    clutched = mapping.reach if mapping.clutch is not None else 0.0
    bounds: list[Bounds] = []
    for i in range(3):
        low = high = mapping.centre[i]
        for j in range(3):
            ends = [turn[i][j] * end if turn[i][j] else 0.0 for end in limits.workspace[j]]
            low, high = low + min(ends), high + max(ends)
        # Where the device stands when it is opened is not known yet.
        beyond = clutched + (high - low if mapping.recentre else 0.0)
        bounds.append((low - beyond, high + beyond))
    workspace: Workspace = (bounds[0], bounds[1], bounds[2])
    return msgspec.structs.replace(
        limits,
        peak_force=limits.peak_force / worst,
        continuous_force=limits.continuous_force / worst,
        slew=limits.slew / worst,
        workspace=workspace,
    )
