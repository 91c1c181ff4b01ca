"""Supervision of a loop that calls a device, which alone can remove its force if it hangs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from nodes.base.hang_watchdog import HangWatchdog, LastResort, give_up
from nodes.driver.device import DeviceLimits

if TYPE_CHECKING:
    from nodes.base.node import Node


class Watch:
    """Current activity of the loop's thread and its time limit; ends a process that hangs."""

    def __init__(
        self, node: Node, limits: DeviceLimits, last_resort: LastResort | None
    ) -> None:
        self._node, self._limits, self._last_resort = node, limits, last_resort
        self._watchdog = HangWatchdog()
        self._doing = ("", math.inf)

    def begin(self, what: str, limit: float = math.inf) -> None:
        """Record the activity of the loop's thread and its longest duration [s]."""
        self._doing = (what, limit)
        self._postpone(limit)

    def end(self) -> None:
        """End the supervision."""
        self.begin("")
        if self._last_resort is not None:
            self._last_resort.stop()

    def check(self, progress: tuple[int, ...]) -> None:
        """End the process if there is no progress for too long (control thread)."""
        what, limit = self._doing
        self._postpone(limit)
        if self._watchdog.check((what, *progress)) >= limit:
            hold = self._limits.hold
            lets_go = (
                f"it lets go by itself after {hold:g} s"
                if math.isfinite(hold)
                else "it may hold its last force"
            )
            give_up(
                self._node,
                f"the device hangs: no end of {what} within {limit:g} s; {lets_go}",
            )

    def _postpone(self, limit: float) -> None:
        if self._last_resort is not None:
            self._last_resort.postpone(
                limit if math.isfinite(limit) else self._limits.opening
            )
