"""A node on a scripted clock: time passes and messages come only as a test says, alike for interpreted and compiled ticks.

Compiled ticks call the clock, the waits and ZeroMQ by their addresses, so they are handed scripted ones; the interpreter gets
the same script through the modules that it takes time and sockets from. Looking at the clock takes no time: only waits do. So
what a node does depends on the script alone, and both ticks must do the same, to the bit and to the nanosecond.
"""

from __future__ import annotations

import ctypes
import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from ctypes import c_int32, c_int64
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import msgspec
import pytest
import zmq

from messages import topics
from messages.transport.sockets import Publisher, Subscription
from messages.types import Vector
from nodes.base.node import Node
from nodes.compiled.layout import LOOP
from nodes.driver.calls import READ, WRITE, Calls
from nodes.driver.device import DeviceLimits
from nodes.driver.node import Driver
from nodes.driver.parameters import DriverParameters
from tests.support.setups import setup_of

INBOX, HOP, ASIDE = 1, 2, 3
T = 0.002
TICK = 2_000_000
START = 1_000_000_000_000
EPOCH = START + TICK
"""Tick 0, as a driver sets it when it starts [ns]."""

_GRID = 1000
"""Waits end so much after the time that was asked for, whatever was rounded on the way to them [ns]."""

_SECOND = 10**9


class Arrival(NamedTuple):
    """A message of some frames, and when it is there [ns]."""

    at: int
    frames: tuple[bytes, ...]


def at(tick: float, microseconds: float = 0.0) -> int:
    """Give a time from the start of a tick on; never one at which a wait ends [ns]."""
    return EPOCH + round(tick * TICK) + round(1000 * microseconds) + _GRID // 2


def _end_of(wanted: float) -> int:
    """When a wait ends; times are whole or half steps, give or take what was rounded on the way."""
    return (math.floor(wanted / _GRID + 0.25) + 1) * _GRID


