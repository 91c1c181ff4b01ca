"""The sim driver's tick, compiled: nodes/driver/node.py as long as its safety is active.

An answer that comes late, and ticks that are over before they begin, are usual at high rates: left to the interpreter, each
would cost the ten ticks after it, too.
"""

from __future__ import annotations

import math
from typing import Any

from messages.types import DeviceState, Force
from nodes.driver import response_times
from nodes.driver.passivity import observe, through
from nodes.driver.response_times import BINS, BLOCK
from nodes.kernels import limit
from nodes.tick.fields import fields_of, slot
from nodes.tick.kernels.encode import make_encode
from nodes.tick.kernels.hop import (
    CLOCK_MONOTONIC,
    DONTWAIT,
    called,
    flush,
    has_message,
    hold,
    monotonic,
    out_at,
    receive,
    send_hop,
)
from nodes.tick.kernels.machine import (
    call_poll,
    call_sleep,
    compilable,
    reals_at,
    record_at,
    wholes_at,
)
from nodes.tick.kernels.scan import make_scan
from nodes.tick.kernels.sources import kernel, record_of
from sim.device.tick.device import lockstep_tick, measured, move_hand, pass_tick, write_force
from sim.device.tick.layout import BETWEEN, WAITING, DriverState

for _function in (limit, observe, through):
    kernel(_function)
_look = record_at(record_of(DriverState))
_scan = make_scan(Force)
_encode = make_encode(DeviceState)
_IN, _OUT = fields_of(Force), fields_of(DeviceState)
_SEQ, _FORCE = slot(_IN, "seq"), slot(_IN, "force")
_TO_SEQ, _TO_FORCE_SEQ, _TO_AGE, _TO_MISSED, _TO_OVERRUNS = (
    slot(_OUT, name) for name in ("seq", "force_seq", "age", "missed", "overruns")
)
_TO_STAMP, _TO_POSITION, _TO_FORCE, _TO_RESPONSE, _TO_LATENESS, _TO_ENERGY, _TO_DELAY, _TO_GUARD, _TO_TARGET = (
    slot(_OUT, name)
    for name in ("stamp", "position", "force", "response", "lateness", "energy", "delay", "guard", "target")
)
_BETWEEN, _WAITING = BETWEEN, WAITING
_STOP = -1
_TIMER_ABSTIME = 1
_RECENT = response_times.RECENT
# As long as ZeroMQ waits at least in `Subscription.receive_soon` [s].
_SOON = 1e-3


@compilable
def _usual_position(s: Any) -> bool:
    """Read the device; whether it is where it may be."""
    s.reals[0] = s.reals[1] = s.reals[2] = 0.0
    s.reals[s.device_axis] = measured(s)
    for i in range(3):
        value = s.reals[i]
        if not (-s.reach <= value <= s.reach and s.workspace[2 * i] <= value <= s.workspace[2 * i + 1]):
            return False
    return True


@compilable
def _sample(s: Any, seq: int, stamp: float) -> None:
    """Take the position that was read as the tick's sample, and publish the state (`Driver._sample`)."""
    s.at_before, s.at, s.asked = s.at, stamp, seq
    s.elapsed, s.covered = s.covered, 0
    energy = s.energy
    places = reals_at(s.places, 3 * s.places_count)
    for i in range(3):
        s.slewed[i] = 0.0
        s.before[i] = s.position[i]
        s.position[i] = s.reals[i]
        places[3 * s.places_at + i] = s.position[i]
        s.acted[i] = s.acting[i]
        if s.line_length > 0:
            line = reals_at(s.lines + 8 * i * s.line_length, s.line_length)
            total = through(line, s.acting[i], s.line_part)
            for _ in range(1, s.elapsed):
                total += through(line, s.acting[i], s.line_part)
            s.acted[i] = total if s.elapsed == 1 else total / s.elapsed
    s.places_at = (s.places_at + 1) % s.places_count
    for n in range(s.axes):
        i = s.axis[n]
        energy = observe(energy, s.acted[i], s.position[i] - s.before[i])
    s.energy = energy
    if energy > s.highest:
        s.highest = energy
    out, whole = s.out_reals, s.out_wholes
    for i in range(3):
        out[_TO_POSITION + i] = s.position[i]
        out[_TO_FORCE + i] = s.force[i]
    out[_TO_STAMP], out[_TO_RESPONSE], out[_TO_LATENESS] = stamp, s.response, s.lateness
    # Where a hand pulls to during this tick.
    out[_TO_TARGET] = out[_TO_TARGET + 1] = out[_TO_TARGET + 2] = 0.0
    if s.targets_count > 0:
        out[_TO_TARGET + s.device_axis] = move_hand(s, seq)
    out[_TO_ENERGY], out[_TO_DELAY], out[_TO_GUARD] = energy, s.delay, 0.0
    whole[_TO_SEQ], whole[_TO_FORCE_SEQ], whole[_TO_AGE] = seq, s.force_seq, s.age
    whole[_TO_MISSED], whole[_TO_OVERRUNS] = s.missed, s.overruns
    at = out_at(s)
    size = _encode(at, s.out_keys, out, whole, s.text, s.text_size) - at
    s.sent, s.sent_size = at, size
    # Taken before sending: under FIFO the whole chain may run before the call returns.
    s.sampled = monotonic(s)
    send_hop(s, at, size)
    s.phase = _WAITING


