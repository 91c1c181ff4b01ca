"""The gate: admits only allowed keys on encrypted sockets, and disconnects revoked ones.

ZeroMQ calls it once per connection (ZAP, RFC 27), never per message, so it costs the loop nothing.
It also monitors handshakes that fail before there is a key: a plain client, a port scan, a replayed
or altered stream. Keys are read for each new connection, and twice a second for existing ones. When
one was revoked, replaced or became unreadable, the sockets are closed to all tcp peers and opened
again (`Reopening`); allowed peers are back within a second.
"""

import contextlib
import os
import struct
import threading
import time
from collections.abc import Callable, Sequence

import zmq

from messages.transport.endpoints import (
    DOMAIN,
    Context,
    EndpointRefusedError,
    Socket,
    bind,
)
from messages.transport.keys import identity, key_dir, trusted

REVIEW = 0.5  # interval of checking the keys of connected peers [s]

ZAP = "inproc://zeromq.zap.01"
FAILURES = (
    zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL
    | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL
    | zmq.EVENT_HANDSHAKE_FAILED_AUTH
)
_FAILED: dict[int, str] = {
    zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL: (
        "without a valid handshake: a plain client, or an altered or replayed stream"
    ),
    zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL: (
        "that ended before its handshake was complete: the client gave up, "
        "took too long or has no keys"
    ),
}
_STOP = "inproc://haptic.gate.stop"
# first frame of a monitor's message: event and value (zmq_socket_monitor)
_MONITORED = struct.Struct("=Hi")


def monitor(context: Context, socket: Socket, events: int) -> Socket:
    """Return a socket that receives the events of `socket`, without blocking its thread."""
    place = f"inproc://monitor-{id(socket)}-{os.urandom(4).hex()}"
    socket.monitor(place, events)
    found = context.socket(zmq.PAIR)
    # No limit: ZeroMQ's thread would wait for a slow reader.
    found.rcvhwm = 0
    found.connect(place)
    return found


def monitored(frames: list[bytes]) -> tuple[int, str]:
    """Return event and endpoint of a monitor's message.

    pyzmq's own parser imports asyncio, a quarter of what a node loads.
    """
    event, _ = _MONITORED.unpack(frames[0])
    return event, frames[1].decode("utf-8", "replace")


def close_bound(socket: Socket, endpoint: str, deadline: float) -> bool:
    """Close a socket and wait until ZeroMQ is done with the ipc endpoint it is bound to.

    Until then its thread may still remove the endpoint's file, which would be that of the next
    socket. Not all builds of libzmq remove it, so the file itself says nothing: ZeroMQ reports the
    end of its listener.

    Parameters
    ----------
    socket : Socket
        Socket without a monitor, bound to `endpoint`.
    endpoint : str
        Where; an endpoint that is not ipc has no file, and nothing is waited for.
    deadline : float
        End of the wait by the monotonic clock [s].

    Returns
    -------
    bool
        Whether ZeroMQ is done with it.
    """
    done = not endpoint.startswith("ipc://")
    if not done:
        # without a free descriptor nothing can be waited for
        with contextlib.suppress(zmq.ZMQError):
            done = _unbind(socket, endpoint.partition("#")[0], deadline)
    socket.close(linger=0)
    return done


def _unbind(socket: Socket, bare: str, deadline: float) -> bool:
    """Unbind a socket; return whether ZeroMQ reports the listener's end before a deadline."""
    ends = monitor(socket.context, socket, zmq.EVENT_CLOSED | zmq.EVENT_CLOSE_FAILED)
    try:
        socket.unbind(bare)
        return bool(ends.poll(max(0, int(1e3 * (deadline - time.monotonic())))))
    finally:
        socket.disable_monitor()
        ends.close(linger=0)


class Reopening:
    """Closes all tcp connections to the encrypted `places` of a socket and opens them again."""

    def __init__(self, socket: Socket, places: Sequence[str]) -> None:
        self._socket = socket
        self._places = [place for place in places if "#" in place]
        self._closed: list[str] = []
        self._asked = False

    def ask(self) -> None:
        """Request it, from any thread."""
        self._asked = True

    def maintain(self) -> None:
        """Close and open as requested; called often, on the thread that owns the socket."""
        if self._asked:
            self._asked = False
            for place in self._places:
                if place not in self._closed:
                    self._closed.append(place)
                    self._socket.unbind(place.partition("#")[0])
        for place in list(self._closed):
            # ZeroMQ's thread may still occupy the port; and without this machine's keys nobody is
            # admitted.
            with contextlib.suppress(EndpointRefusedError):
                bind(self._socket, place)
                self._closed.remove(place)


