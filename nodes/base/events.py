"""What a node has to say beside its ticks: events, what it refused, whom it turned away, and when that was.

Nothing here waits: what is published goes into an outbox, which the loop empties when its tick's own message has left.
"""

from __future__ import annotations

import math
import os
import sys
import threading
import time
from collections import deque
from typing import TYPE_CHECKING

from messages import topics
from messages.codec import encode
from messages.transport.waker import Waker
from messages.types import Event, Message
from nodes.base.setup import Setup
from nodes.parameters.store import ParameterError
from nodes.tick.layout import Counted

if TYPE_CHECKING:
    from nodes.tick.answering import CompiledTicks


class Telling:
    """The part of a node that tells.

    Parameters
    ----------
    setup : Setup
        Who the node is and how it is paced.

    Attributes
    ----------
    seq : int
        The tick that the node is at.
    ticks, gaps, skipped : int
        Ticks handled so far, ticks missing in what it follows, and messages left out for newer ones.
    ahead : CompiledTicks or None
        Its compiled ticks, when the sockets exist.
    outbox : deque of tuple of bytes
        Topics and payloads that wait for the end of the tick.
    called : bool
        Whether something waits to be done between two ticks: the one thing that a loop looks at.
    waker : Waker or None
        What ends the loop's wait; None for a loop that does not wait without end.
    refused, denied : int
        Messages refused; connections not let in.
    loop_thread : int
        Identifier of the thread that runs the loop.
    clock_offset, clock_error : float
        What is added to this host's monotonic clock to get the run's time, and how far off that may be [s].
    """

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.seq = 0
        self.outbox: deque[tuple[bytes, bytes]] = deque(maxlen=1024)
        self.called = False
        self.waker: Waker | None = None
        # Nodes are made on the thread that runs their loop.
        self.loop_thread = threading.get_ident()
        self.refused = self.denied = 0
        self.ticks = self.gaps = self.skipped = 0
        self.ahead: CompiledTicks | None = None
        self.clock_offset = self.clock_error = 0.0
        self._period = setup.period
        self._simulated = setup.pace == "lockstep"
        self._told: dict[str, int] = {}

    def ticking(self) -> CompiledTicks | None:
        """Give the compiled ticks while they go on: the node itself knows then only what was before; from any thread."""
        ahead = self.ahead
        return ahead if ahead is not None and ahead.inside else None

    def counted(self) -> Counted:
        """Tell how far the node is, compiled ticks that still go on included; from any thread."""
        ahead = self.ticking()
        return Counted(self.seq, self.ticks, self.gaps, self.skipped) if ahead is None else ahead.counted()

    def now(self) -> float:
        """Time for stamps: the monotonic clock of the launcher's host, or simulated time in lockstep."""
        return self.counted().seq * self._period if self._simulated else time.monotonic() + self.clock_offset

    def set_clock(self, offset: float, error: float) -> None:
        """Take over how far this host's clock is from the launcher's, as the launcher has measured it."""
        if not (isinstance(offset, float) and isinstance(error, float) and math.isfinite(offset) and error >= 0.0):
            raise ParameterError(
                f"{self.setup.name}: clock.set {offset!r} {error!r}: expected two finite numbers of seconds"
            )
        self.clock_offset, self.clock_error = offset, error
        # Compiled ticks go on with the one that they were given.
        self.call()

    def say(self, text: str) -> None:
        """Write one line to standard error, named; in a node's process it only joins a queue (nodes/base/words.py)."""
        # On a terminal the launcher's status line stands where this goes.
        clear = "\r\x1b[K" if sys.stderr.isatty() and os.environ.get("TERM") != "dumb" else ""
        sys.stderr.write(f"{clear}[{self.setup.name}] {text}\n")

    def tell(self, kind: str, reason: str, always: bool = False, count: int = 0) -> None:
        """Publish an event and say it; repeats of one kind at powers of two only, which who counts them itself gives."""
        count = self._told[kind] = count or self._told.get(kind, 0) + 1
        seldom = count & (count - 1) == 0
        if seldom:
            repeat = f" ({count} events of this kind)" if count > 1 else ""
            self.say(f"{kind}: {reason}{repeat}")
        if seldom or always:
            self._post_event(kind, reason)

    def announce(self, kind: str, reason: str) -> None:
        """Publish an event and say it, however often: for what people do, which cannot come in every tick."""
        self.say(f"{kind}: {reason}")
        self._post_event(kind, reason)

    def _post_event(self, kind: str, reason: str) -> None:
        message = Event(seq=self.counted().seq, stamp=self.now(), node=self.setup.name, kind=kind, reason=reason[:4000])
        self.post(topics.event(self.setup.name), message)

    def post(self, topic: str, message: Message) -> None:
        """Queue a message that is not part of the tick; it leaves after the tick's own."""
        frames = topic.encode(), encode(message)
        # Compiled ticks send it themselves, and are not called for it.
        if self.ahead is None or not self.ahead.mail(*frames):
            self.outbox.append(frames)
            self.call()

    def call(self) -> None:
        """Call the loop's attention to what waits between two ticks; from any thread."""
        self.called = True
        if threading.get_ident() != self.loop_thread:
            self.wake()

    def wake(self) -> None:
        """End the loop's wait for a message, if it waits without end."""
        if self.waker is not None:
            self.waker.wake()

    def refuse(self, reason: str) -> None:
        """Count and tell a message that was refused."""
        self.refused += 1
        self.tell("refused", reason[:1000])

    def deny(self, reason: str) -> None:
        """Count and tell a peer that was turned away."""
        self.denied += 1
        self.tell("denied", reason)