class World:
    """The clock and the sockets of one node.

    Parameters
    ----------
    arrivals : iterable of Arrival
        What comes.
    late : mapping of int to int
        By how much a wait until the start of a tick is too long [µs].

    Attributes
    ----------
    now : int
        The time [ns].
    sent : dict of int to list
        Of each socket the time and the frames of what was sent.
    at_end : callable
        Called by who waits when nothing more will come.
    """

    def __init__(self, arrivals: Iterable[Arrival], late: Mapping[int, int] | None = None) -> None:
        self.now = START
        self._coming = deque(sorted(arrivals, key=lambda arrival: arrival.at))
        self._late = dict(late or {})
        self._frames: deque[bytes] = deque()
        self._begun: dict[int, list[bytes]] = {HOP: [], ASIDE: []}
        self.sent: dict[int, list[tuple[int, tuple[bytes, ...]]]] = {HOP: [], ASIDE: []}
        self.at_end: Callable[[], None] = lambda: None
        self.errors: list[BaseException] = []

    def clock(self) -> float:
        """Read it as the kernel does [s]."""
        return float(self.now // _SECOND + self.now % _SECOND * 1e-9)

    def sleep(self, seconds: float) -> None:
        """Sleep at least for so long."""
        self.sleep_until(self.now + seconds * 1e9)

    def sleep_until(self, wanted: float) -> None:
        """Sleep at least until then [ns]."""
        self._wake(_end_of(wanted))

    def _wake(self, until: int) -> None:
        """Let time pass until then, and for longer where the script says that the start of a tick is missed."""
        tick = round((until - EPOCH) / TICK)
        is_start = abs(until - EPOCH - tick * TICK) <= 2 * _GRID
        self.now = max(self.now, until) + (1000 * self._late.get(tick, 0) if is_start else 0)

    def is_ready(self) -> bool:
        """Whether there is a frame to be received."""
        return bool(self._frames or (self._coming and self._coming[0].at <= self.now))

    def wait(self, longest: float) -> bool:
        """Wait for a frame, so many nanoseconds at most; whether there is one."""
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
        """Take the next frame, after some milliseconds at most; -1 waits without end."""
        until = self.now + 1_000_000 * timeout_ms if timeout_ms >= 0 else math.inf
        if timeout_ms > 0 and (until - EPOCH) // TICK != (self.now - EPOCH) // TICK:
            # A wait that ends within its tick is followed by a finer one: only the last of them is too long.
            until = _end_of(until)
        if not (self.is_ready() or (timeout_ms and self._wait_until(until))):
            return None
        if not self._frames:
            self._frames.extend(self._coming.popleft().frames)
        return self._frames.popleft()

    @property
    def more(self) -> bool:
        """Whether the message of the last frame goes on."""
        return bool(self._frames)

    def send(self, socket: int, frame: bytes, more: bool) -> None:
        """Send a frame."""
        self._begun[socket].append(frame)
        if not more:
            self.sent[socket].append((self.now, tuple(self._begun[socket])))
            self._begun[socket] = []


# -- for the interpreter ---------------------------------------------------------------------------------------------


class _Socket:
    """A scripted SUB socket, as pyzmq's."""

    underlying, FD, rcvhwm, rcvtimeo = INBOX, -1, 0, -1

    def __init__(self, world: World) -> None:
        self._world = world

    def setsockopt(self, option: int, value: int) -> None:
        """Nothing to set."""

    def recv(self, flags: int = 0) -> bytes:
        frame = self._world.receive(0 if flags & zmq.NOBLOCK else self.rcvtimeo)
        if frame is None:
            raise zmq.Again
        return frame

    def get(self, option: int) -> int:
        if option == zmq.RCVMORE:
            return int(self._world.more)
        return int(zmq.POLLIN) if self._world.is_ready() else 0

    def close(self, linger: int = 0) -> None:
        """Nothing to close."""


class _Publisher(Publisher):
    """The publisher, over scripted sockets."""

    def __init__(self, world: World) -> None:
        self.apart, self.endpoint = True, ""
        self._batch, self._held = 4, []
        self._sockets: list[Any] = [SimpleNamespace(underlying=HOP), SimpleNamespace(underlying=ASIDE)]

        def sender(socket: int) -> Any:
            return lambda frame, flags=0: world.send(socket, frame, bool(flags & zmq.SNDMORE))

        self._hop, self._aside = sender(HOP), sender(ASIDE)


# -- for compiled ticks ----------------------------------------------------------------------------------------------


class _Functions:
    """The C functions that a kernel calls, with the script behind them."""

    def __init__(self, world: World, socket: _Socket) -> None:
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
            name: ctypes.CFUNCTYPE(c_int32, *kinds)(self._guarded(getattr(self, name))) for name, kinds in takes.items()
        }
        self.addresses = {name: ctypes.cast(call, ctypes.c_void_p).value or 0 for name, call in self._kept.items()}

    def _guarded(self, call: Callable[..., int]) -> Callable[..., int]:
        def guarded(*given: int) -> int:
            try:
                return call(*given)
            except BaseException as error:  # noqa: BLE001  # nothing can be raised through compiled code
                self._world.errors.append(error)
                # Whoever waits comes to its end.
                self._world.now += 1000 * _SECOND
                return -1

        return guarded

    def zmq_recv(self, socket: int, room: int, size: int, flags: int) -> int:
        assert socket == INBOX
        frame = self._world.receive(0 if flags else self.socket.rcvtimeo)
        if frame is None:
            return -1
        ctypes.memmove(room, frame, min(len(frame), size))
        return len(frame)

    def zmq_send(self, socket: int, place: int, size: int, flags: int) -> int:
        self._world.send(socket, ctypes.string_at(place, size), bool(flags & zmq.SNDMORE))
        return size

    def zmq_getsockopt(self, socket: int, option: int, value: int, _: int) -> int:
        told = self._world.more if option == zmq.RCVMORE else socket == INBOX and self._world.is_ready()
        c_int32.from_address(value).value = int(told)
        return 0

    def clock_gettime(self, _: int, value: int) -> int:
        (c_int64 * 2).from_address(value)[:] = [*divmod(self._world.now, _SECOND)]
        return 0

    def clock_nanosleep(self, _: int, __: int, until: int, ___: int) -> int:
        seconds, rest = (c_int64 * 2).from_address(until)
        self._world.sleep_until(seconds * _SECOND + rest)
        return 0

    def ppoll(self, _: int, __: int, longest: int, ___: int) -> int:
        seconds, rest = (c_int64 * 2).from_address(longest)
        return int(self._world.wait(seconds * _SECOND + rest))

    def sched_yield(self, _: int) -> int:
        return 0


