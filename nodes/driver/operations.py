"""Requests that hold up or release a driver's loop: pause it, and rearm it after a stop."""

from __future__ import annotations

import time
from typing import Any

from nodes.base.node import Node
from nodes.driver.safety import rearm
from nodes.driver.state import DriverState
from nodes.parameters.interface_words import COMMAND_LINE
from nodes.parameters.store import ParameterError

LONGEST_PAUSE = 60.0  # longest pause of a loop in lockstep per request [s]


class DriverOperations:
    """Requests to one driver (control thread).

    Attributes
    ----------
    paused_until : float
        Monotonic time until which the loop pauses between two ticks [s].
    """

    def __init__(self, node: Node, state: DriverState, virtual: bool) -> None:
        self._node, self._state, self._virtual = node, state, virtual
        self.paused_until = 0.0

    def rearm(self, beside: bool = False) -> dict[str, Any]:
        """Rearm after a stop; a real device only if somebody is `beside` it."""
        name = self._node.setup.name
        if not (self._virtual or beside):
            raise ParameterError(
                "the driver of a real device has stopped an unstable loop; choose a "
                f"softer law, stand beside the device, then {COMMAND_LINE.rearm}",
                path=name,
            )

        def apply(seq: int) -> dict[str, Any]:
            if not rearm(self._state, seq):
                raise ParameterError(
                    "has not stopped the loop; nothing was changed", path=name
                )
            return {"seq": seq}

        receipt: dict[str, Any] = self._node.changes.hand_over(apply)
        return receipt

    def pause(self, seconds: float) -> dict[str, Any]:
        """Pause the lockstep loop for `seconds` (0 resumes), to free the CPU meanwhile."""
        name = self._node.setup.name
        if self._state.realtime:
            raise ParameterError(
                "only a lockstep loop can pause; a device in real time cannot wait",
                path=name,
            )
        if not (isinstance(seconds, int | float) and 0.0 <= seconds <= LONGEST_PAUSE):
            raise ParameterError(
                f"a pause of {seconds!r} s: expected 0 to {LONGEST_PAUSE:g} s",
                path=name,
            )
        self.paused_until = time.monotonic() + seconds
        self._node.events.notify()
        return {}
