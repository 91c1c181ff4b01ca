"""Another device as the environment: the coupling pulls this device to its position.

Two people each have a device, a coupling and a law; their nodes exchange positions, delayed by the
network. The position presented to the coupling never jumps. When a partner is first heard, or heard
again, the presented position starts at this device, and the offset to the real position decreases
at `align`. When the partner falls silent, it returns to this device at the same speed.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import msgspec

from messages import topics
from messages.codec import Decoder, MessageRefusedError, encode
from messages.types import ZERO, DeviceState, Proxy, Vector
from nodes.base.follow import answer_ticks
from nodes.base.node import Node
from nodes.base.setup import Axis, Setup
from nodes.environment.spent import note_spent, spent_us
from nodes.environment.spent_counters import SpentCounters
from nodes.parameters.interface_words import interface
from nodes.parameters.store import ParameterError

UNHEARD, HEARD, SILENT = range(3)
"""What is known of a partner: nothing yet, its position, or only its last position."""

Patience = Annotated[float, msgspec.Meta(gt=0.0, le=10.0)]
MetresPerSecond = Annotated[float, msgspec.Meta(gt=0.0, le=100.0)]


class PartnerParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of an environment that follows another device.

    silence: Time without a message after which the partner counts as gone [s].
    align: Speed at which an offset to the partner decreases, so that nobody is pushed by a jump
        [m/s].
    fastest: Speed above which a step of the partner's position counts as a jump [m/s].
    """

    silence: Patience = 0.1
    align: MetresPerSecond = 0.1
    fastest: MetresPerSecond = 10.0


class Partner:
    """Position of the partner as the coupling sees it: continuous despite network gaps."""

    def __init__(self, period: float, parameters: PartnerParameters) -> None:
        self._period, self._parameters = period, parameters
        self.state = UNHEARD
        self.place: Vector = ZERO  # last position heard of the partner [m]
        self._offset: Vector = ZERO  # presented position minus `place` [m]
        self._seq = -1  # seq of the last message used
        self._heard_at = 0  # own tick of the last message
        self._fresh = False  # whether a message arrived since the last tick
        self.credit = 0.0  # energy that the partner had put in by its last message [J]

    def hear(self, state: DeviceState) -> bool:
        """Use a message of the partner; return False if it is outdated or has no valid position."""
        if state.safety == "fault" or state.seq == self._seq:
            return False
        if (
            state.seq < self._seq
            and self.state == HEARD
            and self._seq - state.seq < 1.0 / self._period
        ):
            # Overtaken in the network. A restarted partner would be far older, or silent before.
            return False
        if self.state == HEARD:
            step = _minus(state.position, self.place)
            ticks = max(state.seq - self._seq, 1)
            if math.hypot(*step) > self._parameters.fastest * self._period * ticks:
                self._offset = _minus(self._offset, step)
        self._seq = state.seq
        self.place = state.position
        self._fresh = True
        self.credit = state.surplus
        return True

    def present(self, own: Vector, seq: int) -> tuple[Vector, bool]:
        """Return the position presented at own tick `seq` [m], and whether a partner is felt."""
        known = self.state
        if self._fresh:
            self._fresh = False
            self._heard_at = seq
            if known != HEARD:
                # The presented position continues from its last value, or starts at the device.
                begin = own if known == UNHEARD else self._presented
                self._offset = _minus(begin, self.place)
                self.state = HEARD
        elif (
            known == HEARD
            and (seq - self._heard_at) * self._period > self._parameters.silence
        ):
            self.state = SILENT
        if self.state == UNHEARD:
            return own, False
        most = self._parameters.align * self._period
        if self.state == SILENT:
            self._presented = _plus(own, _shorter(_minus(self._presented, own), most))
            if self._presented == own:
                self.state = UNHEARD
            return self._presented, self.state == SILENT
        self._offset = _shorter(self._offset, most)
        self._presented = _plus(self.place, self._offset)
        return self._presented, True

    _presented: Vector = ZERO  # last presented position [m]


