"""Compiled tick of the environment. Shapes compile slowly and have shapes/kernel.py."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from messages.types import DeviceState, Proxy
from nodes.compiled.kernels.encode import make_encode
from nodes.compiled.kernels.follow_kernel import count_gap, in_order, overtaken
from nodes.compiled.kernels.hop import answer, called, flush, monotonic, out_at, receive
from nodes.compiled.kernels.machine import compilable, reals_at, record_at
from nodes.compiled.kernels.scan import make_match, make_scan
from nodes.compiled.kernels.sources import record_of, register_rules
from nodes.compiled.layout import TEXTS
from nodes.compiled.message_fields import fields_of, slots
from nodes.environment.meet import meet_flat
from nodes.environment.spent import note_spent
from nodes.environment.state import INSIDE, JUMPED, EnvironmentState

register_rules()
_look = record_at(record_of(EnvironmentState))
_scan = make_scan(DeviceState)
# In a fault the position is outdated. A message without the field is of an active driver.
_tells_fault = make_match("fault")
_encode = make_encode(Proxy)
_TEXTS, _JUMPED, _INSIDE = TEXTS, JUMPED, INSIDE
_IN, _OUT = fields_of(DeviceState), fields_of(Proxy)
_SEQ, _REBASED, _STAMP, _POSITION, _DELAY = slots(
    _IN, "seq", "rebased", "stamp", "position", "delay"
)
(
    _TO_SEQ,
    _TO_CONTACT,
    _TO_REBASED,
    _TO_EASE,
    _TO_STAMP,
    _TO_POSITION,
    _TO_PROXY,
    _TO_NORMAL,
    _TO_DISTANCE,
    _TO_DELAY,
) = slots(
    _OUT,
    "seq",
    "contact",
    "rebased",
    "ease",
    "stamp",
    "position",
    "proxy",
    "normal",
    "distance",
    "delay",
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
        taken, out = s.reals, s.out_reals
        while done < s.most:
            if not receive(s, 0):
                break
            begin = monotonic(s) if s.realtime != 0 else 0.0
            if not _scan(s.payload, s.payload + s.payload_size, taken, s.wholes):
                break
            seq = s.wholes[_SEQ]
            if not in_order(s, seq) or (s.wholes[_TEXTS + 1] >= 0 and _tells_fault(s.wholes)):
                break
            if s.wholes[_REBASED] != s.driver_rebased:
                break  # the device jumped: the plain tick restarts the proxy
            if overtaken(s, taken[_STAMP]):
                continue
            s.frames = 0
            count_gap(s, seq - s.seq - 1)
            s.seq = s.answered = seq
            table, memory = reals_at(s.table, s.table_count), reals_at(s.memory, s.memory_count)
            x, y, z = taken[_POSITION], taken[_POSITION + 1], taken[_POSITION + 2]
            s.out_wholes[_TO_SEQ] = seq
            s.out_wholes[_TO_CONTACT] = 1 if meet(s.kind, table, memory, x, y, z, s.met) else 0
            if s.met[_JUMPED] != 0.0:
                s.rebased, s.ease = seq, 0
            s.out_wholes[_TO_REBASED] = max(s.rebased, s.driver_rebased)
            s.out_wholes[_TO_EASE] = s.ease if s.rebased >= s.driver_rebased else 0
            for i in range(3):
                out[_TO_POSITION + i] = taken[_POSITION + i]
                out[_TO_PROXY + i] = s.met[i]
                out[_TO_NORMAL + i] = s.met[3 + i]
            out[_TO_DISTANCE] = s.met[6]
            out[_TO_DELAY] = taken[_DELAY]
            out[_TO_STAMP] = taken[_STAMP]
            if s.realtime != 0:
                end = monotonic(s)
                out[_TO_STAMP] = end + s.clock_offset
                note_spent(s.spent, end - begin)
            # before sending: a client that has the answer must find it counted
            s.ticks += 1
            at = out_at(s)
            answer(s, at, _encode(at, s.out_keys, out, s.out_wholes, s.text, s.text_size) - at)
            done += 1
            if s.met[_INSIDE] != s.inside or called(s):
                break  # an event is due, or a request is waiting
        flush(s)
        return done

    return ticks


@compilable
def _meet(kind: int, table: Any, memory: Any, x: float, y: float, z: float, met: Any) -> bool:  # noqa: ARG001
    return meet_flat(kind, table, x, y, z, met)


# Answer device states with proxies on a surface without shapes until the plain tick is needed.
ticks = make_ticks(_meet)
