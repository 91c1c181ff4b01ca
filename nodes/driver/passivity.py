"""Passivity observer and controller (Hannaford & Ryu 2002; Ryu, Kim & Hannaford 2004): a guard after any law.

Under zero-order hold the energy given out by the virtual side is exact in samples: E_k = E_{k−1} + F_{k−1}·(x_k − x_{k−1}).
A virtual wall may store what it was given and give that back, no more: E ≤ 0. The controller looks one tick ahead, with the
displacement of the tick before: on the way out the force is lowered so far that no more leaves than is in store; on the way
in, while more was given out than was taken, a damper may take the rest back.

With Δ_k = x_k − x_{k−1}, whatever the law asks for and however the device moves, if a force takes effect in its own tick,

    E_{k+1} ≤ max(E_k, 0) + F_k (Δ_{k+1} − Δ_k),

so that one tick gives out no more than force times the *change* of the displacement, T²·|F·acceleration|: what nobody can
know when the force is chosen. (For a free mass m that is F²T²/m.) The force never changes sign and zero stays zero: free
space remains free, and a wall never pulls.

Energy that a law has dissipated is not in store, but E does not know that: credit from minutes of damping could feed an
instability later. So credit is forgotten when there is no force (no contact: nothing can be stored) and, where a stiffness is
given, whenever it exceeds what a spring of that stiffness holds at the present force, F²/(2k). A debt is never forgotten.

**Several axes have one account**, and the controller acts along the force that is wanted, whose direction stays: along a
surface that leans or curves, what one axis takes another gives back, and accounts of their own would let the guard brake a
motion that makes no energy. Dissipation along the rendering direction first is also what asks least of the motors (Porcini &
Frisoli 2026, arXiv 2603.26347; they let what is left act across it, within each motor's limits, where here nothing does: it
would be friction).

A device may itself apply a force later than it was handed over (its latency). What acts is then what went into a line that
much earlier, and what is still in the line will act before anything that is chosen now (THEORY.md §6).
"""

from __future__ import annotations

import math
from collections.abc import MutableSequence, Sequence
from typing import Annotated, Any, Literal

import msgspec

from nodes.compiled.memory import reals_at


class PassivityParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters of the guard.

    guard: ``on`` or ``off``.
    stiffness: Stiffness of the spring that the law stands for [N/m]: no more is kept in store than it holds. None forgets
        credit in free space only.
    damping: Largest damper that takes back what was given out too much [N s/m]; keep it well below m/T of the device, or the
        guard itself is what shakes. 0 lets the next contact pay.
    allowance: Energy that may be given out beyond what is in store before the guard acts [J]: a last line beside a law that is
        meant to be felt as it is.
    """

    guard: Literal["on", "off"] = "on"
    stiffness: Annotated[float, msgspec.Meta(gt=0.0)] | None = None
    damping: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0
    allowance: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0


def observe(energy: float, acting: float, step: float) -> float:
    """Count the energy of one tick."""
    return energy + acting * step


def line_of(latency: float) -> tuple[list[float], float]:
    """Make an empty line of forces on their way."""
    whole = int(latency)
    part = latency - whole
    return [0.0] * (whole + (2 if part > 0.0 else 1)), part


def through(line: MutableSequence[float], force: float, part: float) -> float:
    """Let the force of a tick into the line, and give what acts during that tick."""
    last = len(line) - 1
    for i in range(last, 0, -1):
        line[i] = line[i - 1]
    line[0] = force
    if part > 0.0:
        return part * line[last] + (1.0 - part) * line[last - 1]
    return line[last]


def backlog(line: Sequence[float], part: float) -> float:
    """Add up what is on its way."""
    last = len(line) - 1
    total = 0.0
    for i in range(last - 1 if part > 0.0 else last):
        total += line[i]
    return total + part * line[last - 1] if part > 0.0 else total


def forget(energy: float, force: float, stiffness: float | None) -> float:
    """Forget credit that cannot be in store."""
    if energy >= 0.0:
        return energy
    if force == 0.0:
        return 0.0
    if stiffness is not None:
        most = -force * force / (2.0 * stiffness)
        if energy < most:
            return most
    return energy


def control(energy: float, force: float, step: float, rate: float) -> float:
    """Choose the force of the next tick."""
    given = force * step
    if given > 0.0:
        if energy >= 0.0:
            return 0.0
        if energy + given > 0.0:
            return -energy / step
    elif given < 0.0 and energy > 0.0:
        take = energy / step
        most = rate * step
        # Both have the sign of the step; the damper's force has the opposite one, which is that of the law's force.
        if take * step > most * step:
            take = most
        return force - take
    return force


def set_guard(s: Any, parameters: PassivityParameters | None) -> None:
    """Take up a guard with its accounts at zero, or none."""
    s.guard_on = parameters is not None and parameters.guard == "on"
    for i in range(3):
        s.guard_energy[i] = s.guard_step[i] = 0.0
    s.lowered = s.raised = 0
    s.guard_highest = 0.0
    if parameters is not None:
        s.guard_bounded = parameters.stiffness is not None
        s.guard_stiffness = parameters.stiffness or 0.0
        s.guard_rate, s.guard_allowance = parameters.damping / s.period, parameters.allowance


def count_step(s: Any) -> None:
    """Count what acted between the two newest samples; of several axes in one account, which is kept with the first."""
    account = s.axis[0]
    for n in range(s.axes):
        i = s.axis[n]
        step = s.position[i] - s.before[i]
        s.guard_step[i] = step / s.elapsed
        s.guard_energy[account] = observe(s.guard_energy[account], s.acted[i], step)
    s.guard_highest = max(s.guard_highest, s.guard_energy[account])


def guarded(s: Any, share: float) -> None:
    """Choose the force in place of what is wanted; what is on the device acts for a `share` of the tick before it."""
    account = s.axis[0]
    force = s.wanted[account]
    if s.axes > 1:
        # Along the force that is wanted, whose direction stays.
        # Products, not powers: compiled code makes other last bits of a power.
        x, y, z = s.wanted[0], s.wanted[1], s.wanted[2]
        force = math.sqrt(x * x + y * y + z * z)
    if s.guard_bounded != 0:
        energy = forget(s.guard_energy[account], force, s.guard_stiffness)
    else:
        energy = forget(s.guard_energy[account], force, None)
    s.guard_energy[account] = energy
    expected, step = energy - s.guard_allowance, 0.0
    for n in range(s.axes):
        i = s.axis[n]
        waiting = 0.0
        if s.line_length > 0:
            waiting = backlog(reals_at(s.lines + 8 * i * s.line_length, s.line_length), s.line_part)
        expected += (share * s.handed[i] + waiting) * s.guard_step[i]
        step += s.guard_step[i] if s.axes == 1 else s.wanted[i] * s.guard_step[i]
    if s.axes > 1:
        if force == 0.0:
            return
        step /= force
    value = control(expected, force, step, s.guard_rate)
    if abs(value) < abs(force):
        s.lowered += 1
    elif value != force:
        s.raised += 1
    else:
        return
    for n in range(s.axes):
        i = s.axis[n]
        s.wanted[i] = value if s.axes == 1 else s.wanted[i] * (value / force)