# -- a driver's device ------------------------------------------------------------------------------------------------


class Hand:
    """A device whose positions are scripted; what it was given is kept.

    Parameters
    ----------
    limits : DeviceLimits
        Its limits.
    position : callable
        Where it is at a tick [m].
    fails : collection of int
        Ticks at which `read_position` raises once.
    """

    def __init__(self, limits: DeviceLimits, position: Callable[[int], Vector], fails: Iterable[int] = ()) -> None:
        self.limits, self._position, self._fails = limits, position, set(fails)
        self.given: list[tuple[int, Vector, float]] = []

    def open(self) -> None:
        """Nothing to connect."""

    def read_position(self, seq: int) -> Vector:
        """Give the position, or raise."""
        if seq in self._fails:
            self._fails.remove(seq)
            raise BlockingIOError(f"no position at tick {seq}")
        return self._position(seq)

    def write_force(self, force: Vector, seq: int, offset: float) -> None:
        """Keep what it is given."""
        self.given.append((seq, force, offset))

    def close(self) -> None:
        """Nothing to disconnect."""


class HandInC(Hand):
    """The same behind calls of its own, one of which fails where the methods do not."""

    def read_position(self, seq: int) -> Vector:
        """Give the position."""
        return self._position(seq)

    def calls(self) -> Calls:
        """Give its calls."""

        def read(_: int, seq: int, out: Any) -> int:
            if seq in self._fails:
                return -1
            out[0], out[1], out[2] = self._position(seq)
            return 0

        def write(_: int, force: Any, seq: int, offset: float) -> int:
            self.given.append((seq, (force[0], force[1], force[2]), offset))
            return 0

        self._kept = READ(read), WRITE(write)
        first, second = (ctypes.cast(function, ctypes.c_void_p).value or 0 for function in self._kept)
        return Calls(first, second, 0)


class ScriptedDriver(Driver):
    """The driver of hardware, with a `Hand` in its place."""

    Parameters = DriverParameters
    hand: Hand

    def make_device(self) -> Hand:
        """Take the hand."""
        return self.hand


class ScriptedSimulation(ScriptedDriver):
    """The same, of a device that can wait."""

    virtual = True


# -- playing ----------------------------------------------------------------------------------------------------------


class Outcome(NamedTuple):
    """All that a node did, with the time at which it did it [ns]."""

    sent: list[tuple[int, tuple[bytes, ...]]]
    aside: list[bytes]
    events: list[tuple[str, str, int, float]]
    counted: tuple[int, ...]
    state: dict[str, Any]
    given: list[tuple[int, Vector, float]]


_NOT_ALIKE = {
    *("device_read", "device_write", "device_context", "device_room", "attention", "fd", "poll"),
    *("places", "lines", "bins", "texts", "text_sizes", "table", "memory"),
    *("history", "taps", "sections", "sections_state", "undo", "undo_count", "oldest", "turned_before", "met"),
}
"""Fields that are addresses, or what compiled ticks keep for themselves."""


def _numbers(state: Any) -> dict[str, Any]:
    """Give the numbers of a node's state, beyond what its compiled ticks need of the world."""
    found: dict[str, Any] = {name: getattr(state, name) for name in ("seq", "answered", "gaps", "skipped", "ticks")}
    for name, _ in type(state)._fields_[len(LOOP) :]:
        if name not in _NOT_ALIKE:
            value = getattr(state, name)
            found[name] = value if isinstance(value, int) else repr(list(value) if hasattr(value, "__len__") else value)
    return found


