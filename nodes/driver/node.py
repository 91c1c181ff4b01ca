"""The driver node: the clock of the loop, and the only one that touches the device.

At each tick it samples the position, publishes it, and waits for the force that answers this very tick. ``realtime`` waits
until the next absolute deadline and goes on without an answer if it must; ``lockstep`` waits for the answer, however long,
so a run is deterministic and as fast as the machine allows. What happened in a tick is told by the next state message.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any, ClassVar

import msgspec

from messages import topics
from messages.codec import Decoder, encode
from messages.transport.sockets import TimedOut
from messages.types import ZERO, DeviceState, Force, Vector
from nodes.base import realtime
from nodes.base.node import IDLE_MS
from nodes.base.setup import AXIS_INDEX, Setup
from nodes.base.standstill import LastResort, Standstill
from nodes.driver.ahead import Ahead, Belated
from nodes.driver.answers import Answers
from nodes.driver.device import Device
from nodes.driver.limits import STOP_TIME, undeclared
from nodes.driver.mean_force import Latency, Split
from nodes.driver.motion import Motion, scaled
from nodes.driver.parameters import DriverParameters, check
from nodes.driver.response_times import ResponseTimes
from nodes.driver.safety import Safety
from nodes.parameters.store import ParameterError, convert

__all__ = [
    "ASK_AGAIN",
    "SOFT_STOP",
    "Driver",
]

ASK_AGAIN = 0.5
"""In lockstep, a tick without an answer for so long is published again: its answer was lost with a node [s]."""

SOFT_STOP = STOP_TIME + 1.0
"""After so long on the way down to zero force the device is taken to hang [s]."""


class Driver(Answers):
    """Base of the drivers: a kind of device defines `make_device` and adds its own parameters.

    Attributes
    ----------
    virtual : bool
        Whether the device lives in simulated time and can wait.
    """

    Parameters: ClassVar[type[msgspec.Struct]] = DriverParameters
    publishes: ClassVar[tuple[str, ...]] = (topics.DEVICE_STATE,)
    listens_to: ClassVar[tuple[str, ...]] = (topics.FORCE,)
    virtual: ClassVar[bool] = False
    # A stop may be asked for before the node is configured.
    _ahead: Ahead | None = None

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Check pace and workspace before anything is started.

        Parameters
        ----------
        setup : Setup
            The node as it would be started.

        Raises
        ------
        ParameterError
            With path, value, limit and remedy.
        """
        check(setup, convert(setup.parameters, cls.Parameters, setup.name), cls.virtual)

    @property
    def target(self) -> Vector:
        """Where a simulated hand pulls the device to during this tick [m]; zero without one."""
        return ZERO

    def make_device(self) -> Device:
        """Make the device from the parameters; do not open it yet.

        Returns
        -------
        Device
            The device.
        """
        raise TypeError(f"driver kind {self.setup.kind!r} does not define make_device()")

    def configure(self) -> None:
        """Make the device and its safety."""
        self._device = self.make_device()
        if not self.virtual and (refusal := undeclared(self.store.current.safety, self._device.limits)):
            self._device.close()
            raise ParameterError(f"{self.setup.name}: {refusal}")
        self._axes = [AXIS_INDEX[axis] for axis in self.setup.axes]
        self._untold: deque[tuple[str, str]] = deque(maxlen=1000)
        self._safety = Safety(
            self.store.current.safety,
            self._device.limits,
            self.setup.period,
            self._axes,
            self._tell_safety,
            f"{self.setup.name}.safety",
        )
        self._guard = self._guard_of(self.store.current.passivity)
        self._guard_is_own = self._guard is not None
        latency = self._device.limits.latency
        if latency is None and self._guard is not None:
            self.tell(
                "guard", "the device does not tell its latency: the guard takes forces to act when they are handed over"
            )
        self._latency = Latency(round(latency / self.setup.period, 9)) if latency else None
        self._motion = Motion(self.setup.period, self._axes, self.virtual, self._latency)
        self._open = False
        self._soft_stop_ticks = 0
        # What is on the device, which under ``next_tick`` is not yet what was decided last; and the tick it was written in.
        self._handed: Vector = ZERO
        self._written = 0
        # The device lets go by itself so many ticks after the last force that was written.
        self._bears = self._device.limits.hold / self.setup.period
        self._standstill = Standstill()
        debugged = self.store.current.safety.hang is None
        self._last_resort = None if self.virtual or debugged else LastResort(self.setup)
        # What the loop's thread is at, and how long it may take [s].
        self._doing = ("", math.inf)
        self._first_seq = 0
        self._response = self._lateness = self._delay = 0.0
        self._age = self._missed = self._overruns = 0
        self._responses = ResponseTimes()
        self._oldest_age = 0
        self._first_stamp = self._last_stamp = 0.0
        self._complete = False

    # -- one tick ----------------------------------------------------------------------------------------------------

    def _sample(self, seq: int, stamp: float) -> float:
        """Sample the device and publish its state, with the report of the tick before; when it was published [s]."""
        position = self._device.read_position(seq)
        safety, motion, guard = self._safety, self._motion, self._guard
        if safety.watch_position(position, seq):
            stepped = motion.sample(position, stamp)
            if guard is not None and stepped:
                guard.observe(motion.acted, motion.before, position, motion.elapsed)
            if safety.swings:
                safety.watch_swings(motion.energy, motion.velocity, seq)
        self.seq = seq
        payload = encode(
            DeviceState(
                seq=seq,
                stamp=stamp,
                position=motion.position,
                force=safety.force,
                force_seq=safety.force_seq,
                age=self._age,
                response=self._response,
                lateness=self._lateness,
                missed=self._missed,
                overruns=self._overruns,
                safety=safety.state,
                energy=motion.energy,
                delay=self._delay,
                guard=guard.energy if guard is not None else 0.0,
                target=self.target,
            )
        )
        self.sent += 1
        # Taken before sending: under FIFO the whole chain may run before the call returns.
        published = time.monotonic()
        self.publisher.send_hop(self._topic, payload)
        self._unlistened = payload
        return published

    def _guarded(self, pending: Vector, share: float) -> Callable[[Vector], Vector] | None:
        """Give what the guard makes of a force, with what still acts before it; None without a guard."""
        if self._guard is None:
            return None
        backlog = ZERO if self._latency is None else self._latency.backlog()
        return partial(self._guard.control, pending=pending, share=share, backlog=backlog)

    def _tell_listeners(self) -> None:
        """Publish the tick's state to the listeners too, when nothing waits for it any more."""
        if self.publisher.apart:
            self.publisher.send_aside(self._topic, self._unlistened)

    def loop(self) -> None:
        """Tick until stopped or done."""
        self._topic = topics.DEVICE_STATE.encode()
        self._expected = topics.FORCE.encode()
        self._decoder = Decoder(Force)
        assert self.inbox is not None  # noqa: S101  # every kind that listens has one
        if self.stopping:
            return
        # Set first: a device that failed half-way is closed too.
        self._open = True
        self._begin("open()", self._device.limits.opening)
        self._device.open()
        self._begin("")
        self.started.wait()
        self.state = "running"
        ticks: Any = self.compiled()
        self._ahead = ticks
        if not self.stopping:
            end = self.setup.ticks or 2**62
            if self.setup.pace == "lockstep":
                self._lockstep(end)
            else:
                self._realtime(end)
            self._complete = self.seq >= end
            if self._complete:
                self.stop("done")

    def wake(self) -> None:
        """Ask compiled ticks, too, to come back."""
        if self._ahead is not None:
            self._ahead.wake()

    def _lockstep(self, end: int) -> None:
        inbox = self.inbox
        assert inbox is not None  # noqa: S101
        next_frame, device, safety, period = inbox.next_frame, self._device, self._safety, self.setup.period
        inbox.set_timeout(IDLE_MS)
        clock, note, act = time.monotonic, self._responses.add, self._motion.act
        late = 1 if self.setup.apply == "next_tick" else 0
        self._first_stamp = time.monotonic()
        seq = 0
        acting = ZERO
        sent: float | None
        while seq < end and not self.stopping:
            sent = None
            if self._ahead is not None:
                seq, sent, _, _, done = self._ahead.run(seq, end, 0.0, None, None)
                acting = self._handed
                if done and sent is None:
                    self.between_ticks(seq)
                    continue
            if sent is None:
                sent = self._sample(seq, seq * period)
            asked = sent
            while not self.stopping:
                try:
                    frames = next_frame(), next_frame()
                except TimedOut:
                    if time.monotonic() - asked > ASK_AGAIN:
                        asked = time.monotonic()
                        self.tell("unanswered", f"tick {seq} has no answer; asking again")
                        self.publisher.send_hop(self._topic, self._unlistened)
                    self.between_ticks(seq)
                    continue
                force = self.take(self._decoder, frames, self._expected)
                if force is not None and force.seq == seq and safety.admit(force, seq):
                    self._response = response = clock() - sent
                    note(response)
                    command = safety.command(
                        force.force, seq, seq, self._motion.velocity, self._guarded(acting, float(late))
                    )
                    device.write_force(command, seq + late, 0.0)
                    self._handed = command
                    act(list(acting if late else command))
                    acting = command
                    self.ticks += 1
                    self._delay = float(late)
                    seq += 1
                    break
                self.skipped += 1
            self._tell_listeners()
            if self.called:
                self.between_ticks(seq)
        self._last_stamp = time.monotonic()
        self._sample(seq, seq * period)
        self._tell_listeners()

    def _epoch(self) -> float:
        """When tick 0 is or was: a respawned driver goes on counting where its predecessor was killed."""
        path = Path(self.setup.run_dir) / f"{self.setup.name}.epoch"
        if path.exists():
            self._safety.resume()
            return float(path.read_text(encoding="ascii"))
        epoch = time.monotonic() + 0.002
        path.write_text(repr(epoch), encoding="ascii")
        return epoch

    def _realtime(self, end: int) -> None:
        inbox = self.inbox
        assert inbox is not None  # noqa: S101
        period, safety, write = self.setup.period, self._safety, self._write
        next_tick = self.setup.apply == "next_tick"
        if self._ahead is not None:
            self._ahead.rehearse()
        epoch = self._epoch()
        seq = self._first_seq = max(0, math.ceil((time.monotonic() - epoch) / period))
        following_command: Vector | None = None
        belated: Belated | None = None
        heard = False
        sent: float | None
        # A virtual device waits for whoever debugs it; what exists does not.
        self._begin("a tick", self.store.current.safety.hang or math.inf)
        while seq < end and not self.stopping:
            sent = None
            if self._ahead is not None:
                seq, sent, following_command, belated, done = self._ahead.run(
                    seq, end, epoch, following_command, belated
                )
                heard = heard or done > 0
                if done and sent is None:
                    self.between_ticks(seq)
                    continue
            deadline = epoch + seq * period
            if sent is None:
                now = realtime.sleep_until(deadline)
                late = now - deadline
                if late >= period:
                    # The driver itself was held up: the ticks that are over cannot be sampled any more, only counted.
                    lost = min(int(late / period), end - seq)
                    self._overruns += lost
                    self._lateness = late
                    let_go = self._hold(seq, lost)
                    seq += lost
                    if let_go or (following_command is not None and seq - safety.force_seq > safety.limits.max_age):
                        # What was still to be handed over is too old by now.
                        following_command = None
                        safety.hold(self._handed)
                    continue
                self._lateness = late
                if following_command is not None:
                    # Under ``next_tick`` hardware, too, gets its force at the start of the tick.
                    write(following_command, seq, 0.0)
                    following_command = None
                sent = self._sample(seq, now + self.clock_offset)
                if not self.ticks:
                    self._first_stamp = now
            following = deadline + period
            self._age = seq - safety.force_seq if safety.force_seq >= 0 else 0
            # An answer that comes a little late is waited for, and the next tick sampled late: sampled on time, it would take
            # the processor from that answer and be answered late itself, and so would the next. Not so when nothing came.
            receive = inbox.receive_soon if heard else inbox.receive_until
            answered = heard = False
            split = Split(self._handed, self._handed if next_tick else None)
            while not answered:
                if belated is not None:
                    frames, arrival = belated
                    belated = None
                else:
                    received = receive(following)
                    if received is None:
                        break
                    frames, arrival, heard = received, time.monotonic(), True
                    if arrival >= following:
                        # Nor must whoever floods the topic keep the driver from its next tick.
                        belated = frames, arrival
                        break
                force = self.take(self._decoder, frames, self._expected)
                if force is None or not safety.admit(force, seq):
                    self.skipped += 1
                else:
                    answered = force.seq == seq
                    self._age = seq - force.seq
                    offset = min(max((arrival - deadline) / period, 0.0), 1.0)
                    guarded = self._guarded(self._handed, 1.0 if next_tick else offset)
                    command = safety.command(force.force, force.seq, seq, self._motion.velocity, guarded)
                    if next_tick:
                        following_command = command
                        self._delay = 1.0 + self._age
                    else:
                        write(command, seq, offset)
                        split.change(command, offset)
                        self._delay = offset + self._age
                    if answered:
                        self._response = arrival - sent
                        self._responses.add(self._response)
            if self._age > self._oldest_age:
                self._oldest_age = self._age
            if not answered:
                # In a fault there is no position that could have been answered.
                self._missed += safety.state != "fault"
                self._response = 0.0
                guarded = self._guarded(self._handed, 1.0)
                held = None if guarded is None else guarded(safety.force)
                command_now = safety.missed(seq, self._motion.velocity(), held)
                if command_now is not None:
                    following_command = None
                    write(command_now, seq + 1, 0.0)
                elif following_command is None and seq + 1 - self._written >= self._bears:
                    self._handed = ZERO
                    safety.let_go(seq, self._written + self._bears)
            self._motion.act(split.mean())
            self.ticks += 1
            seq += 1
            self._tell_listeners()
            if self.called:
                self.between_ticks(seq)
        self._last_stamp = realtime.sleep_until(epoch + seq * period)
        self._sample(seq, self._last_stamp + self.clock_offset)
        self._tell_listeners()

    def _write(self, force: Vector, seq: int, offset: float) -> None:
        self._device.write_force(force, seq, offset)
        self._handed = force
        self._written = seq

    def _hold(self, seq: int, lost: int) -> bool:
        """Take into the mean force what acted during ticks that were left out; whether the device let go meanwhile."""
        force = self._handed
        acted = min(max(self._bears - (seq - self._written), 0.0), float(lost))
        self._motion.act(scaled(force, acted / lost), lost)
        if acted == lost or force == ZERO:
            return False
        self._handed = ZERO
        self._safety.let_go(seq + lost, self._written + self._bears)
        self._tell_safety("device", f"no force from tick {self._written} to {seq + lost}; the device let go by itself")
        return True

    def finish(self) -> None:
        """Bring the force down to zero and close the device, on every way out."""
        if not self._open:
            return
        self._open = False
        period = self.setup.period
        try:
            self._begin("the soft stop", SOFT_STOP)
            start = time.monotonic()
            for n, force in enumerate(self._safety.soft_stop(self._handed), 1):
                self._soft_stop_ticks = n
                self._device.write_force(force, self.seq + n - 1, 0.0)
                self._handed = force
                if self.setup.pace == "realtime":
                    realtime.sleep_until(start + n * period)
        finally:
            self._begin("close()", self._device.limits.closing)
            self._device.close()
            self._begin("")
            if self._last_resort is not None:
                self._last_resort.stop()
            self._tell_all()
