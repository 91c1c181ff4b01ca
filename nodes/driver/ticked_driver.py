"""A driver as its ticks see it: a node with a state between ticks, and a target."""

from __future__ import annotations

from messages.types import ZERO, Vector
from nodes.base.node import Node
from nodes.base.setup import Setup
from nodes.driver.state import DriverState


class TickedDriver(Node):
    """Base of `Driver`, which interpreted ticks, compiled ticks and the loop around them use.

    Attributes
    ----------
    driving : DriverState
        State between ticks; the node's counters are in it.
    """

    counters: DriverState

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.driving = self.counters

    @property
    def target(self) -> Vector:
        """Point to which a simulated hand pulls the device in this tick [m]; zero without one."""
        return ZERO
