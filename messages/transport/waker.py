"""Ending a wait for the next message from another thread, or from a signal handler.

A receive with a time-out costs a tick 1.5 µs more than one without, and a node that waits for
something else than messages sees it only when the time is over. So the loop waits without end, and
other threads send it a message inside the process.
"""

import os
import threading

import zmq

from messages.transport.endpoints import Context


class Waker:
    """Sends a subscription of the same process a frame that is no message, but begins with its `topic` and so gets through."""

    def __init__(self, context: Context, topic: bytes) -> None:
        # Nobody else can make one: what looks like it is refused as any other topic.
        self.frame = topic + b"\x00" + os.urandom(16)  # what it receives, alone
        self.endpoint = f"inproc://wake-{id(self)}"  # where the subscription connects
        self._lock = threading.RLock()  # A signal handler may interrupt its own thread here
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
