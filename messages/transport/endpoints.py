"""Endpoints and their socket options: encryption over tcp, keep-alives, bounded messages.

An endpoint is ZeroMQ's own text, followed for an encrypted one by ``#`` and the public key of the
machine that binds it::

    ipc:///run/user/1000/haptic/floor_drop-…/coupling.pub  in a private directory
    tcp://10.0.0.2:5600#9f0c…                              CURVE; refused without a key
    tcp://127.0.0.1:5600#9f0c…                             also on loopback, shared by all users

The key is part of the endpoint, so a client also knows whom to expect: a forger that binds in place
of a node cannot complete the handshake.

Two rules keep a peer from ending this process. libzmq (4.3.5) remembers a peer that leaves while
its input is stopped, because a receive queue is full, and aborts (``Assertion failed: !_io_error``)
when it then writes a heartbeat to it: one of its own, or the answer to one that the peer left in
the buffer. So heartbeats are never switched on, and a silent tcp peer is detected by the kernel's
keep-alives. And a bound socket has no limit on its receive queue, so that its input never stops.
"""

import contextlib
import ipaddress
import os
from collections.abc import Iterator
from typing import TypeAlias

import zmq

from messages.codec import MAX_PAYLOAD
from messages.errors import HapticError
from messages.transport.keys import identity, parse_key

Socket: TypeAlias = zmq.Socket[bytes]
Context: TypeAlias = zmq.Context[Socket]


# ZAP domain of the encrypted sockets; with it enforced, a process without a gate accepts nobody
DOMAIN = b"haptic"

# longest frame accepted from a publisher or sent to a node; a longer one ends the connection
# [bytes]
MAX_MESSAGE = 16 * MAX_PAYLOAD
MAX_UPSTREAM = 1024  # longest frame that a listener may send to a publisher: a subscription [bytes]
# interval of the kernel's keep-alive probes on a silent tcp connection [s]
KEEPALIVE_S = 1
KEEPALIVE_PROBES = 2  # unanswered probes after which the connection is closed
# longest handshake of a local peer [ms]; ZeroMQ's 30 s would accumulate idle connections
HANDSHAKE_MS = 3000
# the same over tcp [ms]: two round trips of 1 s for the greeting, two for the keys, a lost packet
TCP_HANDSHAKE_MS = 8000
# retry interval for a publisher that is not there yet or was respawned [ms]
RECONNECT_MS = 10
MAX_RECONNECT_MS = 500  # longest retry interval for another machine [ms]


class EndpointRefusedError(HapticError, ValueError):
    """An endpoint that must not be used as it is; the text has the reason and the remedy."""


def split(endpoint: str) -> tuple[str, str]:
    """Split an endpoint into ZeroMQ's own and its key (empty for ipc).

    Raises EndpointRefusedError for tcp without a key and for other transports.
    """
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
        # another name, an interface, or * for all
        return False


def is_remote(endpoint: str) -> bool:
    """Return whether other machines can reach an endpoint: tcp, not on loopback."""
    bare = endpoint.partition("#")[0]
    return bare.startswith("tcp://") and not _is_loopback(bare)


def _set_tcp(socket: Socket) -> None:
    # TCP_NODELAY is ZeroMQ's default. Keep-alives detect a peer whose machine or cable is gone.
    socket.setsockopt(zmq.TCP_KEEPALIVE, 1)
    socket.setsockopt(zmq.TCP_KEEPALIVE_IDLE, KEEPALIVE_S)
    socket.setsockopt(zmq.TCP_KEEPALIVE_INTVL, KEEPALIVE_S)
    # Not TCP_MAXRT, which would also limit lost packets in a handshake over a bad cable.
    socket.setsockopt(zmq.TCP_KEEPALIVE_CNT, KEEPALIVE_PROBES)
    socket.setsockopt(zmq.HANDSHAKE_IVL, TCP_HANDSHAKE_MS)
    socket.setsockopt(zmq.CONNECT_TIMEOUT, 3000)
    socket.setsockopt(zmq.RECONNECT_IVL_MAX, MAX_RECONNECT_MS)
    socket.ipv6 = True


def connect(socket: Socket, endpoint: str) -> None:
    """Connect a socket; an endpoint with a key only to that key, with this machine's keys."""
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
        # Options persist: a plain endpoint after an encrypted one must not inherit its keys.
        socket.plain_server = False
    socket.connect(bare)


@contextlib.contextmanager
def closed_if_refused(*sockets: Socket) -> Iterator[None]:
    """Close new sockets if an address in the block is refused."""
    try:
        yield
    except ValueError:
        for socket in sockets:
            socket.close(linger=0)
        raise


def is_open_place(endpoint: str) -> bool:
    """Return whether an endpoint may be open to local users: tcp on loopback, without a key."""
    return (
        endpoint.startswith("tcp://") and "#" not in endpoint and _is_loopback(endpoint)
    )


def bind(socket: Socket, endpoint: str, is_open: bool = False) -> None:
    """Bind a socket; if the endpoint has a key, with this machine's keys, to allowed machines.

    `socket` may be of any kind. Plain endpoints must be bound before encrypted ones, because a
    bound endpoint keeps the options of its binding. `is_open` admits all users of this machine,
    where `is_open_place`; only for sockets that take no commands. Raises EndpointRefusedError or
    KeyRefusedError if the endpoint or this machine's keys cannot be used, or the address is taken.
    """
    bare, key = (
        (endpoint, "") if is_open and is_open_place(endpoint) else split(endpoint)
    )
    socket.setsockopt(
        zmq.MAXMSGSIZE, MAX_UPSTREAM if socket.type == zmq.XPUB else MAX_MESSAGE
    )
    # See above: the input of a bound socket must not stop. Never on a socket that is bound again:
    # libzmq 4.3.5 applies it to peers that are just being closed, and crashes.
    if socket.rcvhwm:
        socket.rcvhwm = 0
    # A peer that never completes its handshake must not occupy a connection.
    socket.setsockopt(zmq.HANDSHAKE_IVL, HANDSHAKE_MS)
    if bare.startswith("ipc://"):
        # a respawned node finds the socket file of its killed predecessor
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
        raise EndpointRefusedError(
            f"{bare}: cannot be bound: {error.strerror}"
        ) from error


def remove_ipc(endpoint: str) -> None:
    """Remove the file of an ipc endpoint, if any."""
    if endpoint.startswith("ipc://"):
        with contextlib.suppress(FileNotFoundError):
            os.unlink(endpoint.removeprefix("ipc://"))
