"""From a proxy to a force: the rule of a coupling's tick, one source for the interpreter, the compiled tick and one process.

`evaluate` is the force of one law on numbers, for whoever has them at hand. `make_render` makes the tick on the coupling's
state; what differs between ways of playing is how a law in a slot is found and called, its `LawPort`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, MutableSequence, Sequence
from typing import Any, NamedTuple, TypeVar

from nodes.coupling.state import SLOTS
from nodes.kernels import cross_fade, deflection, fir, one_sided, push, sections

Function = TypeVar("Function", bound=Callable[..., Any])


def evaluate(
    taps: Sequence[float],
    recursive: Sequence[float] | None,
    state: MutableSequence[float],
    history: Sequence[float],
    head: int,
) -> float:
    """Force of one law over the history."""
    force = fir(taps, history, head)
    if recursive is not None and len(recursive) > 0:
        force += sections(recursive, state, history[head], history[head + 1])
    return force


class LawPort(NamedTuple):
    """What a tick needs of the laws; each takes the state first.

    `ring` gives the history of an axis; `force_of` renders the newest deflection with the law in a slot of that axis, `see`
    lets its sections see a deflection that nobody renders.
    """

    ring: Callable[[Any, int], Any]
    force_of: Callable[[Any, int, int, Any, int], float]
    see: Callable[[Any, int, int, Any, int], None]


def _as_it_stands(function: Function) -> Function:
    return function


def make_render(
    port: LawPort, made: Callable[[Any], Any] = _as_it_stands
) -> tuple[Callable[..., bool], Callable[..., None]]:
    """Make the tick of a port, and the bridge over ticks that were left out."""
    ring, force_of, see = port
    slots = SLOTS

    @made
    def render(
        s: Any, position: Any, proxy: Any, normal: Any, distance: float, contact: bool, force: Any, due: int
    ) -> bool:
        """Render the force of one tick, whose deflection is the one number `due` in each history; whether it is finite."""
        raw, clamp = s.raw != 0, s.clamp != 0
        fading = s.fade_ramp > 0
        force[0] = force[1] = force[2] = along = 0.0
        for n in range(s.axes):
            i = s.axis[n]
            history = ring(s, n)
            head = s.head[n]
            if s.pushes[n] < due:
                value = deflection(position[i], proxy[i], distance, normal[i], contact, raw)
                s.head[n] = head = push(history, head, s.length, value)
                s.pushes[n] += 1
            value = force_of(s, n, 0, history, head)
            if fading:
                old = 0.0
                for m in range(1, 1 + s.leaving):
                    old += s.weight[slots * n + m] * force_of(s, n, m, history, head)
                value = cross_fade(old, value, s.fade_done, s.fade_ramp)
            force[i] = value
            along += value * normal[i]
        for n in range(s.axes):
            i = s.axis[n]
            force[i] = one_sided(force[i], normal[i], along, contact, raw, clamp)
        if not math.isfinite(force[0] + force[1] + force[2]):
            return False
        if fading:
            s.fade_done += 1
            if s.fade_done >= s.fade_ramp:
                s.fade_ramp = 0
        return True

    @made
    def bridge(s: Any, position: Any, proxy: Any, normal: Any, distance: float, contact: bool, missing: int) -> None:
        """Fill ticks that were left out by a straight line up to the newest deflection, which is not yet rendered.

        Laws assume evenly spaced deflections; leaving ticks out would read as a jump in velocity.
        """
        laws = 1 + s.leaving if s.fade_ramp > 0 else 1
        for n in range(s.axes):
            i = s.axis[n]
            history = ring(s, n)
            newest = deflection(position[i], proxy[i], distance, normal[i], contact, s.raw != 0)
            before = history[s.head[n]]
            # Of a gap longer than the history only its end is ever seen.
            for k in range(max(1, missing + 1 - s.length), missing + 1):
                value = before + (newest - before) * k / (missing + 1)
                s.head[n] = head = push(history, s.head[n], s.length, value)
                s.pushes[n] += 1
                for m in range(laws):
                    see(s, n, m, history, head)

    return render, bridge
