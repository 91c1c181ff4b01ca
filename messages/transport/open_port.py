"""A port open to all local users, unencrypted, in a process that no loop depends on.

No process of the loop has such a socket (nodes/base). A forwarder (nodes/forwarder.py) or ``haptic
relay`` listens to the nodes as their user and publishes their messages here. The memory that
strangers can make this process use, for subscriptions and unread messages, is limited by ending all
connections when it grows; mere listeners reconnect at once.
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
    bind,
    closed_if_refused,
    is_open_place,
    remove_ipc,
)
from messages.transport.gate import close_bound

# growth of memory at which all listeners are disconnected [bytes]
MAX_GROWTH = 128 << 20
QUEUE = 4096  # messages queued for one listener before its newest ones are dropped
# longest time for ZeroMQ to free a closed port, under thousands of connections [s]
GIVEN_BACK = 10.0

_CHECK_INTERVAL = 0.5
_PAGE = resource.getpagesize()


class OpenPort:
    """Publishes to all listeners and takes no commands.

    `denied` is called with one sentence when the listeners are disconnected.
    """

    def __init__(
        self, context: Context, endpoint: str, denied: Callable[[str], None]
    ) -> None:
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
        """Check memory and accept subscriptions; to be called often, also when nothing is sent."""
        now = time.monotonic()
        if now < self._following:
            return
        self._following = now + _CHECK_INTERVAL
        self.listeners()
        memory = int(Path("/proc/self/statm").read_text("ascii").split()[1]) * _PAGE
        self._usual = self._usual or memory
        if memory - self._usual > MAX_GROWTH:
            self._denied(
                f"{self._endpoint}: memory grew by {(memory - self._usual) >> 20} MiB; all"
                " listeners there are disconnected"
            )
            self._usual = memory
            self._renew()

    def listeners(self) -> int:
        """Process a limited number of subscriptions. Return the number of wanted topics."""
        for _ in range(10_000):
            if not int(self._socket.get(zmq.EVENTS)) & zmq.POLLIN:
                break
            # other input is discarded
            self._wanted += {b"\x00": -1, b"\x01": 1}.get(
                self._socket.recv(zmq.NOBLOCK)[:1], 0
            )
        return self._wanted

    def _renew(self) -> None:
        self._wanted = 0
        deadline = time.monotonic() + GIVEN_BACK
        close_bound(self._socket, self._endpoint, deadline)
        while time.monotonic() < deadline:
            with contextlib.suppress(EndpointRefusedError):
                self._socket = self._bound()
                return
            time.sleep(0.001)
        self._socket = self._bound()

    def close(self, linger_ms: int = 500) -> None:
        """Close the port; queued messages may take `linger_ms` to leave [ms]."""
        self._socket.close(linger=linger_ms)
        remove_ipc(self._endpoint)
