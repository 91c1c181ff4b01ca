"""Passivity observer and controller (Hannaford & Ryu 2002; Ryu, Kim & Hannaford 2004): a guard after any law.

Under zero-order hold the energy given out by the virtual side is exact in samples: E_k = E_{k−1} +
F_{k−1}·(x_k − x_{k−1}). A virtual wall may store what it was given and give that back, no more: E ≤
0. The controller looks one tick ahead, with the displacement of the tick before: on the way out the
force is lowered so far that no more leaves than is in store; on the way in, while more was given
out than was taken, a damper may take the rest back.

With Δ_k = x_k − x_{k−1}, whatever the law asks for and however the device moves, if a force takes
effect in its own tick,

    E_{k+1} ≤ max(E_k, 0) + F_k (Δ_{k+1} − Δ_k),

so that one tick gives out no more than force times the *change* of the displacement,
T²·|F·acceleration|: what nobody can know when the force is chosen. (For a free mass m that is
F²T²/m.) The force never changes sign and zero stays zero: free space remains free, and a wall never
pulls.

Energy that a law has dissipated is not in store, but E does not know that: credit from minutes of
damping could feed an instability later. So credit is forgotten when there is no force (no contact:
nothing can be stored) and, where a stiffness is given, whenever it exceeds what a spring of that
stiffness holds at the present force, F²/(2k). A debt is never forgotten.

**Several axes have two accounts**: what the law stores along the surface's normal, which comes with
the force, and what acts along the surface, where friction only ever takes. With one account a
rubbing surface would pay for an unstable normal: at μ 0.3 and a PD wall of 6000 N/m it chatters at
52 mm/s, without friction or with two accounts at 22. An account each for x, y and z would not do:
along a surface that leans or curves, what one axis takes another gives back, and the guard would
brake a motion that makes no energy. Where there is no normal, what acts along the wanted force has
account 0.

**A partner** (nodes/environment/partner.py) may give out what was put in here: what is forgotten is
counted as `surplus`, sent with the state, and comes to the partner's guard as `credit` of its
forces. Sums are sent, so that what is lost or late on the way delays energy and makes none.

A device may itself apply a force later than it was handed over (its latency). What acts is then
what went into a line that much earlier, and what is still in the line will act before anything that
is chosen now (THEORY.md §6).
"""

from __future__ import annotations

import math
from collections.abc import MutableSequence, Sequence
from typing import Annotated, Final, Literal

import msgspec

from nodes.compiled.memory import reals_at
from nodes.compiled.rules import rule
from nodes.driver.state import DriverState

# what acts along a surface with less is rounding of the normal, and no friction [N]
ROUNDED: Final = 1e-9