class Gate(threading.Thread):
    """Guards the encrypted sockets of a process.

    It must be started before they are bound, and stopped before the context ends. On its thread it
    calls `begin` first (to leave the loop's processor), `denied` with one sentence for every peer
    that was not admitted or was disconnected, and `evict` when all connections must end because a
    key was revoked.
    """

    def __init__(
        self,
        context: Context,
        denied: Callable[[str], None],
        evict: Callable[[], None] = lambda: None,
        begin: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(name="gate", daemon=True)
        self._context, self._denied, self._evict, self._begin = (
            context,
            denied,
            evict,
            begin,
        )
        self._folder = key_dir()
        identity(self._folder)
        self._entered: set[str] = set()
        self._unreadable = ""
        self._watched: list[tuple[Socket, Socket]] = []
        self._zap = context.socket(zmq.REP)
        self._zap.bind(ZAP)
        self._stop_in = context.socket(zmq.PAIR)
        self._stop_in.bind(_STOP)
        self._stop_out = context.socket(zmq.PAIR)
        self._stop_out.connect(_STOP)

    def watch(self, socket: Socket) -> None:
        """Monitor a socket for failed handshakes; on its own thread, before the gate is started."""
        self._watched.append((socket, monitor(self._context, socket, FAILURES)))

    def run(self) -> None:
        """Guard until stopped."""
        self._begin()
        poller = zmq.Poller()
        for socket in (
            self._zap,
            self._stop_in,
            *(events for _, events in self._watched),
        ):
            poller.register(socket, zmq.POLLIN)
        following = time.monotonic() + REVIEW
        while True:
            ready = dict(poller.poll(max(1, int(1e3 * (following - time.monotonic())))))
            if self._stop_in in ready:
                break
            if self._zap in ready:
                self._answer(self._zap.recv_multipart())
            for _, events in self._watched:
                if events in ready:
                    self._tell_failure(events.recv_multipart())
            if time.monotonic() >= following:
                following = time.monotonic() + REVIEW
                self._review()
        self._close()

    def _close(self) -> None:
        for socket in (
            self._zap,
            self._stop_in,
            *(events for _, events in self._watched),
        ):
            socket.close(linger=0)

    def _tell_failure(self, frames: list[bytes]) -> None:
        event, place = monitored(frames)
        # unknown keys are reported where they are refused, with the key
        if event in _FAILED:
            self._denied(f"a connection to {place} {_FAILED[event]}")

    def _trusted(self) -> dict[str, str]:
        """Return the allowed keys and their machines' names; none if they cannot be read."""
        found, why = trusted(self._folder)
        if why and why != self._unreadable:
            self._denied(why)
        self._unreadable = why
        return found

    def _answer(self, frames: list[bytes]) -> None:
        version, request, domain, address, _, mechanism, *credentials = frames
        key = credentials[0].hex() if mechanism == b"CURVE" and credentials else ""
        name = self._trusted().get(key, "") if domain == DOMAIN else ""
        if name:
            self._entered.add(key)
        code, text = (b"200", b"OK") if name else (b"400", b"unknown key")
        self._zap.send_multipart([version, request, code, text, name.encode(), b""])
        if not name:
            where = address.decode("ascii", "replace").removeprefix("::ffff:")
            self._denied(
                f"a connection from {where} with the unknown key {key}; to let it in: haptic keys"
                f" allow NAME {key}"
            )

    def _review(self) -> None:
        gone = self._entered - self._trusted().keys() if self._entered else set()
        if gone:
            self._entered -= gone
            self._denied(
                f"the key {', '.join(sorted(gone))} is no longer allowed; all tcp connections "
                "end, and allowed peers reconnect"
            )
            self._evict()

    def stop(self) -> None:
        """Stop and wait for the thread; before the watched sockets are closed."""
        for socket, _ in self._watched:
            if not socket.closed:
                socket.disable_monitor()
        if self.is_alive():
            self._stop_out.send(b"")
            self.join()
        else:
            self._close()
        self._stop_out.close(linger=0)
