"""A driver's safety with its events, driven as the driver does it."""

from __future__ import annotations

from typing import Any

from messages.types import ZERO, Force, Vector
from nodes.driver.device import DeviceLimits
from nodes.driver.limits import SafetyParameters
from nodes.driver.safety import Safety

T = 0.002
UP: Vector = (0.0, 0.0, 1.0)


def force(seq: int, z: float = 1.0) -> Force:
    return Force(seq=seq, stamp=0.0, force=(0.0, 0.0, z))


class Port:
    """A safety with its events, driven as the driver does it."""

    def __init__(
        self, device: DeviceLimits | None = None, axes: tuple[int, ...] = (0, 1, 2), **parameters: Any
    ) -> None:
        self.events: list[tuple[str, str]] = []
        self.velocity: Vector = ZERO
        self.safety = Safety(
            SafetyParameters(**parameters),
            device or DeviceLimits(),
            T,
            list(axes),
            lambda kind, reason: self.events.append((kind, reason)),
        )

    def answer(self, message: Force, tick: int) -> bool:
        """Let a force arrive; tell whether it was admitted."""
        if not self.safety.admit(message, tick):
            return False
        self.safety.command(message.force, message.seq, tick, lambda: self.velocity)
        return True

    def changes(self) -> list[str]:
        """List the changes of state that were told."""
        return [text.split(" at tick")[0] for kind, text in self.events if kind == "safety"]