class PassivityParameters(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Parameters of the guard.

    guard: ``on`` or ``off``.
    stiffness: Stiffness of the spring that the law stands for [N/m]: no more is kept in store than
        it holds. None forgets credit in free space only.
    damping: Largest damper that takes back what was given out too much [N s/m]; keep it well below
        m/T of the device, or the guard itself is what shakes. 0 lets the next contact pay.
    allowance: Energy that may be given out beyond what is in store before the guard acts [J]: a
        last line beside a law that is meant to be felt as it is.
    """

    guard: Literal["on", "off"] = "on"
    stiffness: Annotated[float, msgspec.Meta(gt=0.0)] | None = None
    damping: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0
    allowance: Annotated[float, msgspec.Meta(ge=0.0)] = 0.0


@rule
def observe(energy: float, acting: float, step: float) -> float:
    """Count the energy of one tick."""
    return energy + acting * step


def line_of(latency: float) -> tuple[list[float], float]:
    """Make an empty line of forces on their way."""
    whole = int(latency)
    part = latency - whole
    return [0.0] * (whole + (2 if part > 0.0 else 1)), part


@rule
def through(line: MutableSequence[float], force: float, part: float) -> float:
    """Let the force of a tick into the line, and give what acts during that tick."""
    last = len(line) - 1
    for i in range(last, 0, -1):
        line[i] = line[i - 1]
    line[0] = force
    if part > 0.0:
        return part * line[last] + (1.0 - part) * line[last - 1]
    return line[last]


@rule
def backlog(line: Sequence[float], part: float) -> float:
    """Add up what is on its way."""
    last = len(line) - 1
    total = 0.0
    for i in range(last - 1 if part > 0.0 else last):
        total += line[i]
    return total + part * line[last - 1] if part > 0.0 else total


@rule
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


@rule
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
        # Both have the sign of the step; the damper's force has the opposite one, which is that of
        # the law's force.
        if take * step > most * step:
            take = most
        return force - take
    return force


def set_guard(s: DriverState, parameters: PassivityParameters | None) -> None:
    """Take up a guard with its accounts at zero, or none."""
    s.guard_on = int(parameters is not None and parameters.guard == "on")
    for i in range(3):
        s.guard_energy[i] = s.guard_step[i] = 0.0
    s.lowered = s.raised = 0
    s.guard_highest = 0.0
    s.guard_surplus = s.guard_credit = 0.0
    s.guard_partner = 0
    if parameters is not None:
        s.guard_bounded = int(parameters.stiffness is not None)
        s.guard_stiffness = parameters.stiffness or 0.0
        s.guard_rate, s.guard_allowance = parameters.damping / s.period, parameters.allowance


@rule
def count_step(s: DriverState) -> None:
    """Count what acted between the two newest samples.

    One axis has the account of its number. Several have two: account 0 of what acted along the
    normal (of everything, where there is none), account 1 of the rest.
    """
    if s.axes == 1:
        i = s.axis[0]
        step = s.position[i] - s.before[i]
        s.guard_step[i] = step / s.elapsed
        s.guard_energy[i] = observe(s.guard_energy[i], s.acted[i], step)
        s.guard_highest = max(s.guard_highest, s.guard_energy[i])
        return
    whole = pushed = moved = square = 0.0
    for n in range(s.axes):
        i = s.axis[n]
        step = s.position[i] - s.before[i]
        s.guard_step[i] = step / s.elapsed
        whole += s.acted[i] * step
        pushed += s.acted[i] * s.normal[i]
        moved += step * s.normal[i]
        square += s.normal[i] * s.normal[i]
    along = pushed * moved if square > 0.0 else whole
    s.guard_energy[0] += along
    s.guard_energy[1] += whole - along
    s.guard_highest = max(s.guard_highest, s.guard_energy[0] + s.guard_energy[1])


@rule
def settle(s: DriverState, account: int, force: float) -> float:
    """Forget credit of an account that cannot be in store at a force; what goes may be given out by a partner."""
    before = s.guard_energy[account]
    if s.guard_bounded != 0:  # noqa: SIM108  # compiled code takes None as a type of its own
        kept = forget(before, force, s.guard_stiffness)
    else:
        kept = forget(before, force, None)
    s.guard_surplus += kept - before
    s.guard_energy[account] = kept
    return kept


@rule
def take_credit(s: DriverState, account: int) -> None:
    """Take up what a partner has put in since it was told last; a sum that begins anew gives nothing."""
    credit = s.got_credit
    if s.guard_partner != 0 and credit > s.guard_credit:
        s.guard_energy[account] -= credit - s.guard_credit
    if credit != 0.0:
        s.guard_partner = 1
    s.guard_credit = credit


@rule
def guarded(s: DriverState, share: float) -> None:
    """Replace the wanted force by a passive one; what is on the device acts for a `share` of the tick before it."""
    if s.axes > 1:
        guarded_along(s, share)
        return
    i = s.axis[0]
    force = s.wanted[i]
    take_credit(s, i)
    expected = settle(s, i, force) - s.guard_allowance
    waiting = 0.0
    if s.line_length > 0:
        waiting = backlog(reals_at(s.lines + 8 * i * s.line_length, s.line_length), s.line_part)
    expected += (share * s.handed[i] + waiting) * s.guard_step[i]
    value = control(expected, force, s.guard_step[i], s.guard_rate)
    if abs(value) < abs(force):
        s.lowered += 1
    elif value != force:
        s.raised += 1
    else:
        return
    s.wanted[i] = value


@rule
def guarded_along(s: DriverState, share: float) -> None:
    """Replace a wanted force in space: its part along the normal by account 0, the rest by account 1, each in its direction."""
    x, y, z = s.normal[0], s.normal[1], s.normal[2]
    wx, wy, wz = s.wanted[0], s.wanted[1], s.wanted[2]
    along = wx * x + wy * y + wz * z
    if x * x + y * y + z * z <= 0.0:
        # No surface: everything along the force itself.
        along = math.sqrt(wx * wx + wy * wy + wz * wz)
        if along > 0.0:
            x, y, z = wx / along, wy / along, wz / along
    tx, ty, tz = wx - along * x, wy - along * y, wz - along * z
    across = math.sqrt(tx * tx + ty * ty + tz * tz)
    if across > 0.0:
        tx, ty, tz = tx / across, ty / across, tz / across
    take_credit(s, 0)
    expected, expected_across = settle(s, 0, along), settle(s, 1, across)
    step = s.guard_step[0] * x + s.guard_step[1] * y + s.guard_step[2] * z
    step_across = s.guard_step[0] * tx + s.guard_step[1] * ty + s.guard_step[2] * tz
    whole = pushed = 0.0
    for n in range(s.axes):
        i = s.axis[n]
        acts = share * s.handed[i]
        if s.line_length > 0:
            acts += backlog(reals_at(s.lines + 8 * i * s.line_length, s.line_length), s.line_part)
        whole += acts * s.guard_step[i]
        pushed += acts * (x if i == 0 else y if i == 1 else z)
    expected += pushed * step - s.guard_allowance
    expected_across += whole - pushed * step - s.guard_allowance
    value = control(expected, along, step, s.guard_rate)
    value_across = across
    if across > ROUNDED:
        value_across = control(expected_across, across, step_across, s.guard_rate)
    if value == along and value_across == across:
        return
    if abs(value) < abs(along) or value_across < across:
        s.lowered += 1
    else:
        s.raised += 1
    s.wanted[0] += (value - along) * x + (value_across - across) * tx
    s.wanted[1] += (value - along) * y + (value_across - across) * ty
    s.wanted[2] += (value - along) * z + (value_across - across) * tz
