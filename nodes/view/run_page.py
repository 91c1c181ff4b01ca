"""One open page of a running launch: what it has not received, its hand, its requests."""

from __future__ import annotations

import math
import time
from collections.abc import Awaitable, Callable
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
_NEAR, _WEAK = 1e-5, 5e-3  # differences that a page does not show [m], [N]


class Wakes:
    """How often messages are read: less often while nothing moves."""

    def __init__(self) -> None:
        self._place: Any = None  # position, force and target at the last look
        self._moved_at = 0.0

    def pause(self, state: DeviceState | None) -> float:
        """Return the time until the next messages are read [s]."""
        now = time.monotonic()
        place = (state.position, state.force, state.target) if state else None
        if place != self._place:
            self._place, self._moved_at = place, now
        return REST_PERIOD if now - self._moved_at > REST_AFTER else DRAIN_PERIOD


class Demand:
    """What pages ask for now: heavy work that they do not wait for comes after it."""

    def __init__(self) -> None:
        self._busy_at = -math.inf

    def note(self) -> None:
        """Note a request, a movement of the hand, or a page that opens."""
        self._busy_at = time.monotonic()

    @property
    def rests(self) -> bool:
        """Whether no page asked for anything in the last `RESTED` seconds."""
        return time.monotonic() - self._busy_at > RESTED


class RunPage:
    """An open page of a running launch."""

    def __init__(
        self,
        live: LiveRun,
        hand: SharedHand,
        command: Callable[[dict[str, Any]], Awaitable[Any]],
        demand: Demand,
    ) -> None:
        self._live, self._hand, self._command = live, hand, command
        self._demand = demand
        demand.note()
        self._feed = live.feed
        self._version = self._logged = 0
        self._cursor = self._feed.oldest(HISTORY)
        self._seq = -1
        self._void = True
        self._refused = False
        self._shown: tuple[float, ...] = ()
        self._sent_at = 0.0

    def news(self) -> list[str | bytes]:
        """Return everything not sent yet; frames seldom while nothing moves."""
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
        lengths = (*state.position, *state.target)
        values = (*(x / _NEAR for x in lengths), *(f / _WEAK for f in state.force))
        moved = not self._shown or any(
            abs(new - old) > 1.0 for new, old in zip(values, self._shown, strict=True)
        )
        if not moved and now - self._sent_at < STILL_PERIOD and not self._live.ended:
            return True
        if moved:
            self._shown = values
        self._sent_at = now
        return False

    def hand(self, target: list[float] | None) -> str:
        """Move the hand's target; report repeated refusals once, until the page lets go."""
        self._demand.note()
        refused = self._hand.move(id(self), target)
        document = self._refused
        self._refused = bool(refused)
        return "" if document else refused

    async def ask(self, request: dict[str, Any]) -> Any:
        """Execute a request of the page."""
        self._demand.note()
        return await self._command(request)

    def close(self) -> None:
        """Release the hand."""
        self._hand.move(id(self), None)
