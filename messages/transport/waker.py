"""Ending a wait for the next message from another thread, or from a signal handler.

A receive with a time-out costs a tick 1.5 µs more than one without, and a node that waits for something else than messages
sees it only when the time is over. So the loop waits without end, and other threads send it a message inside the process.
"""

from __future__ import annotations

import os
import threading
from typing import TYPE_CHECKING

import zmq

if TYPE_CHECKING:
    from messages.transport.endpoints import Context


class Waker:
    """Sends a subscription of the same process a frame that is no message.

    `topic`: what the subscription takes: the frame begins with it, so that it passes the same filter.
    """

    def __init__(self, context: Context, topic: bytes) -> None:
        # Nobody else can make one: what looks like it is refused as any other topic.
        self.frame = topic + b"\x00" + os.urandom(16)  # what it receives, alone
        self.endpoint = f"inproc://wake-{id(self)}"  # where the subscription connects
        # A signal handler may interrupt its own thread here.
        self._lock = threading.RLock()
        self._socket = context.socket(zmq.PUB)
        self._socket.bind(self.endpoint)

    def wake(self) -> None:
        """End the wait; from any thread."""
        with self._lock:
            if not self._socket.closed:
                self._socket.send(self.frame)

    def close(self) -> None:
        """Close the socket; waking does nothing any more."""
        with self._lock:
            self._socket.close(linger=0)
