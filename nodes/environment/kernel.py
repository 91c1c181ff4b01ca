"""Compiled tick of the environment. Shapes compile slowly and have shapes/kernel.py."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from messages.types import DeviceState
from nodes.compiled.kernels.encode import make_write
from nodes.compiled.kernels.follow_kernel import count_gap, in_order, overtaken
from nodes.compiled.kernels.hop import answer, called, flush, monotonic, out_at, receive
from nodes.compiled.kernels.machine import compilable, reals_at, record_at
from nodes.compiled.kernels.scan import make_match, make_scan
from nodes.compiled.kernels.sources import record_of, register_rules
from nodes.compiled.layout import TEXTS
from nodes.compiled.message_fields import fields_of, slots
from nodes.environment.flat import meet_flat
from nodes.environment.note_tick import note_tick
from nodes.environment.spent import note_spent
from nodes.environment.state import (
    INSIDE,
    JUMPED,
    PUBLISHED,
    EnvironmentState,
    tell_jump,
)

register_rules()
_look = record_at(record_of(EnvironmentState))
_scan = make_scan(DeviceState)
# In a fault the position is outdated. A message without the field is of an active driver.
_tells_fault = make_match("fault")
_write_answer = make_write(PUBLISHED)
_TEXTS, _JUMPED, _INSIDE = TEXTS, JUMPED, INSIDE
_SEQ, _REBASED, _STAMP, _POSITION, _DELAY, _FORCE = slots(
    fields_of(DeviceState), "seq", "rebased", "stamp", "position", "delay", "force"
)


def make_ticks(
    meet: Callable[[int, Any, Any, float, float, float, Any], bool],
) -> Callable[[int], int]:
    """Return the compiled ticks of an environment that finds its proxy by `meet`."""

    @compilable
    def ticks(address: int) -> int:
        """Answer positions until a case for the plain tick comes. Return how many were answered."""
        s = _look(address)
        done = 0
        taken = s.reals
        while done < s.most:
            if not receive(s, 0):
                break
            begin = monotonic(s) if s.realtime != 0 else 0.0
            if not _scan(s.payload, s.payload + s.payload_size, taken, s.wholes):
                break
            seq = s.wholes[_SEQ]
            if not in_order(s, seq) or (
                s.wholes[_TEXTS + 1] >= 0 and _tells_fault(s.wholes)
            ):
                break
            if s.wholes[_REBASED] != s.driver_rebased:
                break  # the device jumped: the plain tick restarts the proxy
            if overtaken(s, taken[_STAMP]):
                continue
            s.frames = 0
            count_gap(s, seq - s.seq - 1)
            s.seq = s.answered = seq
            table = reals_at(s.table, s.table_count)
            memory = reals_at(s.memory, s.memory_count)
            x, y, z = taken[_POSITION], taken[_POSITION + 1], taken[_POSITION + 2]
            fx, fy, fz = taken[_FORCE], taken[_FORCE + 1], taken[_FORCE + 2]
            note_tick(s.kind, memory, seq, fx, fy, fz)
            s.contact = 1 if meet(s.kind, table, memory, x, y, z, s.met) else 0
            if s.met[_JUMPED] != 0.0:
                s.rebased = seq
                s.ease = 0
            tell_jump(s)
            for i in range(3):
                s.position[i] = taken[_POSITION + i]
            s.delay, s.stamp = taken[_DELAY], taken[_STAMP]
            if s.realtime != 0:
                end = monotonic(s)
                s.stamp = end + s.clock_offset
                note_spent(s.spent, end - begin)
            # before sending: a client that has the answer must find it counted
            s.ticks += 1
            at = out_at(s)
            answer(s, at, _write_answer(s, at) - at)
            done += 1
            if s.met[_INSIDE] != s.inside or called(s):
                break  # an event is due, or a request is waiting
        flush(s)
        return done

    return ticks


@compilable
def _meet(
    kind: int,
    table: Any,
    memory: Any,  # noqa: ARG001
    x: float,
    y: float,
    z: float,
    met: Any,
) -> bool:
    return meet_flat(kind, table, x, y, z, met)


# Answer device states with proxies on a surface without shapes until the plain tick is needed.
ticks = make_ticks(_meet)
