"""Endpoints, and what each kind of them asks of a socket: encryption over tcp, keep-alives, bounded messages.

An endpoint is ZeroMQ's own text, followed for an encrypted one by ``#`` and the public key of the
machine that binds it::

    ipc:///run/user/1000/haptic/floor_drop-…/coupling.pub     a private directory: nobody else gets
    there tcp://10.0.0.2:5600#9f0c…                                 CURVE, or it is refused
    tcp://127.0.0.1:5600#9f0c…                                so too on loopback, which all users of
    the machine share

The key travels with the endpoint, so who knows where to connect also knows whom to expect there: a
forger that binds in the place of a node cannot complete the handshake.

Two rules keep a peer from ending this process. libzmq (4.3.5) remembers a peer that leaves while
its input is stopped, because a receive queue is full, and aborts (``Assertion failed: !_io_error``)
when it then writes a heartbeat to it: one of its own, or the answer to one that the peer left
behind in the buffer. So heartbeats are never switched on, a silent tcp peer is found by the
kernel's keep-alives instead; and what others connect to has no limit on its receive queue, so that
its input never stops.
"""

import contextlib
import ipaddress
import os
import time
from collections.abc import Iterator
from typing import TypeAlias

import zmq

from messages.codec import MAX_PAYLOAD
from messages.errors import HapticError
from messages.transport.keys import identity, parse_key

Socket: TypeAlias = zmq.Socket[bytes]
Context: TypeAlias = zmq.Context[Socket]


# ZAP domain of the encrypted sockets; with it set and enforced, a process without a gate lets
# nobody in
DOMAIN = b"haptic"

# Longest frame that is received from a publisher or asked of a node; a longer one ends the
# connection [bytes].
MAX_MESSAGE = 16 * MAX_PAYLOAD
MAX_UPSTREAM = 1024  # longest frame that a listener may send to a publisher: a subscription [bytes]
KEEPALIVE_S = 1  # how often the kernel asks a silent tcp peer whether it is still there [s]
KEEPALIVE_PROBES = 2  # after so many of them without an answer it is given up
# how long a local peer may take to introduce itself [ms]; ZeroMQ's 30 s let idle connections pile
# up
HANDSHAKE_MS = 3000
# the same over tcp: two round trips of 1 s for the greeting, two for the keys, a lost packet [ms]
TCP_HANDSHAKE_MS = 8000
# how soon a listener tries again to reach a publisher that is not there yet or was respawned [ms]
RECONNECT_MS = 10
MAX_RECONNECT_MS = 500  # longest pause between two tries to reach another machine [ms]


class EndpointRefusedError(HapticError, ValueError):
    """An endpoint that must not be used as it is; the text says why and what to do."""


def split(endpoint: str) -> tuple[str, str]:
    """Take an endpoint apart into ZeroMQ's and its key, empty for ipc; tcp without a key and other transports are refused."""
    bare, sign, key = endpoint.partition("#")
    if sign:
        parse_key(key)
    if bare.startswith("ipc://"):
        return bare, ""
    if not bare.startswith("tcp://"):
        raise EndpointRefusedError(f"{endpoint}: neither ipc:// nor tcp://")
    if not sign and _is_loopback(bare):
        raise EndpointRefusedError(
            f"{bare}: every user of this machine can reach it, so it needs a key: haptic keys new;"
            " or use ipc://"
        )
    if not sign:
        raise EndpointRefusedError(
            f"{bare}: other machines can reach it, so it needs keys: on both machines haptic keys"
            " new, then on each haptic keys allow NAME KEY with the key of the other"
        )
    return bare, key


def _is_loopback(bare: str) -> bool:
    host = bare.removeprefix("tcp://").rpartition(":")[0].strip("[]")
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        # A name of any other kind, an interface or * for all of them.
        return False


def is_remote(endpoint: str) -> bool:
    """Whether other machines can reach an endpoint: tcp off loopback."""
    bare = endpoint.partition("#")[0]
    return bare.startswith("tcp://") and not _is_loopback(bare)


