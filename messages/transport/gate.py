"""The gate: lets in only so many connections, only allowed keys on encrypted sockets, and puts out who is allowed no more.

ZeroMQ asks it once per connection (ZAP, RFC 27), never per message, so it costs the loop nothing. It also watches the
process's sockets for handshakes that fail before there is a key to ask about: a plain client, a port scan, a replayed or
altered stream. Keys are read anew for each connection, and twice a second for those that are there: a key that was revoked,
replaced or cannot be read any more ends the connections of its machine.
"""

from __future__ import annotations

import contextlib
import os
import resource
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING

import zmq
from zmq.utils.monitor import parse_monitor_message

from messages.transport.doors import Door, Peer, doors, has_descriptors, plain_address
from messages.transport.endpoints import DOMAIN
from messages.transport.keys import identity, key_dir, trusted

if TYPE_CHECKING:
    from messages.transport.endpoints import Context, Socket

MOST_PEERS = 128
"""Connections to one socket; further ones wait until one ends, and cost no descriptor."""

RESERVED = 96
"""Descriptors that connections leave to the rest of the process."""

BURST, RATE = 64, 100.0
"""How many connections are let in at once, and how many a second after that."""

REVIEW = 0.5
"""How often keys, doors and memory are looked at [s]."""

MOST_GROWTH = 256 << 20
"""By so much memory may grow before those that came in are put out: requests without an end look like that [bytes]."""

ZAP = "inproc://zeromq.zap.01"
FAILURES = zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL | zmq.EVENT_HANDSHAKE_FAILED_AUTH
_FAILED: dict[int, str] = {
    zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL: "without a valid handshake: a plain client, or an altered or replayed stream",
    zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL: "that ended before its handshake was complete: who connected gave up, "
    "took too long or has no keys",
}
_EVENTS = FAILURES | zmq.EVENT_ACCEPTED | zmq.EVENT_ACCEPT_FAILED | zmq.EVENT_DISCONNECTED
_STOP = "inproc://haptic.gate.stop"


def monitor(context: Context, socket: Socket, events: int) -> Socket:
    """Watch a socket, without ever holding up the thread that serves it."""
    place = f"inproc://monitor-{id(socket)}-{os.urandom(4).hex()}"
    socket.monitor(place, events)
    found = context.socket(zmq.PAIR)
    # Without a limit: ZeroMQ's thread would wait for whoever is slow to look.
    found.rcvhwm = 0
    found.connect(place)
    return found


class _Watched:
    """A socket that others connect to."""

    def __init__(self, socket: Socket, events: Socket, places: Iterable[str], answers: bool) -> None:
        self.socket, self.events, self.answers = socket, events, answers
        self.places = [place.partition("#")[0] for place in places]
        self.doors: dict[str, Door] = {}
        self.peers: dict[int, Peer] = {}
        self.waits = False