class Script(NamedTuple):
    """What happens to a node, and what it is made of.

    Attributes
    ----------
    kind : type
        Its class.
    arrivals : sequence of Arrival
        What comes.
    parameters : dict
        Its parameters.
    late : mapping of int to int
        By how much the sleep until a tick is too long [µs].
    ticks : int
        How many ticks a driver runs.
    pace, apply : str
        As in a launch file.
    hand : callable or None
        Makes a driver's device.
    """

    kind: type[Node]
    arrivals: Sequence[Arrival]
    parameters: Mapping[str, Any] = {}
    late: Mapping[int, int] = {}
    ticks: int = 0
    pace: str = "realtime"
    apply: str = "on_arrival"
    hand: Callable[[], Hand] | None = None


def played(script: Script, tick: str, folder: Path) -> tuple[Outcome, Any]:
    """Play a script with one kind of tick; what the node did, and the node."""
    world = World(script.arrivals, script.late)
    name = script.kind.__name__.lower()
    for left in folder.glob("*.epoch"):
        left.unlink()
    node: Any = script.kind(
        setup_of(
            name=name,
            kind=name,
            run_dir=str(folder),
            tick=tick,
            pace=script.pace,
            apply=script.apply,
            ticks=script.ticks,
            axes=["x", "y", "z"],
            parameters=dict(script.parameters),
        )
    )
    if script.hand is not None:
        node.hand = script.hand()
    socket = _Socket(world)
    functions = _Functions(world, socket)
    time = SimpleNamespace(monotonic=world.clock, sleep=world.sleep)

    def wait(readers: Any, _: Any, __: Any, longest: float) -> None:
        assert readers
        world.wait(longest * 1e9)

    with pytest.MonkeyPatch.context() as patch:
        for module in (
            *(
                "nodes.driver.node",
                "nodes.driver.plain_tick",
                "nodes.base.realtime",
                "nodes.base.events",
                "nodes.base.follow",
            ),
            *("nodes.compiled.memory", "messages.transport.sockets"),
        ):
            patch.setattr(f"{module}.time", time)
        patch.setattr("messages.transport.sockets.select", SimpleNamespace(select=wait))
        patch.setattr("nodes.compiled.answering.functions", lambda: functions.addresses)
        node.load_kernel()
        assert (node.kernel is not None) == (tick == "compiled")
        node.entered, kernel = 0, node.kernel

        def counted(state: int) -> int:
            node.entered += 1
            return int(kernel(state))

        node.kernel = kernel and counted
        node.configure()
        node.publisher = _Publisher(world)
        context: Any = SimpleNamespace(socket=lambda _: socket)
        node.inbox = Subscription(context, [], [])
        if not isinstance(node, Driver):
            world.at_end = lambda: setattr(node, "stopping", True)
        node.started.set()
        try:
            node.loop()
        finally:
            node.finish()
        node.between_ticks(node.counted().seq)
        node.publisher.flush()
    assert not world.errors, world.errors
    return _outcome(world, node, script), node


def _outcome(world: World, node: Any, script: Script) -> Outcome:
    topic, event = node.setup.topic(script.kind.publishes[0]).encode(), topics.event(node.setup.name).encode()
    aside = [frames for _, frames in world.sent[ASIDE]]
    events = [msgspec.msgpack.decode(frames[1]) for frames in aside if frames[0] == event]
    status = node.status()
    return Outcome(
        sent=world.sent[HOP],
        aside=[frames[1] for frames in aside if frames[0] == topic],
        # Within a tick a refusal by the decoder is told at once, one by the safety at its end.
        events=sorted((one["kind"], one["reason"], one["seq"], one["stamp"]) for one in events),
        counted=(status.seq, status.ticks, status.gaps, status.skipped, status.received, status.refused, status.sent),
        state=_numbers(node.counters),
        given=node.hand.given if script.hand is not None else [],
    )


def assert_alike(script: Script, folder: Path) -> tuple[Outcome, Any]:
    """Play a script with both ticks, which must do the same; what they did, and the compiled node."""
    plain, one = played(script, "plain", folder)
    compiled, other = played(script, "compiled", folder)
    for name in Outcome._fields:
        assert getattr(compiled, name) == getattr(plain, name), name
    assert one.ticks_compiled == 0
    return compiled, other
