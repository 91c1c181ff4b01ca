"""Requests to a running node: parameters, laws, status, stop. One request, one reply, on a socket of its own.

A request is a MessagePack map ``{op, args}``, a reply ``{ok, result, error}``. The node serves them
on a second thread, never between sample and force.
"""

import time
from collections.abc import Callable, Sequence
from typing import Annotated, Any, TypeVar

import msgspec
import zmq

from messages.codec import MAX_PAYLOAD, MessageRefusedError
from messages.errors import RefusedError
from messages.transport.endpoints import Context, Socket, closed_if_refused, connect
from messages.transport.keys import trusted
from messages.types import Name, Text

__all__ = [
    "MAX_REPLY",
    "MAX_REQUEST",
    "Connection",
    "ControlError",
    "Desk",
    "NoAnswerError",
    "Reply",
    "Request",
    "T",
    "call",
    "decode_reply",
    "decode_request",
]


class Request(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What is asked of a node.

    Attributes
    ----------
    op : str
        Name of the operation, e.g. ``param.set``.
    args : dict
        Its arguments by name.
    """

    op: Name
    args: Annotated[dict[Name, Any], msgspec.Meta(max_length=64)] = {}


class Reply(msgspec.Struct, frozen=True):
    """What the node answers.

    Attributes
    ----------
    ok : bool
        Whether it was done.
    result : object
        The answer, when it was.
    error : str
        The reason, when it was not: path, value, limit and remedy.
    """

    ok: bool
    result: Any = None
    error: Text = ""


class ControlError(RefusedError):
    """A node refused a request, or did not answer."""


class NoAnswerError(ControlError):
    """A node did not answer a request in time."""


T = TypeVar("T")

_WATCHED = 250
"""How often one who waits looks whether the node is there [ms]."""

_request = msgspec.msgpack.Decoder(Request)
_reply = msgspec.msgpack.Decoder(Reply)

MAX_REPLY = 16 * MAX_PAYLOAD
"""Longest reply that is looked at [bytes]."""

MAX_REQUEST = MAX_REPLY
"""Longest request that is looked at [bytes]: what a node dumps, laws of thousands of taps included, can be loaded again."""


def decode_request(frames: Sequence[bytes]) -> Request:
    """Decode a request from the `frames` received.

    Returns
    -------
    Request
        The typed request.

    Raises
    ------
    MessageRefusedError
        When it is not one frame, malformed or longer than MAX_REQUEST.
    """
    return _decode("Request", _request, frames, MAX_REQUEST)


def decode_reply(frames: Sequence[bytes]) -> Reply:
    """Decode a reply from the `frames` received.

    Returns
    -------
    Reply
        The typed reply.

    Raises
    ------
    MessageRefusedError
        When it is not one frame, malformed or longer than MAX_REPLY.
    """
    return _decode("Reply", _reply, frames, MAX_REPLY)


def _decode(
    name: str, decoder: msgspec.msgpack.Decoder[T], frames: Sequence[bytes], limit: int
) -> T:
    if len(frames) != 1:
        raise MessageRefusedError(f"{name}: {len(frames)} frames, expected 1")
    if len(frames[0]) > limit:
        raise MessageRefusedError(f"{name}: {len(frames[0])} bytes, limit {limit}")
    try:
        return decoder.decode(frames[0])
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise MessageRefusedError(f"{name}: {error}") from error


class Desk:
    """Where a node takes requests and answers them, one after the other.

    A ROUTER, as libzmq's own REP loses the next reply, whosever it is, when somebody sent no whole
    request and is gone (4.3.5: its rollback keeps the state of the reply that it could not begin).

    Parameters
    ----------
    context : zmq.Context
        Context of the calling process.
    """

    def __init__(self, context: Context) -> None:
        self.socket = context.socket(zmq.ROUTER)
        self._envelope: list[bytes] = []

    def take(self) -> list[bytes]:
        """Wait for a request; its frames without the envelope that leads back to who asked.

        Returns
        -------
        list of bytes
            Frames as received.
        """
        frames = self.socket.recv_multipart()
        # The peer, and what REQ puts before its request: an empty frame.
        inside = frames.index(b"") + 1 if b"" in frames else 1
        self._envelope, frames = frames[:inside], frames[inside:]
        return frames

    def answer(self, reply: bytes) -> None:
        """Answer the request that was taken with an encoded `reply`; who is gone gets nothing."""
        self.socket.send_multipart([*self._envelope, reply])


class Connection:
    """A connection to a node that is kept from one request to the next: over a slow cable each handshake costs round trips.

    One thread uses it.

    Parameters
    ----------
    context : zmq.Context
        Context of the calling process.
    endpoint : str
        The node's control endpoint.
    watch : callable, optional
        Called again and again while an answer is waited for; it raises when there is nobody left
        who could give one.
    """

    def __init__(
        self, context: Context, endpoint: str, watch: Callable[[], None] | None = None
    ) -> None:
        self._context = context
        self._endpoint = endpoint
        self._watch = watch
        self._socket: Socket | None = None

    def call(self, op: str, timeout: float = 2.0, **args: object) -> Any:
        """Ask the node and wait for its reply.

        Parameters
        ----------
        op : str
            Operation.
        timeout : float
            Longest wait [s].
        **args : object
            Arguments of the operation.

        Returns
        -------
        object
            The result.

        Raises
        ------
        ControlError
            When the request is too long, or the node refuses, answers nonsense, or does not answer
            in time.
        EndpointRefusedError, KeyRefusedError
            When the endpoint or this machine's keys cannot be used.
        """
        payload = msgspec.msgpack.encode(Request(op, args))
        if len(payload) > MAX_REQUEST:
            raise ControlError(
                f"{self._endpoint}: {op}: a request of {len(payload)} bytes, limit {MAX_REQUEST}"
            )
        self._refuse_revoked()
        socket = self._socket = self._socket or self._connected()
        socket.rcvtimeo = socket.sndtimeo = int(timeout * 1000)
        try:
            socket.send(payload)
            frames = self._received(socket, time.monotonic() + timeout)
        except zmq.Again as error:
            # What comes later must not be taken for the answer to another request.
            self.drop()
            raise NoAnswerError(
                f"{self._endpoint}: no answer to {op} within {timeout:g} s; is the node running?"
            ) from error
        try:
            reply = decode_reply(frames)
        except MessageRefusedError as error:
            raise ControlError(f"{self._endpoint}: {error}") from error
        if not reply.ok:
            raise ControlError(reply.error)
        return reply.result

    def _received(self, socket: Socket, until: float) -> list[bytes]:
        """Wait for the reply; a node that has ended in the meantime gives none, and need not be waited for."""
        while self._watch is not None and not socket.poll(_WATCHED):
            if time.monotonic() >= until:
                raise zmq.Again
            try:
                self._watch()
            except ControlError:
                self.drop()
                raise
        return socket.recv_multipart()

    def _refuse_revoked(self) -> None:
        """Ask no machine whose key is not allowed here any more, and hear nothing from it."""
        bare, _, key = self._endpoint.partition("#")
        if key and key not in trusted()[0]:
            self.drop()
            raise ControlError(
                f"{bare}: its key {key} is not allowed here; to allow it: haptic keys allow NAME"
                f" {key}"
            )

    def _connected(self) -> Socket:
        socket = self._context.socket(zmq.REQ)
        socket.linger = 0
        with closed_if_refused(socket):
            connect(socket, self._endpoint)
        return socket

    def drop(self) -> None:
        """Close the connection; the next request makes another one."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def call(context: Context, endpoint: str, op: str, timeout: float = 2.0, **args: object) -> Any:
    """Ask a node once: `op` with `args`, at its `endpoint`, over a connection in this `context`, for `timeout` at most [s].

    Returns
    -------
    object
        The result.

    Raises
    ------
    ControlError, EndpointRefusedError, KeyRefusedError
        As `Connection.call`.
    """
    line = Connection(context, endpoint)
    try:
        return line.call(op, timeout, **args)
    finally:
        line.drop()
