"""A port at which anybody on this machine may listen, unencrypted: for a process that can be done without.

What strangers connect to is in no process of the loop: nodes/base has no such socket. A forwarder (nodes/forwarder.py) or
``haptic relay`` listens to the nodes as their user and publishes here what they say. What a stranger makes this process keep,
subscriptions and messages that it does not take, is bounded by ending all connections when memory grows; who only listens is
back at once.
"""

from __future__ import annotations

import contextlib
import os
import resource
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

import zmq

from messages.transport.endpoints import EndpointRefusedError, bind, is_open_place, remove_ipc, split

if TYPE_CHECKING:
    from messages.transport.endpoints import Context, Socket


MOST_GROWTH = 128 << 20
"""By so much memory may grow before all listeners are put out [bytes]."""

QUEUE = 4096
"""Messages queued for one listener before its newest ones are dropped."""

GIVEN_BACK = 10.0
"""How long ZeroMQ may take to give back a port that was closed, under thousands of connections [s]."""

_PERIOD = 0.5
_PAGE = resource.getpagesize()


class OpenPort:
    """Publishes to all who listen, and takes no commands.

    `denied`: takes one sentence when the listeners are put out. Raises EndpointRefusedError when others than this machine's
    users could reach it, or the address is taken.
    """

    def __init__(self, context: Context, endpoint: str, denied: Callable[[str], None]) -> None:
        self._context, self._endpoint, self._denied = context, endpoint, denied
        self._is_open = is_open_place(endpoint)
        self._following = 0.0
        self._usual = self._wanted = 0
        self._socket = self._bound()

    def _bound(self) -> Socket:
        socket = self._context.socket(zmq.XPUB)
        socket.sndhwm = QUEUE
        try:
            bind(socket, self._endpoint, self._is_open)
        except ValueError:
            socket.close(linger=0)
            raise
        return socket

    def send(self, topic: bytes, payload: bytes) -> None:
        """Publish one message: two frames, topic and payload."""
        self._socket.send(topic, zmq.SNDMORE)
        self._socket.send(payload)

    def keep(self) -> None:
        """Look whether memory has grown, and take in who has come; called as often as it likes, also when nothing is sent."""
        now = time.monotonic()
        if now < self._following:
            return
        self._following = now + _PERIOD
        self.listeners()
        with open("/proc/self/statm", encoding="ascii") as statm:
            memory = int(statm.read().split()[1]) * _PAGE
        self._usual = self._usual or memory
        if memory - self._usual > MOST_GROWTH:
            self._denied(
                f"{self._endpoint}: memory grew by {(memory - self._usual) >> 20} MiB; all listeners there are disconnected"
            )
            self._usual = memory
            self._renew()

    def listeners(self) -> int:
        """Take in what listeners have sent, not too much at once, and count the topics that somebody wants.

        Returns: different subscriptions; several listeners may have the same one.
        """
        for _ in range(10_000):
            if not int(self._socket.get(zmq.EVENTS)) & zmq.POLLIN:
                break
            # Whatever else they send is dropped.
            self._wanted += {b"\x00": -1, b"\x01": 1}.get(self._socket.recv(zmq.NOBLOCK)[:1], 0)
        return self._wanted

    def _renew(self) -> None:
        self._socket.close(linger=0)
        self._wanted = 0
        place = split(self._endpoint)[0].removeprefix("ipc://") if not self._is_open else ""
        deadline = time.monotonic() + GIVEN_BACK
        # ZeroMQ's thread gives the port back, or removes the file, in its own time; it must not remove the new one's.
        while place and os.path.exists(place) and time.monotonic() < deadline:
            time.sleep(0.001)
        while time.monotonic() < deadline:
            with contextlib.suppress(EndpointRefusedError):
                self._socket = self._bound()
                return
            time.sleep(0.001)
        self._socket = self._bound()

    def close(self, linger_ms: int = 500) -> None:
        """Close it.

        `linger_ms`: how long queued messages may take to leave [ms].
        """
        self._socket.close(linger=linger_ms)
        remove_ipc(self._endpoint)
