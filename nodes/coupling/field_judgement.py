"""Stability of a coupling's laws in its force field (nodes/stability/field_loop.py)."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from nodes.base.setup import AXIS_INDEX
from nodes.coupling.felt_law import slow
from nodes.coupling.force_fields import Constant, ForceField, NoField
from nodes.laws import CompiledLaw

if TYPE_CHECKING:
    from nodes.stability.judge import Verdict
    from nodes.stability.plant import Plant

# a law that a surface or region makes of the one that renders, and whether it lacks a stiffness
FeltLaw = tuple[CompiledLaw, bool]
_HALVINGS = 20


def resistance_of(field: ForceField, axes: Sequence[str]) -> Any:
    """Return R of F = −R v along the computed axes [N s/m], shape (n, n)."""
    import numpy as np

    indices = [AXIS_INDEX[axis] for axis in axes]
    return -np.array(field.linear().matrix)[np.ix_(indices, indices)]


def worst_in_field(
    felt: Iterable[FeltLaw],
    plants: Sequence[Plant],
    field: ForceField,
    axes: Sequence[str],
    where: str,
) -> Verdict | None:
    """Return the worst verdict in a field, None if nothing is judged; `where`: its path."""
    if isinstance(field, NoField | Constant):
        return None
    from nodes.stability.field_loop import judge_in_field

    resistance = resistance_of(field, axes)
    found = [
        judge_in_field(law, plant, resistance, springless)
        for law, springless in felt
        for plant in plants
    ]
    judged = [verdict for verdict in found if verdict is not None]
    unstable = [verdict for verdict in judged if not verdict.stable]
    if not judged:
        return None
    worst = max(unstable or judged, key=lambda one: one.pole_radius)
    return replace(worst, felt=f"{where}, {worst.felt}")


def largest_share(
    felt: Sequence[FeltLaw],
    plants: Sequence[Plant],
    field: ForceField,
    axes: Sequence[str],
) -> float:
    """Return the largest part of a field, from none on, that is stable with these laws."""
    from nodes.stability.field_loop import judge_in_field
    from nodes.stability.judge import last_inside

    resistance = resistance_of(field, axes)

    def holds(share: float) -> bool:
        found = [
            judge_in_field(law, plant, share * resistance, springless)
            for law, springless in felt
            for plant in plants
        ]
        return all(verdict is None or verdict.stable for verdict in found)

    return last_inside(holds, 0.0, 1.0, _HALVINGS)


def field_text(
    field: ForceField, law: CompiledLaw, period: float, axes: Sequence[str]
) -> str:
    """Return a field in words, and with which stiffness and damping it is felt at a surface."""
    if isinstance(field, NoField):
        return ""
    matrix, force = field.linear()
    indices = [AXIS_INDEX[axis] for axis in axes]
    parts = []
    for i, axis in zip(indices, axes, strict=True):
        terms = [
            f"{matrix[i][j]:+g} v{of}" for j, of in enumerate("xyz") if matrix[i][j]
        ]
        terms += [f"{force[i]:+g} N"] if force[i] else []
        parts += [f"{axis}: {' '.join(terms)}"] if terms else []
    texts = [f"F = ({', '.join(parts)})"]
    damping = {-matrix[i][i] for i in indices} - {0.0}
    if damping and law.evaluate is None:
        stiffness, slope = slow(law, period)
        felt = " and ".join(f"{slope + b:.3g}" for b in sorted(damping))
        texts.append(f"the law is felt with K {stiffness:.4g} N/m, B {felt} N s/m")
    return "; ".join(texts)


def unjudged_field(
    field: ForceField, laws: Iterable[tuple[str, CompiledLaw]], moves: bool, where: str
) -> str:
    """Return why laws are not judged in a field; empty if they are.

    `moves`: whether what the coupling is coupled to is a body of its own.
    """
    if isinstance(field, NoField | Constant):
        return ""
    if moves:
        return f"{where} beside a body that moves, or a second device"
    from nodes.stability.field_loop import LONGEST

    for name, law in laws:
        if len(law.taps) > LONGEST:
            return f"{where} with {name}, a law of more than {LONGEST} taps"
    return ""
