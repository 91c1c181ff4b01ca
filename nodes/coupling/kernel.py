"""The coupling's tick, compiled: laws of taps and recursive sections over the shared deflection histories, and their fades."""

from __future__ import annotations

import math
from typing import Any

from messages.types import Force, Proxy
from nodes.compiled.fields import fields_of, slot
from nodes.compiled.kernels.encode import make_encode
from nodes.compiled.kernels.follow import in_order, overtaken
from nodes.compiled.kernels.hop import answer, called, flush, monotonic, out_at, receive
from nodes.compiled.kernels.machine import compilable, reals_at, record_at
from nodes.compiled.kernels.scan import make_scan
from nodes.compiled.kernels.sources import kernel, record_of
from nodes.compiled.layout import LEAVING, CouplingState
from nodes.kernels import SMOOTHING, cross_fade, deflection, fir, one_sided, push, sections

for _function in (cross_fade, deflection, fir, one_sided, push, sections):
    kernel(_function)
_look = record_at(record_of(CouplingState))
_scan = make_scan(Proxy)
_encode = make_encode(Force)
_IN, _OUT = fields_of(Proxy), fields_of(Force)
_SEQ, _CONTACT = (slot(_IN, name) for name in ("seq", "contact"))
_STAMP, _POSITION, _PROXY, _NORMAL, _DISTANCE, _DELAY = (
    slot(_IN, name) for name in ("stamp", "position", "proxy", "normal", "distance", "delay")
)
_TO_SEQ, _TO_REVISION = (slot(_OUT, name) for name in ("seq", "revision"))
_TO_STAMP, _TO_FORCE = (slot(_OUT, name) for name in ("stamp", "force"))


_LEAVING = LEAVING


@compilable
def _force(taps: int, taps_count: int, numbers: int, count: int, state: int, history: Any, head: int) -> float:
    """Render the newest deflection with one law."""
    value = fir(reals_at(taps, taps_count), history, head)
    if count > 0:
        value = value + sections(
            reals_at(numbers, 4 * count), reals_at(state, 2 * count), history[head], history[head + 1]
        )
    return value


@compilable
def _render(s: Any, taken: Any, contact: bool, force: Any) -> bool:
    """Render the force of one tick; whether it is finite."""
    raw, clamp, length = s.raw != 0, s.clamp != 0, s.length
    _note(s, True)
    along = 0.0
    for i in range(3):
        force[_TO_FORCE + i] = 0.0
    for n in range(s.axes):
        i = s.axis[n]
        normal = taken[_NORMAL + i]
        history = reals_at(s.history[n], 2 * length)
        newest = deflection(taken[_POSITION + i], taken[_PROXY + i], taken[_DISTANCE], normal, contact, raw)
        s.oldest[n] = history[s.head[n] - 1 if s.head[n] > 0 else length - 1]
        s.head[n] = head = push(history, s.head[n], length, newest)
        value = _force(s.taps, s.taps_count, s.sections, s.sections_count, s.sections_state[n], history, head)
        if s.fade_ramp > 0:
            old = 0.0
            for m in range(_LEAVING * n, _LEAVING * n + s.leaving):
                old += s.leaving_weight[m] * _force(
                    s.leaving_taps[m],
                    s.leaving_taps_count[m],
                    s.leaving_sections[m],
                    s.leaving_sections_count[m],
                    s.leaving_state[m],
                    history,
                    head,
                )
            value = cross_fade(old, value, s.fade_done, s.fade_ramp)
        force[_TO_FORCE + i] = value
        along += value * normal
    for n in range(s.axes):
        i = s.axis[n]
        force[_TO_FORCE + i] = one_sided(force[_TO_FORCE + i], taken[_NORMAL + i], along, contact, raw, clamp)
    return math.isfinite(force[_TO_FORCE] + force[_TO_FORCE + 1] + force[_TO_FORCE + 2])


