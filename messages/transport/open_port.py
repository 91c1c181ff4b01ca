"""A port at which anybody on this machine may listen, unencrypted: for a process that can be done without.

What strangers connect to is in no process of the loop: nodes/base has no such socket. A forwarder
(nodes/forwarder.py) or ``haptic relay`` listens to the nodes as their user and publishes here what
they say. What a stranger makes this process keep, subscriptions and messages that it does not take,
is bounded by ending all connections when memory grows; who only listens is back at once.
"""

import contextlib
import resource
import time
from collections.abc import Callable
from pathlib import Path

import zmq

from messages.transport.endpoints import (
    Context,
    EndpointRefusedError,
    Socket,
    await_given_back,
    bind,
    closed_if_refused,
    is_open_place,
    remove_ipc,
)

MOST_GROWTH = 128 << 20  # by so much memory may grow before all listeners are disconnected [bytes]
QUEUE = 4096  # messages queued for one listener before its newest ones are dropped
# how long ZeroMQ may take to give back a port that was closed, under thousands of connections [s]
GIVEN_BACK = 10.0

_PERIOD = 0.5
_PAGE = resource.getpagesize()


class OpenPort:
    """Publishes to all who listen, and takes no commands; `denied` takes one sentence when the listeners are disconnected."""

    def __init__(self, context: Context, endpoint: str, denied: Callable[[str], None]) -> None:
        self._context, self._endpoint, self._denied = context, endpoint, denied
        self._is_open = is_open_place(endpoint)
        self._following = 0.0
        self._usual = self._wanted = 0
        self._socket = self._bound()

    def _bound(self) -> Socket:
        socket = self._context.socket(zmq.XPUB)
        socket.sndhwm = QUEUE
        with closed_if_refused(socket):
            bind(socket, self._endpoint, self._is_open)
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
        memory = int(Path("/proc/self/statm").read_text("ascii").split()[1]) * _PAGE
        self._usual = self._usual or memory
        if memory - self._usual > MOST_GROWTH:
            self._denied(
                f"{self._endpoint}: memory grew by {(memory - self._usual) >> 20} MiB; all"
                " listeners there are disconnected"
            )
            self._usual = memory
            self._renew()

    def listeners(self) -> int:
        """Take in what listeners have sent, not too much at once, and count the topics that somebody wants."""
        for _ in range(10_000):
            if not int(self._socket.get(zmq.EVENTS)) & zmq.POLLIN:
                break
            # Whatever else they send is dropped.
            self._wanted += {b"\x00": -1, b"\x01": 1}.get(self._socket.recv(zmq.NOBLOCK)[:1], 0)
        return self._wanted

    def _renew(self) -> None:
        self._socket.close(linger=0)
        self._wanted = 0
        deadline = time.monotonic() + GIVEN_BACK
        await_given_back(self._endpoint, deadline)
        while time.monotonic() < deadline:
            with contextlib.suppress(EndpointRefusedError):
                self._socket = self._bound()
                return
            time.sleep(0.001)
        self._socket = self._bound()

    def close(self, linger_ms: int = 500) -> None:
        """Close it; queued messages may take so long to leave [ms]."""
        self._socket.close(linger=linger_ms)
        remove_ipc(self._endpoint)
