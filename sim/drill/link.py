"""A faulty link between coupling and driver: drops, delays, reorders, corrupts and floods.

It is a node between the two: the driver subscribes to it instead of the coupling, so the faults of
a network happen to real messages on real sockets. Its parameters can be changed while it runs.
"""

import heapq
import random
import time
from collections.abc import Callable
from typing import Annotated, Any, ClassVar

import msgspec

from messages import topics
from nodes.base.node import IDLE_MS, Node

Portion = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
Time = Annotated[float, msgspec.Meta(ge=0.0, le=10.0)]


class LinkParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of the link; by default it forwards everything at once.

    drop: Share of messages lost.
    delay: Delay of each message [s].
    jitter: Largest additional delay, uniformly distributed; later messages may overtake [s].
    corrupt: Share of messages of which one bit is flipped.
    flood: Copies of old messages sent after each message.
    oversize: Length of one extra message sent after the next one, once per change [bytes]; 0 for
        none.
    seed: Seed of the random numbers.
    """

    drop: Portion = 0.0
    delay: Time = 0.0
    jitter: Time = 0.0
    corrupt: Portion = 0.0
    flood: Annotated[int, msgspec.Meta(ge=0, le=100_000)] = 0
    oversize: Annotated[int, msgspec.Meta(ge=0, le=1 << 24)] = 0
    seed: int = 1


class Link(Node):
    """Forwards forces with faults."""

    Parameters: ClassVar[type[msgspec.Struct]] = LinkParameters
    listens_to: ClassVar[tuple[str, ...]] = (topics.FORCE,)
    relays: ClassVar[tuple[str, ...]] = (topics.FORCE,)

    def configure(self) -> None:
        """Seed the random numbers."""
        self._to = self.setup.topic((self.relays or self.publishes)[0]).encode()
        self._now: LinkParameters = self.store.current
        self._random = random.Random(self._now.seed)  # noqa: S311  # faults, not secrets
        self._waiting: list[tuple[float, int, bytes]] = []
        self._count = 0
        self._old: list[bytes] = []
        self._oversize = self._now.oversize

    def prepare(self, parameters: Any) -> Callable[[int], Any]:
        """Prepare other faults."""

        def apply(seq: int) -> dict[str, Any]:
            self._now = parameters
            self._oversize = parameters.oversize
            return {"seq": seq}

        return apply

    def _accept(self, payload: bytes) -> None:
        now = self._now
        chance = self._random.random
        if chance() < now.drop:
            self.counters.skipped += 1
            return
        if chance() < now.corrupt:
            spoilt = bytearray(payload)
            spoilt[self._random.randrange(len(spoilt))] ^= 1 << self._random.randrange(
                8
            )
            payload = bytes(spoilt)
        self._count += 1
        due = time.monotonic() + now.delay + now.jitter * chance()
        heapq.heappush(self._waiting, (due, self._count, payload))

    def _pass_on(self) -> None:
        topic = self._to
        while self._waiting and self._waiting[0][0] <= time.monotonic():
            payload = heapq.heappop(self._waiting)[2]
            # Not `send`, which yields the processor before it serves other subscribers: without
            # FIFO, beside a busy process, the link would never catch up with its own flood.
            self.publisher.send_hop(topic, payload)
            if self.publisher.apart:
                self.publisher.send_aside(topic, payload)
            for n in range(self._now.flood):
                # Flood only the driver, not other subscribers.
                self.publisher.send_hop(
                    topic, self._old[n % len(self._old)] if self._old else payload
                )
            self.sent += 1
            self._old = [*self._old[-63:], payload]
            if self._oversize:
                self.publisher.send(topic, bytes(self._oversize))
                self._oversize = 0

    def loop(self) -> None:
        """Forward messages until stopped."""
        self.state = "running"
        inbox = self.inbox
        assert inbox is not None  # noqa: S101  # every kind that listens has one
        while not self.stopping:
            frames = (
                inbox.receive_until(self._waiting[0][0])
                if self._waiting
                else inbox.receive(IDLE_MS)
            )
            if frames is not None:
                self.received += 1
                self.counters.ticks += 1
                self._accept(frames[1])
            self._pass_on()
            self.between_ticks(self.counters.ticks)


class HandLink(Link):
    """The network between two hands: forwards one device's states to the partner.

    `remap` names the other chain's states, e.g. ``{/device/state: /right/device/state}``.
    """

    listens_to: ClassVar[tuple[str, ...]] = (topics.DEVICE_STATE,)
    relays: ClassVar[tuple[str, ...]] = ()
    publishes: ClassVar[tuple[str, ...]] = (topics.PARTNER,)
