"""Scripted clock and sockets of a node, for interpreted and compiled ticks.

Reading the clock takes no time, only waits do, so a node's behaviour depends on the script alone.
"""

from __future__ import annotations

import ctypes
import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from ctypes import c_int32, c_int64
from types import SimpleNamespace
from typing import Any, NamedTuple

import zmq

from messages.transport.sockets import Publisher

INBOX, HOP, ASIDE = 1, 2, 3
T = 0.002
TICK = 2_000_000
START = 1_000_000_000_000
EPOCH = START + TICK
"""Time of tick 0, as a driver sets it when it starts [ns]."""

_GRID = 1000
"""Offset of the ends of waits, so that rounding before them does not matter [ns]."""

_TENTH = _GRID // 10

_SECOND = 10**9


class Arrival(NamedTuple):
    """A message of some frames, and its time of arrival [ns]."""

    at: int
    frames: tuple[bytes, ...]


def at(tick: float, microseconds: float = 0.0) -> int:
    """Return a time from the start of a tick, never one at which a wait ends [ns]."""
    return EPOCH + round(tick * TICK) + round(1000 * microseconds) + _GRID // 2


def _end_of(wanted: float) -> int:
    """Return when a wait ends: until a deadline, which is a whole step, a step late.

    Any other wait began at an arrival, at half a step. It ends a tenth late, not at the next whole
    step: that may be the deadline, for which the interpreted tick would not wait any more, while
    the compiled one waits in one piece and is late.
    """
    whole = round(wanted / _GRID)
    if abs(wanted / _GRID - whole) < 0.025:  # of rounding
        return (whole + 1) * _GRID
    return (math.floor(wanted / _TENTH + 0.25) + 1) * _TENTH


