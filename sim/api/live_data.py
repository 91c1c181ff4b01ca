"""Live data of a running launch: streams, the newest message, the last seconds, marks.

Every listener has its own subscription, which no node of the loop waits for, and its threads stay
off the processors of the loop.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
import time
import weakref
from collections import deque
from collections.abc import AsyncIterator, Callable, Generator, Iterator
from dataclasses import dataclass
from numbers import Real
from typing import TYPE_CHECKING, Any, NamedTuple

from messages.errors import HapticError, UsageError
from messages.topics import DEVICE_STATE, FORCE, PROXY
from nodes.client import launches
from nodes.client.listen import listen
from nodes.launcher.runs import RunInfo
from sim.api.python_words import speaking_python
from sim.api.recordings import TickTable

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from messages.types import Message

LONGEST = 60.0  # longest span of a table of the last seconds [s]
STARTS_WITHIN = 5.0  # default wait for the first message of a topic [s]
_POLL = 0.02  # time between checks for new messages [s]


class Received(NamedTuple):
    """A message of one of several topics."""

    topic: str  # its topic
    message: Message  # the message
    time: float  # time of reception, on the host's monotonic clock [s]


class Stream:
    """Messages of a running launch, in a ``for`` or an ``async for`` loop.

    Parameters
    ----------
    run : RunInfo
        The launch.
    topics : tuple of str
        Topics; with one, the loop yields its messages, with several `Received`.
    duration : float
        Time after which it ends [s]; 0: with the launch.
    """

    def __init__(
        self, run: RunInfo, topics: tuple[str, ...], duration: float = 0.0
    ) -> None:
        if not topics:
            raise UsageError(
                f"stream: name a topic; there are {', '.join(run.endpoints())}"
            )
        if not duration >= 0.0:
            raise UsageError(f"stream: duration {duration} s; expected 0 or more")
        self._run, self._duration = run, duration
        self._topics = tuple(launches.known_topic(run, topic) for topic in topics)

    def received(self) -> Iterator[Received | None]:
        """Yield each message once, and None while nothing arrives."""
        last: dict[str, Message] = {}
        for heard in listen(self._run, self._topics, self._duration):
            # In lockstep a node that is asked again repeats its answer.
            if (
                heard is None
                or heard.message is None
                or last.get(heard.topic) == heard.message
            ):
                yield None
                continue
            last[heard.topic] = heard.message
            yield Received(heard.topic, heard.message, heard.time)

    def _shown(self, received: Received) -> Any:
        return received.message if len(self._topics) == 1 else received

    def __iter__(self) -> Generator[Any]:
        """Yield messages until the launch ends or the duration is over."""
        for received in self.received():
            if received is not None:
                yield self._shown(received)

    async def __aiter__(self) -> AsyncIterator[Any]:
        """Yield messages; other tasks run while none is there."""
        loop = asyncio.get_running_loop()
        arrived, left = asyncio.Event(), threading.Event()
        waiting: deque[Received] = deque()
        ended: list[Exception | None] = []

        def wake() -> None:
            with contextlib.suppress(RuntimeError):  # the event loop is closed already
                loop.call_soon_threadsafe(arrived.set)

        def receive() -> None:
            failure: Exception | None = None
            try:
                for received in self.received():
                    if left.is_set():
                        break
                    if received is not None:
                        waiting.append(received)
                        wake()
            except Exception as error:  # noqa: BLE001  # raised again in the loop that waits
                failure = error
            ended.append(failure)
            wake()

        thread = threading.Thread(target=receive, name="haptic-stream", daemon=True)
        thread.start()
        try:
            while True:
                arrived.clear()
                while waiting:
                    yield self._shown(waiting.popleft())
                if ended and not waiting:
                    if ended[0] is not None:
                        raise ended[0]
                    return
                if not waiting:
                    await arrived.wait()
        finally:
            left.set()


class RecentMessages:
    """The newest messages of some topics, received by a thread of their own.

    Parameters
    ----------
    run : RunInfo
        The launch.
    topics : tuple of str
        Topics to receive.
    """

    def __init__(self, run: RunInfo, topics: tuple[str, ...]) -> None:
        self._stream = Stream(run, topics)
        self._closing, self.ended = threading.Event(), threading.Event()
        self._messages: dict[str, deque[Message]] = {topic: deque() for topic in topics}
        self.span = 0.0  # seconds of messages to keep; at least the newest one is kept
        self._lock = threading.Lock()
        self._failure: Exception | None = None
        threading.Thread(
            target=self._receive, name="haptic-latest", daemon=True
        ).start()

    def _receive(self) -> None:
        try:
            for received in self._stream.received():
                if self._closing.is_set():
                    break
                if received is not None:
                    self._keep(received)
        except Exception as error:  # noqa: BLE001  # raised again in the thread that asks
            self._failure = error
        finally:
            self.ended.set()

    def _keep(self, received: Received) -> None:
        messages = self._messages[received.topic]
        with self._lock:
            messages.append(received.message)
            oldest = received.message.stamp - self.span
            # Stamps that went back are those of a restarted driver.
            while (
                len(messages) > 1
                and not oldest <= messages[0].stamp <= messages[-1].stamp
            ):
                messages.popleft()

    def close(self) -> None:
        """End the thread."""
        self._closing.set()

    def of(self, topic: str) -> list[Message]:
        """Return the messages of a topic that are kept, oldest first."""
        if self._failure is not None:
            raise self._failure
        with self._lock:
            return list(self._messages[topic])

    def await_(self, what: Callable[[], bool], timeout: float) -> bool:
        """Wait until a condition holds, the launch ends or time is up; return whether it holds."""
        until = time.monotonic() + timeout
        while not what():
            if self.ended.is_set() or time.monotonic() > until:
                return what()
            time.sleep(_POLL)
        return True


@dataclass(frozen=True, repr=False)
class LiveTable(TickTable):
    """The last seconds of a running launch: one row per tick, as of a recording."""

    scenario: str  # name of the launched scenario
    duration_s: float  # from the first to the last stamp [s]
    _table: dict[str, NDArray[Any]]


class Live:
    """Live data of a launch; the base of `sim.api.python_runs.Run`."""

    info: RunInfo
    ask: Callable[..., Any]
    role: Callable[[str], str]

    def _kept(self, topics: tuple[str, ...]) -> RecentMessages:
        """Return the listener to some topics, started by the first call."""
        kept: dict[tuple[str, ...], RecentMessages] = self.__dict__.setdefault(
            "_listeners", {}
        )
        if topics not in kept or kept[topics].ended.is_set():
            kept[topics] = RecentMessages(self.info, topics)
            weakref.finalize(self, kept[topics].close)
        return kept[topics]

    def stream(self, *topics: str, duration: float = 0.0) -> Stream:
        """Return the messages of topics as they come, for a ``for`` or ``async for`` loop.

        A program that is slower than its messages finds at most 100 000 of them waiting; the loop
        of the launch never waits for it.

        Parameters
        ----------
        *topics : str
            Full names, e.g. ``/device/state``.
        duration : float
            Time after which the stream ends [s]; 0: with the launch.

        Returns
        -------
        Stream
            Messages (messages/PROTOCOL.md); of several topics, tuples of topic, message and time.

        Raises
        ------
        nodes.client.launches.NoSuchNameError
            If the launch has no such topic.

        Examples
        --------
        >>> for state in run.stream("/device/state", duration=2):  # doctest: +SKIP
        ...     print(state.seq, state.position)
        """
        return Stream(self.info, topics, duration)

    def latest(self, topic: str, timeout: float = STARTS_WITHIN) -> Any:
        """Return the newest message of a topic; the first call starts to listen to it.

        Parameters
        ----------
        topic : str
            Full name, e.g. ``/device/state``.
        timeout : float
            Longest wait for the first message [s].

        Returns
        -------
        Message
            The newest message (messages/PROTOCOL.md).

        Raises
        ------
        HapticError
            If there is no such topic, or no message came.

        Examples
        --------
        >>> run.latest("/device/state").position  # doctest: +SKIP
        """
        kept = self._kept((topic,))
        if not kept.await_(lambda: bool(kept.of(topic)), timeout):
            why = (
                "the launch has ended"
                if kept.ended.is_set()
                else f"none within {timeout:g} s"
            )
            raise HapticError(f"{self.info.run}: no message on {topic}: {why}")
        return kept.of(topic)[-1]

    def table(self, seconds: float = 2.0, timeout: float = 30.0) -> LiveTable:
        """Return the last seconds as columns, one row per tick; the first call gathers them.

        Parameters
        ----------
        seconds : float
            Time of the run to return [s], at most 60.
        timeout : float
            Longest wait [s].

        Returns
        -------
        LiveTable
            Columns as of `haptic.read`: ``table["position"]`` has the shape (N, 3).

        Raises
        ------
        HapticError
            If the launch ended or the time was up before there were two ticks.

        Examples
        --------
        >>> run.table(seconds=2)["position"].max(axis=0)  # doctest: +SKIP
        """
        from nodes.recording.table import columns_of, joined

        if not isinstance(seconds, Real) or not 0.0 < seconds <= LONGEST:
            raise UsageError(
                f"table: seconds is {seconds!r}; expected more than 0 and at most {LONGEST:g} s"
            )
        with speaking_python():
            self.info.only_chain()
        topics = tuple(
            topic
            for topic in (DEVICE_STATE, PROXY, FORCE)
            if topic in self.info.endpoints()
        )
        kept = self._kept(topics)
        kept.span = max(kept.span, seconds)

        def gathered() -> bool:
            states = kept.of(DEVICE_STATE)
            return len(states) > 1 and states[-1].stamp - states[0].stamp >= seconds

        kept.await_(gathered, timeout)
        states = kept.of(DEVICE_STATE)
        if len(states) < 2:
            raise HapticError(
                f"{self.info.run}: {len(states)} ticks came within {timeout:g} s"
            )
        newest = states[-1].stamp
        found = [
            m for topic in topics for m in kept.of(topic) if m.stamp >= newest - seconds
        ]
        found.sort(key=lambda message: message.seq)
        columns = columns_of(joined(found))
        columns["time"] = columns["time"] - columns["time"][0]
        return LiveTable(self.info.scenario, float(columns["time"][-1]), columns)

    def mark(self, text: str) -> dict[str, Any]:
        """Mark this moment: an event of kind ``mark``, which is recorded, drawn and listed.

        Parameters
        ----------
        text : str
            What happens now, e.g. ``"trial 3"``; at most 200 characters.

        Returns
        -------
        dict
            ``tick`` and ``stamp`` [s] of the mark.

        Raises
        ------
        HapticError
            If the text is empty or too long, or the launch has ended.

        Examples
        --------
        >>> run.mark("trial 3")  # doctest: +SKIP
        """
        marked: dict[str, Any] = self.ask(self.role("driver"), "mark", text=text)
        return marked
