"""A node on a scripted clock, for interpreted and compiled ticks alike.

Compiled ticks call clock, waits and ZeroMQ by address, so they get scripted functions; the
interpreter gets the same script through the modules it uses. Reading the clock takes no time, only
waits do. So the node's behaviour depends on the script alone, and both ticks must agree to the bit
and to the nanosecond.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import msgspec
import pytest

from messages import topics
from messages.transport.sockets import Subscription
from messages.types import Vector
from nodes.base.node import Node
from nodes.compiled.layout import LoopState
from nodes.compiled.load import load_kernel
from nodes.driver.calls import JUMPED, READ, WRITE, Calls
from nodes.driver.device import DeviceLimits
from nodes.driver.node import Driver
from nodes.driver.parameters import DriverParameters
from tests.support.scripted_world import (
    ASIDE,
    HOP,
    Arrival,
    ScriptedFunctions,
    ScriptedPublisher,
    ScriptedSocket,
    World,
)
from tests.support.setups import setup_of

# -- a driver's device
# ------------------------------------------------------------------------------------------------


class Hand:
    """A device with scripted positions that records the forces it receives.

    Parameters
    ----------
    limits : DeviceLimits
        Its limits.
    position : callable
        Where it is at a tick [m].
    fails : collection of int
        Ticks at which `read_position` raises once.
    jumps_at : collection of int
        Ticks whose position is elsewhere without a motion, as its counter `jumps` says.
    """

    world: World | None = None

    def __init__(
        self,
        limits: DeviceLimits,
        position: Callable[[int], Vector],
        fails: Iterable[int] = (),
        jumps_at: Iterable[int] = (),
    ) -> None:
        self.limits, self._position, self._fails, self._jumps_at = (
            limits,
            position,
            set(fails),
            set(jumps_at),
        )
        self.given: list[tuple[int, Vector, float]] = []
        self.log: list[tuple[int, Vector]] = []
        self.jumps = 0

    def _at(self, seq: int) -> Vector:
        if self.world is not None:
            self.world.stall("read")
        self.jumps += seq in self._jumps_at
        return self._position(seq)

    def _take(self, force: Vector, seq: int, offset: float) -> None:
        self.given.append((seq, force, offset))
        if self.world is not None:
            self.world.stall("write")
            self.log.append((self.world.now, force))

    def open(self) -> None:
        """Do nothing."""

    def read_position(self, seq: int) -> Vector:
        """Return the scripted position, or raise."""
        if seq in self._fails:
            self._fails.remove(seq)
            raise BlockingIOError(f"no position at tick {seq}")
        return self._at(seq)

    def write_force(self, force: Vector, seq: int, offset: float) -> None:
        """Record a force."""
        self._take(force, seq, offset)

    def close(self) -> None:
        """Do nothing."""


class HandInC(Hand):
    """A `Hand` with compiled calls, which can fail where the methods do not."""

    def read_position(self, seq: int) -> Vector:
        """Return the scripted position."""
        return self._at(seq)

    def calls(self) -> Calls:
        """Return its compiled calls."""

        def read(_: int, seq: int, out: Any) -> int:
            if seq in self._fails:
                return -1
            before = self.jumps
            out[0], out[1], out[2] = self._at(seq)
            return JUMPED if self.jumps != before else 0

        def write(_: int, force: Any, seq: int, offset: float) -> int:
            self._take((force[0], force[1], force[2]), seq, offset)
            return 0

        self._kept = READ(read), WRITE(write)
        first, second = (
            ctypes.cast(function, ctypes.c_void_p).value or 0 for function in self._kept
        )
        return Calls(first, second, 0)


class ScriptedDriver(Driver):
    """A driver of hardware with a `Hand` as device."""

    Parameters = DriverParameters
    hand: Hand

    def make_device(self) -> Hand:
        """Return the hand."""
        return self.hand


class ScriptedSimulation(ScriptedDriver):
    """A `ScriptedDriver` whose device can wait."""

    virtual = True


AHEAD = 5000.0
"""Offset of the launcher's clock to the driver's [s]."""


# -- playing
# --------------------------------------------------------------------------------------------------


class Outcome(NamedTuple):
    """Everything that a node did, with times [ns]."""

    sent: list[tuple[int, tuple[bytes, ...]]]
    aside: list[bytes]
    events: list[tuple[str, str, int, float]]
    counted: tuple[int, ...]
    state: dict[str, Any]
    given: list[tuple[int, Vector, float]]
    log: list[tuple[int, Vector]]


_NOT_ALIKE = {
    *(
        "device_read",
        "device_write",
        "device_context",
        "device_room",
        "attention",
        "fd",
        "poll",
    ),
    *("places", "lines", "bins", "texts", "text_sizes", "table", "memory"),
    *(
        "history",
        "taps",
        "sections",
        "sections_state",
        "undo",
        "undo_count",
        "oldest",
        "turned_before",
        "met",
    ),
}
"""Fields with addresses, or private to compiled ticks."""


def _numbers(state: Any) -> dict[str, Any]:
    """Return the numbers of a node's state, without the compiled ticks' external data."""
    found: dict[str, Any] = {
        name: getattr(state, name)
        for name in ("seq", "answered", "gaps", "skipped", "ticks")
    }
    loop: Any = LoopState
    for name, _ in type(state)._fields_[len(loop._fields_) :]:
        if name not in _NOT_ALIKE:
            # How long a tick took is measured, not ruled; that it was counted is.
            value = sum(state.spent) if name == "spent" else getattr(state, name)
            found[name] = (
                value
                if isinstance(value, int)
                else repr(list(value) if hasattr(value, "__len__") else value)
            )
    return found


class Script(NamedTuple):
    """Events of a scripted run, and the node's set-up.

    Attributes
    ----------
    kind : type
        Its class.
    arrivals : sequence of Arrival
        Messages that arrive.
    parameters : dict
        Its parameters.
    late : mapping of int to int
        Excess of the sleep until a tick [µs].
    stalls : mapping of (int, str) to int
        For how long the process is stopped in a tick, by the place in it (`World`) [µs].
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
    stalls: Mapping[tuple[int, str], int] = {}


