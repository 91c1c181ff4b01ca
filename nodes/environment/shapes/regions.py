"""Regions without a surface: viscosity, and lines that attract.

A region moves the proxy's goal, which is the device elsewhere. In a viscous one the goal trails
behind the device, T/(T + τ) of the way in each tick: the law, whatever it is, then renders no
stiffness and a damping of its stiffness times τ. A line attracts as far as half its reach with the
law itself, and from there less, down to nothing at its reach, so that no force jumps.
"""

from __future__ import annotations

from messages.types import Vector
from nodes.environment.shapes import tables as t
from nodes.environment.shapes.convex import gap
from nodes.environment.shapes.tables import Memory, Table


def find_goal(scene: Table, memory: Memory, x: float, y: float, z: float) -> Vector:
    """Return where the proxy would be without shapes [m]; the device itself outside regions."""
    regions = int(scene[t.REGIONS])
    gx = x
    gy = y
    gz = z
    if regions > 0:
        lag = pull = px = py = pz = 0.0
        shapes = int(scene[t.SHAPES])
        for n in range(regions):
            row = t.ROWS + t.ROW * (shapes + n)
            away, nx, ny, nz = gap(scene, row, x, y, z)
            deep = -(away + scene[t.RADIUS])
            if deep <= 0.0:
                continue
            if scene[row + t.EFFECT] == t.VISCOSITY:
                lag += scene[row + t.LAG] * min(deep / scene[row + t.BAND], 1.0)
            else:
                # The capsule's radius is the reach of its line.
                reach = scene[row + t.GIVEN + 7]
                pull = scene[row + t.STIFF] * min(reach - deep, deep)
                px, py, pz = px + pull * nx, py + pull * ny, pz + pull * nz
        if lag > 0.0 and memory[t.TICKS] > 0.0:
            span = memory[t.TICKS] * scene[t.CALL_PERIOD]
            part = lag / (lag + span)
            gx = x + part * (memory[t.WAKE] - x)
            gy = y + part * (memory[t.WAKE + 1] - y)
            gz = z + part * (memory[t.WAKE + 2] - z)
        memory[t.WAKE], memory[t.WAKE + 1], memory[t.WAKE + 2] = gx, gy, gz
        gx, gy, gz = gx - px, gy - py, gz - pz
    memory[t.GOAL], memory[t.GOAL + 1], memory[t.GOAL + 2] = gx, gy, gz
    return gx, gy, gz
