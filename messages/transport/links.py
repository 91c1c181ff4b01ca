"""Links: connections to publishers that must not fail silently.

ZeroMQ reconnects when a peer goes away, but gives up silently when received data violates its
protocol: a message above the limit, or another service on a node's port. Here a link that was given
up, that gets no handshake, or that has gone silent raises an event with the reason and is
reconnected. This runs off the loop: the loop's thread only applies what was requested, between two
ticks.
"""

import contextlib
import math
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable

import zmq

from messages.transport.endpoints import (
    MAX_MESSAGE,
    TCP_HANDSHAKE_MS,
    Context,
    Socket,
    connect,
)
from messages.transport.gate import FAILURES, monitor, monitored
from messages.transport.keys import trusted

# time without a retry after the end of a connection when ZeroMQ has given it up [s]
GIVEN_UP = 0.3
AGAIN = 1.0  # shortest time between two reconnections of a link [s]
POLL_INTERVAL = 0.5  # interval of `Links.keep` [s]
# time without a message after which a link that is not connected is reconnected [s]
SILENCE = 3.0
# the same for a connected link [s]: the other process may live, starved of its processor
CONNECTED_SILENCE = 30.0

_EVENTS = (
    FAILURES
    | zmq.EVENT_CONNECTED
    | zmq.EVENT_DISCONNECTED
    | zmq.EVENT_CONNECT_RETRIED
    | zmq.EVENT_HANDSHAKE_SUCCEEDED
)
_NOT_LET_IN = "this machine's key is not allowed there; on that machine: haptic keys allow NAME KEY"
_NO_KEY = "the peer does not have the expected key; its messages are ignored"
_NO_NODE = "the peer is not a haptic node"
_WENT_AWAY = "the peer disconnected before its handshake was complete"
_STATES: dict[int, str] = {
    zmq.EVENT_CONNECTED: "no handshake",
    zmq.EVENT_HANDSHAKE_SUCCEEDED: "connected",
    zmq.EVENT_DISCONNECTED: "given up",
    zmq.EVENT_CONNECT_RETRIED: "nobody answers",
}


class _Link:
    """One endpoint of a subscription."""

    def __init__(self, socket: Socket, endpoint: str) -> None:
        self.socket, self.endpoint = socket, endpoint
        self.bare, _, self.key = endpoint.partition("#")
        self.state, self.since, self.was_open, self.failed = (
            "connected",
            time.monotonic(),
            True,
            "",
        )
        self.renewed, self.is_revoked = 0.0, False

    def take(self, event: int, now: float) -> str:
        """Process an event. Return why a side refused the other, or ""."""
        if event == zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL and not self.key:
            # A node that is just ending is no intruder. ZeroMQ tries again; a repeated failure is
            # reported as a link.
            self.failed = _WENT_AWAY
            return ""
        if event & FAILURES:
            self.failed = (
                _NOT_LET_IN
                if event == zmq.EVENT_HANDSHAKE_FAILED_AUTH
                else _NO_KEY
                if self.key
                else _NO_NODE
            )
            return self.failed
        self.state = _STATES[event]
        self.since = now
        if event == zmq.EVENT_HANDSHAKE_SUCCEEDED:
            self.was_open, self.failed = True, ""
        elif event == zmq.EVENT_CONNECTED:
            self.was_open = False
        return ""

    def trouble(self, now: float) -> str:
        """Return why the link must be reconnected, or ""."""
        if self.is_revoked or now - self.renewed < AGAIN:
            return ""
        if self.state == "given up" and now - self.since > GIVEN_UP:
            if self.was_open:
                return (
                    f"the data received exceeded {MAX_MESSAGE} bytes, the limit,"
                    " or was no message"
                )
            return self.failed or _NO_NODE
        if (
            self.state == "no handshake"
            and now - self.since > 1e-3 * TCP_HANDSHAKE_MS + GIVEN_UP
        ):
            return f"{_NO_NODE}: no handshake"
        return ""


