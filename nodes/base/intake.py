"""Receiving the expected messages; all others are refused, counted and reported."""

from collections.abc import Callable
from typing import ClassVar, Protocol, TypeVar

from messages.codec import Decoder, MessageRefusedError
from messages.transport.sockets import Subscription
from messages.types import Message
from nodes.base.events import Events

M = TypeVar("M", bound=Message)


class TickTaker(Protocol):
    """Compiled ticks of a node, which handle the usual case before the plain tick."""

    def in_front_of(self, take: Callable[[], M | None]) -> Callable[[], M | None]:
        """Return a `take` that runs compiled ticks before the plain one."""

    def post(self, topic: bytes, payload: bytes) -> bool:
        """Send a message of another thread. Return whether it will be sent."""

    def return_outgoing(self) -> None:
        """Send what was not sent yet."""


class Receiver(Protocol):
    """A node as its intake sees it."""

    answers: ClassVar[bool]
    events: Events
    inbox: Subscription | None
    received: int


class Intake:
    """The intake of one node."""

    def __init__(self, node: Receiver) -> None:
        self._node = node

    def take(
        self, decoder: Decoder[M], frames: tuple[bytes, bytes], topic: bytes
    ) -> M | None:
        """Decode a received message of the expected topic; None if it was refused."""
        if frames[0] != topic:
            self.out_of_step(frames[0], topic)
            return None
        try:
            message = decoder.decode(frames[1])
        except MessageRefusedError as error:
            self._node.events.refuse(str(error))
            return None
        # nodes that answer ticks count them, and skipped messages, themselves
        self._node.received += not self._node.answers
        return message

    def out_of_step(self, frame: bytes, topic: bytes) -> None:
        """Refuse a message with an unexpected topic, and find the beginning of the next one."""
        if self._node.inbox is not None:
            self._node.inbox.resynchronise()
        self._node.events.refuse(
            f"a message on {frame[:64]!r} where {topic.decode()} was expected"
        )