@compilable
def _command(s: Any, seq: int) -> bool:
    """Turn the force received into what the device gets (`Safety.admit`, `Safety.command`); False when that is not usual."""
    if not _scan(s.payload, s.payload + s.payload_size, s.reals, s.wholes):
        return False
    answers = s.wholes[_SEQ]
    if answers > seq or answers <= s.force_seq or seq - answers > s.max_age:
        return False
    wanted = s.reals
    if not math.isfinite(wanted[_FORCE] + wanted[_FORCE + 1] + wanted[_FORCE + 2]):
        return False
    for n in range(s.axes):
        i = s.axis[n]
        if limit(wanted[_FORCE + i], s.force[i], s.peak, max(s.slew - s.slewed[i], 0.0)) != wanted[_FORCE + i]:
            return False
    for n in range(s.axes):
        i = s.axis[n]
        s.slewed[i] += abs(wanted[_FORCE + i] - s.force[i])
        s.force[i] = wanted[_FORCE + i]
    s.force_seq, s.since = answers, seq
    s.age = seq - answers
    s.taken += 1
    s.frames = 0
    return True


@compilable
def _note(s: Any, response: float) -> None:
    """Note a response time (`ResponseTimes.add`)."""
    recent = reals_at(s.recent, _RECENT)
    at = s.recent_at
    recent[at] = response
    at += 1
    if at % BLOCK == 0:
        bins = wholes_at(s.bins, BINS + 1)
        for k in range(at - BLOCK, at):
            bins[min(int(recent[k] * 1e6), BINS)] += 1
            if recent[k] > s.longest:
                s.longest = recent[k]
        s.counted += BLOCK
        at %= _RECENT
    s.recent_at = at


@compilable
def _close(s: Any) -> None:
    """End the tick: the listeners get what nothing waits for any more."""
    s.ticks += 1
    s.seq += 1
    s.covered = 1
    s.phase = _BETWEEN
    if hold(s, s.sent_size):
        flush(s)


@compilable
def _lockstep_tick(s: Any, seq: int) -> int:
    """Do one tick in lockstep; `_STOP` when something in it is for the plain tick."""
    if not _usual_position(s):
        return _STOP
    _sample(s, seq, seq * s.period)
    if not receive(s, 0):
        return _STOP
    arrival = monotonic(s)
    if not _command(s, seq):
        return _STOP
    s.response = arrival - s.sampled
    _note(s, s.response)
    lockstep_tick(s, s.force[s.device_axis])
    for i in range(3):
        s.acting[i] = s.force[i] if s.next_tick == 0 else s.handed[i]
        s.handed[i] = s.force[i]
    s.delay = float(s.next_tick)
    _close(s)
    return 1


@compilable
def _sleep_until(s: Any, deadline: float) -> float:
    """Sleep to an absolute time; the time on waking [s], before the deadline when a signal came."""
    now = monotonic(s)
    if now < deadline:
        until = wholes_at(s.time, 2)
        seconds = int(deadline)
        until[0], until[1] = seconds, int((deadline - seconds) * 1e9) + 1
        call_sleep(s.clock_nanosleep, (CLOCK_MONOTONIC, _TIMER_ABSTIME, s.time, 0))
        now = monotonic(s)
    return now


@compilable
def _await(s: Any, deadline: float) -> bool:
    """Wait for a message until an absolute time, to the microsecond (`Subscription.receive_until`)."""
    while True:
        if has_message(s, s.inbox):
            return True
        remaining = deadline - monotonic(s)
        if remaining <= 0.0 or s.attention != 0:
            return False
        left = wholes_at(s.time, 2)
        seconds = int(remaining)
        left[0], left[1] = seconds, int((remaining - seconds) * 1e9)
        call_poll(s.ppoll, (s.poll, 1, s.time, 0))


