"""A node's output besides its ticks: events, refusal counts, and the clock.

Nothing here waits: published messages go into an outbox, which the loop empties when its tick's own
message has left.
"""

import math
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

from messages import topics
from messages.codec import encode
from messages.event_kinds import MARK, EventKind, OtherKind, checked_data
from messages.types import Event, Message
from nodes.base.kept_line import erased
from nodes.base.log_line import AS_JSON, LogLine
from nodes.base.setup import Setup
from nodes.parameters.store import ParameterError

LONGEST_MARK: Final = 200  # longest text of a mark [characters]
NONE: Final[Mapping[str, float]] = MappingProxyType({})  # an event without numbers


class Clock:
    """The run's time, on this machine."""

    def __init__(self, setup: Setup, seq: Callable[[], int]) -> None:
        # `simulated`: time is counted in ticks (lockstep).
        self._name = setup.name
        self._period = setup.period
        self.simulated = setup.pace == "lockstep"
        self._seq = seq
        # offset from this host's monotonic clock to the run's time, and its uncertainty [s]
        self.offset = self.error = 0.0

    def now(self) -> float:
        """Return the time for stamps: the launcher's clock, or simulated time in lockstep."""
        return (
            self._seq() * self._period
            if self.simulated
            else time.monotonic() + self.offset
        )

    def set(self, offset: float, error: float) -> None:
        """Set the offset of this host's clock to the launcher's, and its uncertainty [s]."""
        if not (
            isinstance(offset, float)
            and isinstance(error, float)
            and math.isfinite(offset)
            and error >= 0.0
        ):
            raise ParameterError(
                f"clock.set {offset!r} {error!r}: expected two finite numbers of seconds",
                path=self._name,
            )
        self.offset, self.error = offset, error


class Events:
    """The events of a node."""

    def __init__(self, name: str, clock: Clock, seq: Callable[[], int]) -> None:
        self._name, self._clock, self._seq = name, clock, seq
        # topics and payloads that wait for the end of the tick
        self.outbox: deque[tuple[bytes, bytes]] = deque(maxlen=1024)
        # whether something waits to be done between two ticks; the only flag that a loop checks
        self.waiting = False
        # ends the loop's wait for a message, if it waits for ever
        self.interrupt: Callable[[], None] = lambda: None
        # requests compiled ticks to send a message; returns whether they will
        self.post: Callable[[bytes, bytes], bool] | None = None
        # nodes are created on the thread that runs their loop
        self.loop_thread = threading.get_ident()  # identifier of the loop's thread
        self.refused = self.denied = 0  # messages refused; connections refused
        # publish events without logging them: a node without a process
        self.quiet = False
        self._counts: dict[str, int] = {}

    def log(self, text: str, kind: str = "", data: Mapping[str, float] = NONE) -> None:
        """Write one named line to standard error, which queues it (nodes/base/stderr_queue.py)."""
        if self.quiet:
            return
        line = LogLine(text, self._name, kind, data)
        # the launcher's status line may occupy this line of the terminal
        shown = line.as_json() if AS_JSON else f"{erased(sys.stderr)}{line}"
        sys.stderr.write(f"{shown}\n")

    def emit(
        self,
        kind: EventKind | OtherKind,
        reason: str,
        data: Mapping[str, float] = NONE,
        *,
        always: bool = False,
        count: int = 0,
    ) -> None:
        """Publish and log an event; of repeats of one kind only the 1st, 2nd, 4th, 8th and so on.

        Parameters
        ----------
        kind : str
            One of messages/event_kinds.py, or ``package.kind`` of another package.
        reason : str
            One sentence with value and limit, for people.
        data : mapping of str to float
            Numbers of the event, which its kind names; values that are not finite are left out.
        always : bool
            Publish each event, and thin out its log lines only.
        count : int
            Number of the event among those of its kind, if the caller counts them; 0: counted here.

        Raises
        ------
        UnknownEventError
            If the kind or the name of a number is not registered.
        """
        numbers = checked_data(kind, data)
        count = self._counts[kind] = count or self._counts.get(kind, 0) + 1
        seldom = count & (count - 1) == 0
        if seldom:
            repeat = f" ({count} events of this kind)" if count > 1 else ""
            self.log(f"{reason}{repeat}", kind, numbers)
        if seldom or always:
            self._publish_event(kind, reason, numbers)

    def emit_each(
        self, kind: EventKind | OtherKind, reason: str, data: Mapping[str, float] = NONE
    ) -> None:
        """Publish and log every event, for actions of people, which cannot come in every tick."""
        numbers = checked_data(kind, data)
        self.log(reason, kind, numbers)
        self._publish_event(kind, reason, numbers)

    def mark(self, text: str) -> dict[str, float]:
        """Publish an event of kind ``mark`` on request; return its tick and stamp [s].

        Parameters
        ----------
        text : str
            Text of the mark; at most `LONGEST_MARK` characters.

        Returns
        -------
        dict of str to float
            ``tick`` and ``stamp``.

        Raises
        ------
        ParameterError
            If the text is empty or longer.
        """
        if not isinstance(text, str) or not 0 < len(text.strip()) <= LONGEST_MARK:
            raise ParameterError(
                f"mark {str(text)[:40]!r}: expected a text of 1 to {LONGEST_MARK} characters",
                path=self._name,
            )
        self.log(text, MARK)
        seq, stamp = self._publish_event(MARK, text, {})
        return {"tick": seq, "stamp": stamp}

    def _publish_event(
        self, kind: str, reason: str, data: dict[str, float]
    ) -> tuple[int, float]:
        seq = self._seq()
        stamp = self._clock.now()
        message = Event(
            seq=seq,
            stamp=stamp,
            node=self._name,
            kind=kind,
            reason=reason[:4000],
            data=data,
        )
        self.publish(topics.event(self._name), message)
        return seq, stamp

    def publish(self, topic: str, message: Message) -> None:
        """Queue a message that is not part of the tick; it leaves after the tick's own."""
        frames = topic.encode(), encode(message)
        # Compiled ticks send it themselves, without interruption.
        if self.post is None or not self.post(*frames):
            self.outbox.append(frames)
            self.notify()

    def notify(self) -> None:
        """Request the loop's attention between two ticks; from any thread."""
        self.waiting = True
        if threading.get_ident() != self.loop_thread:
            self.interrupt()

    def refuse(self, reason: str) -> None:
        """Count and report a refused message."""
        self.refused += 1
        self.emit("refused", reason[:1000])

    def deny(self, reason: str, data: Mapping[str, float] = NONE) -> None:
        """Count and report a refused peer."""
        self.denied += 1
        self.emit("denied", reason, data)
