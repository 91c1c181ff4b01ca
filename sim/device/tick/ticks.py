"""The sim driver's compiled ticks: what crosses the border between its plain side and the kernel."""

from __future__ import annotations

import ctypes
import math
from array import array
from collections.abc import Sequence
from typing import Any, Protocol

import msgspec

from messages import topics
from messages.types import Vector
from nodes.base.setup import Setup
from nodes.driver.ahead import Belated, Stop
from nodes.driver.mean_force import Latency
from nodes.driver.motion import Motion
from nodes.driver.passivity import PassivityGuard
from nodes.driver.response_times import BLOCK, ResponseTimes
from nodes.driver.safety import REACH, Safety
from nodes.tick.answering import WAIT_MS, CompiledTicks, Node
from nodes.tick.layout import LONGEST_IN, Counted
from nodes.tick.library import Kernel
from sim.device.tick.layout import PENDING, WAITING, DriverState

HAND_AHEAD = 0.05
"""How much of a hand's path is computed at once [s]: ten microseconds at 500 Hz."""

AHEAD = 4
"""Points of a hand's path that are computed beyond the ticks to do: a lost tick lets several pass at once."""


class _Timed(Protocol):
    """`sim.device.driver.TimedDevice`, as far as it is shared."""

    device: Any
    dragged: Any
    axis: int
    tick: int
    acting: float
    commanded: float
    pending: Any
    delay: float
    hold: float


class _Driver(Node, Protocol):
    """`nodes.driver.node.Driver`, as far as it is shared."""

    setup: Setup
    called: bool
    stopping: bool
    sent: int
    _axes: list[int]
    _device: Any
    _safety: Safety
    _motion: Motion
    _guard: PassivityGuard | None
    _latency: Latency | None
    _responses: ResponseTimes
    _handed: Vector
    _written: int
    _bears: float
    _oldest_age: int
    _response: float
    _lateness: float
    _delay: float
    _age: int
    _missed: int
    _overruns: int
    _unlistened: bytes


def _vector(numbers: Sequence[float]) -> Vector:
    return numbers[0], numbers[1], numbers[2]


