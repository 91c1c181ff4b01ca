"""What a device says of itself, which is code of somebody else's on the thread that serves requests."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from messages.event_kinds import EventKind

if TYPE_CHECKING:
    from nodes.base.node import Node


class Condition:
    """The condition of a driver's device: why it gives no force, or what it raised when it was asked."""

    def __init__(self, node: Node, ask: Callable[[], str]) -> None:
        self._node, self._ask = node, ask
        self._last = ""  # what it said last
        self._failed = ""  # what it raised, which ends the run

    def told(self) -> str:
        """Return what keeps forces off; a device that raises ends the run softly, and is not asked again."""
        if self._failed:
            return self._failed
        try:
            return self._ask()
        except Exception as error:  # noqa: BLE001  # whatever a vendor's library raises: requests go on being served
            node = self._node
            self._failed = (
                f"{node.setup.name}: condition() of the device failed: {type(error).__name__}:"
                f" {error}"
            )
            node.events.emit(
                "device", f"{self._failed}; the force is brought down to zero, and the driver ends"
            )
            node.failing = True
            node.stop(self._failed)
            return self._failed

    def report(self) -> None:
        """Publish a condition that has changed."""
        now = self.told()
        if now != self._last:
            self._last = now
            kind: EventKind = "device_force" if now else "device_force_back"
            self._node.events.emit_each(kind, now or "nothing keeps forces off any more")
