"""Where the bodies of a scene are, for pages that draw them: the environment writes it some 60 times a second, a page reads it.

Both map one small file in the run's private directory, sequence-locked as nodes/driver/pointer.py
is: the writer counts up before and after, and a reader takes the poses only when both counts agree.
So drawing costs the loop no message and no waiting.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nodes.base.shared_file import mapped

RATE = 60.0  # poses that are written per second of the run
NUMBERS = 12  # of each geom: its place [m], then its rotation matrix by rows


def poses_file(run_dir: str | Path, node: str) -> Path:
    """Place of an environment's file of poses."""
    return Path(run_dir) / f"{node}.poses"


def file_size(count: int) -> int:
    """Length of the file for so many geoms [bytes]."""
    return 8 * (NUMBERS * count + 2)


class Poses:
    """Poses of the geoms of a scene, in a mapped file, which the environment makes."""

    def __init__(self, path: Path, count: int, make: bool = False) -> None:
        self._map = mapped(path, file_size(count), make)
        numbers = np.frombuffer(self._map, dtype=np.uint64)
        self._after, self._before = numbers[:1], numbers[-1:]
        self._poses = numbers[1:-1].view(np.float64).reshape(count, NUMBERS)

    def write(self, places: NDArray[np.float64], turns: NDArray[np.float64]) -> None:
        """Write where the geoms are: places of shape (n, 3) and rotation matrices of shape (n, 9)."""
        self._before += np.uint64(1)
        self._poses[:, :3] = places
        self._poses[:, 3:] = turns
        self._after[:] = self._before

    def read(self) -> NDArray[np.float64] | None:
        """Read them, of shape (n, 12); None before the first ones, and while they are written."""
        after = int(self._after[0])
        found = self._poses.copy()
        return found if after and after == int(self._before[0]) else None
