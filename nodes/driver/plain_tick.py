"""Interpreted ticks of a driver: nodes/driver/tick.py with a port of pyzmq and msgspec."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

from messages import topics
from messages.codec import Decoder, encode
from messages.transport.sockets import TimedOut
from messages.types import DeviceState, Force
from nodes.base import realtime
from nodes.compiled.published import message_of
from nodes.driver.calls import Jumps, numbers_of
from nodes.driver.device import Device
from nodes.driver.state import PUBLISHED, SAFETY, DriverState
from nodes.driver.tick import GOT, NONE, REFUSED, Port, make_ticks

if TYPE_CHECKING:
    from nodes.driver.ticked_driver import TickedDriver

_message = message_of(PUBLISHED)


def state_message(s: DriverState, seq: int, stamp: float) -> DeviceState:
    """Return the state of a tick as it is published."""
    assert s.asked == seq  # noqa: S101  # `take_sample` comes before
    s.stamp = stamp
    message: DeviceState = _message(s, SAFETY[s.safety])
    return message


class PlainTicks:
    """Interpreted ticks of one driver."""

    def __init__(self, node: TickedDriver, device: Device) -> None:
        assert node.inbox is not None  # noqa: S101  # a driver subscribes to forces
        self._node = node
        self._device = device
        self._inbox = node.inbox
        self._publisher = node.publisher
        self._events = node.events
        self._take = node.intake.take
        self._topic, self._expected = (
            node.setup.topic(name).encode()
            for name in (topics.DEVICE_STATE, topics.FORCE)
        )
        self._decoder = Decoder(Force)
        self._clock = time.monotonic
        self._what = f"{node.setup.name}: {type(device).__name__}"
        self.jumps = Jumps(device)
        self.payload = b""  # last published state
        lockstep, paced = make_ticks(
            Port(
                clock=lambda _: self._clock(),
                sleep_until=lambda _, deadline: realtime.sleep_until(deadline),
                read=self._read,
                write=self._write,
                publish=self.publish,
                receive=self.receive,
                aside=self.aside,
                called=lambda _: bool(self._events.waiting or node.stopping),
            )
        )
        # ticks until the driver is needed; returns why, as nodes/driver/tick.py defines it
        self.run = paced if node.driving.realtime else lockstep

    def _read(self, s: DriverState, seq: int) -> bool:
        s.place[:] = numbers_of(self._device.read_position(seq), self._what)
        if self.jumps.again():
            s.jumped = 1
        s.target[:] = self._node.target
        return True

    def _write(self, s: DriverState, seq: int, offset: float) -> bool:
        x, y, z = s.handed
        self._device.write_force((x, y, z), seq, offset)
        return True

    def publish(self, s: DriverState, seq: int, stamp: float) -> None:
        """Send the state of a tick to the next hop."""
        payload = encode(state_message(s, seq, stamp))
        s.states_sent += 1
        # before sending: under FIFO the whole chain may run before the call returns
        s.sampled = self._clock()
        self._publisher.send_hop(self._topic, payload)
        self.payload = payload

    def receive(self, s: DriverState, until: float) -> int:
        """Wait for a force until a time, in lockstep for a while. Return the outcome."""
        inbox = self._inbox
        if s.realtime == 0:
            try:
                frames = inbox.next_message()
            except TimedOut:
                return NONE
        else:
            wait = inbox.receive_soon if s.patient != 0 else inbox.receive_until
            found = wait(until)
            if found is None:
                return NONE
            frames = found
        s.arrival = self._clock()
        return self._read_force(s, frames)

    def take_up(self, s: DriverState) -> int:
        """Process the message that compiled ticks put back. Return the outcome."""
        frames = self._inbox.receive_until(0.0)
        assert frames is not None  # noqa: S101  # it was put back just now
        return self._read_force(s, frames)

    def _read_force(self, s: DriverState, frames: tuple[bytes, bytes]) -> int:
        expected = self._expected
        while frames[1] == expected:
            # A message of one frame, and the beginning of the next.
            self._events.refuse(
                "a message of one frame where topic and payload were expected"
            )
            s.skipped += 1
            frames = expected, self._inbox.next_frame()
        force = self._take(self._decoder, frames, expected)
        if force is None:
            return REFUSED
        s.got_seq = force.seq
        s.got[:], s.got_normal[:], s.got_credit = (
            force.force,
            force.normal,
            force.credit,
        )
        return GOT

    def aside(self, s: DriverState) -> None:
        """Send the last published state to the listeners."""
        del s
        if self._publisher.apart:
            self._publisher.send_aside(self._topic, self.payload)
