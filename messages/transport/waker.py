"""Ending a wait for the next message from another thread, or from a signal handler.

A receive with a time-out costs a tick 1.5 µs more than one without, and would notice other work
only after that time. So the loop waits for ever, and other threads send it a message inside the
process.
"""

import os
import threading

import zmq

from messages.transport.endpoints import Context


class Waker:
    """Wakes a SUB socket of this process with a dummy frame that matches its `topic`."""

    def __init__(self, context: Context, topic: bytes) -> None:
        # Nobody else can forge it: a similar frame is discarded like any other topic.
        self.frame = topic + b"\x00" + os.urandom(16)  # the frame received, alone
        self.endpoint = f"inproc://wake-{id(self)}"  # where the subscription connects
        # a signal handler may interrupt its own thread here
        self._lock = threading.RLock()
        self._socket = context.socket(zmq.PUB)
        self._socket.bind(self.endpoint)

    def wake(self) -> None:
        """End the wait; from any thread."""
        with self._lock:
            if not self._socket.closed:
                self._socket.send(self.frame)

    def close(self) -> None:
        """Close the socket; `wake` has no effect any more."""
        with self._lock:
            self._socket.close(linger=0)
