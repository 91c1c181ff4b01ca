"""Measures of sets of triangles: heights, volumes."""

from __future__ import annotations

import numpy as np

from nodes.environment.shapes.polygons import Coordinates, Ids


def lowest_heights(corners: Coordinates) -> tuple[Coordinates, Coordinates]:
    """Return the height of each triangle over its longest edge, and the lengths of its edges."""
    along = np.roll(corners, -1, axis=1) - corners
    lengths = np.linalg.norm(along, axis=2)
    twice_area = np.linalg.norm(np.cross(along[:, 0], along[:, 1]), axis=1)
    return twice_area / np.maximum(lengths.max(axis=1), 1e-300), lengths


def signed_volumes(corners: Coordinates, part: Ids, count: int) -> Coordinates:
    """Return the volume of each of `count` parts, negative if its faces look inwards."""
    about = corners - corners.reshape(-1, 3).mean(axis=0)
    pieces = (
        np.einsum("ij,ij->i", about[:, 0], np.cross(about[:, 1], about[:, 2])) / 6.0
    )
    return np.asarray(np.bincount(part, pieces, minlength=count), dtype=np.float64)
