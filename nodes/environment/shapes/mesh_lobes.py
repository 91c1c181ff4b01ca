"""Parts of a closed mesh that are inside out, found by lines through it along the axes.

A mesh that crosses itself may have a part whose faces look inwards though no shell does as a whole.
There its winding number is negative: a tool enters that part without a force and is held in it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nodes.environment.shapes.mesh_edges import Flags
from nodes.environment.shapes.polygons import Coordinates, Ids

_LINES = 64  # along each side of the mesh
_MOST_WORK = 300_000  # pairs of a line and the box of a triangle, per axis
# places of the first line along each side [steps]: none runs through a face's edge or diagonal
_FIRST = np.array([0.4531, 0.6172, 0.5391])
_FLUSH = 1e-12  # distance of flush faces by rounding [of the largest coordinate]


class Lobe(NamedTuple):
    """A piece of a line within a part that is inside out."""

    place: tuple[float, float, float]  # its middle [m]
    length: float  # [m]


class _Lines(NamedTuple):
    """Lines along an axis of the mesh, at whole numbers of steps across it."""

    axis: int
    across: tuple[int, int]  # the other two axes
    low: Coordinates  # place of line 0, shape (2,) [m]
    step: Coordinates  # distance between neighbours, shape (2,) [m]


def inside_out(corners: Coordinates) -> Lobe | None:
    """Return the longest piece of a line where closed triangles (n, 3, 3) are inside out.

    `_LINES` by `_LINES` lines run along each axis: a part that all of them miss is not found.
    """
    low, high = corners.min(axis=1), corners.max(axis=1)
    found = [_along(corners, low, high, axis) for axis in range(3)]
    return max(
        (lobe for lobe in found if lobe is not None),
        key=lambda lobe: lobe.length,
        default=None,
    )


def _along(
    corners: Coordinates, low: Coordinates, high: Coordinates, axis: int
) -> Lobe | None:
    """Return the longest piece along an axis; `low` and `high` are those of each triangle."""
    across = ((axis + 1) % 3, (axis + 2) % 3)
    begin = low[:, across].min(axis=0)
    size = high[:, across].max(axis=0) - begin
    count = _LINES
    while True:
        step = size / count
        lines = _Lines(axis, across, begin + _FIRST[list(across)] * step, step)
        first = np.ceil((low[:, across] - lines.low) / step).astype(np.int64)
        last = np.floor((high[:, across] - lines.low) / step).astype(np.int64)
        sides = np.maximum(last - first + 1, 0)
        times = sides[:, 0] * sides[:, 1]
        if times.sum() <= _MOST_WORK or count == 1:
            break
        count //= 2
    which = np.repeat(np.arange(len(corners)), times)
    nth = np.arange(len(which)) - np.repeat(np.cumsum(times) - times, times)
    width = sides[which, 1]
    at = first[which] + np.stack([nth // width, nth % width], axis=1)
    seen = (corners[which][:, :, across] - lines.low) / step
    crossed = _is_across(seen, at)
    return _longest(lines, seen[crossed], corners[which[crossed], :, axis], at[crossed])


def _is_across(seen: Coordinates, at: Ids) -> Flags:
    """Return which triangles, seen along the lines, contain their line; at an edge one of two."""
    inside = np.zeros(len(at), dtype=bool)
    for k in range(3):
        one, other = seen[:, k], seen[:, (k + 1) % 3]
        # From the lower end, so that both triangles at an edge compute the same.
        turn = one[:, :1] > other[:, :1]
        low, high = np.where(turn, other, one), np.where(turn, one, other)
        between = (low[:, 0] <= at[:, 0]) & (at[:, 0] < high[:, 0])
        low, high, line = low[between], high[between], at[between]
        part = (line[:, 0] - low[:, 0]) / (high[:, 0] - low[:, 0])
        inside[between] ^= low[:, 1] + part * (high[:, 1] - low[:, 1]) > line[:, 1]
    return inside


def _longest(
    lines: _Lines, seen: Coordinates, along: Coordinates, at: Ids
) -> Lobe | None:
    """Return the longest piece with a negative winding number.

    Each row is a triangle that its line crosses: its corners across the lines [steps] and along
    them [m], and the line.
    """
    one, other = seen[:, 1] - seen[:, 0], seen[:, 2] - seen[:, 0]
    spoke = at - seen[:, 0]
    area = one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]
    flat = area == 0.0
    part = (spoke[:, 0] * other[:, 1] - spoke[:, 1] * other[:, 0]) / (area + flat)
    rest = (spoke[:, 1] * one[:, 0] - spoke[:, 0] * one[:, 1]) / (area + flat)
    place = along[:, 0] + part * (along[:, 1] - along[:, 0])
    place += rest * (along[:, 2] - along[:, 0])
    # A line enters the solid where a face looks against it.
    order = np.lexsort((place, at[:, 1], at[:, 0]))
    at, place, enters = at[order], place[order], -np.sign(area[order])
    new = np.concatenate([[True], (at[1:] != at[:-1]).any(axis=1)])
    begins = np.flatnonzero(new[: len(at)])
    if not len(begins):
        return None
    # Rounding may turn a triangle that is nearly parallel to its line.
    whole = np.add.reduceat(enters, begins) == 0.0
    good = np.repeat(whole, np.diff(np.append(begins, len(at))))
    at, place, enters = at[good], place[good], enters[good]
    negative = np.flatnonzero(np.cumsum(enters) < 0.0)
    if not len(negative):
        return None
    lengths = place[negative + 1] - place[negative]
    longest = int(lengths.argmax())
    if lengths[longest] <= _FLUSH * np.abs(along).max():
        return None
    k = negative[longest]
    middle = np.empty(3)
    middle[lines.axis] = 0.5 * (place[k] + place[k + 1])
    middle[list(lines.across)] = lines.low + at[k] * lines.step
    x, y, z = middle.tolist()
    return Lobe((x, y, z), float(lengths[longest]))
