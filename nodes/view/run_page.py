"""One open page of a running launch: what it has not received, its hand, its requests."""

from __future__ import annotations

import asyncio
import contextlib
import math
import time
from collections.abc import Awaitable, Callable, Iterator
from typing import Any, Final

from messages.types import DeviceState
from nodes.view.live import HISTORY, LiveRun
from nodes.view.shared_hand import SharedHand

# A screen's refresh period: waking for each message would cost more processor time [s].
DRAIN_PERIOD = 1.0 / 60.0
REST_PERIOD = 0.05  # the same while nothing has moved for REST_AFTER [s]
REST_AFTER = 1.0  # [s]
STILL_PERIOD: Final = 0.2  # time between two frames while nothing moves [s]
# Time after the last request of a page, or its hand's last movement, after which it rests [s].
RESTED: Final = 1.0
# Time after an answer in which the page shows what it did [s].
SHOWN: Final = 0.2
_NEAR, _WEAK = 1e-5, 5e-3  # differences that a page does not show [m], [N]


def _visible(state: DeviceState) -> tuple[float, ...]:
    """Return lengths and forces of a state, scaled so that a difference of 1 can be seen."""
    lengths = (*state.position, *state.target)
    return (*(x / _NEAR for x in lengths), *(f / _WEAK for f in state.force))


def _differs(values: tuple[float, ...], before: tuple[float, ...]) -> bool:
    """Whether a difference can be seen; a loop at rest still changes in the last digits."""
    return not before or any(
        abs(new - old) > 1.0 for new, old in zip(values, before, strict=True)
    )


class Wakes:
    """How often messages are read: less often while nothing visible moves."""

    def __init__(self) -> None:
        self._shown: tuple[float, ...] = ()
        self._moved_at = 0.0

    def pause(self, state: DeviceState | None, rests: bool) -> float:
        """Return the time until the next messages are read [s]; short unless the page `rests`."""
        now = time.monotonic()
        if state is not None and _differs(values := _visible(state), self._shown):
            self._shown = values
            self._moved_at = now
        slow = rests and now - self._moved_at > REST_AFTER
        return REST_PERIOD if slow else DRAIN_PERIOD


class Attention:
    """What pages ask for now: heavy work that they do not wait for comes after it."""

    def __init__(self) -> None:
        self._busy_at = self._answered_at = -math.inf
        self._pending = 0  # requests without an answer
        self._asked = asyncio.Event()
        self._read = asyncio.Event()
        self._wakes = Wakes()
        self.viewers: set[int] = set()  # pages that somebody can see

    def note(self) -> None:
        """Note a request, a movement of the hand, or a page that opens."""
        self._busy_at = time.monotonic()
        self._asked.set()

    @property
    def rests(self) -> bool:
        """Whether no page asked for anything in the last `RESTED` seconds."""
        return time.monotonic() - self._busy_at > RESTED

    @property
    def answers(self) -> bool:
        """Whether a request has no answer yet, or had it in the last `SHOWN` seconds."""
        return self._pending > 0 or time.monotonic() - self._answered_at < SHOWN

    @contextlib.contextmanager
    def request(self) -> Iterator[None]:
        """Note a request for the time until it has its answer."""
        self.note()
        self._pending += 1
        try:
            yield
        finally:
            self._pending -= 1
            self._answered_at = time.monotonic()

    async def pause(self, state: DeviceState | None) -> None:
        """Pause until messages are to be read; a page that asks ends a long pause."""
        seconds = self._wakes.pause(state, self.rests)
        if seconds <= DRAIN_PERIOD:
            await asyncio.sleep(seconds)
            return
        self._asked.clear()
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(self._asked.wait(), seconds)

    def was_read(self) -> None:
        """Wake the pages: messages were read."""
        self._read.set()
        self._read = asyncio.Event()

    async def news(self) -> None:
        """Wait until messages were read."""
        await self._read.wait()


class RunPage:
    """An open page of a running launch."""

    def __init__(
        self,
        live: LiveRun,
        hand: SharedHand,
        command: Callable[[dict[str, Any]], Awaitable[Any]],
        attention: Attention,
    ) -> None:
        self._live, self._hand, self._command = live, hand, command
        self._attention = attention
        attention.viewers.add(id(self))
        attention.note()
        self._feed = live.feed
        self._version = self._logged = 0
        self._cursor = self._feed.oldest(HISTORY)
        self._seq = -1
        self._void = True
        self._refused = False
        self._shown: tuple[float, ...] = ()
        self._sent_at = 0.0

    def news(self) -> list[str | bytes]:
        """Return everything not sent yet; frames seldom while nothing moves.

        A page that nobody sees gets nothing until it is seen again, or the run has ended.
        """
        if id(self) not in self._attention.viewers and not self._live.ended:
            return []
        texts, self._version, self._logged = self._live.board.since(
            self._version, self._logged
        )
        found: list[str | bytes] = list(texts)
        state = self._feed.state
        if state is None or not (
            state.seq != self._seq or self._feed.head > self._cursor
        ):
            return found
        if not self._may_wait(state, time.monotonic()):
            found.append(self._feed.frame(self._cursor, self._feed.head, self._void))
            self._cursor = self._feed.head
            self._seq = state.seq
            self._void = False
        return found

    def _may_wait(self, state: DeviceState, now: float) -> bool:
        """Whether nothing moved since the last frame, which is `STILL_PERIOD` old at most."""
        values = _visible(state)
        moved = _differs(values, self._shown)
        if not moved and now - self._sent_at < STILL_PERIOD and not self._live.ended:
            return True
        if moved:
            self._shown = values
        self._sent_at = now
        return False

    def hand(self, target: list[float] | None) -> str:
        """Move the hand's target; report repeated refusals once, until the page lets go."""
        self._attention.note()
        refused = self._hand.move(id(self), target)
        document = self._refused
        self._refused = bool(refused)
        return "" if document else refused

    async def ask(self, request: dict[str, Any]) -> Any:
        """Execute a request of the page."""
        if request.get("op") == "seen":
            self._attention.note()
            self._see(request.get("on") is not False)
            return {}
        with self._attention.request():
            return await self._command(request)

    def _see(self, on: bool) -> None:
        if not on:
            self._attention.viewers.discard(id(self))
            return
        self._attention.viewers.add(id(self))
        oldest = self._feed.oldest(HISTORY)
        if self._cursor < oldest:
            # Earlier bins that it has would not join these.
            self._cursor = oldest
            self._void = True

    async def due(self) -> None:
        """Wait until there may be news."""
        await self._attention.news()

    def close(self) -> None:
        """Release the hand."""
        self._attention.viewers.discard(id(self))
        self._hand.move(id(self), None)
