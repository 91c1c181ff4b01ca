"""Shells of a mesh: which look inwards, and which of those are cavities of another."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from nodes.environment.shapes.mesh_edges import Flags
from nodes.environment.shapes.polygons import Coordinates, Ids
from nodes.environment.shapes.triangle_sets import signed_volumes

MOST_SHELLS = 20_000  # of a mesh of which some look inwards
# triangles of shells that are asked whether they contain another
_MOST_WORK = 50_000_000
_PROBES = 5  # places of a shell at which it is asked whether another contains it


class ShellTurns(NamedTuple):
    """Which closed shells look inwards and are to be turned, and which remain cavities."""

    turn: Flags  # shape (shells,)
    cavity: Flags  # shape (shells,)


def winding_number(corners: Coordinates, places: Coordinates) -> Coordinates:
    """Return how often triangles, shape (n, 3, 3), enclose each place, shape (m, 3).

    1 within a solid, 0 outside (van Oosterom and Strackee 1983).
    """
    found = np.empty(len(places))
    for i, place in enumerate(places):
        spokes = corners - place
        a, b, c = spokes[:, 0], spokes[:, 1], spokes[:, 2]
        la, lb, lc = np.linalg.norm(spokes, axis=2).T
        product = np.einsum("ij,ij->i", a, np.cross(b, c))
        divisor = (
            la * lb * lc
            + np.einsum("ij,ij->i", a, b) * lc
            + np.einsum("ij,ij->i", b, c) * la
            + np.einsum("ij,ij->i", c, a) * lb
        )
        found[i] = np.arctan2(product, divisor).sum() / (2.0 * np.pi)
    return found


def shell_turns(corners: Coordinates, shell: Ids, closed: Flags) -> ShellTurns:
    """Return which shells of triangles, shape (n, 3, 3), are to be turned.

    A shell within another keeps the orientation that it has to it in the file: a cavity stays one.
    Raises ValueError if there are too many shells to compare.
    """
    count = len(closed)
    volume = signed_volumes(corners, shell, count)
    turn = np.zeros(count, dtype=bool)
    cavity = np.zeros(count, dtype=bool)
    if not (closed & (volume < 0.0)).any():
        return ShellTurns(turn, cavity)
    if count > MOST_SHELLS:
        raise ValueError(
            f"has {count} shells, some of which look inwards; at most {MOST_SHELLS} can be"
            " compared: split the mesh into files of fewer"
        )
    work = 0
    low = np.full((count, 3), np.inf)
    high = np.full((count, 3), -np.inf)
    np.minimum.at(low, shell, corners.min(axis=1))
    np.maximum.at(high, shell, corners.max(axis=1))
    order = np.argsort(shell, kind="stable")
    bounds = np.searchsorted(shell[order], np.arange(count + 1))
    # From large to small, so that a shell comes after those that may contain it.
    by_size = np.argsort(-np.abs(volume), kind="stable")
    by_size = by_size[closed[by_size]]
    lower, upper = low[by_size], high[by_size]
    for place, s in enumerate(by_size.tolist()):
        if volume[s] > 0.0 and not turn.any():
            continue
        contains = (lower[:place] <= low[s]).all(axis=1) & (
            upper[:place] >= high[s]
        ).all(axis=1)
        around = by_size[:place][contains]
        holder = -1
        if volume[s] < 0.0 or turn[around].any():
            mine = order[bounds[s] : bounds[s + 1]]
            probes = corners[
                mine[np.linspace(0, len(mine) - 1, _PROBES).astype(int)]
            ].mean(axis=1)
            for other in around[::-1].tolist():
                faces = corners[order[bounds[other] : bounds[other + 1]]]
                work += len(faces)
                if work > _MOST_WORK:
                    raise ValueError(
                        "has too many shells within others to compare them; split the mesh"
                    )
                if (np.rint(winding_number(faces, probes)) != 0.0).sum() >= _PROBES - 1:
                    holder = other
                    break
        turn[s] = volume[s] < 0.0 if holder < 0 else turn[holder]
        cavity[s] = holder >= 0 and (volume[s] < 0.0) != turn[s]
    return ShellTurns(turn, cavity)
