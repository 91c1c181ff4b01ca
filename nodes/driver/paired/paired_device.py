"""Two devices as one: positions, forces and limits of both, aligned."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack

import msgspec

from messages.types import ZERO, Vector
from nodes.driver.calls import Jumps
from nodes.driver.device import Device, DeviceLimits, Workspace


class Alignment(msgspec.Struct, frozen=True, kw_only=True):
    """How two devices with an initial distance are brought together.

    Attributes
    ----------
    step : float
        Decrease of their offset per tick [m].
    apart : float
        Largest initial distance along an axis [m].
    """

    step: float
    apart: float = math.inf


class PairedDevice:
    """Two devices as one; `limits` are those of each device, if lower than its own.

    With an `alignment` the pair begins at zero, wherever its devices are: a distance without motion
    is an offset, which decreases. After a gap in either position, or a jump of either, the pair
    continues from its last position in the same way.
    """

    def __init__(
        self,
        first: Device,
        second: Device,
        limits: Sequence[DeviceLimits] = (),
        alignment: Alignment | None = None,
    ) -> None:
        self.first, self.second = first, second
        self._alignment = alignment
        self._jumps = Jumps(first), Jumps(second)
        self._place: Vector = ZERO  # last position of the pair
        self._offset: Vector = ZERO
        self._read_at = -1
        # offset when they were last aligned [m]
        self.met_apart = 0.0
        self._device_limits = tuple(limits) or (first.limits, second.limits)
        nowhere = (math.nan, math.nan, math.nan)
        self.places: tuple[Vector, Vector] = (nowhere, nowhere)
        self._known = False  # whether both positions are valid, so that a force may act

    @property
    def limits(self) -> DeviceLimits:
        """The lower of each limit; as workspace, all possible differences of positions."""
        a, b = self._device_limits
        x, y, z = (
            (p[0] - q[1], p[1] - q[0])
            for p, q in zip(a.workspace, b.workspace, strict=True)
        )
        workspace: Workspace = (x, y, z)
        known = None not in (a.latency, b.latency)
        return DeviceLimits(
            peak_force=min(a.peak_force, b.peak_force),
            continuous_force=min(a.continuous_force, b.continuous_force),
            slew=min(a.slew, b.slew),
            silence=min(a.silence, b.silence),
            # No force remains once the later device has let go; after the earlier one, a single
            # device is left.
            hold=max(a.hold, b.hold),
            lets_go=min(
                one.hold if one.lets_go is None else one.lets_go for one in (a, b)
            ),
            latency=max(a.latency or 0.0, b.latency or 0.0) if known else None,
            opening=a.opening + b.opening,
            closing=a.closing + b.closing,
            workspace=workspace,
        )

    def open(self) -> None:
        """Open both, or none."""
        with ExitStack() as opened:
            for device in (self.first, self.second):
                opened.callback(device.close)
                device.open()
            opened.pop_all()

    def read_position(self, seq: int) -> Vector:
        """Return their distance; NaN if a position is unknown, or outside its own workspace."""
        a = self.first.read_position(seq)
        b = self.second.read_position(seq)
        self.places = a, b
        # record jumps also while a position is unknown
        jumped = [jumps.again() for jumps in self._jumps]
        was_known = self._known and not any(jumped)
        finite = all(math.isfinite(x) for x in (*a, *b))
        self._known = finite and not self.outside()
        if not self._known:
            return (math.nan, math.nan, math.nan)
        apart = (a[0] - b[0], a[1] - b[1], a[2] - b[2])
        if self._alignment is None:
            return apart
        return self._aligned(apart, seq, was_known, self._alignment)

    def _aligned(
        self, apart: Vector, seq: int, was_known: bool, alignment: Alignment
    ) -> Vector:
        """Return the position of the pair: the devices' distance less an offset that decreases."""
        if self._read_at < 0 and max(map(abs, apart)) > alignment.apart:
            raise OSError(
                f"the devices stand ({', '.join(f'{x:.4g}' for x in apart)}) m apart, limit apart:"
                f" {alignment.apart:g} m; move them together, or raise the limit"
            )
        x, y, z = self._offset
        if not was_known:
            x, y, z = (
                now - before for now, before in zip(apart, self._place, strict=True)
            )
            self.met_apart = math.hypot(x, y, z)
        else:
            size = math.hypot(x, y, z)
            left = size - alignment.step * (seq - self._read_at)
            share = left / size if left > 0.0 else 0.0
            x, y, z = x * share, y * share, z * share
        self._offset = (x, y, z)
        self._read_at = seq
        self._place = apart[0] - x, apart[1] - y, apart[2] - z
        return self._place

    def outside(self) -> str:
        """Return which of them is outside its own workspace, or ""."""
        for name, place, limits in zip(
            ("first", "second"), self.places, self._device_limits, strict=True
        ):
            for axis, at, (low, high) in zip(
                "xyz", place, limits.workspace, strict=True
            ):
                if not low <= at <= high and math.isfinite(at):
                    return (
                        f"{name}: {axis} = {at:.4g} m, outside its workspace of {low:.4g} to"
                        f" {high:.4g} m"
                    )
        return ""

    def write_force(self, force: Vector, seq: int, offset: float) -> None:
        """Push the first device, and the second the opposite way; none if a position is unknown."""
        x, y, z = force if self._known else (0.0, 0.0, 0.0)
        self.first.write_force((x, y, z), seq, offset)
        self.second.write_force((-x, -y, -z), seq, offset)

    def close(self) -> None:
        """Close both, even if the first fails."""
        try:
            self.first.close()
        finally:
            self.second.close()
