"""The gate: lets only allowed keys in on encrypted sockets, and ends the connections of a key that is allowed no more.

ZeroMQ asks it once per connection (ZAP, RFC 27), never per message, so it costs the loop nothing.
It also watches these sockets for handshakes that fail before there is a key to ask about: a plain
client, a port scan, a replayed or altered stream. Keys are read anew for each connection, and twice
a second for those that are there. When one was revoked, replaced or cannot be read any more, the
sockets are closed to all tcp peers and opened again (`Reopening`): who is still allowed is back
within a second.
"""

import contextlib
import os
import struct
import threading
import time
from collections.abc import Callable, Sequence

import zmq

from messages.transport.endpoints import DOMAIN, Context, EndpointRefusedError, Socket, bind
from messages.transport.keys import identity, key_dir, trusted

REVIEW = 0.5  # how often the keys of those who are connected are looked at [s]

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
    """Watch a socket, without ever holding up the thread that serves it."""
    place = f"inproc://monitor-{id(socket)}-{os.urandom(4).hex()}"
    socket.monitor(place, events)
    found = context.socket(zmq.PAIR)
    # Without a limit: ZeroMQ's thread would wait for a slow reader.
    found.rcvhwm = 0
    found.connect(place)
    return found


def monitored(frames: list[bytes]) -> tuple[int, str]:
    """Read event and endpoint from a monitor's message; pyzmq's own parser brings asyncio, a quarter of what a node loads."""
    event, _ = _MONITORED.unpack(frames[0])
    return event, frames[1].decode("utf-8", "replace")


class Reopening:
    """Ends all tcp connections to the encrypted ones of the `places` that a socket is bound to, and lets come back who may."""

    def __init__(self, socket: Socket, places: Sequence[str]) -> None:
        self._socket = socket
        self._places = [place for place in places if "#" in place]
        self._closed: list[str] = []
        self._asked = False

    def ask(self) -> None:
        """Ask for it, from any thread."""
        self._asked = True

    def tend(self) -> None:
        """Do what was asked for; on the thread that owns the socket, as often as it likes."""
        if self._asked:
            self._asked = False
            for place in self._places:
                if place not in self._closed:
                    self._closed.append(place)
                    self._socket.unbind(place.partition("#")[0])
        for place in list(self._closed):
            # ZeroMQ's thread may still hold the port; and without this machine's keys nobody is let
            # in.
            with contextlib.suppress(EndpointRefusedError):
                bind(self._socket, place)
                self._closed.remove(place)


class Gate(threading.Thread):
    """Guards the encrypted sockets of one process; to be started before they are bound, stopped before the context ends.

    On the gate's thread it calls `begin` first (to leave the loop's processor), `denied` with one
    sentence for every peer that was not let in or was disconnected, and `evict` when all
    connections must end, because a key is not allowed any more.
    """

    def __init__(
        self,
        context: Context,
        denied: Callable[[str], None],
        evict: Callable[[], None] = lambda: None,
        begin: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(name="gate", daemon=True)
        self._context, self._denied, self._evict, self._begin = context, denied, evict, begin
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
        """Watch a socket for handshakes that fail, from the thread that owns it and before the gate is started."""
        self._watched.append((socket, monitor(self._context, socket, FAILURES)))

    def run(self) -> None:
        """Guard until stopped."""
        self._begin()
        poller = zmq.Poller()
        for socket in (self._zap, self._stop_in, *(events for _, events in self._watched)):
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
        for socket in (self._zap, self._stop_in, *(events for _, events in self._watched)):
            socket.close(linger=0)

    def _tell_failure(self, frames: list[bytes]) -> None:
        event, place = monitored(frames)
        # Unknown keys are told where they are refused, with the key.
        if event in _FAILED:
            self._denied(f"a connection to {place} {_FAILED[event]}")

    def _trusted(self) -> dict[str, str]:
        """Keys that are let in now, to the names of their machines; nobody by what cannot be read."""
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
                f"the key {', '.join(sorted(gone))} is not allowed any more; all connections over"
                " tcp end, and those still allowed connect again"
            )
            self._evict()

    def stop(self) -> None:
        """Stop watching and wait for the thread; before the watched sockets are closed."""
        for socket, _ in self._watched:
            if not socket.closed:
                socket.disable_monitor()
        if self.is_alive():
            self._stop_out.send(b"")
            self.join()
        else:
            self._close()
        self._stop_out.close(linger=0)
