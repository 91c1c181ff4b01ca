"""Force fields: forces by a formula of the device's velocity, everywhere in space.

A field is F = M v + F₀, added to the law's force; v is the device's velocity over one tick. Kinds
are those of motor-control experiments: viscous, curl (Shadmehr and Mussa-Ivaldi 1994), constant,
and any linear one.

Shadmehr, R.; Mussa-Ivaldi, F. A.: Adaptive representation of dynamics during learning of a motor
task. J. Neuroscience 14 (1994) 3208-3224.
"""

from __future__ import annotations

from collections.abc import MutableSequence, Sequence
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias

import msgspec

from messages.types import ZERO, Vector
from nodes.base.setup import AXIS_INDEX, Axis
from nodes.compiled.rules import rule
from nodes.coupling.state import CouplingState
from nodes.parameters.store import ParameterError

Gain = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
Triple: TypeAlias = tuple[Gain, Gain, Gain]
FieldMatrix: TypeAlias = tuple[Triple, Triple, Triple]

_NOTHING: FieldMatrix = (ZERO, ZERO, ZERO)
_TURNS = {"xy": (0, 1), "yz": (1, 2), "zx": (2, 0)}


class LinearField(NamedTuple):
    """A field F = M v + F₀."""

    matrix: FieldMatrix  # M [N s/m], by rows
    force: Vector  # F₀ [N]

    def axes(self) -> tuple[Axis, ...]:
        """Return the axes on which it acts or of which it needs the velocity."""

        def matters(i: int) -> bool:
            column = (row[i] for row in self.matrix)
            return bool(self.force[i]) or any(self.matrix[i]) or any(column)

        every: tuple[Axis, ...] = ("x", "y", "z")
        return tuple(axis for axis in every if matters(AXIS_INDEX[axis]))


class _Kind(
    msgspec.Struct,
    frozen=True,
    forbid_unknown_fields=True,
    kw_only=True,
    tag_field="kind",
):
    """Base of all kinds."""

    def linear(self) -> LinearField:
        """Return the field as M and F₀."""
        return LinearField(_NOTHING, ZERO)


class NoField(_Kind, frozen=True, kw_only=True, tag="none"):
    """No field.

    gain: Not used; the null condition of an experiment may have it [N s/m].
    """

    gain: float = 0.0


class Viscous(_Kind, frozen=True, kw_only=True, tag="viscous"):
    """A viscous field, F = −B v.

    gain: B, the same along all axes; negative pushes along the motion [N s/m].
    gains: In place of `gain`: B along x, y and z [N s/m].
    """

    gain: Gain | None = None
    gains: Triple | None = None

    def __post_init__(self) -> None:
        """Check that one of both is given."""
        if (self.gain is None) == (self.gains is None):
            both = "both are given" if self.gains else "neither is given"
            raise ValueError(f"gain or gains: {both}; expected one of them")

    def linear(self) -> LinearField:
        """Return the field as M and F₀."""
        x, y, z = self.gains or (self.gain or 0.0,) * 3
        return LinearField(((-x, 0.0, 0.0), (0.0, -y, 0.0), (0.0, 0.0, -z)), ZERO)


class Curl(_Kind, frozen=True, kw_only=True, tag="curl"):
    """A field across the motion in a plane, F = B [[0, 1], [−1, 0]] v.

    gain: B; negative turns the other way [N s/m].
    plane: Plane of the two axes.
    """

    gain: Gain
    plane: Literal["xy", "yz", "zx"] = "xy"

    def linear(self) -> LinearField:
        """Return the field as M and F₀."""
        rows = [[0.0] * 3 for _ in range(3)]
        first, second = _TURNS[self.plane]
        rows[first][second] = self.gain
        rows[second][first] = -self.gain
        return LinearField(tuple(map(tuple, rows)), ZERO)  # type: ignore[arg-type]


class Constant(_Kind, frozen=True, kw_only=True, tag="constant"):
    """A force that is the same everywhere, F = F₀.

    force: F₀ [N].
    """

    force: Triple

    def linear(self) -> LinearField:
        """Return the field as M and F₀."""
        return LinearField(_NOTHING, self.force)


class Linear(_Kind, frozen=True, kw_only=True, tag="linear"):
    """Any linear field, F = M v + F₀.

    matrix: M, by rows [N s/m].
    force: F₀ [N].
    """

    matrix: FieldMatrix
    force: Triple = ZERO

    def linear(self) -> LinearField:
        """Return the field as M and F₀."""
        return LinearField(self.matrix, self.force)


ForceField: TypeAlias = NoField | Viscous | Curl | Constant | Linear


def check_axes(field: ForceField, axes: Sequence[str], where: str) -> None:
    """Raise ParameterError if a field needs an axis that the scene does not compute.

    A viscous field with one gain acts on the computed axes.
    """
    if isinstance(field, Viscous) and field.gains is None:
        return
    if missing := [axis for axis in field.linear().axes() if axis not in axes]:
        raise ParameterError(
            f"acts along {', '.join(missing)}, but run.axes is [{', '.join(axes)}]; name these"
            " axes in run.axes, or leave run.axes out",
            path=where,
        )


def needed_axes(field: ForceField) -> tuple[Axis, ...]:
    """Return the axes that a scene must compute for a field."""
    if isinstance(field, Viscous) and field.gains is None:
        return ()
    return field.linear().axes()


def begin_field(s: CouplingState, field: ForceField, period: float) -> bool:
    """Set the field of a coupling. Return whether it is another one, whose force is eased in."""
    matrix, force = field.linear()
    gains = [gain / period for row in matrix for gain in row]
    if list(s.field_gain) == gains and list(s.field_force) == list(force):
        return False
    s.field_gain[:], s.field_force[:] = gains, force
    if s.field == 0:  # the last position is not known
        s.field_due = 0
        s.field_way[:] = ZERO
    s.field = int(any(gains) or any(force))
    return True


@rule
def add_field(
    s: CouplingState, position: Any, force: MutableSequence[float], due: int
) -> None:
    """Add the field's force to a tick's [N]; `due` is the number of its deflection.

    The velocity is the way from the last position over the ticks between; after a jump of the
    position, which is no motion, it is that of before. A tick that is rendered again has the same.
    """
    if due > s.field_due:
        if s.field_due > 0:
            ticks = due - s.field_due
            for i in range(3):
                s.field_way[i] = (position[i] - s.field_at[i]) / ticks
        for i in range(3):
            s.field_at[i] = position[i]
        s.field_due = due
    for n in range(s.axes):
        i = s.axis[n]
        force[i] += (
            s.field_force[i]
            + s.field_gain[3 * i] * s.field_way[0]
            + s.field_gain[3 * i + 1] * s.field_way[1]
            + s.field_gain[3 * i + 2] * s.field_way[2]
        )