class Gate(threading.Thread):
    """Guards what others connect to in one process.

    Parameters
    ----------
    context : zmq.Context
        Context of the process; start the gate before binding, stop it before terminating.
    denied : callable
        Called on the gate's thread with one sentence for every peer that was not let in, or was put out.
    encrypted : bool
        Whether there are encrypted sockets, so that this machine's keys are needed.
    begin : callable
        Called first on the gate's thread, e.g. to take it off the loop's processor.

    Raises
    ------
    KeyRefusedError
        When this machine's keys are needed and cannot be used.
    """

    def __init__(
        self,
        context: Context,
        denied: Callable[[str], None],
        encrypted: bool = True,
        begin: Callable[[], None] = lambda: None,
    ) -> None:
        super().__init__(name="gate", daemon=True)
        self._context = context
        self._denied = denied
        self._begin = begin
        self._encrypted = encrypted
        self._folder = key_dir()
        if encrypted:
            identity(self._folder)
        self._entered: dict[str, set[str]] = {}
        self._unreadable = ""
        self._watched: list[_Watched] = []
        self._tokens, self._counted = float(BURST), time.monotonic()
        self._usual = self._cuts = 0
        self._stands = threading.Event()
        self._poller = zmq.Poller()
        self._zap = context.socket(zmq.REP)
        if encrypted:
            self._zap.bind(ZAP)
        self._stop_in = context.socket(zmq.PAIR)
        self._stop_in.bind(_STOP)
        self._stop_out = context.socket(zmq.PAIR)
        self._stop_out.connect(_STOP)
        self._statm = os.open("/proc/self/statm", os.O_RDONLY | os.O_CLOEXEC)

    def watch(self, socket: Socket, places: Iterable[str], answers: bool = False) -> None:
        """Watch who connects to a socket, from the thread that owns it and before the gate is started."""
        self._watched.append(_Watched(socket, monitor(self._context, socket, _EVENTS), places, answers))

    def start(self) -> None:
        """Start, and return when nobody comes in unseen any more."""
        super().start()
        self._stands.wait(1.0)

    def run(self) -> None:
        """Guard until stopped."""
        self._begin()
        poller = self._poller
        for watched in (self._zap, self._stop_in, *(one.events for one in self._watched)):
            poller.register(watched, zmq.POLLIN)
        following = time.monotonic() + 0.05
        while not self._find_doors() and time.monotonic() < following:
            time.sleep(0.001)
        self._review()
        self._stands.set()
        while True:
            ready = dict(poller.poll(max(1, int(1e3 * (following - time.monotonic())))))
            if self._stop_in in ready:
                break
            if self._zap in ready:
                self._answer(self._zap.recv_multipart())
            for one in self._watched:
                for door in one.doors.values():
                    if door.knocks in ready:
                        self._admit(one, door)
                if one.events in ready:
                    self._take_events(one)
            if time.monotonic() >= following:
                following = time.monotonic() + REVIEW
                self._review()
            if any(one.waits and len(one.peers) < self._limit for one in self._watched):
                following = min(following, time.monotonic() + 5.0 / RATE)
        self._close()

    def _close(self) -> None:
        for socket in (self._zap, self._stop_in, *(one.events for one in self._watched)):
            socket.close(linger=0)
        os.close(self._statm)
        for one in self._watched:
            for door in one.doors.values():
                door.forget()

    # -- how many ----------------------------------------------------------------------------------------------------

    @property
    def _limit(self) -> int:
        most = (resource.getrlimit(resource.RLIMIT_NOFILE)[0] - RESERVED) // max(1, len(self._watched))
        return max(8, min(MOST_PEERS, most))

    def _find_doors(self) -> bool:
        """Find the listening sockets, which ZeroMQ's threads make in their own time; whether all are there."""
        for place, door in doors().items():
            for one in self._watched:
                if place not in one.doors and _is_one_of(place, one.places):
                    one.doors[place] = door
                    door.adopt()
                    self._listen_at(door)
        return all(len(one.doors) == len(one.places) for one in self._watched)

    def _listen_at(self, door: Door) -> None:
        """Wait until somebody knocks: only then a descriptor is needed, and only then it is looked whether there is one."""
        self._poller.register(door.knocks, zmq.POLLIN)

    def _admit(self, one: _Watched, door: Door) -> None:
        """Let in who knocks, unless there are many already, or were just now, or descriptors run out."""
        self._poller.unregister(door.knocks)
        now = time.monotonic()
        self._tokens = min(float(BURST), self._tokens + (now - self._counted) * RATE)
        self._counted = now
        if len(one.peers) >= self._limit or self._tokens < 1.0 or not has_descriptors(RESERVED // 4):
            one.waits = True
            return
        door.open_once()

    def _let_knock(self, one: _Watched) -> None:
        """Wait for the next one at the doors of a socket, if there is room."""
        one.waits = len(one.peers) >= self._limit
        if not one.waits:
            for door in one.doors.values():
                door.close()
                self._listen_at(door)

    def _take_events(self, one: _Watched) -> None:
        with contextlib.suppress(zmq.Again):
            while True:
                self._take(one, one.events.recv_multipart(zmq.NOBLOCK))

    def _take(self, one: _Watched, frames: list[bytes]) -> None:
        told = parse_monitor_message(frames)
        event, place = told["event"], told["endpoint"].decode("utf-8", "replace")
        if event == zmq.EVENT_ACCEPTED:
            self._tokens -= 1.0
            one.peers[int(told["value"])] = Peer(int(told["value"]))
            if len(one.peers) == self._limit:
                self._denied(f"{len(one.peers)} connections to {place}, the limit: others wait until one ends")
            self._let_knock(one)
        elif event == zmq.EVENT_DISCONNECTED:
            one.peers.pop(int(told["value"]), None)
            if one.waits:
                self._let_knock(one)
        elif event == zmq.EVENT_ACCEPT_FAILED:
            self._let_knock(one)
        elif event != zmq.EVENT_HANDSHAKE_FAILED_AUTH:
            # Unknown keys are told where they are refused, with the key.
            self._denied(f"a connection to {place} {_FAILED[event]}")

    # -- who ---------------------------------------------------------------------------------------------------------

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
        where = address.decode("ascii", "replace")
        if name:
            self._entered.setdefault(key, set()).add(plain_address(where))
        code, text = (b"200", b"OK") if name else (b"400", b"unknown key")
        self._zap.send_multipart([version, request, code, text, name.encode(), b""])
        if not name:
            self._denied(
                f"a connection from {where} with the unknown key {key}; to let it in: haptic keys allow NAME {key}"
            )

    def _review(self) -> None:
        if self._entered:
            there = self._trusted()
            for key in [key for key in self._entered if key not in there]:
                self._put_out(key, self._entered.pop(key))
        if not all(len(one.doors) == len(one.places) for one in self._watched):
            self._find_doors()
        for one in self._watched:
            self._let_knock(one)
        self._review_memory()

    def _put_out(self, key: str, addresses: set[str]) -> None:
        """End the connections from where a key was used; others from there are let in again at once."""
        cut = [peer for one in self._watched for peer in one.peers.values() if peer.address in addresses]
        for peer in cut:
            peer.cut()
        if cut:
            self._denied(
                f"the key {key} is not allowed any more; connections from {', '.join(sorted(addresses))} are ended"
            )

    def _review_memory(self) -> None:
        """Put out those who may send requests when memory grows without an end, then all; ZeroMQ bounds no request."""
        pages = int(os.pread(self._statm, 128, 0).split()[1])
        now = pages * resource.getpagesize()
        self._usual = self._usual or now
        if now - self._usual < MOST_GROWTH:
            self._cuts = 0
            return
        cut = [peer for one in self._watched if one.answers or self._cuts for peer in one.peers.values()]
        for peer in cut:
            peer.cut()
        self._cuts += 1
        if self._cuts > 2:
            # It is the node's own doing.
            self._usual, self._cuts = now, 0
        elif cut:
            self._denied(f"memory grew by {(now - self._usual) >> 20} MiB; {len(cut)} connections are ended")

    def stop(self) -> None:
        """Stop watching and wait for the thread; before the watched sockets are closed."""
        for one in self._watched:
            if not one.socket.closed:
                one.socket.disable_monitor()
        if self.is_alive():
            self._stop_out.send(b"")
            self.join()
        else:
            self._close()
        self._stop_out.close(linger=0)


def _is_one_of(place: str, bound: Sequence[str]) -> bool:
    """Whether a listening socket is one of those endpoints, which may be written with a machine's name."""
    port = place.rpartition(":")[2]
    return place in bound or any(one.startswith("tcp://") and one.rpartition(":")[2] == port for one in bound)
