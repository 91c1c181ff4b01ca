"""Proxy of a surface without shapes: free space, a plane across an axis, an anchor."""

from __future__ import annotations

from collections.abc import MutableSequence, Sequence

from nodes.arithmetic import plane_distance
from nodes.compiled.rules import rule
from nodes.environment.state import ANCHOR, PLANE


@rule
def meet_plane(
    position: float, surface: float, side: float
) -> tuple[float, float, bool]:
    """Return the proxy on a plane's axis [m], the signed distance [m] and whether they touch."""
    distance = plane_distance(position, surface, side)
    contact = distance < 0.0
    return surface if contact else position, distance, contact


@rule
def meet_flat(
    kind: int,
    table: Sequence[float],
    x: float,
    y: float,
    z: float,
    met: MutableSequence[float],
) -> bool:
    """Write the proxy of a surface without shapes for device position x, y, z [m] into `met`.

    Return whether there is contact.
    """
    met[0], met[1], met[2] = x, y, z
    met[3] = met[4] = met[5] = met[6] = met[7] = met[8] = 0.0
    met[9] = met[10] = 1.0
    if kind == PLANE:
        i = int(table[0])
        met[3 + i] = table[2]
        met[i], met[6], contact = meet_plane(met[i], table[1], table[2])
        return contact
    if kind == ANCHOR:
        met[0], met[1], met[2] = table[0], table[1], table[2]
        return True
    return False
