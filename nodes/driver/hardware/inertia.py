"""The mass that a law feels on a device of direction- and position-dependent inertia.

A force along a direction u moves a device of inertia M like one mass 1/(uᵀ M⁻¹ u), because the
other directions yield. Over all directions that lies between the smallest and the largest
eigenvalue of M.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

import numpy as np

from messages.types import Vector

Inertia = tuple[Vector, Vector, Vector]


def masses_along(
    inertia: Sequence[Sequence[float]],
) -> tuple[Vector, tuple[float, float]]:
    """Return the mass along x, y and z, and the extremes over all directions [kg].

    Raises ValueError if the inertia is invalid.
    """
    matrix = np.array(inertia, dtype=float)
    if not np.isfinite(matrix).all():
        raise ValueError("the device's inertia is not finite")
    values = np.linalg.eigvalsh(0.5 * (matrix + matrix.T))
    if not values[0] > 0.0:
        raise ValueError(f"the device's inertia is not positive: {values.tolist()} kg")
    x, y, z = (1.0 / np.diag(np.linalg.inv(matrix))).tolist()
    return (x, y, z), (float(values[0]), float(values[-1]))


class SeenMasses:
    """Smallest and largest mass of a device over all its poses so far; thread-safe."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._range: tuple[float, float] | None = None

    def record(self, inertia: Inertia | None) -> dict[str, Any] | None:
        """Record a pose. Return its masses and those of all poses so far [kg]; None if unknown."""
        if inertia is None:
            return None
        try:
            here, (least, greatest) = masses_along(inertia)
        except ValueError:
            return None
        with self._lock:
            low, high = self._range or (least, greatest)
            self._range = low, high = min(low, least), max(high, greatest)
        return {"here_kg": list(here), "least_kg": low, "greatest_kg": high}