def _plus(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _shorter(a: Vector, by: float) -> Vector:
    """Return vector `a` shortened by the length `by`, or zero."""
    length = math.hypot(*a)
    if length <= by:
        return ZERO
    share = 1.0 - by / length
    return share * a[0], share * a[1], share * a[2]


class PartnerEnvironment(Node):
    """Answers device states with the partner's position."""

    Parameters: ClassVar[type[msgspec.Struct]] = PartnerParameters
    publishes: ClassVar[tuple[str, ...]] = (topics.PROXY,)
    listens_to: ClassVar[tuple[str, ...]] = (topics.DEVICE_STATE, topics.PARTNER)
    answers: ClassVar[bool] = True

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Reject lockstep: each of the two drivers would wait in its own simulated time."""
        if setup.pace == "lockstep":
            raise ParameterError(
                "a partner is heard in real time, but run.pace is lockstep; "
                f"use {interface.get().argument('pace', 'realtime')}, or"
                f" {interface.get().study('hands')}, which plays both in one process",
                path=setup.name,
            )

    @classmethod
    def axes(cls, parameters: Mapping[str, Any], name: str) -> tuple[Axis, ...]:
        """Return no axes: the partner is felt along every axis that the scene computes."""
        del parameters, name
        return ()

    def make_counters(self) -> SpentCounters:
        """Return the tick counters."""
        return SpentCounters()

    def configure(self) -> None:
        """Start without a partner."""
        self._partner = Partner(self.setup.period, self.store.current)
        self._decoder = Decoder(DeviceState)
        # messages of the partner that were used, and that arrived too late
        self.heard = self.late = 0

    def _hear(self, payload: bytes) -> None:
        try:
            counted = self._partner.hear(self._decoder.decode(payload))
        except MessageRefusedError as error:
            self.events.refuse(str(error))
            return
        self.heard += counted
        self.late += not counted

    def respond(self, state: DeviceState) -> bytes | None:
        """Answer a tick's state with a proxy."""
        if state.safety == "fault":
            # The position is outdated; the coupling bridges the gap.
            return None
        begin = time.monotonic()
        before = self._partner.state
        proxy, contact = self._partner.present(state.position, state.seq)
        self._report(before, state)
        note_spent(self.counters.spent, time.monotonic() - begin)
        # The partner is felt from all sides: no normal, and no clamping.
        return encode(
            Proxy(
                seq=state.seq,
                stamp=self.clock.now(),
                position=state.position,
                proxy=proxy,
                contact=contact,
                delay=state.delay,
                credit=self._partner.credit,
                rebased=state.rebased,
            )
        )

    def _report(self, before: int, state: DeviceState) -> None:
        now, parameters = self._partner.state, self.store.current
        if now == HEARD and before != HEARD:
            apart = math.dist(state.position, self._partner.place)
            self.events.emit(
                "partner",
                f"heard, {1e3 * apart:.3g} mm apart: aligned at {parameters.align:g} m/s, in"
                f" {apart / parameters.align:.2g} s",
                {"apart_m": apart, "align_m_per_s": parameters.align},
            )
        elif now == SILENT and before == HEARD:
            self.events.emit(
                "partner",
                f"silent for {parameters.silence:g} s (silence): the device is released at"
                f" {parameters.align:g} m/s",
                {"silent_s": parameters.silence, "align_m_per_s": parameters.align},
            )

    def report(self) -> dict[str, Any]:
        """Return tick durations, and the partner's messages that were used and overtaken."""
        return {
            "spent_us": spent_us(self.counters.spent),
            "partner": {"heard": self.heard, "overtaken": self.late},
        }

    def loop(self) -> None:
        """Answer device states with the partner's newest position until stopped."""
        partner = self.setup.topic(topics.PARTNER).encode()
        answer_ticks(
            self,
            DeviceState,
            topics.DEVICE_STATE,
            topics.PROXY,
            self.respond,
            {partner: self._hear},
        )
