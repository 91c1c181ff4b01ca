"""From a proxy to a force: one source for interpreted, compiled and one-process ticks.

`evaluate` is the force of one law on numbers. `make_render` makes the tick on the coupling's state;
ways of playing differ in how a law in a slot is found and called, its `LawPort`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, MutableSequence, Sequence
from typing import Any, Final, NamedTuple

from nodes.arithmetic import (
    cross_fade,
    deflection,
    eased,
    fir,
    limit,
    one_sided,
    push,
    sections,
)
from nodes.compiled.rules import Made, rule
from nodes.coupling.force_fields import add_field
from nodes.coupling.state import SLOTS, CouplingState


@rule
def evaluate(
    taps: Sequence[float],
    recursive: Sequence[float] | None,
    state: MutableSequence[float],
    history: Sequence[float],
    head: int,
) -> float:
    """Return the force of one law over the history [N]."""
    force = fir(taps, history, head)
    if recursive is not None and len(recursive) > 0:
        force += sections(recursive, state, history[head], history[head + 1])
    return force


class LawPort(NamedTuple):
    """How a tick accesses the laws; every function has the state as first argument."""

    ring: Callable[[Any, int], Any]  # returns the history of an axis
    # returns the force for the newest deflection of the law in a slot of that axis [N]
    force_of: Callable[[Any, int, int, Any, int], float]
    # updates that law's sections with a deflection that is not rendered
    see: Callable[[Any, int, int, Any, int], None]
    # returns the gain of that law on the newest deflection [N/m]
    gain_of: Callable[[Any, int, int], float]
    # corrects that law's sections for a newest deflection that was too large
    revise: Callable[[Any, int, int, float], None]


# cosine of a normal's turn in a tick below which (some 25°) it is an edge, and axes stay
LEAST_COSINE: Final = 0.9
_SHORTEST: Final = 0.5  # length below which a normal is absent; surfaces give 1


def begin_turning(s: CouplingState, frame: str) -> None:
    """Start or stop turning the history's axes with the surface; past deflections stay valid."""
    turns = frame == "surface" or (frame == "auto" and s.axes == 3)
    if turns == (s.turning == 1):
        return
    if s.turning == 0:
        s.turned[:] = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
    s.upright[:] = (0.0, 0.0, 0.0)
    s.turning = 1 if turns else 2


def turn(
    turned: MutableSequence[float],
    upright: MutableSequence[float],
    normal: Sequence[float],
    contact: bool,
) -> None:
    """Turn axes (rows of a matrix) as a normal turns; at an edge, leave them.

    A deflection keeps its components.
    """
    a, b, c = upright[0], upright[1], upright[2]
    x, y, z = normal[0], normal[1], normal[2]
    if not contact or x * x + y * y + z * z < _SHORTEST:
        upright[0] = upright[1] = upright[2] = 0.0
        return
    cosine = a * x + b * y + c * z
    if cosine >= LEAST_COSINE:
        # Rodrigues: v + w × v + w × (w × v)/(1 + cos) turns by the angle between both normals, with
        # w their cross product.
        u, v, w = b * z - c * y, c * x - a * z, a * y - b * x
        part = 1.0 / (1.0 + cosine)
        for row in range(0, 9, 3):
            p = turned[row]
            q = turned[row + 1]
            r = turned[row + 2]
            d, e, f = v * r - w * q, w * p - u * r, u * q - v * p
            p, q, r = (
                p + d + part * (v * f - w * e),
                q + e + part * (w * d - u * f),
                r + f + part * (u * e - v * d),
            )
            # One Newton step towards length 1, so that rounding does not add up over hours.
            scale = 1.5 - 0.5 * (p * p + q * q + r * r)
            turned[row], turned[row + 1], turned[row + 2] = (
                scale * p,
                scale * q,
                scale * r,
            )
    upright[0], upright[1], upright[2] = x, y, z


def deflections(
    s: CouplingState,
    position: Any,
    proxy: Any,
    distance: float,
    normal: Any,
    contact: bool,
) -> list[float]:
    """Return the deflections that a tick would push into the histories [m], in their axes."""
    return [
        deflection_along(s, n, position, proxy, distance, normal, contact)
        for n in range(s.axes)
    ]


