"""What a node has to say beside its ticks: events, what it refused, whom it turned away, and when that was.

Nothing here waits: what is published goes into an outbox, which the loop empties when its tick's own message has left.
"""

import math
import sys
import threading
import time
from collections import deque
from collections.abc import Callable

from messages import topics
from messages.codec import encode
from messages.types import Event, Message
from nodes.base.kept_line import erased
from nodes.base.setup import Setup
from nodes.parameters.store import ParameterError


class Clock:
    """The run's time, on this machine."""

    def __init__(self, setup: Setup, seq: Callable[[], int]) -> None:
        # Whether time is that of the ticks: lockstep.
        self._name, self._period, self.simulated = setup.name, setup.period, setup.pace == "lockstep"
        self._seq = seq
        # What is added to this host's monotonic clock to get the run's time, and how far off that may be [s].
        self.offset = self.error = 0.0

    def now(self) -> float:
        """Time for stamps: the monotonic clock of the launcher's host, or simulated time in lockstep."""
        return self._seq() * self._period if self.simulated else time.monotonic() + self.offset

    def set(self, offset: float, error: float) -> None:
        """Take over how far this host's clock is from the launcher's, as the launcher has measured it."""
        if not (isinstance(offset, float) and isinstance(error, float) and math.isfinite(offset) and error >= 0.0):
            raise ParameterError(f"{self._name}: clock.set {offset!r} {error!r}: expected two finite numbers of seconds")
        self.offset, self.error = offset, error


class Events:
    """The events of a node."""

    def __init__(self, name: str, clock: Clock, seq: Callable[[], int]) -> None:
        self._name, self._clock, self._seq = name, clock, seq
        self.outbox: deque[tuple[bytes, bytes]] = deque(maxlen=1024)  # topics and payloads that wait for the end of the tick
        self.waiting = False  # whether something waits to be done between two ticks: the one thing that a loop looks at
        self.interrupt: Callable[[], None] = lambda: None  # ends the loop's wait for a message, where it waits without end
        # Has compiled ticks that go on send a message; whether they will.
        self.mail: Callable[[bytes, bytes], bool] | None = None
        # Nodes are made on the thread that runs their loop.
        self.loop_thread = threading.get_ident()  # identifier of the thread that runs the loop
        self.refused = self.denied = 0  # messages refused; connections not let in
        self._counts: dict[str, int] = {}

    def log(self, text: str) -> None:
        """Write one line to standard error, named; in a node's process it only joins a queue (nodes/base/stderr_queue.py)."""
        # On a terminal the launcher's status line stands where this goes.
        sys.stderr.write(f"{erased(sys.stderr)}[{self._name}] {text}\n")

    def emit(self, kind: str, reason: str, always: bool = False, count: int = 0) -> None:
        """Publish and log an event; repeats of one kind at powers of two only, which who counts them itself gives.

        With `always` each is published, and only its log line is thinned out.
        """
        count = self._counts[kind] = count or self._counts.get(kind, 0) + 1
        seldom = count & (count - 1) == 0
        if seldom:
            repeat = f" ({count} events of this kind)" if count > 1 else ""
            self.log(f"{kind}: {reason}{repeat}")
        if seldom or always:
            self._publish_event(kind, reason)

    def emit_each(self, kind: str, reason: str) -> None:
        """Publish and log an event, however often: for what people do, which cannot come in every tick."""
        self.log(f"{kind}: {reason}")
        self._publish_event(kind, reason)

    def _publish_event(self, kind: str, reason: str) -> None:
        message = Event(seq=self._seq(), stamp=self._clock.now(), node=self._name, kind=kind, reason=reason[:4000])
        self.publish(topics.event(self._name), message)

    def publish(self, topic: str, message: Message) -> None:
        """Queue a message that is not part of the tick; it leaves after the tick's own."""
        frames = topic.encode(), encode(message)
        # Compiled ticks send it themselves, and are not interrupted for it.
        if self.mail is None or not self.mail(*frames):
            self.outbox.append(frames)
            self.notify()

    def notify(self) -> None:
        """Call the loop's attention to what waits between two ticks; from any thread."""
        self.waiting = True
        if threading.get_ident() != self.loop_thread:
            self.interrupt()

    def refuse(self, reason: str) -> None:
        """Count and tell a message that was refused."""
        self.refused += 1
        self.emit("refused", reason[:1000])

    def deny(self, reason: str) -> None:
        """Count and tell a peer that was turned away."""
        self.denied += 1
        self.emit("denied", reason)
