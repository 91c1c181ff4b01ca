"""Friction of the proxy on the contacts that carry it, and the factors of the law on them."""

from __future__ import annotations

from nodes.environment.shapes import tables as t
from nodes.environment.shapes.tables import Memory, Table

_CHANGE = 0.05  # time over which a factor changes from 0 to 1 [s]
STILL = 1e-14  # length below which a step counts as zero [m]


def carried(
    scene: Table, memory: Memory, count: int, sliding: bool
) -> tuple[int, int, float, float, float]:
    """Return how many contacts carry the proxy, the last of them, and their friction.

    The friction is the cone [m], the viscous part and the sum of the shares, each weighted by the
    shares of the contacts.
    """
    carrying, carrier = 0, 0
    cone = coat = pressed = 0.0
    for i in range(count):
        at = t.CONTACTS + t.CONTACT * i
        share = memory[at + t.SHARE]
        if share > 0.0:
            carrying = carrying + 1
            carrier = i
            row = t.ROWS + t.ROW * int(memory[at + t.SHAPE])
            cone += share * scene[row + (t.DYNAMIC if sliding else t.STATIC)]
            coat += share * scene[row + t.VISCOUS]
            pressed += share
    return carrying, carrier, cone, coat, pressed


def dynamic_cone(scene: Table, memory: Memory, count: int) -> float:
    """Return the cone of a proxy that slides [m]."""
    cone = 0.0
    for i in range(count):
        at = t.CONTACTS + t.CONTACT * i
        row = t.ROWS + t.ROW * int(memory[at + t.SHAPE])
        cone += memory[at + t.SHARE] * scene[row + t.DYNAMIC]
    return cone


def slide(length: float, cone: float, behind: float, slid: float) -> float:
    """Return the part of a step of this length that friction leaves; 0 if the proxy sticks.

    `behind`: viscous lag per distance slid; `slid`: distance slid in this call [m].
    """
    left = length - cone - behind * slid
    return 0.0 if left <= STILL else left / (length * (1.0 + behind))


def feel(scene: Table, memory: Memory, was_touched: bool) -> None:
    """Set the factors of stiffness and damping: those of the contacts, by their shares.

    From one contact to another they change over `_CHANGE`, so that no force jumps.
    """
    stiff = damp = pressed = 0.0
    for i in range(int(memory[t.TOUCHED])):
        at = t.CONTACTS + t.CONTACT * i
        row = t.ROWS + t.ROW * int(memory[at + t.SHAPE])
        stiff += memory[at + t.SHARE] * scene[row + t.STIFF]
        damp += memory[at + t.SHARE] * scene[row + t.DAMP]
        pressed += memory[at + t.SHARE]
    stiff, damp = (stiff / pressed, damp / pressed) if pressed > 0.0 else (1.0, 1.0)
    if was_touched and memory[t.TICKS] > 0.0:
        most = memory[t.TICKS] * scene[t.CALL_PERIOD] / _CHANGE
        now = memory[t.FELT_AS]
        then = memory[t.FELT_AS + 1]
        stiff = min(max(stiff, now - most), now + most)
        damp = min(max(damp, then - most), then + most)
    memory[t.FELT_AS], memory[t.FELT_AS + 1] = stiff, damp


def total_share(memory: Memory, count: int) -> float:
    """Return the sum of the contacts' shares: positive if a surface holds the proxy."""
    pressed = 0.0
    for i in range(count):
        pressed += memory[t.CONTACTS + t.CONTACT * i + t.SHARE]
    return pressed
