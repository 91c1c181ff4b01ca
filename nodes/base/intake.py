"""What a node takes in: messages of the topic that it expects; all others are refused, counted and reported."""

from collections.abc import Callable
from typing import Any, Protocol, TypeVar

from messages.codec import Decoder, MessageRefusedError
from messages.types import Message

M = TypeVar("M", bound=Message)


class TickTaker(Protocol):
    """Takes a node's usual ticks itself, compiled; the plain tick takes what it leaves."""

    def in_front_of(self, take: Callable[[], M | None]) -> Callable[[], M | None]:
        """Stand before the plain way to take a message."""

    def mail(self, topic: bytes, payload: bytes) -> bool:
        """Send a message that another thread has; whether it will."""

    def take_mail(self) -> None:
        """Send what was not sent yet."""


class Intake:
    """The intake of one node."""

    def __init__(self, node: Any) -> None:
        self._node = node

    def take(self, decoder: Decoder[M], frames: tuple[bytes, bytes], topic: bytes) -> M | None:
        """Decode a message that was received, if it is one of the topic expected; None when it was refused."""
        if frames[0] != topic:
            self.out_of_step(frames[0], topic)
            return None
        try:
            message = decoder.decode(frames[1])
        except MessageRefusedError as error:
            self._node.events.refuse(str(error))
            return None
        # Those that answer ticks count them, and what was skipped.
        self._node.received += not self._node.answers
        return message

    def out_of_step(self, frame: bytes, topic: bytes) -> None:
        """Refuse a message whose first frame is not the topic expected, and find the beginning of the next one."""
        if self._node.inbox is not None:
            self._node.inbox.resynchronise()
        self._node.events.refuse(f"a message on {frame[:64]!r} where {topic.decode()} was expected")