@rule
def turned_deflection(
    s: CouplingState,
    n: int,
    position: Any,
    proxy: Any,
    distance: float,
    normal: Any,
    contact: bool,
) -> float:
    """Return the deflection along a turned axis; the scene then computes all three axes."""
    value = 0.0
    for i in range(3):
        value += s.turned[3 * n + i] * deflection(
            position[i], proxy[i], distance, normal[i], contact, s.raw != 0
        )
    return value


@rule
def deflection_along(
    s: CouplingState,
    n: int,
    position: Any,
    proxy: Any,
    distance: float,
    normal: Any,
    contact: bool,
) -> float:
    """Return the deflection of a tick in the axes of the histories."""
    if s.turning != 0:
        return turned_deflection(s, n, position, proxy, distance, normal, contact)
    i = s.axis[n]
    return deflection(position[i], proxy[i], distance, normal[i], contact, s.raw != 0)


@rule
def hold_one_sided(s: CouplingState, normal: Any, contact: bool, force: Any) -> None:
    """Remove the part of a force that pulls, where the law's conventions ask for that."""
    along = 0.0
    for n in range(s.axes):
        i = s.axis[n]
        along += force[i] * normal[i]
    for n in range(s.axes):
        i = s.axis[n]
        force[i] = one_sided(
            force[i], normal[i], along, contact, s.raw != 0, s.clamp != 0
        )


@rule
def ease(s: CouplingState, force: Any) -> None:
    """Ease a force over a jump that no motion made."""
    # A force beyond the driver's limit is not felt: eased in full, 500 N would reach the limit at
    # once.
    peak = s.ease_peak if s.ease_peak > 0.0 else math.inf
    for n in range(s.axes):
        i = s.axis[n]
        asked = limit(force[i], 0.0, peak, math.inf)
        if s.ease_done == 0:
            s.ease_from[i] = limit(s.felt[i], 0.0, peak, math.inf)
            s.ease_offset[i] = s.ease_from[i] - asked
        force[i] = eased(
            asked, s.ease_from[i], s.ease_offset[i], s.ease_done, s.ease_ramp
        )
    s.ease_done += 1
    if s.ease_done >= s.ease_ramp:
        s.ease_ramp = 0


def make_render(
    port: LawPort, made: Made = lambda function: function
) -> tuple[Callable[..., bool], Callable[..., None]]:
    """Return the functions that render a tick, and that bridge missing ticks."""
    force_along = _make_force_along(port, _make_give_way(port, made), made)
    scaled = _make_scaled(port, made)
    turn_axes = made(turn)

    @made
    def render(
        s: CouplingState,
        position: Any,
        proxy: Any,
        normal: Any,
        distance: float,
        contact: bool,
        felt_as: tuple[float, float, float],
        force: Any,
        due: int,
    ) -> bool:
        """Render the force of one tick into `force`. Return whether it is finite.

        `felt_as`: compliance of the proxy [m/N], and factors of stiffness and damping of the law.
        The tick's deflection has number `due` in each history.
        """
        compliance, stiffness, damping = felt_as
        whole = stiffness == 1.0 and damping == 1.0
        is_fading = s.fade_ramp > 0
        force[0] = force[1] = force[2] = 0.0
        if s.turning == 1 and s.pushes[0] < due:
            turn_axes(s.turned, s.upright, normal, contact)
        for n in range(s.axes):
            value = 0.0
            is_new = s.pushes[n] < due
            if is_new:
                value = deflection_along(
                    s, n, position, proxy, distance, normal, contact
                )
            value = force_along(s, n, is_new, value, compliance)
            if not whole:
                value = scaled(s, n, value, stiffness, damping)
            if s.turning != 0:
                for j in range(3):
                    force[j] += s.turned[3 * n + j] * value
            else:
                force[s.axis[n]] = value
        hold_one_sided(s, normal, contact, force)
        if s.field != 0:
            add_field(s, position, force, due)
        if not math.isfinite(force[0] + force[1] + force[2]):
            return False
        if is_fading:
            s.fade_done += 1
            if s.fade_done >= s.fade_ramp:
                s.fade_ramp = 0
        if s.ease_ramp > 0:
            ease(s, force)
        s.felt[0], s.felt[1], s.felt[2] = force[0], force[1], force[2]
        return True

    return render, _make_bridge(port, made)


