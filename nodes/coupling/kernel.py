"""Compiled tick of the coupling: nodes/coupling/render.py over laws of taps and sections."""

from __future__ import annotations

from typing import Any

from messages.types import Proxy
from nodes.arithmetic import SMOOTHING, newest_gain, revise_sections, sections
from nodes.compiled.kernels.encode import make_write
from nodes.compiled.kernels.follow_kernel import count_gap, in_order, overtaken
from nodes.compiled.kernels.hop import answer, called, flush, monotonic, out_at, receive
from nodes.compiled.kernels.machine import compilable, reals_at, record_at
from nodes.compiled.kernels.scan import make_scan
from nodes.compiled.kernels.sources import record_of, register_rules
from nodes.compiled.message_fields import fields_of, slots
from nodes.coupling.render import LawPort, evaluate, make_render
from nodes.coupling.state import PUBLISHED, SLOTS, CouplingState

register_rules()
_look = record_at(record_of(CouplingState))
_scan = make_scan(Proxy)
_write_answer = make_write(PUBLISHED)
(
    _SEQ,
    _CONTACT,
    _REBASED,
    _STAMP,
    _POSITION,
    _PROXY,
    _NORMAL,
    _DISTANCE,
    _DELAY,
    _CREDIT,
    _COMPLIANCE,
    _STIFFNESS,
    _DAMPING,
) = slots(
    fields_of(Proxy),
    "seq",
    "contact",
    "rebased",
    "stamp",
    "position",
    "proxy",
    "normal",
    "distance",
    "delay",
    "credit",
    "compliance",
    "stiffness",
    "damping",
)
_SLOTS = SLOTS


@compilable
def _ring(s: CouplingState, n: int) -> Any:
    return reals_at(s.history[n], 2 * s.length)


@compilable
def _force_of(s: CouplingState, n: int, m: int, history: Any, head: int) -> float:
    at = _SLOTS * n + m
    count = s.sections_count[at]
    taps = reals_at(s.taps[at], s.taps_count[at])
    recursive = reals_at(s.sections[at], 4 * count)
    return evaluate(
        taps, recursive, reals_at(s.sections_state[at], 2 * count), history, head
    )


@compilable
def _see(s: CouplingState, n: int, m: int, history: Any, head: int) -> None:
    at = _SLOTS * n + m
    count = s.sections_count[at]
    if count > 0:
        state = reals_at(s.sections_state[at], 2 * count)
        sections(
            reals_at(s.sections[at], 4 * count), state, history[head], history[head + 1]
        )


@compilable
def _gain_of(s: CouplingState, n: int, m: int) -> float:
    at = _SLOTS * n + m
    return newest_gain(
        reals_at(s.taps[at], s.taps_count[at]),
        reals_at(s.sections[at], 4 * s.sections_count[at]),
    )


@compilable
def _revise(s: CouplingState, n: int, m: int, by: float) -> None:
    at = _SLOTS * n + m
    count = s.sections_count[at]
    revise_sections(
        reals_at(s.sections[at], 4 * count),
        reals_at(s.sections_state[at], 2 * count),
        by,
    )


_render, _bridge = make_render(
    LawPort(_ring, _force_of, _see, _gain_of, _revise), compilable
)


@compilable
def _note(s: CouplingState, saves: bool) -> None:
    """Save, or restore, the state that a tick overwrites."""
    undo = reals_at(s.undo, s.undo_count)
    at = 0
    if s.turning == 1:
        for k in range(9):
            if saves:
                s.turned_before[k] = s.turned[k]
            else:
                s.turned[k] = s.turned_before[k]
        for k in range(3):
            if saves:
                s.turned_before[9 + k] = s.upright[k]
            else:
                s.upright[k] = s.turned_before[9 + k]
    for n in range(s.axes):
        history = reals_at(s.history[n], 2 * s.length)
        head = s.head[n]
        if saves:
            s.oldest[n] = history[head - 1 if head > 0 else s.length - 1]
        else:
            history[head] = history[head + s.length] = s.oldest[n]
            s.head[n] = head + 1 if head + 1 < s.length else 0
            s.pushes[n] -= 1
        for m in range(
            _SLOTS * n, _SLOTS * n + 1 + (s.leaving if s.fade_ramp > 0 else 0)
        ):
            state = reals_at(s.sections_state[m], 2 * s.sections_count[m])
            for k in range(2 * s.sections_count[m]):
                if saves:
                    undo[at] = state[k]
                else:
                    state[k] = undo[at]
                at += 1


@compilable
def ticks(address: int) -> int:
    """Answer proxies with forces until a case for the plain tick comes. Return how many."""
    s = _look(address)
    done = 0
    position, proxy, normal = (
        s.reals[_POSITION : _POSITION + 3],
        s.reals[_PROXY : _PROXY + 3],
        s.reals[_NORMAL : _NORMAL + 3],
    )
    while done < s.most:
        if not receive(s, 0) or not _scan(
            s.payload, s.payload + s.payload_size, s.reals, s.wholes
        ):
            break
        seq = s.wholes[_SEQ]
        if (
            not in_order(s, seq)
            or s.answered < 0
            or s.wholes[_REBASED] != s.rebased
            or s.jumps != 0
        ):
            break  # a start or a jump: the plain tick restarts the histories
        if overtaken(s, s.reals[_STAMP]):
            continue
        contact = s.wholes[_CONTACT] != 0
        distance = s.reals[_DISTANCE]
        if seq > s.seq + 1:
            missing = seq - s.seq - 1
            _bridge(s, position, proxy, normal, distance, contact, missing)
            # counted here, so that the plain tick does not count the gap again
            count_gap(s, missing)
            s.seq += missing
            s.answered = s.seq
        _note(s, True)
        felt_as = s.reals[_COMPLIANCE], s.reals[_STIFFNESS], s.reals[_DAMPING]
        if not _render(
            s,
            position,
            proxy,
            normal,
            distance,
            contact,
            felt_as,
            s.force,
            s.pushes[s.axes - 1] + 1,
        ):
            _note(s, False)  # the plain tick repeats it, and falls back
            break
        s.frames = 0
        s.seq = s.answered = seq
        s.delay += (s.reals[_DELAY] - s.delay) * SMOOTHING
        for i in range(3):
            s.normal[i] = normal[i] if contact else 0.0
        s.credit = s.reals[_CREDIT]
        s.stamp = monotonic(s) + s.clock_offset if s.realtime != 0 else s.reals[_STAMP]
        # before sending: a client that has the answer must find it counted
        s.ticks += 1
        at = out_at(s)
        answer(s, at, _write_answer(s, at) - at)
        done += 1
        if called(s):
            break
    flush(s)
    return done