class World:
    """Clock and sockets of one node.

    Parameters
    ----------
    arrivals : iterable of Arrival
        What comes.
    late : mapping of int to int
        By how much a wait until the start of a tick is too long [µs].
    stalls : mapping of (int, str) to int
        For how long the process is stopped in a tick, and where in it [µs]: in the device's
        ``read``, after the ``publish`` of its state, after an ``answer`` was received, when its
        arrival was ``stamped``, or in the device's ``write``.

    Attributes
    ----------
    now : int
        The time [ns].
    sent : dict of int to list
        Of each socket the time and the frames of what was sent.
    at_end : callable
        Called by who waits when nothing more will come.
    """

    def __init__(
        self,
        arrivals: Iterable[Arrival],
        late: Mapping[int, int] | None = None,
        stalls: Mapping[tuple[int, str], int] | None = None,
    ) -> None:
        self.now = START
        self._coming = deque(sorted(arrivals, key=lambda arrival: arrival.at))
        self._late, self._stalls = dict(late or {}), dict(stalls or {})
        self._stamps = False  # whether the next look at the clock is the one that stamps an arrival
        self._frames: deque[bytes] = deque()
        self._begun: dict[int, list[bytes]] = {HOP: [], ASIDE: []}
        self.sent: dict[int, list[tuple[int, tuple[bytes, ...]]]] = {HOP: [], ASIDE: []}
        self.at_end: Callable[[], None] = lambda: None
        self.errors: list[BaseException] = []

    def clock(self) -> float:
        """Return the time, as the kernel's clock does [s]."""
        now = self.now
        self.looked()
        return float(now // _SECOND + now % _SECOND * 1e-9)

    def looked(self) -> None:
        """Stop the process after a clock reading, if the script says so."""
        if self._stamps:
            self._stamps = False
            self.stall("stamped")

    def stall(self, place: str) -> None:
        """Stop the process at a place of the present tick, once, as scripted."""
        self.now += 1000 * self._stalls.pop(((self.now - EPOCH) // TICK, place), 0)

    def sleep(self, seconds: float) -> None:
        """Sleep at least for a duration."""
        self.sleep_until(self.now + seconds * 1e9)

    def sleep_until(self, wanted: float) -> None:
        """Sleep at least until a time [ns]."""
        self._wake(_end_of(wanted))

    def _wake(self, until: int) -> None:
        """Advance the time, further if the script delays the start of a tick."""
        tick = round((until - EPOCH) / TICK)
        # Waits for a deadline end at whole steps, see `_end_of`.
        is_start = until % _GRID == 0 and abs(until - EPOCH - tick * TICK) <= 2 * _GRID
        self.now = max(self.now, until) + (
            1000 * self._late.get(tick, 0) if is_start else 0
        )

    def is_ready(self) -> bool:
        """Whether a frame can be received."""
        return bool(self._frames or (self._coming and self._coming[0].at <= self.now))

    def wait(self, longest: float) -> bool:
        """Wait for a frame for at most some nanoseconds; return whether there is one."""
        return self._wait_until(_end_of(self.now + longest))

    def _wait_until(self, until: float) -> bool:
        if not self.is_ready():
            if not self._coming:
                self.at_end()
            if not self._coming or self._coming[0].at > until:
                if until < math.inf:
                    self._wake(int(until))
                return False
            self.now = self._coming[0].at
        return True

    def receive(self, timeout_ms: int) -> bytes | None:
        """Return the next frame within some milliseconds; -1 waits without limit."""
        until = self.now + 1_000_000 * timeout_ms if timeout_ms >= 0 else math.inf
        if timeout_ms > 0:
            # Every wait ends a step late, as that for a message does; of one that is followed by a
            # finer one nothing is seen.
            until = _end_of(until)
        if not (self.is_ready() or (timeout_ms and self._wait_until(until))):
            return None
        if not self._frames:
            self._frames.extend(self._coming.popleft().frames)
        frame = self._frames.popleft()
        if not self._frames:
            self._stamps = True
            self.stall("answer")
        return frame

    @property
    def more(self) -> bool:
        """Whether the last frame's message continues."""
        return bool(self._frames)

    def send(self, socket: int, frame: bytes, more: bool) -> None:
        """Send a frame."""
        self._begun[socket].append(frame)
        if not more:
            self.sent[socket].append((self.now, tuple(self._begun[socket])))
            self._begun[socket] = []
            if socket == HOP:
                self.stall("publish")


# -- for the interpreter
# ---------------------------------------------------------------------------------------------


class ScriptedSocket:
    """A scripted SUB socket with pyzmq's interface."""

    underlying, FD, rcvhwm, rcvtimeo = INBOX, -1, 0, -1

    def __init__(self, world: World) -> None:
        self._world = world

    def setsockopt(self, option: int, value: int) -> None:
        """Do nothing."""

    def recv(self, flags: int = 0) -> bytes:
        """Return the next frame."""
        frame = self._world.receive(0 if flags & zmq.NOBLOCK else self.rcvtimeo)
        if frame is None:
            raise zmq.Again
        return frame

    def get(self, option: int) -> int:
        """Return an option of the socket."""
        if option == zmq.RCVMORE:
            return int(self._world.more)
        return int(zmq.POLLIN) if self._world.is_ready() else 0

    def close(self, linger: int = 0) -> None:
        """Do nothing."""


class ScriptedPublisher(Publisher):
    """The publisher over scripted sockets."""

    def __init__(self, world: World) -> None:
        self.apart, self.endpoint = True, ""
        self._batch, self._held = 4, []
        self._sockets: list[Any] = [
            SimpleNamespace(underlying=HOP),
            SimpleNamespace(underlying=ASIDE),
        ]

        def sender(socket: int) -> Any:
            return lambda frame, flags=0: world.send(
                socket, frame, bool(flags & zmq.SNDMORE)
            )

        self._hop, self._aside = sender(HOP), sender(ASIDE)


# -- for compiled ticks
# ----------------------------------------------------------------------------------------------


class ScriptedFunctions:
    """The C functions that a kernel calls, with the script behind them."""

    def __init__(self, world: World, socket: ScriptedSocket) -> None:
        self._world, self.socket = world, socket
        takes: dict[str, tuple[Any, ...]] = {
            "zmq_recv": (c_int64, c_int64, c_int64, c_int32),
            "zmq_send": (c_int64, c_int64, c_int64, c_int32),
            "zmq_getsockopt": (c_int64, c_int32, c_int64, c_int64),
            "clock_gettime": (c_int32, c_int64),
            "clock_nanosleep": (c_int32, c_int32, c_int64, c_int64),
            "ppoll": (c_int64, c_int64, c_int64, c_int64),
            "sched_yield": (c_int64,),
        }
        self._kept = {
            name: ctypes.CFUNCTYPE(c_int32, *kinds)(self._guarded(getattr(self, name)))
            for name, kinds in takes.items()
        }
        self.addresses = {
            name: ctypes.cast(call, ctypes.c_void_p).value or 0
            for name, call in self._kept.items()
        }

    def _guarded(self, call: Callable[..., int]) -> Callable[..., int]:
        def guarded(*given: int) -> int:
            try:
                return call(*given)
            except BaseException as error:  # noqa: BLE001  # compiled code cannot propagate it
                self._world.errors.append(error)
                # Whoever waits comes to its end.
                self._world.now += 1000 * _SECOND
                return -1

        return guarded

    def zmq_recv(self, socket: int, room: int, size: int, flags: int) -> int:
        """Return the next frame."""
        assert socket == INBOX
        frame = self._world.receive(0 if flags else self.socket.rcvtimeo)
        if frame is None:
            return -1
        ctypes.memmove(room, frame, min(len(frame), size))
        return len(frame)

    def zmq_send(self, socket: int, place: int, size: int, flags: int) -> int:
        """Send a frame."""
        self._world.send(
            socket, ctypes.string_at(place, size), bool(flags & zmq.SNDMORE)
        )
        return size

    def zmq_getsockopt(self, socket: int, option: int, value: int, _: int) -> int:
        """Return an option of the socket."""
        told = (
            self._world.more
            if option == zmq.RCVMORE
            else socket == INBOX and self._world.is_ready()
        )
        c_int32.from_address(value).value = int(told)
        return 0

    def clock_gettime(self, _: int, value: int) -> int:
        """Return the time."""
        (c_int64 * 2).from_address(value)[:] = [*divmod(self._world.now, _SECOND)]
        self._world.looked()
        return 0

    def clock_nanosleep(self, _: int, __: int, until: int, ___: int) -> int:
        """Sleep as scripted."""
        seconds, rest = (c_int64 * 2).from_address(until)
        self._world.sleep_until(seconds * _SECOND + rest)
        return 0

    def ppoll(self, _: int, __: int, longest: int, ___: int) -> int:
        """Wait for a message."""
        seconds, rest = (c_int64 * 2).from_address(longest)
        return int(self._world.wait(seconds * _SECOND + rest))

    def sched_yield(self, _: int) -> int:
        """Continue at once."""
        return 0
