"""Compiled ticks of a driver: its state, shared with the kernel, and the device's calls."""

from __future__ import annotations

import ctypes
from array import array
from typing import TYPE_CHECKING

import msgspec

from messages import topics
from nodes.compiled.answering import WAIT_MS, CompiledTicks
from nodes.compiled.library import Kernel
from nodes.driver.calls import DeviceCalls, Jumps
from nodes.driver.device import Device
from nodes.driver.state import SAFETY, DriverState
from nodes.driver.tick import SILENT, UNREAD

if TYPE_CHECKING:
    from nodes.driver.ticked_driver import TickedDriver


class DriverTicks(CompiledTicks[DriverState]):
    """Compiled ticks of one driver."""

    def __init__(
        self, node: TickedDriver, kernel: Kernel, device: Device, jumps: Jumps
    ) -> None:
        s = node.driving
        super().__init__(node, kernel, topics.FORCE, topics.DEVICE_STATE)
        self._driver = node
        self._device = DeviceCalls(device, lambda: node.target, jumps)
        s.device_read, s.device_write, s.device_context = self._device.calls
        self._room("device_room", 48)
        # struct pollfd: descriptor, then two shorts: POLLIN, and the result
        self._poll = array("i", [self._inbox.fd, 1])
        self.set_array("poll", self._poll)
        self._texts = [
            ctypes.create_string_buffer(msgspec.msgpack.encode(text).ljust(32, b"\0"))
            for text in SAFETY
        ]
        s.texts[:] = [ctypes.addressof(text) for text in self._texts]
        s.text_sizes[:] = [len(msgspec.msgpack.encode(text)) for text in SAFETY]
        self.payload = b""  # last published state
        # in and out once without a tick: the first time, with cold caches, it takes some ticks of 8
        # a first call without a tick: with cold caches it takes several ticks of 8 kHz
        s.most = 0
        self.go()

    def run(self, s: DriverState) -> int:
        """Tick until the driver is needed. Return why, as nodes/driver/tick.py defines it."""
        node = self._driver
        s.attention = 0  # before checking, so that a later request stops the ticks
        # do not delay what waits between two ticks
        s.most = 1 if node.events.waiting or node.stopping else self._most
        node.publisher.flush()
        if not s.realtime:
            self._inbox.set_timeout(WAIT_MS)
        s.frames = 0
        why = self.go()
        if why == SILENT or s.seq >= s.until:
            self.payload = self.last_sent()
        elif why == UNREAD:
            self._inbox.put_back(self._frames())
        return why

    def raise_error(self) -> None:
        """Raise the exception of the device's last call, if any."""
        self._device.raise_error()