def played(script: Script, tick: str, folder: Path) -> tuple[Outcome, Any]:
    """Run a script with one kind of tick; return the outcome and the node."""
    world = World(script.arrivals, script.late, script.stalls)
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
        node.hand.world = world
    socket = ScriptedSocket(world)
    functions = ScriptedFunctions(world, socket)
    time = SimpleNamespace(monotonic=world.clock, sleep=world.sleep)

    def wait(readers: Any, _: Any, __: Any, longest: float) -> None:
        assert readers
        world.wait(longest * 1e9)

    with pytest.MonkeyPatch.context() as patch:
        for module in (
            *(
                "nodes.driver.node",
                "nodes.driver.epoch",
                "nodes.driver.operations",
                "nodes.driver.soft_stop",
                "nodes.driver.tick_loop",
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
        load_kernel(node)
        assert (node.kernel is not None) == (tick == "compiled")
        node.entered, kernel = 0, node.kernel

        def counted(state: int) -> int:
            node.entered += 1
            return int(kernel(state))

        node.kernel = kernel and counted
        node.configure()
        node.publisher = ScriptedPublisher(world)
        context: Any = SimpleNamespace(socket=lambda _: socket)
        node.inbox = Subscription(context, [], [])
        if isinstance(node, Driver):
            # As on another machine; whoever follows compares stamps, which these scripts give in
            # this machine's time.
            node.clock.set(AHEAD, 0.0)
        else:
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
    topic, event = (
        node.setup.topic(script.kind.publishes[0]).encode(),
        topics.event(node.setup.name).encode(),
    )
    aside = [frames for _, frames in world.sent[ASIDE]]
    events = [
        msgspec.msgpack.decode(frames[1]) for frames in aside if frames[0] == event
    ]
    status = node.status()
    return Outcome(
        sent=world.sent[HOP],
        aside=[frames[1] for frames in aside if frames[0] == topic],
        # Within a tick a refusal by the decoder is told at once, one by the safety at its end.
        events=sorted(
            (one["kind"], one["reason"], one["seq"], one["stamp"]) for one in events
        ),
        counted=(
            status.seq,
            status.ticks,
            status.gaps,
            status.skipped,
            status.received,
            status.refused,
            status.sent,
        ),
        state=_numbers(node.counters),
        given=node.hand.given if script.hand is not None else [],
        log=node.hand.log if script.hand is not None else [],
    )


def assert_alike(script: Script, folder: Path) -> tuple[Outcome, Any]:
    """Run a script with both kinds of tick; assert equal outcomes, and return them."""
    plain, one = played(script, "plain", folder)
    compiled, other = played(script, "compiled", folder)
    for name in Outcome._fields:
        assert getattr(compiled, name) == getattr(plain, name), name
    assert one.ticks_compiled == 0
    return compiled, other