def _set_tcp(socket: Socket) -> None:
    # TCP_NODELAY is ZeroMQ's default. Keep-alives find a peer whose machine or cable went away
    # without a word.
    socket.setsockopt(zmq.TCP_KEEPALIVE, 1)
    socket.setsockopt(zmq.TCP_KEEPALIVE_IDLE, KEEPALIVE_S)
    socket.setsockopt(zmq.TCP_KEEPALIVE_INTVL, KEEPALIVE_S)
    # Not TCP_MAXRT: it would also bound how often a packet may be lost in a handshake over a bad
    # cable.
    socket.setsockopt(zmq.TCP_KEEPALIVE_CNT, KEEPALIVE_PROBES)
    socket.setsockopt(zmq.HANDSHAKE_IVL, TCP_HANDSHAKE_MS)
    socket.setsockopt(zmq.CONNECT_TIMEOUT, 3000)
    socket.setsockopt(zmq.RECONNECT_IVL_MAX, MAX_RECONNECT_MS)
    socket.ipv6 = True


def connect(socket: Socket, endpoint: str) -> None:
    """Connect a socket; where the endpoint has a key, as this machine and to that machine only."""
    bare, key = split(endpoint)
    socket.setsockopt(zmq.RECONNECT_IVL, RECONNECT_MS)
    socket.setsockopt(zmq.MAXMSGSIZE, MAX_MESSAGE)
    if bare.startswith("tcp://"):
        _set_tcp(socket)
    if key:
        me = identity()
        socket.curve_publickey, socket.curve_secretkey = (
            bytes.fromhex(me.public),
            bytes.fromhex(me.secret),
        )
        socket.curve_serverkey = bytes.fromhex(key)
    else:
        # Options last until they are changed: a plain endpoint after an encrypted one must not
        # inherit its keys.
        socket.plain_server = False
    socket.connect(bare)


@contextlib.contextmanager
def closed_if_refused(*sockets: Socket) -> Iterator[None]:
    """Close sockets that are new when what is bound or connected in a block is refused."""
    try:
        yield
    except ValueError:
        for socket in sockets:
            socket.close(linger=0)
        raise


def await_given_back(endpoint: str, deadline: float) -> None:
    """Wait, after a close, until ZeroMQ's thread has removed an ipc endpoint's file: it must not remove the next one's."""
    while (
        os.path.exists(endpoint.partition("#")[0].removeprefix("ipc://"))
        and time.monotonic() < deadline
    ):
        time.sleep(0.001)


def is_open_place(endpoint: str) -> bool:
    """Whether all users of this machine may be let listen at an endpoint, unencrypted: tcp on loopback without a key."""
    return endpoint.startswith("tcp://") and "#" not in endpoint and _is_loopback(endpoint)


def bind(socket: Socket, endpoint: str, is_open: bool = False) -> None:
    """Bind a socket; where the endpoint has a key, as this machine, to machines that the gate lets in.

    `socket`: of any kind. Plain endpoints are bound before encrypted ones: what is bound keeps the
    options it was bound with. `is_open`: whether all users of this machine may come, where
    `is_open_place`: only for what nobody can command. Raises EndpointRefusedError, KeyRefusedError
    when the endpoint or this machine's keys cannot be used, or the address is taken.
    """
    bare, key = (endpoint, "") if is_open and is_open_place(endpoint) else split(endpoint)
    socket.setsockopt(zmq.MAXMSGSIZE, MAX_UPSTREAM if socket.type == zmq.XPUB else MAX_MESSAGE)
    # See above: the input of what others connect to must not stop. Never on a socket that is bound
    # again: libzmq 4.3.5 tells it to the peers that it is just putting out, and crashes.
    if socket.rcvhwm:
        socket.rcvhwm = 0
    # What never introduces itself must not keep a place.
    socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)
    if bare.startswith("ipc://"):
        # A respawned node finds the socket file of its killed predecessor.
        remove_ipc(bare)
    else:
        _set_tcp(socket)
    if key:
        me = identity()
        if me.public != key:
            raise EndpointRefusedError(
                f"{bare}: expected with the key {key}, but this machine's is {me.public}"
            )
        socket.curve_server = True
        socket.curve_secretkey = bytes.fromhex(me.secret)
        socket.zap_domain = DOMAIN
        socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)
    try:
        socket.bind(bare)
    except zmq.ZMQError as error:
        raise EndpointRefusedError(f"{bare}: cannot be bound: {error.strerror}") from error


def remove_ipc(endpoint: str) -> None:
    """Remove the file of an ipc endpoint, if it has one."""
    if endpoint.startswith("ipc://"):
        with contextlib.suppress(FileNotFoundError):
            os.unlink(endpoint.removeprefix("ipc://"))