def _make_force_along(port: LawPort, give_way: Callable[..., float], made: Made) -> Any:
    ring, force_of = port.ring, port.force_of
    slots = SLOTS

    @made
    def force_along(
        s: CouplingState, n: int, is_new: bool, value: float, compliance: float
    ) -> float:
        """Return the force of the laws along an axis; push the deflection first if it is new."""
        history = ring(s, n)
        head = s.head[n]
        if is_new:
            s.head[n] = head = push(history, head, s.length, value)
            s.pushes[n] += 1
        force = force_of(s, n, 0, history, head)
        if s.fade_ramp > 0:
            old = 0.0
            for m in range(1, 1 + s.leaving):
                old += s.weight[slots * n + m] * force_of(s, n, m, history, head)
            force = cross_fade(old, force, s.fade_done, s.fade_ramp)
        if compliance > 0.0 and is_new:
            force = give_way(s, n, history, head, force, compliance)
        return float(force)

    return force_along


def _make_scaled(port: LawPort, made: Made) -> Callable[..., float]:
    ring = port.ring
    slots = SLOTS

    @made
    def scaled(
        s: CouplingState, n: int, force: float, stiffness: float, damping: float
    ) -> float:
        """Scale the part of a force that rests, and the rest of it, by a shape's factors.

        The part that rests is H(1) times the newest deflection, mixed as the laws are.
        """
        still = s.still[slots * n]
        if s.fade_ramp > 0:
            old = 0.0
            for m in range(1, 1 + s.leaving):
                old += s.weight[slots * n + m] * s.still[slots * n + m]
            still = cross_fade(old, still, s.fade_done, s.fade_ramp)
        rests = still * ring(s, n)[s.head[n]]
        return float(damping * force + (stiffness - damping) * rests)

    factored: Callable[..., float] = scaled
    return factored


def _make_give_way(port: LawPort, made: Made) -> Callable[..., float]:
    gain_of, revise = port.gain_of, port.revise
    slots = SLOTS

    @made
    def give_way(
        s: CouplingState,
        n: int,
        history: Any,
        head: int,
        force: float,
        compliance: float,
    ) -> float:
        """Return the force on a proxy that yields in the same tick; correct history and sections.

        F = F̂ − g·C·F with F̂ the force on a proxy that does not yield, g the gain on the newest
        deflection, C the compliance.
        """
        fading = s.fade_ramp > 0
        gain = gain_of(s, n, 0)
        if fading:
            old = 0.0
            for m in range(1, 1 + s.leaving):
                old += s.weight[slots * n + m] * gain_of(s, n, m)
            gain = cross_fade(old, gain, s.fade_done, s.fade_ramp)
        if not 1.0 + compliance * gain > 0.0 or not math.isfinite(force):
            return force  # the law is unstable on anything: do not let the proxy yield
        force = force / (1.0 + compliance * gain)
        by = compliance * force
        history[head] -= by
        history[head + s.length] -= by
        for m in range(1 + s.leaving if fading else 1):
            revise(s, n, m, by)
        return force

    yielding: Callable[..., float] = give_way
    return yielding


def _make_bridge(port: LawPort, made: Made) -> Callable[..., None]:
    ring, see = port.ring, port.see

    @made
    def bridge(
        s: CouplingState,
        position: Any,
        proxy: Any,
        normal: Any,
        distance: float,
        contact: bool,
        missing: int,
    ) -> None:
        """Fill missing ticks with a straight line to the newest deflection: no velocity jump."""
        laws = 1 + s.leaving if s.fade_ramp > 0 else 1
        for n in range(s.axes):
            history = ring(s, n)
            newest = deflection_along(s, n, position, proxy, distance, normal, contact)
            before = history[s.head[n]]
            # Of a gap longer than the history only the end is used.
            for k in range(max(1, missing + 1 - s.length), missing + 1):
                value = before + (newest - before) * k / (missing + 1)
                s.head[n] = head = push(history, s.head[n], s.length, value)
                s.pushes[n] += 1
                for m in range(laws):
                    see(s, n, m, history, head)

    filled: Callable[..., None] = bridge
    return filled
