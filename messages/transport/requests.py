"""Requests to a running node (parameters, laws, status, stop): one request, one reply.

A request is a MessagePack map ``{op, args}``, a reply ``{ok, result, error, remedies}``, on a
socket of its own. The node serves them on a second thread, never between sample and force.
"""

import time
from collections.abc import Callable, Sequence
from typing import Annotated, Any, TypeVar

import msgspec
import zmq

from messages.codec import MAX_PAYLOAD, MessageRefusedError
from messages.errors import RefusedError, Remedy
from messages.transport.endpoints import Context, Socket, closed_if_refused, connect
from messages.transport.keys import trusted
from messages.types import Name, Text

__all__ = [
    "MAX_REPLY",
    "MAX_REQUEST",
    "Connection",
    "ControlError",
    "NoAnswerError",
    "Reply",
    "ReplySocket",
    "Request",
    "T",
    "call",
    "decode_reply",
    "decode_request",
]


class Request(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A request to a node.

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
    """A node's reply.

    Attributes
    ----------
    ok : bool
        Whether the request was carried out.
    result : object
        The result, if so.
    error : str
        The reason, if not: path, value and limit.
    remedies : tuple of Remedy
        Ways out of the refusal, if the node knows any.
    """

    ok: bool
    result: Any = None
    error: Text = ""
    remedies: Annotated[tuple[Remedy, ...], msgspec.Meta(max_length=16)] = ()


class _Bare(msgspec.Struct, frozen=True):
    """A reply without its remedies."""

    ok: bool
    error: Text = ""


class ControlError(RefusedError):
    """A node refused a request, or did not answer."""


class NoAnswerError(ControlError):
    """A node did not answer a request in time."""


T = TypeVar("T")

_WATCHED = 250
"""Interval at which a waiting client checks whether the node still runs [ms]."""

_request = msgspec.msgpack.Decoder(Request)
_reply = msgspec.msgpack.Decoder(Reply)
_bare = msgspec.msgpack.Decoder(_Bare)

MAX_REPLY = 16 * MAX_PAYLOAD
"""Longest reply that is decoded [bytes]."""

MAX_REQUEST = MAX_REPLY
"""Longest request that is decoded [bytes]; enough to load everything that a node can dump."""


def decode_request(frames: Sequence[bytes]) -> Request:
    """Decode a request from the `frames` received.

    Returns
    -------
    Request
        The typed request.

    Raises
    ------
    MessageRefusedError
        If it is not one frame, malformed or longer than MAX_REQUEST.
    """
    return _decode("Request", _request, frames, MAX_REQUEST)


def decode_reply(frames: Sequence[bytes]) -> Reply:
    """Decode a reply from the `frames` received.

    Returns
    -------
    Reply
        The typed reply; a refusal whose remedies are invalid has none.

    Raises
    ------
    MessageRefusedError
        If it is not one frame, malformed or longer than MAX_REPLY.
    """
    try:
        return _decode("Reply", _reply, frames, MAX_REPLY)
    except MessageRefusedError:
        # Without invalid remedies the reason of a refusal remains.
        bare = _decode("Reply", _bare, frames, MAX_REPLY)
        if bare.ok or not bare.error:
            raise
        return Reply(False, error=bare.error)


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


class ReplySocket:
    """Socket on which a node receives requests and answers them, one after the other.

    It is a ROUTER, because libzmq's REP (4.3.5) loses the next reply, whosever it is, after a peer
    that sent no whole request has gone: its rollback keeps the state of the reply that it could not
    begin.

    Parameters
    ----------
    context : zmq.Context
        Context of the calling process.
    """

    def __init__(self, context: Context) -> None:
        self.socket = context.socket(zmq.ROUTER)
        self._envelope: list[bytes] = []

    def receive(self) -> list[bytes]:
        """Wait for a request. Return its frames without the return envelope.

        Returns
        -------
        list of bytes
            Frames as received.
        """
        frames = self.socket.recv_multipart()
        # the peer, and the empty frame that REQ puts before its request
        inside = frames.index(b"") + 1 if b"" in frames else 1
        self._envelope, frames = frames[:inside], frames[inside:]
        return frames

    def answer(self, reply: bytes) -> None:
        """Send an encoded `reply` to the last request; a peer that is gone gets nothing."""
        self.socket.send_multipart([*self._envelope, reply])


class Connection:
    """A persistent connection to a node, to save handshakes over slow cables.

    One thread uses it.

    Parameters
    ----------
    context : zmq.Context
        Context of the calling process.
    endpoint : str
        The node's control endpoint.
    watch : callable, optional
        Called repeatedly while waiting for an answer; it raises if none can come any more.
    """

    def __init__(
        self, context: Context, endpoint: str, watch: Callable[[], None] | None = None
    ) -> None:
        self._context = context
        self._endpoint = endpoint
        self._watch = watch
        self._socket: Socket | None = None

    def call(self, op: str, timeout: float = 2.0, **args: object) -> Any:
        """Send a request to the node and return the result of its reply.

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
            If the request is too long, or the node refuses, sends an invalid reply, or does not
            answer in time.
        EndpointRefusedError, KeyRefusedError
            If the endpoint or this machine's keys cannot be used.
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
            # a late reply must not be taken for the answer to another request
            self.drop()
            raise NoAnswerError(
                f"{self._endpoint}: no answer to {op} within {timeout:g} s; is the node running?"
            ) from error
        try:
            reply = decode_reply(frames)
        except MessageRefusedError as error:
            raise ControlError(f"{self._endpoint}: {error}") from error
        if not reply.ok:
            raise ControlError(reply.error).with_remedies(*reply.remedies)
        return reply.result

    def _received(self, socket: Socket, until: float) -> list[bytes]:
        """Return the frames of the reply; `watch` raises if the node has ended."""
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
        """Raise if the key of the node's machine is not allowed here."""
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
        """Close the connection; the next request opens another one."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None


def call(
    context: Context, endpoint: str, op: str, timeout: float = 2.0, **args: object
) -> Any:
    """Send one request `op` with `args` to the node at `endpoint` and return the result.

    The connection is made in this `context`; `timeout` is the longest wait [s].

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
