"""The loop around a driver's ticks: it runs them, and handles whatever makes them return."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from messages import topics
from messages.types import ZERO
from nodes.driver.calls import numbers_of
from nodes.driver.device import Device
from nodes.driver.operations import DriverOperations
from nodes.driver.plain_tick import PlainTicks
from nodes.driver.state import BETWEEN, DriverState
from nodes.driver.tick import BROKEN, SILENT, UNREAD, take_sample

if TYPE_CHECKING:
    from nodes.driver.compiled_tick import DriverTicks
    from nodes.driver.ticked_driver import TickedDriver

# time after which an unanswered tick is published again in lockstep [s]: a node lost its answer
ASK_AGAIN = 0.5
PAUSE_POLL = 0.01  # interval of checking requests during a pause [s]


class TickLoop:
    """The loop of one driver.

    Parameters
    ----------
    driver : TickedDriver
        The node, for its events, its target and its work between ticks.
    device : Device
        Its device, which is open.
    plain : PlainTicks
        Its interpreted ticks.
    compiled : DriverTicks or None
        Its compiled ticks, which run if there are any.
    operations : DriverOperations
        Requests that pause the loop.
    """

    def __init__(
        self,
        driver: TickedDriver,
        device: Device,
        plain: PlainTicks,
        compiled: DriverTicks | None,
        operations: DriverOperations,
    ) -> None:
        self._driver, self._device, self._operations = driver, device, operations
        self._plain, self._compiled = plain, compiled

    def run(self, s: DriverState) -> None:
        """Run ticks until the last one, or until the driver stops."""
        driver, operations = self._driver, self._operations
        ticks = self._plain.run if self._compiled is None else self._compiled.run
        asked = 0.0
        while s.seq < s.until and not driver.stopping:
            if s.phase == BETWEEN and time.monotonic() < operations.paused_until:
                driver.between_ticks(s.seq)
                time.sleep(PAUSE_POLL)
                continue
            s.clock_offset = driver.clock.offset
            why = ticks(s)
            if why == SILENT:
                asked = max(asked, s.sampled)
                if time.monotonic() - asked > ASK_AGAIN:
                    asked = time.monotonic()
                    self._publish_again(s)
            # in the middle of a tick, work between ticks must wait
            if why == BROKEN:
                self._raise_device_error(s)
            elif why == UNREAD:
                s.pending_result = 1 + self._plain.take_up(s)
            elif driver.events.waiting or s.notes_count:
                driver.between_ticks(s.seq)

    def _publish_again(self, s: DriverState) -> None:
        driver, compiled = self._driver, self._compiled
        driver.events.emit(
            "unanswered",
            f"tick {s.seq} has no answer; publishing it again",
            {"tick": s.seq},
        )
        payload = self._plain.payload if compiled is None else compiled.last_sent()
        topic = driver.setup.topic(topics.DEVICE_STATE).encode()
        driver.publisher.send_hop(topic, payload)

    def _raise_device_error(self, s: DriverState) -> None:
        """Repeat the failed device call in Python, so that its exception is raised."""
        if self._compiled is not None:
            self._compiled.raise_error()
        if s.failed:
            s.failed = 0
            held = (
                not s.realtime
                or time.monotonic()
                < s.epoch + (s.written + s.device_hold_ticks) * s.period
            )
            x, y, z = s.handed
            self._device.write_force((x, y, z) if held else ZERO, s.seq, 0.0)
        else:
            what = f"{self._driver.setup.name}: {type(self._device).__name__}"
            s.place[:] = numbers_of(self._device.read_position(s.seq), what)
            s.jumped |= self._plain.jumps.again()
            s.position_ready = 1

    def publish_last_sample(self, s: DriverState, stamp: float) -> None:
        """Publish the final position of the device, sampled at `stamp` [s]."""
        driver = self._driver
        s.place[:] = numbers_of(self._device.read_position(s.seq), driver.setup.name)
        s.jumped |= self._plain.jumps.again()
        s.target[:] = driver.target
        take_sample(s, s.seq, stamp)
        self._plain.publish(s, s.seq, stamp)
        self._plain.aside(s)
        s.phase = BETWEEN
