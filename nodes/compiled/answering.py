"""The Python side of compiled ticks: it enters them before each plain tick, and comes back with what is unusual.

A node that answers ticks waits for its next message with a function (nodes/base/follow.py).
`CompiledTicks.in_front_of` puts the compiled ticks in front of it: they answer message after
message, and when one is not theirs it is put back on the subscription, so that the plain tick
receives it as if nobody had looked at it.
"""

from __future__ import annotations

import ctypes
import sys
import threading
from array import array
from collections.abc import Callable
from typing import Any, Final, TypeVar

import msgspec

from messages.codec import MAX_PAYLOAD
from messages.topics import LOOP
from nodes.compiled.layout import (
    LONGEST_IN,
    LONGEST_MAIL,
    LONGEST_OUT,
    LONGEST_TEXT,
    LONGEST_TOPIC,
    NEVER,
)
from nodes.compiled.library import Kernel, functions
from nodes.compiled.message_fields import key_blocks

M = TypeVar("M")

# a kernel stops after so many in lockstep; each stop costs a tick or two at 8 kHz
LOCKSTEP_TICKS: Final = 256
WAIT_MS: Final = 100  # longest wait for a message before it looks [ms]


class CompiledTicks:
    """The compiled ticks of one node, which listens to one topic inside the chain and answers on another."""

    def __init__(self, node: Any, kernel: Kernel, expected: str, topic: str) -> None:
        assert node.inbox is not None  # noqa: S101  # every kind that answers has one
        self._node, self._kernel, self._inbox = node, kernel, node.inbox
        self.state = state = node.counters  # the node's state, in which the kernel ticks
        self.inside = False  # whether the kernel ticks now
        self._mailing = threading.Lock()
        self._at = state.here = ctypes.addressof(state)
        realtime = node.setup.pace == "realtime"
        self._most = NEVER if realtime else LOCKSTEP_TICKS
        for name, address in functions().items():
            setattr(state, name, address)
        state.inbox = node.inbox.native_handle()
        state.hop, state.aside, state.batch = node.publisher.native_handles()
        state.realtime, state.period, state.until = int(realtime), node.setup.period, NEVER
        self._kept: list[Any] = []
        keys = key_blocks(LOOP[topic])
        expected, topic = node.setup.topic(expected), node.setup.topic(topic)
        self._expected = expected.encode()
        self._frame = self._room("frame", LONGEST_TOPIC)
        self._text = self._room("text", LONGEST_TEXT + 16)
        self._room("events_size", 8).raw = (4).to_bytes(8, sys.byteorder)
        self._mail = (
            self._room("mail_topic", LONGEST_TOPIC),
            self._room("mail_payload", LONGEST_MAIL),
        )
        # An encoder may write 16 bytes beyond its message.
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
        """Make a buffer, and give its address to the kernel."""
        made = ctypes.create_string_buffer(size)
        self._kept.append(made)
        setattr(self.state, name, ctypes.addressof(made))
        return made

    def keep(self, name: str, numbers: array[Any]) -> None:
        """Give the address of an array to the kernel."""
        setattr(self.state, name, numbers.buffer_info()[0])

    def say_text(self, text: str) -> bool:
        """Set the text of the messages sent."""
        encoded = msgspec.msgpack.encode(text)
        if len(encoded) > LONGEST_TEXT:
            return False
        self._text.raw = encoded.ljust(LONGEST_TEXT + 16, b"\0")
        self.state.text_size = len(encoded)
        return True

    # -- what a kind of node defines
    # ---------------------------------------------------------------------------------

    def load_state(self) -> bool:
        """Tell the kernel what it must know before its ticks; whether they are its own."""
        return True

    def store_state(self) -> None:
        """Do what follows from compiled ticks."""

    # -- for other threads, while the kernel ticks
    # --------------------------------------------------------------------

    def mail(self, topic: bytes, payload: bytes) -> bool:
        """Have the kernel send a message that is not part of a tick; whether it will, or the loop has to be called for it."""
        state = self.state
        fits = len(topic) <= LONGEST_TOPIC and len(payload) <= LONGEST_MAIL
        if not fits or not self.inside or not self._mailing.acquire(blocking=False):
            return False
        try:
            # What waits in the outbox was posted before it.
            if state.mail or self._node.events.outbox:
                return False
            for room, content in zip(self._mail, (topic, payload), strict=True):
                ctypes.memmove(room, content, len(content))
            state.mail_topic_size, state.mail_size = len(topic), len(payload)
            state.mail = 1  # last: the kernel looks at this
        finally:
            self._mailing.release()
        return True

    # -- the border
    # --------------------------------------------------------------------------------------------------

    def go(self) -> int:
        """Let the kernel tick until it stops; what it tells."""
        state = self.state
        state.upstream = state.skipping = 0
        before = state.ticks
        self.inside = True
        try:
            reason = self._kernel(self._at)
        finally:
            self.inside = False
        self._node.ticks_compiled += state.ticks - before
        self.take_mail()
        if state.upstream:
            self._node.events.waiting = True
        return reason

    def take_mail(self) -> None:
        """Put a message that the kernel was to send, and did not, into the outbox: before all that was posted after it."""
        state = self.state
        if state.mail:
            topic, payload = self._mail
            self._node.events.outbox.appendleft(
                (topic.raw[: state.mail_topic_size], payload.raw[: state.mail_size])
            )
            state.mail = 0
            self._node.events.waiting = True

    def last_sent(self) -> bytes:
        """Copy the message sent last."""
        return ctypes.string_at(self.state.sent, self.state.sent_size)

    def in_front_of(self, take: Callable[[], M | None]) -> Callable[[], M | None]:
        """Put the compiled ticks before the plain one."""
        node, state, inbox = self._node, self.state, self._inbox

        def take_next() -> M | None:
            if not self.load_state():
                return take()
            node.publisher.flush()
            inbox.set_timeout(WAIT_MS)
            state.most, state.clock_offset = self._most, node.clock.offset
            if self.go():
                node.answer = self.last_sent()
            self.store_state()
            if not state.frames:
                return None
            if state.skipping:
                # For this one, which is unusual, the one before was left out: whether rightly, the
                # plain tick finds out.
                state.skipped -= 1
                inbox.put_back((self._expected, ctypes.string_at(state.spare, state.spare_size)))
            inbox.put_back(self._frames())
            return take()

        return take_next

    def _frames(self) -> list[bytes]:
        """Copy what was taken off the socket and not answered."""
        state = self.state
        frames = [self._frame.raw[: state.frame_size]]
        if state.frames == 2:
            # A payload too long for the buffer is refused for its length alone
            size = state.payload_size
            frames.append(
                ctypes.string_at(state.payload, size) if size <= MAX_PAYLOAD else bytes(size)
            )
        return frames
