"""The environment's tick, compiled."""

from __future__ import annotations

from typing import Any

# Registers the geometry with numba.
import nodes.environment.shapes.compiled as _registered
from messages.types import DeviceState, Proxy
from nodes.compiled.fields import fields_of, slot
from nodes.compiled.kernels.encode import make_encode
from nodes.compiled.kernels.follow import in_order, overtaken
from nodes.compiled.kernels.hop import answer, called, flush, monotonic, out_at, receive
from nodes.compiled.kernels.machine import compilable, reals_at, record_at
from nodes.compiled.kernels.scan import make_match, make_scan
from nodes.compiled.kernels.sources import kernel, record_of
from nodes.compiled.layout import TEXTS, EnvironmentState
from nodes.environment.meet import meet
from nodes.kernels import plane_distance

del _registered
kernel(plane_distance)
kernel(meet)
_look = record_at(record_of(EnvironmentState))
_scan = make_scan(DeviceState)
# In a fault the position is no new one. A message without the word is of an active driver.
_tells_fault = make_match("fault")
_encode = make_encode(Proxy)
_TEXTS = TEXTS
_IN, _OUT = fields_of(DeviceState), fields_of(Proxy)
_SEQ, _STAMP, _POSITION, _DELAY = (slot(_IN, name) for name in ("seq", "stamp", "position", "delay"))
_TO_SEQ, _TO_CONTACT = (slot(_OUT, name) for name in ("seq", "contact"))
_TO_STAMP, _TO_POSITION, _TO_PROXY, _TO_NORMAL, _TO_DISTANCE, _TO_DELAY = (
    slot(_OUT, name) for name in ("stamp", "position", "proxy", "normal", "distance", "delay")
)


@compilable
def _meet(s: Any, taken: Any, out: Any) -> bool:
    """Write where the proxy is, and whether there is contact."""
    contact = meet(
        s.kind,
        reals_at(s.table, s.table_count),
        reals_at(s.memory, s.memory_count),
        taken[_POSITION],
        taken[_POSITION + 1],
        taken[_POSITION + 2],
        s.met,
    )
    for i in range(3):
        out[_TO_POSITION + i] = taken[_POSITION + i]
        out[_TO_PROXY + i] = s.met[i]
        out[_TO_NORMAL + i] = s.met[3 + i]
    out[_TO_DISTANCE] = s.met[6]
    return contact


@compilable
def ticks(address: int) -> int:
    """Answer device states with proxies until something is unusual."""
    s = _look(address)
    done = 0
    while done < s.most:
        if not receive(s, 0) or not _scan(s.payload, s.payload + s.payload_size, s.reals, s.wholes):
            break
        seq = s.wholes[_SEQ]
        if not in_order(s, seq) or (s.wholes[_TEXTS + 1] >= 0 and _tells_fault(s.wholes)):
            break
        if overtaken(s, s.reals[_STAMP]):
            continue
        s.frames = 0
        s.gaps += seq - s.seq - 1
        s.seq = seq
        s.out_wholes[_TO_SEQ] = seq
        s.out_wholes[_TO_CONTACT] = 1 if _meet(s, s.reals, s.out_reals) else 0
        s.out_reals[_TO_DELAY] = s.reals[_DELAY]
        s.out_reals[_TO_STAMP] = monotonic(s) + s.clock_offset if s.realtime != 0 else s.reals[_STAMP]
        # Before it is sent: whoever has the answer and asks for the count finds it there.
        s.ticks += 1
        at = out_at(s)
        answer(s, at, _encode(at, s.out_keys, s.out_reals, s.out_wholes, s.text, s.text_size) - at)
        done += 1
        if called(s):
            break
    flush(s)
    return done
