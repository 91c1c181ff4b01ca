"""A device's own condition; third-party code, called on the control thread."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from messages.event_kinds import EventKind

if TYPE_CHECKING:
    from nodes.base.node import Node


class Condition:
    """Why a driver's device gives no force, or the exception of its condition()."""

    def __init__(self, node: Node, ask: Callable[[], str]) -> None:
        self._node, self._ask = node, ask
        self._last = ""  # last condition
        self._failed = ""  # exception that ended the run

    def told(self) -> str:
        """Return why no force is given; if the device raises, the run ends softly."""
        if self._failed:
            return self._failed
        try:
            return self._ask()
        # any exception of a vendor's library; requests must still be served
        except Exception as error:  # noqa: BLE001
            node = self._node
            self._failed = (
                f"{node.setup.name}: condition() of the device failed: {type(error).__name__}:"
                f" {error}"
            )
            node.events.emit(
                "device",
                f"{self._failed}; the force ramps down to zero, and the driver ends",
            )
            node.failing = True
            node.stop(self._failed)
            return self._failed

    def report(self) -> None:
        """Report a changed condition."""
        now = self.told()
        if now != self._last:
            self._last = now
            kind: EventKind = "device_force" if now else "device_force_back"
            self._node.events.emit_each(kind, now or "the device applies forces again")
