"""A hand on the virtual device: its target, its grip and its path."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module

import msgspec

from nodes.compiled.rules import rule
from nodes.parameters.checked import NonNegative, Positive, check_fields
from nodes.parameters.paths import LocalPath


class Hand(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A hand that holds the device: mass, damper, and a spring to a point on a path.

    mass: Mass that moves with the device [kg].
    damping: Viscous damping against the ground [N s/m].
    stiffness: Spring between the device and the path [N/m].
    path: Time [s] and position [m] of the corners of a piecewise linear path, times increasing;
        held before the first and after the last. It is sampled at ticks and held between them.
    repeat: Period of the path [s], at least the time of its last corner; None for once.
    file: In place of `path`: a CSV, NPZ, MAT or Parquet file, or a recording, with the path of one
        axis or of three; its times count from its first row.
    columns: Columns of `position` (one, or three) and `time` in the file; empty: those of the usual
        names. Of a recording, `position: target` is where its hand pulled to.
    units: Units of `position` and `time` in the file; empty: those in the names, else SI.
    rate: Rows per second in a file without times [Hz]; None: it has times.
    """

    stiffness: Positive
    path: list[tuple[float, float]] = []
    repeat: Positive | None = None
    file: LocalPath = ""
    columns: dict[str, str | list[str]] = {}
    units: dict[str, str] = {}
    rate: Positive | None = None
    mass: NonNegative = 0.0
    damping: NonNegative = 0.0

    def __post_init__(self) -> None:
        check_fields(self, "hand")
        if bool(self.path) == bool(self.file):
            both = "both are given" if self.path else "neither is given"
            way = "; path: [] leaves out that of a launch file" if self.path else ""
            raise ValueError(f"path or file: {both}; expected one of them{way}")
        if not self.file and (self.columns or self.units or self.rate is not None):
            raise ValueError("columns, units and rate are of a file, but path is given")
        for name, given in (("columns", self.columns), ("units", self.units)):
            if other := set(given) - {"position", "time"}:
                raise ValueError(f"{name}.{min(other)}: expected position or time")
        if self.file:
            end = self.length
            if self.repeat is not None and self.repeat < end:
                raise ValueError(
                    f"repeat is {self.repeat} s, but the path ends at {end:g} s: repeat later"
                )
            return
        for i, (time, _) in enumerate(self.path):
            if i and time <= self.path[i - 1][0]:
                raise ValueError(
                    f"path[{i}] has time {time} s after {self.path[i - 1][0]} s: times must"
                    " increase"
                )
        if self.repeat is not None and self.repeat < self.path[-1][0]:
            raise ValueError(
                f"repeat is {self.repeat} s, but the path ends at {self.path[-1][0]} s: repeat"
                " later"
            )

    def paths(self) -> dict[str, list[tuple[float, float]]]:
        """Return the paths in the file by axis; empty without a file."""
        if not self.file:
            return {}
        # Only a hand that reads a file needs what reads it. It is imported by name because a
        # kernel is compiled anew when a module changes that it imports.
        read_path = import_module("sim.device.hand_path").read_path
        found: dict[str, list[tuple[float, float]]] = read_path(
            self.file, self.columns, self.units, self.rate or 0.0
        )
        return found

    @property
    def corners(self) -> list[tuple[float, float]]:
        """Path of the scene's first axis."""
        return self.path or next(iter(self.paths().values()))

    @property
    def length(self) -> float:
        """Time of the path's last corner [s]."""
        return max(
            corners[-1][0] for corners in [self.path, *self.paths().values()] if corners
        )

    def along(self, axis: str, is_first: bool) -> Hand:
        """Return the hand along an axis, with that path of its file.

        A path of one axis is that of the first axis of the scene; along others the hand rests at 0.
        """
        if self.file:
            paths = self.paths()
            only = next(iter(paths.values())) if len(paths) == 1 and is_first else None
            path = only or (paths.get(axis) if len(paths) > 1 else None)
        else:
            path = self.path if is_first else None
        return msgspec.structs.replace(
            self,
            path=path or [(0.0, 0.0)],
            repeat=self.repeat if path else None,
            file="",
            columns={},
            units={},
            rate=None,
        )

    def point(self, time: float) -> float:
        """Return the point of the path at a time [s], to which the hand pulls [m]."""
        return path_position(
            self.corners, time if self.repeat is None else time % self.repeat
        )


@rule
def path_position(path: Sequence[tuple[float, float]], time: float) -> float:
    """Return the point of a piecewise linear path (times [s], positions [m]) at `time`."""
    # Binary search for the first corner after that time.
    i = 0
    end = len(path)
    while i < end:
        middle = (i + end) // 2
        if time < path[middle][0]:
            end = middle
        else:
            i = middle + 1
    if i == 0:
        return path[0][1]
    if i == len(path):
        return path[i - 1][1]
    t0, x0 = path[i - 1][0], path[i - 1][1]
    t1, x1 = path[i][0], path[i][1]
    return x0 + (x1 - x0) * ((time - t0) / (t1 - t0))
