"""Friction of the proxy: which contacts carry it, and how far it slides along them."""

from __future__ import annotations

from nodes.environment.shapes import tables as t
from nodes.environment.shapes.tables import Memory, Table

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
            carrying, carrier = carrying + 1, i
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


def total_share(memory: Memory, count: int) -> float:
    """Return the sum of the contacts' shares: positive if a surface holds the proxy."""
    pressed = 0.0
    for i in range(count):
        pressed += memory[t.CONTACTS + t.CONTACT * i + t.SHARE]
    return pressed