class Links:
    """Monitors the links of one process.

    `tell` is called with one sentence: link, reason, action; `denied` with one for every peer that
    was refused. `call` is called when `maintain` has something to do.
    """

    def __init__(
        self,
        context: Context,
        tell: Callable[[str], None],
        denied: Callable[[str], None],
        call: Callable[[], None] = lambda: None,
    ) -> None:
        self._context, self._tell, self._denied, self._call = (
            context,
            tell,
            denied,
            call,
        )
        self._following = 0.0
        self._asked: deque[tuple[_Link, bool]] = deque()
        self._monitors: list[tuple[Socket, list[_Link]]] = []
        self._links: list[_Link] = []
        self._heard, self._silent, self._looked = -1, 0.0, time.monotonic()

    def watch(self, socket: Socket, endpoints: Iterable[str]) -> None:
        """Monitor a subscription; to be called before it connects."""
        links = [_Link(socket, endpoint) for endpoint in endpoints]
        self._monitors.append((monitor(self._context, socket, _EVENTS), links))
        self._links += links

    def poll(self, heard: int | None = None) -> None:
        """Check all links, report trouble and request reconnections."""
        now = time.monotonic()
        for events, links in self._monitors:
            with contextlib.suppress(zmq.Again):
                while True:
                    event, place = monitored(events.recv_multipart(zmq.NOBLOCK))
                    for link in _meant(links, place):
                        failure = link.take(event, now)
                        if failure:
                            self._denied(f"{link.bare}: {failure}")
        self._drop_revoked(now)
        for link in self._links:
            trouble = link.trouble(now)
            if trouble:
                self._renew(link, f"{trouble}; reconnecting", now)
        self._listen_for_silence(heard, now)

    def _renew(self, link: _Link, reason: str, now: float) -> None:
        link.state = "asked for"
        link.since = now
        link.renewed = now
        self._tell(f"{link.bare}: {reason}")
        self._asked.append((link, True))
        self._call()

    def _drop_revoked(self, now: float) -> None:
        if not any(link.key for link in self._links):
            return
        there, _ = trusted()
        for link in self._links:
            if link.key and link.key not in there and not link.is_revoked:
                link.is_revoked = True
                self._tell(
                    f"{link.bare}: its key {link.key} is no longer allowed here; its messages "
                    "are ignored"
                )
                self._asked.append((link, False))
                self._call()
            elif link.is_revoked and link.key in there:
                link.is_revoked = False
                self._renew(link, "its key is allowed again; reconnecting", now)

    def _listen_for_silence(self, heard: int | None, now: float) -> None:
        # Time in which this thread was starved itself does not count as silence.
        passed = min(now - self._looked, 2.0 * POLL_INTERVAL)
        self._looked = now
        if heard is None or heard != self._heard:
            self._heard = heard if heard is not None else -1
            self._silent = 0.0
            return
        before = self._silent
        self._silent = self._silent + passed
        for link in self._links:
            limit = CONNECTED_SILENCE if link.state == "connected" else SILENCE
            # Once per such period; a new link over a slow cable takes longer than one.
            is_long = math.floor(self._silent / limit) > math.floor(before / limit)
            if (
                is_long
                and not link.is_revoked
                and now - link.since > limit
                and link.state != "no handshake"
            ):
                self._renew(
                    link,
                    f"no message for {limit:g} s ({link.failed or link.state}); reconnecting",
                    now,
                )

    def keep(self) -> None:
        """Poll and maintain twice a second, for a listener with one thread; may be called often."""
        now = time.monotonic()
        if now >= self._following:
            self._following = now + POLL_INTERVAL
            self.poll()
            self.maintain()

    def maintain(self) -> None:
        """Reconnect or disconnect links as `poll` requested; on the receiving thread."""
        while self._asked:
            link, again = self._asked.popleft()
            # ZeroMQ may have given it up and forgotten it
            with contextlib.suppress(zmq.ZMQError):
                link.socket.disconnect(link.bare)
            if again:
                # unreadable keys connect nobody
                with contextlib.suppress(ValueError):
                    connect(link.socket, link.endpoint)

    def close(self) -> None:
        """Stop monitoring; before the subscriptions are closed."""
        for events, links in self._monitors:
            if links and not links[0].socket.closed:
                links[0].socket.disable_monitor()
            events.close(linger=0)
        self._monitors = []


def _meant(links: list[_Link], place: str) -> list[_Link]:
    """Return the links meant by ZeroMQ, which may write an address in place of a name."""
    exact = [link for link in links if link.bare == place]
    port = place.rpartition(":")[2]
    return exact or [
        link
        for link in links
        if link.bare.startswith("tcp://") and link.bare.rpartition(":")[2] == port
    ]


def say_link(reason: str) -> None:
    """Print to standard error what happened to a link."""
    print(f"[link] {reason}", file=sys.stderr, flush=True)
