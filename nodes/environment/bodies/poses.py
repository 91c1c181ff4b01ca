"""Body poses for pages that draw them, written by the environment about 60 times a second.

Writer and readers map one small file in the run's private directory. It is sequence-locked like
nodes/driver/pointer.py: the writer increments a count before and after, and a reader uses the poses
only if both counts agree. Drawing costs the loop no message and no waiting.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nodes.base.shared_file import mapped

RATE = 60.0  # poses written per second
NUMBERS = 12  # floats per geom: position [m], then the rotation matrix by rows


def poses_file(run_dir: str | Path, node: str) -> Path:
    """Return the path of an environment's file of poses."""
    return Path(run_dir) / f"{node}.poses"


def file_size(count: int) -> int:
    """Return the file's length for `count` geoms [bytes]."""
    return 8 * (NUMBERS * count + 2)


class Poses:
    """Poses of a scene's geoms in a mapped file; the environment creates it (`make`)."""

    def __init__(self, path: Path, count: int, make: bool = False) -> None:
        self._map = mapped(path, file_size(count), make)
        numbers = np.frombuffer(self._map, dtype=np.uint64)
        self._after = numbers[:1]
        self._before = numbers[-1:]
        self._poses = numbers[1:-1].view(np.float64).reshape(count, NUMBERS)

    def write(self, places: NDArray[np.float64], turns: NDArray[np.float64]) -> None:
        """Write positions [m], shape (n, 3), and rotation matrices, shape (n, 9)."""
        self._before += np.uint64(1)
        self._poses[:, :3] = places
        self._poses[:, 3:] = turns
        self._after[:] = self._before

    def read(self) -> NDArray[np.float64] | None:
        """Return poses of shape (n, 12); None before the first, or during a write."""
        after = int(self._after[0])
        found = self._poses.copy()
        return found if after and after == int(self._before[0]) else None
