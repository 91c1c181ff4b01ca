"""The compiled ticks of a driver: its state, lent to the kernel where it stands, and the device's two calls."""

from __future__ import annotations

import ctypes
from array import array
from typing import Any

import msgspec

from messages import topics
from nodes.compiled.answering import WAIT_MS, CompiledTicks
from nodes.compiled.library import Kernel
from nodes.driver.calls import DeviceCalls, Jumps
from nodes.driver.device import Device
from nodes.driver.state import SAFETY, DriverState
from nodes.driver.tick import SILENT, UNREAD


class DriverTicks(CompiledTicks):
    """The compiled ticks of one driver."""

    def __init__(self, node: Any, kernel: Kernel, device: Device, jumps: Jumps) -> None:
        s: DriverState = node.driving
        super().__init__(node, kernel, topics.FORCE, topics.DEVICE_STATE)
        self._driver = node
        self._device = DeviceCalls(device, lambda: node.target, jumps)
        s.device_read, s.device_write, s.device_context = self._device.calls
        self._room("device_room", 48)
        # struct pollfd: descriptor, then two shorts: POLLIN, and the answer
        self._poll = array("i", [self._inbox.fd, 1])
        self.keep("poll", self._poll)
        self._texts = [
            ctypes.create_string_buffer(msgspec.msgpack.encode(text).ljust(32, b"\0"))
            for text in SAFETY
        ]
        s.texts[:] = [ctypes.addressof(text) for text in self._texts]
        s.text_sizes[:] = [len(msgspec.msgpack.encode(text)) for text in SAFETY]
        self.payload = b""  # the state that was published last
        # in and out once without a tick: the first time, with cold caches, it takes some ticks of 8
        # kHz
        s.most = 0
        self.go()

    def run(self, s: DriverState) -> int:
        """Tick until something waits; why it ended, as of nodes/driver/tick.py."""
        node = self._driver
        s.attention = 0  # before looking: what comes in between stops it
        # What waits between two ticks is not left waiting.
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
        """Raise what a call of the device raised."""
        self._device.raise_error()