@compilable
def _lost(s: Any, seq: int, late: float) -> int:
    """Leave out the ticks that are over (`Driver._hold`); `_STOP` when something in it is for the plain tick."""
    lost = min(int(late / s.period), s.until - seq)
    if seq + lost - s.written > s.bears or (s.has_following != 0 and seq + lost - s.force_seq > s.max_age):
        return _STOP
    if s.targets_count > 0 and seq + lost - s.targets_from >= s.targets_count:
        return _STOP
    s.overruns += lost
    s.lateness = late
    for i in range(3):
        s.acting[i] = (s.acting[i] * s.covered + s.handed[i] * lost) / (s.covered + lost)
    s.covered += lost
    s.seq = seq + lost
    return 0


@compilable
def _change(s: Any, offset: float) -> None:
    """Take into the tick's mean force what acted up to a place in it (`Split`)."""
    share = offset - s.split
    if share > 0.0:
        for i in range(3):
            s.mean[i] += share * s.handed[i]
        s.split = offset


@compilable
def _hand_over(s: Any, seq: int, offset: float) -> None:
    """Give the device the force that was just commanded."""
    if s.next_tick != 0:
        s.has_following = 1
        for i in range(3):
            s.following[i] = s.force[i]
        s.delay = 1.0 + s.age
        return
    write_force(s, s.force[s.device_axis], seq, offset)
    s.written = seq
    _change(s, offset)
    for i in range(3):
        s.handed[i] = s.force[i]
    s.delay = offset + s.age


@compilable
def _realtime_tick(s: Any, seq: int) -> int:
    """Do one tick in real time: 1, or 0 where ticks were only left out; `_STOP` when something in it is for the plain tick."""
    # An answer that is missing now must not be one that the watchdog waits for.
    if seq - s.since >= max(s.watchdog, 2):
        return _STOP
    deadline = s.epoch + seq * s.period
    now = _sleep_until(s, deadline)
    late = now - deadline
    if late < 0.0:
        return _STOP
    if late >= s.period:
        return int(_lost(s, seq, late))
    while s.device_tick < seq:
        pass_tick(s)
    if not _usual_position(s):
        return _STOP
    s.lateness = late
    if s.has_following != 0:
        # Under ``next_tick`` hardware, too, gets its force at the start of the tick.
        write_force(s, s.following[s.device_axis], seq, 0.0)
        s.written = seq
        for i in range(3):
            s.handed[i] = s.following[i]
        s.has_following = 0
    _sample(s, seq, now + s.clock_offset)
    following = deadline + s.period
    # As the plain tick does, it waits a little for an answer that is late, unless nothing came in the tick before.
    patience = max(following, s.sampled + _SOON) if s.heard != 0 else following
    s.age = seq - s.force_seq
    s.heard = 0
    s.split = s.mean[0] = s.mean[1] = s.mean[2] = 0.0
    answered = False
    while not answered:
        arrival = s.belated_at
        if s.belated != 0:
            s.belated = 0
        else:
            if not _await(s, patience):
                if s.attention != 0:
                    return _STOP
                break
            if not receive(s, DONTWAIT):
                return _STOP
            arrival = monotonic(s)
            s.heard = 1
            if arrival >= following:
                s.belated, s.belated_at = 1, arrival
                break
        if not _command(s, seq):
            return _STOP
        _hand_over(s, seq, min(max((arrival - deadline) / s.period, 0.0), 1.0))
        answered = s.force_seq == seq
    if answered:
        s.response = arrival - s.sampled
        _note(s, s.response)
    else:
        if seq - s.since >= s.watchdog or (s.has_following == 0 and seq + 1 - s.written >= s.bears):
            return _STOP
        s.missed += 1
        s.response = 0.0
    if s.age > s.oldest_age:
        s.oldest_age = s.age
    if s.next_tick == 0:
        _change(s, 1.0)
    for i in range(3):
        s.acting[i] = s.handed[i] if s.next_tick != 0 else s.mean[i]
    _close(s)
    return 1


@compilable
def ticks(address: int) -> int:
    """Do ticks until something is unusual."""
    s = _look(address)
    done = 0
    if s.belated == 0:
        s.frames = 0
    s.phase = _BETWEEN
    while done < s.most and s.seq < s.until and s.attention == 0:
        # The tick that comes next; a sample taken and not answered is the plain tick's to go on with.
        found = _realtime_tick(s, s.seq) if s.realtime != 0 else _lockstep_tick(s, s.seq)
        if found == _STOP:
            break
        done += found
        if found != 0 and called(s):
            break
    flush(s)
    return done
