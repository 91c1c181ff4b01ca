"""The Python side of compiled ticks: runs them before each plain tick.

A node that answers ticks waits for its next message with a function (nodes/base/follow.py).
`CompiledTicks.in_front_of` runs the compiled ticks before it: they answer message after message,
and a message that they cannot process is put back on the subscription, so that the plain tick
receives it unchanged.
"""

from __future__ import annotations

import ctypes
import sys
import threading
from array import array
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

import msgspec

from messages.codec import MAX_PAYLOAD
from messages.topics import LOOP
from nodes.compiled.layout import (
    LONGEST_IN,
    LONGEST_OUT,
    LONGEST_OUTGOING,
    LONGEST_TEXT,
    LONGEST_TOPIC,
    NEVER,
    LoopState,
    address_of,
)
from nodes.compiled.library import Kernel, functions
from nodes.compiled.message_fields import key_blocks

if TYPE_CHECKING:
    from nodes.base.node import Node

M = TypeVar("M")
S = TypeVar("S", bound=LoopState)

# ticks after which a kernel stops in lockstep; each stop costs a tick or two at 8 kHz
LOCKSTEP_TICKS: Final = 256
WAIT_MS: Final = 100  # longest wait for a message between checks [ms]


class CompiledTicks(Generic[S]):
    """Compiled ticks of a node that listens to one topic of the chain and answers on another."""

    def __init__(self, node: Node, kernel: Kernel, expected: str, topic: str) -> None:
        assert node.inbox is not None  # noqa: S101  # every answering kind has one
        self._node = node
        self._kernel = kernel
        self._inbox = node.inbox
        # the node's state, in which the kernel ticks
        self.state: S = node.counters
        state = self.state
        self.inside = False  # whether the kernel runs
        self._posting = threading.Lock()
        self._at = state.here = address_of(state)
        realtime = node.setup.pace == "realtime"
        self._most = NEVER if realtime else LOCKSTEP_TICKS
        for name, address in functions().items():
            setattr(state, name, address)
        state.inbox = node.inbox.native_handle()
        state.hop, state.aside, state.batch = node.publisher.native_handles()
        state.realtime = int(realtime)
        state.period = node.setup.period
        state.until = NEVER
        self._kept: list[Any] = []
        keys = key_blocks(LOOP[topic])
        expected = node.setup.topic(expected)
        topic = node.setup.topic(topic)
        self._expected = expected.encode()
        self._frame = self._room("frame", LONGEST_TOPIC)
        self._text = self._room("text", LONGEST_TEXT + 16)
        self._room("events_size", 8).raw = (4).to_bytes(8, sys.byteorder)
        self._outgoing = (
            self._room("outgoing_topic", LONGEST_TOPIC),
            self._room("outgoing_payload", LONGEST_OUTGOING),
        )
        # an encoder may write 16 bytes beyond its message
        sizes = {
            "payload": LONGEST_IN,
            "spare": LONGEST_IN,
            "time": 16,
            "events": 8,
            "held_sizes": 8 * state.batch,
        }
        for name, size in {
            **sizes,
            "out": LONGEST_OUT + 16,
            "held": state.batch * LONGEST_OUT + 16,
        }.items():
            self._room(name, size)
        for name, content in (("expected", expected), ("topic", topic)):
            self._room(name, len(content) + 1).value = content.encode()
            setattr(state, f"{name}_size", len(content.encode()))
        self._room("out_keys", len(keys)).raw = keys

    def _room(self, name: str, size: int) -> Any:
        """Allocate a buffer, and set its address in the state."""
        made = ctypes.create_string_buffer(size)
        self._kept.append(made)
        setattr(self.state, name, ctypes.addressof(made))
        return made

    def set_array(self, name: str, numbers: array[Any]) -> None:
        """Set the address of an array in the state."""
        setattr(self.state, name, numbers.buffer_info()[0])

    def set_text(self, text: str) -> bool:
        """Set the text of the messages sent. Return whether it fits."""
        encoded = msgspec.msgpack.encode(text)
        if len(encoded) > LONGEST_TEXT:
            return False
        self._text.raw = encoded.ljust(LONGEST_TEXT + 16, b"\0")
        self.state.text_size = len(encoded)
        return True

    # -- what a kind of node defines --

    def load_state(self) -> bool:
        """Prepare the state for compiled ticks. Return whether they can run."""
        return True

    def store_state(self) -> None:
        """Process the results of compiled ticks."""

    # -- for other threads, while the kernel runs --

    def post(self, topic: bytes, payload: bytes) -> bool:
        """Post a message outside the ticks for the kernel. Return whether it will be sent.

        Otherwise the loop must be interrupted for it.
        """
        state = self.state
        fits = len(topic) <= LONGEST_TOPIC and len(payload) <= LONGEST_OUTGOING
        if not fits or not self.inside or not self._posting.acquire(blocking=False):
            return False
        try:
            # messages in the outbox were posted before it
            if state.outgoing or self._node.events.outbox:
                return False
            for room, content in zip(self._outgoing, (topic, payload), strict=True):
                ctypes.memmove(room, content, len(content))
            state.outgoing_topic_size, state.outgoing_size = len(topic), len(payload)
            state.outgoing = 1  # last, because the kernel checks this
        finally:
            self._posting.release()
        return True

    # -- the border --

    def go(self) -> int:
        """Run the kernel until it stops. Return its reason."""
        state = self.state
        state.upstream = state.skipping = 0
        before = state.ticks
        self.inside = True
        try:
            reason = self._kernel(self._at)
        finally:
            self.inside = False
        self._node.ticks_compiled += state.ticks - before
        self.return_outgoing()
        if state.upstream:
            self._node.events.waiting = True
        return reason

    def return_outgoing(self) -> None:
        """Move a message that the kernel did not send to the front of the outbox."""
        state = self.state
        if state.outgoing:
            topic, payload = self._outgoing
            self._node.events.outbox.appendleft(
                (
                    topic.raw[: state.outgoing_topic_size],
                    payload.raw[: state.outgoing_size],
                )
            )
            state.outgoing = 0
            self._node.events.waiting = True

    def last_sent(self) -> bytes:
        """Return a copy of the last message sent."""
        return ctypes.string_at(self.state.sent, self.state.sent_size)

    def in_front_of(self, take: Callable[[], M | None]) -> Callable[[], M | None]:
        """Return a `take` that runs compiled ticks before the plain one."""
        node, state, inbox = self._node, self.state, self._inbox

        def take_next() -> M | None:
            if not self.load_state():
                return take()
            node.publisher.flush()
            inbox.set_timeout(WAIT_MS)
            state.most = self._most
            state.clock_offset = node.clock.offset
            if self.go():
                node.answer = self.last_sent()
            self.store_state()
            if not state.frames:
                return None
            if state.skipping:
                # The previous message was skipped for this unusual one: the plain tick decides
                # whether rightly.
                state.skipped -= 1
                inbox.put_back(
                    (self._expected, ctypes.string_at(state.spare, state.spare_size))
                )
            inbox.put_back(self._frames())
            return take()

        return take_next

    def _frames(self) -> list[bytes]:
        """Return copies of the received frames that were not answered."""
        state = self.state
        frames = [self._frame.raw[: state.frame_size]]
        if state.frames == 2:
            # a payload too long for the buffer is refused for its length only
            size = state.payload_size
            frames.append(
                ctypes.string_at(state.payload, size)
                if size <= MAX_PAYLOAD
                else bytes(size)
            )
        return frames