@compilable
def _note(s: Any, saves: bool) -> None:
    """Save the states of all sections, or put them back."""
    if s.undo_count == 0:
        return
    undo = reals_at(s.undo, s.undo_count)
    at = 0
    for n in range(s.axes):
        for m in range(-1, s.leaving if s.fade_ramp > 0 else 0):
            count = s.sections_count if m < 0 else s.leaving_sections_count[_LEAVING * n + m]
            state = reals_at(s.sections_state[n] if m < 0 else s.leaving_state[_LEAVING * n + m], 2 * count)
            for k in range(2 * count):
                if saves:
                    undo[at] = state[k]
                else:
                    state[k] = undo[at]
                at += 1


@compilable
def _see(numbers: int, count: int, state: int, history: Any, head: int) -> None:
    """Let sections see a deflection."""
    if count > 0:
        sections(reals_at(numbers, 4 * count), reals_at(state, 2 * count), history[head], history[head + 1])


@compilable
def _bridge(s: Any, taken: Any, contact: bool, missing: int) -> None:
    """Fill ticks that were left out by a straight line (`History.bridge`, `LawOnAxis.catch_up`)."""
    for n in range(s.axes):
        i = s.axis[n]
        history = reals_at(s.history[n], 2 * s.length)
        newest = deflection(
            taken[_POSITION + i], taken[_PROXY + i], taken[_DISTANCE], taken[_NORMAL + i], contact, s.raw != 0
        )
        before = history[s.head[n]]
        for k in range(1, missing + 1):
            s.head[n] = head = push(history, s.head[n], s.length, before + (newest - before) * k / (missing + 1))
            s.pushes[n] += 1
            _see(s.sections, s.sections_count, s.sections_state[n], history, head)
            if s.fade_ramp > 0:
                for m in range(_LEAVING * n, _LEAVING * n + s.leaving):
                    _see(s.leaving_sections[m], s.leaving_sections_count[m], s.leaving_state[m], history, head)
    # Whoever takes the tick over from here must not do it again.
    s.gaps += missing
    s.seq += missing


@compilable
def _undo(s: Any) -> None:
    """Take back what a tick did to histories and sections, so that the plain tick can do it."""
    for n in range(s.axes):
        history = reals_at(s.history[n], 2 * s.length)
        head = s.head[n]
        history[head] = history[head + s.length] = s.oldest[n]
        s.head[n] = head + 1 if head + 1 < s.length else 0
    _note(s, False)


@compilable
def ticks(address: int) -> int:
    """Answer proxies with forces until something is unusual."""
    s = _look(address)
    done = 0
    while done < s.most:
        if not receive(s, 0) or not _scan(s.payload, s.payload + s.payload_size, s.reals, s.wholes):
            break
        seq = s.wholes[_SEQ]
        if not in_order(s, seq):
            break
        if overtaken(s, s.reals[_STAMP]):
            continue
        if seq > s.seq + 1:
            _bridge(s, s.reals, s.wholes[_CONTACT] != 0, seq - s.seq - 1)
        if not _render(s, s.reals, s.wholes[_CONTACT] != 0, s.out_reals):
            _undo(s)
            break
        s.frames = 0
        s.seq = seq
        if s.fade_ramp > 0:
            s.fade_done += 1
            if s.fade_done >= s.fade_ramp:
                s.fade_ramp = 0
        s.delay += (s.reals[_DELAY] - s.delay) * SMOOTHING
        s.out_wholes[_TO_SEQ] = seq
        s.out_wholes[_TO_REVISION] = s.revision
        s.out_reals[_TO_STAMP] = monotonic(s) + s.clock_offset if s.realtime != 0 else s.reals[_STAMP]
        # Before it is sent: whoever has the answer and asks for the count finds it there.
        s.ticks += 1
        at = out_at(s)
        answer(s, at, _encode(at, s.out_keys, s.out_reals, s.out_wholes, s.text, s.text_size) - at)
        # Last: who copies the histories from another thread takes a push under way for one that has not begun.
        for n in range(s.axes):
            s.pushes[n] += 1
        done += 1
        if called(s):
            break
    flush(s)
    return done
