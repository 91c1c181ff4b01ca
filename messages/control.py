"""Requests to a running node: parameters, laws, status, stop. One request, one reply, on a socket of its own.

A request is a MessagePack map ``{op, args}``, a reply ``{ok, result, error}``. The node serves them on a second thread, never
between sample and force.
"""

from __future__ import annotations

from typing import Annotated, Any

import msgspec
import zmq

from messages.codec import MAX_PAYLOAD, MessageRefusedError
from messages.types import Name, Text


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


class ControlError(RuntimeError):
    """A node refused a request, or did not answer."""


_request = msgspec.msgpack.Decoder(Request)
_reply = msgspec.msgpack.Decoder(Reply)


def decode_request(payload: bytes) -> Request:
    """Decode a request.

    Parameters
    ----------
    payload : bytes
        One frame.

    Returns
    -------
    Request
        The typed request.

    Raises
    ------
    MessageRefusedError
        When it is malformed or longer than MAX_PAYLOAD.
    """
    if len(payload) > MAX_PAYLOAD:
        raise MessageRefusedError(f"Request: {len(payload)} bytes, limit {MAX_PAYLOAD}")
    try:
        return _request.decode(payload)
    except (msgspec.DecodeError, RecursionError, UnicodeDecodeError) as error:
        raise MessageRefusedError(f"Request: {error}") from error


def call(context: zmq.Context[zmq.Socket[bytes]], endpoint: str, op: str, timeout: float = 2.0, **args: object) -> Any:
    """Ask a node and wait for its reply.

    Parameters
    ----------
    context : zmq.Context
        Context of the calling process.
    endpoint : str
        The node's control endpoint.
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
        When the node refuses, answers nonsense, or does not answer in time.
    """
    with context.socket(zmq.REQ) as socket:
        socket.linger = 0
        socket.rcvtimeo = socket.sndtimeo = int(timeout * 1000)
        socket.setsockopt(zmq.RECONNECT_IVL, 20)
        socket.connect(endpoint)
        try:
            socket.send(msgspec.msgpack.encode(Request(op, args)))
            payload = socket.recv()
        except zmq.Again as error:
            raise ControlError(f"{endpoint}: no answer to {op} within {timeout:g} s; is the node running?") from error
    try:
        reply = _reply.decode(payload)
    except (msgspec.DecodeError, RecursionError) as error:
        raise ControlError(f"{endpoint}: not a control reply: {error}") from error
    if not reply.ok:
        raise ControlError(reply.error)
    return reply.result
