"""A driver's safety with its own state, driven as the driver's tick does."""

from __future__ import annotations

from typing import Any

from messages.types import ZERO, Force, Vector
from nodes.driver import safety, safety_setup, swings
from nodes.driver.device import DeviceLimits
from nodes.driver.force_words import take_notes
from nodes.driver.limits import SafetyParameters, lower
from nodes.driver.motion import set_motion
from nodes.driver.passivity import PassivityParameters, set_guard
from nodes.driver.state import LIMITED, REFUSED, SAFETY, DriverState

T = 0.002
UP: Vector = (0.0, 0.0, 1.0)


def force(seq: int, z: float = 1.0) -> Force:
    return Force(seq=seq, stamp=0.0, force=(0.0, 0.0, z))


def state_of(axes: tuple[int, ...] = (0, 1, 2), latency: float = 0.0) -> Any:
    """Create a driver's state without limits, which keeps its buffers alive."""
    s: Any = DriverState()
    s.period, s.virtual, s.axes, s.axis[:] = T, 1, len(axes), (*axes, 0, 0)[:3]
    s.kept = set_motion(s, latency)
    return s


class Port:
    """A safety with its events."""

    def __init__(
        self,
        device: DeviceLimits | None = None,
        axes: tuple[int, ...] = (0, 1, 2),
        guard: PassivityParameters | None = None,
        **parameters: Any,
    ) -> None:
        self.s = state_of(axes)
        self._events: list[tuple[str, str]] = []
        # What a first force does is said where it is tried.
        given = SafetyParameters(**{"ramp": 0.0, **parameters})
        self.limits = lower(given, device or DeviceLimits(), T)
        safety_setup.set_safety(self.s, given, self.limits, T)
        set_guard(self.s, guard)
        self.moves(ZERO)

    @property
    def state(self) -> str:
        """Present safety state."""
        return SAFETY[self.s.safety]

    @property
    def force(self) -> Vector:
        """Last force handed over."""
        x, y, z = self.s.force
        return x, y, z

    @property
    def refused(self) -> dict[str, int]:
        """Forces refused, by reason."""
        return dict(zip(REFUSED, self.s.refused_for, strict=True))

    @property
    def limited(self) -> dict[str, int]:
        """Forces limited, by limit."""
        return dict(zip(LIMITED, self.s.limited_by, strict=True))

    @property
    def events(self) -> list[tuple[str, str]]:
        """Kind and reason of all events."""
        self._events += [(note.kind, note.reason) for note in take_notes(self.s)]
        return self._events

    def moves(self, velocity: Vector) -> None:
        """Move the device."""
        self.s.before[:] = ZERO
        self.s.position[:] = [T * v for v in velocity]
        self.s.elapsed = 1

    def answer(self, message: Force, tick: int) -> bool:
        """Deliver a force; return whether it was admitted."""
        self.s.got_seq, self.s.got[:] = message.seq, message.force
        if not safety.admit(self.s, tick):
            return False
        safety.command(self.s, tick, 0.0)
        return True

    def missed(self, tick: int, velocity: Vector) -> Vector | None:
        """Close a tick without a force; return what is handed over, if anything."""
        self.moves(velocity)
        is_written = safety.missed(self.s, tick)
        self.moves(ZERO)
        return self.force if is_written else None

    def watch_position(self, position: Vector, tick: int) -> bool:
        """Process a position."""
        self.s.place[:] = position
        return safety.watch_position(self.s, tick)

    def watch_swings(self, energy: float, velocity: Vector, tick: int) -> None:
        """Run the detection of swings."""
        self.moves(velocity)
        self.s.energy = energy
        if self.s.stop_after:
            swings.watch_swings(self.s, tick)

    def changes(self) -> list[str]:
        """Return the changes of state reported."""
        return [
            text.split(" at tick")[0] for kind, text in self.events if kind == "safety"
        ]