class DriverTicks(CompiledTicks):
    """The compiled ticks of a sim driver.

    Parameters
    ----------
    node : SimDriver
        The node; its device is made.
    kernel : callable
        sim/device/tick/kernel.py, compiled.
    """

    def __init__(self, node: _Driver, kernel: Kernel) -> None:
        setup = node.setup
        realtime = setup.pace == "realtime"
        state: Any = DriverState()
        super().__init__(node, kernel, state, topics.FORCE, topics.DEVICE_STATE, setup.period, realtime)
        self._driver = node
        self.say_text("active")
        state.axes, state.axis[:] = len(node._axes), (*node._axes, 0, 0)[:3]
        state.next_tick = setup.apply == "next_tick"
        self._set_waiting()
        self._set_limits(node._safety)
        self._set_device(node._device)
        self.keep("recent", node._responses.recent)
        self.keep("bins", node._responses.bins)
        state.places_count = node._motion.kept
        self.keep("places", node._motion.recent)
        lines = [] if node._latency is None else node._latency.lines
        self._lines = array("d", [0.0]) * sum(map(len, lines))
        self.keep("lines", self._lines)
        state.line_length = len(lines[0]) if lines else 0
        state.line_part = 0.0 if node._latency is None else node._latency.part

    def _set_waiting(self) -> None:
        self._poll = array(
            "i", [self._inbox.fd, 1]
        )  # struct pollfd: descriptor, then two shorts: POLLIN, and the answer
        self.keep("poll", self._poll)

    def _set_limits(self, safety: Safety) -> None:
        state: Any = self.state
        limits = safety.limits
        state.peak = math.inf if limits.peak is None else limits.peak
        state.slew = math.inf if limits.slew is None else limits.slew
        # In lockstep only the tick's own answer counts.
        state.max_age, state.watchdog = limits.max_age if state.realtime else 0, limits.watchdog
        state.workspace[:] = [bound for bounds in limits.workspace for bound in bounds]
        state.reach = REACH

    def _set_device(self, timed: _Timed) -> None:
        state: Any = self.state
        device = timed.device
        model = device.model
        state.mass, state.damping, state.grip = model.moving_mass, model.moving_damping, model.grip
        for name, value in (
            ("friction", model.friction),
            ("resolution", model.resolution),
            ("motor", model.peak_force),
        ):
            setattr(state, f"has_{name}", value is not None)
            setattr(state, name, 0.0 if value is None else value)
        state.low, state.high = device.ends
        state.device_axis = timed.axis
        state.early, state.late = device.early, device.late
        state.early_map[:], state.late_map[:] = device.early_map, device.late_map
        self._commands = array("d", device.commands)
        self.keep("commands", self._commands)
        state.commands_count = len(self._commands)
        state.device_delay, state.device_hold = timed.delay, timed.hold
        self._pending = array("d", [0.0]) * (2 * PENDING)
        self.keep("pending", self._pending)
        if model.hand is not None and self._most * device.period > HAND_AHEAD:
            self._most = max(1, int(HAND_AHEAD / device.period))
        state.weight = msgspec.structs.replace(model, hand=None).load(0, device.period)
        self._targets = array("d", [0.0]) * (self._most + AHEAD if model.hand is not None else 0)
        self.keep("targets", self._targets)
        state.targets_count = len(self._targets)
        if timed.dragged is not None:
            reader = timed.dragged.reader
            state.pointer, state.silence, state.farthest = reader.address, reader.silence, timed.dragged.farthest

    def wake(self) -> None:
        """Ask the kernel to stop after the present tick; from any thread."""
        self.state.attention = 1

    def counted(self) -> Counted:
        """Tell how far the kernel is; of a driver, the tick that was sampled last."""
        return super().counted()._replace(seq=self.state.asked)

    def progress(self) -> dict[str, Any]:
        """Tell what `Answers` tells of its progress."""
        state: Any = self.state
        return {
            "tick": state.ticks,
            "position_m": list(state.position),
            "force_n": list(state.force),
            "missed": state.missed,
            "overruns": state.overruns,
            "answered": state.counted + state.recent_at % BLOCK,
        }

    def _usual(self) -> bool:
        """Whether the next tick is one for the kernel."""
        node = self._driver
        safety, motion = node._safety, node._motion
        return (
            safety.state == "active"
            and safety.motor is None
            and not (safety.swings and safety.peaked)
            and node._guard is None
            and motion.covered > 0
            and motion.samples > 0
            and (self.state.realtime == 0 or node._device.tick >= 0)
            and len(node._device.pending) < PENDING // 2
            and not (node.called or node.stopping)
        )

    def run(self, seq: int, end: int, epoch: float, following: Vector | None, belated: Belated | None) -> Stop:
        """Do ticks until something is unusual."""
        state: Any = self.state
        # Before looking: what comes in between stops it.
        state.attention = 0
        if not self._usual() or not self._keep(belated):
            return Stop(seq, None, following, belated, 0)
        node = self._driver
        node.publisher.flush()
        if not state.realtime:
            self._inbox.set_timeout(WAIT_MS)
        state.seq, state.until, state.epoch = seq, end, epoch
        state.has_following = following is not None
        if following is not None:
            state.following[:] = following
        self._take_over()
        done = self.go()
        self._give_back(done)
        belated = None
        if state.belated:
            topic, payload = self._frames()
            belated = (topic, payload), state.belated_at
        elif state.frames:
            self._inbox.put_back(self._frames())
        waits = state.phase == WAITING
        return Stop(
            state.seq,
            state.sampled if waits else None,
            _vector(state.following) if state.has_following else None,
            belated,
            done,
        )

    def rehearse(self) -> None:
        """Go in and out once without a tick: the first time, with cold caches, it takes some ticks of 8 kHz."""
        self._take_over()
        self.state.most = 0
        self.go()
        self._give_back(0)

    def _keep(self, belated: Belated | None) -> bool:
        """Lay an answer that came late into the kernel's buffers; whether it fits."""
        state: Any = self.state
        state.belated = belated is not None
        if belated is not None:
            (topic, payload), state.belated_at = belated
            if topic != self._expected or len(payload) > LONGEST_IN:
                return False
            ctypes.memmove(self._frame, topic, len(topic))
            ctypes.memmove(self._payload, payload, len(payload))
            state.frames, state.frame_size, state.payload_size = 2, len(topic), len(payload)
        return True

    def _take_over(self) -> None:
        """Bring the kernel's side up to date."""
        node = self._driver
        safety, motion, responses = node._safety, node._motion, node._responses
        state: Any = self.state
        state.most = self._most
        state.ticks, state.clock_offset = node.ticks, node.clock_offset
        state.lateness, state.response, state.delay = node._lateness, node._response, node._delay
        state.age, state.missed, state.overruns = node._age, node._missed, node._overruns
        state.handed[:], state.written, state.bears = node._handed, node._written, node._bears
        state.oldest_age, state.heard, state.taken = node._oldest_age, 1, 0
        state.force[:], state.force_seq, state.since = safety.force, safety.force_seq, safety.since
        state.position[:], state.before[:] = motion.position, motion.before
        state.acting[:], state.acted[:] = motion.acting, motion.acted
        state.elapsed, state.covered = motion.elapsed, motion.covered
        state.energy, state.highest = motion.energy, motion.highest
        state.at, state.at_before = motion.at, motion.at_before
        state.places_at = motion.samples % motion.kept
        state.recent_at, state.counted, state.longest = responses.at, responses.counted, responses.longest_counted
        if node._latency is not None:
            for i, line in enumerate(node._latency.lines):
                self._lines[i * len(line) : (i + 1) * len(line)] = array("d", line)
        self._device_over()

    def _device_over(self) -> None:
        state: Any = self.state
        timed: _Timed = self._driver._device
        device = timed.device
        state.x, state.v, state.device_ticks = device.position, device.velocity, device.ticks
        state.targets_from = device.ticks
        for n in range(len(self._targets)):
            self._targets[n] = device.model.hand.point((device.ticks + n) * device.period)
        if (dragged := timed.dragged) is not None:
            state.wanted, state.wanted_at = dragged.reader.last[timed.axis], dragged.reader.last[3]
            state.is_away, state.away = dragged.away is not None, dragged.away or 0.0
            state.pull = device.target or 0.0
        # The oldest first: the next one overwrites it.
        self._commands[:] = array("d", reversed(device.commands))
        state.slot = 0
        state.device_tick, state.device_acting, state.commanded = timed.tick, timed.acting, timed.commanded
        state.pending_first, state.pending_count = 0, len(timed.pending)
        for n, (when, force) in enumerate(timed.pending):
            self._pending[2 * n], self._pending[2 * n + 1] = when, force

    def _give_back(self, done: int) -> None:
        """Bring the node's side up to date."""
        node = self._driver
        state: Any = self.state
        safety, motion, responses = node._safety, node._motion, node._responses
        sampled = done + (state.phase == WAITING)
        node.ticks, node.ticks_compiled = state.ticks, node.ticks_compiled + done
        node.sent += sampled
        node.received += state.taken
        node._missed, node._overruns, node._oldest_age = state.missed, state.overruns, state.oldest_age
        node._lateness, node._response, node._delay, node._age = state.lateness, state.response, state.delay, state.age
        node._handed, node._written = _vector(state.handed), state.written
        if done or state.taken:
            safety.answered(_vector(state.force), state.force_seq, state.since, state.asked, list(state.slewed))
            responses.at, responses.counted, responses.longest_counted = state.recent_at, state.counted, state.longest
        motion.elapsed, motion.covered, motion.acting = state.elapsed, state.covered, list(state.acting)
        if sampled:
            node.seq = state.asked
            node._unlistened = self.last_sent()
            motion.position, motion.before = _vector(state.position), _vector(state.before)
            motion.acted = list(state.acted)
            motion.energy, motion.highest = state.energy, state.highest
            motion.at, motion.at_before = state.at, state.at_before
            motion.samples += sampled
        if node._latency is not None:
            for i, line in enumerate(node._latency.lines):
                line[:] = self._lines[i * len(line) : (i + 1) * len(line)].tolist()
        self._device_back()

    def _device_back(self) -> None:
        state: Any = self.state
        timed: _Timed = self._driver._device
        device = timed.device
        device.position, device.velocity, device.ticks = state.x, state.v, state.device_ticks
        if (dragged := timed.dragged) is not None:
            last = [*dragged.reader.last[:3], state.wanted_at]
            last[timed.axis] = state.wanted
            dragged.reader.last = last[0], last[1], last[2], last[3]
            dragged.away = state.away if state.is_away else None
            device.target = state.pull
        commands = [*self._commands[state.slot :], *self._commands[: state.slot]]
        device.commands.extendleft(commands)
        timed.tick, timed.acting, timed.commanded = state.device_tick, state.device_acting, state.commanded
        timed.pending.clear()
        for n in range(state.pending_first, state.pending_first + state.pending_count):
            at = 2 * (n % PENDING)
            timed.pending.append((self._pending[at], self._pending[at + 1]))
