"""Regions that overlap act together; the coupling judges its law on their sum, too.

Overlap is decided by bounding boxes along the axes, so it is never missed. Boxes of which each two
overlap have a point in common, a largest lower corner (Helly's theorem for boxes).
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from math import inf, sqrt
from typing import TypeAlias

from nodes.base.setup import Effect
from nodes.environment.shapes import tables as t
from nodes.environment.shapes.scene import FeltRegion, Solid

Extent: TypeAlias = tuple[float, float]
_FEW = 6  # regions near one of which all common points are tried


def overlap_effects(
    regions: Sequence[FeltRegion], effects: Sequence[Effect]
) -> list[Effect]:
    """Return what regions do to a law where several of them act.

    Parameters
    ----------
    regions : sequence of FeltRegion
        All regions of a scene.
    effects : sequence of Effect
        What each of them does to a law, shape (len(regions),).

    Returns
    -------
    list of Effect
        One for each set of regions with a point in common: their times added, and their pulls.
    """
    boxes = [_bounds(region.shape) for region in regions]
    together: set[frozenset[int]] = set()
    for box in boxes:
        near = [m for m, other in enumerate(boxes) if _overlap(box, other)]
        if len(near) > _FEW:
            together.add(frozenset(near))
            continue
        for point in product(*({boxes[m][k][0] for m in near} for k in range(3))):
            together.add(
                frozenset(
                    m
                    for m in near
                    if all(
                        low <= x <= high
                        for x, (low, high) in zip(point, boxes[m], strict=True)
                    )
                )
            )
    largest = [one for one in together if not any(one < other for other in together)]
    return [
        _sum([effects[m] for m in sorted(one)])
        for one in sorted(largest, key=sorted)
        if len(one) > 1
    ]


def _sum(parts: Sequence[Effect]) -> Effect:
    lines = [one for one in parts if one.line]
    return Effect(
        name=" with ".join(one.name for one in parts),
        stiffness=sum(one.stiffness for one in lines) if lines else 1.0,
        damping=sum(one.damping for one in lines) if lines else 1.0,
        lag=sum(one.lag for one in parts),
        line=bool(lines),
    )


def _overlap(one: Sequence[Extent], other: Sequence[Extent]) -> bool:
    return all(a[0] <= b[1] and b[0] <= a[1] for a, b in zip(one, other, strict=True))


def _bounds(shape: Solid) -> tuple[Extent, ...]:
    """Return the lowest and the highest coordinate of a shape on each axis [m]."""
    numbers = shape.numbers
    reach: list[float] = [inf] * 3
    centre = list(numbers[:3])
    if shape.kind == t.SPHERE:
        reach = [numbers[3]] * 3
    elif shape.kind == t.BOX:
        half = numbers[12:15]
        reach = [
            sum(abs(numbers[3 + 3 * i + k]) * half[i] for i in range(3))
            for k in range(3)
        ]
    elif shape.kind == t.CAPSULE:
        length, radius = numbers[6:8]
        centre = [numbers[k] + 0.5 * length * numbers[3 + k] for k in range(3)]
        reach = [0.5 * length * abs(numbers[3 + k]) + radius for k in range(3)]
    elif shape.kind == t.CYLINDER:
        half_length, radius = numbers[6:8]
        reach = [
            half_length * abs(a) + radius * sqrt(max(1.0 - a * a, 0.0))
            for a in numbers[3:6]
        ]
    return tuple((c - r, c + r) for c, r in zip(centre, reach, strict=True))
