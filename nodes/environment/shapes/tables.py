"""Layout of the two tables of floats that the geometry works on.

The *scene* table contains all shapes and regions; while it is touched, only offsets of shapes that
move change in it. The *memory* table contains the proxy's position, its contacts and the last
answer. Both are flat, so that the same source reads lists when interpreted and arrays when
compiled. All lengths are in metres.
"""

from __future__ import annotations

from collections.abc import MutableSequence, Sequence
from typing import Final, TypeAlias

Table: TypeAlias = Sequence[float]
Memory: TypeAlias = MutableSequence[float]  # state of a proxy between calls
MovingTable: TypeAlias = MutableSequence[float]  # a scene table whose offsets change
Vector4: TypeAlias = tuple[float, float, float, float]

# rest height of the proxy above a surface [m], so that rounding never puts it inside
SKIN: Final = 1e-10
# depth below that height from which a path counts as a hit [m]
TOLERANCE: Final = SKIN / 4.0
# distance from that height within which a surface counts as touched [m]
TOUCH: Final = 2.0 * TOLERANCE
# overhang of a triangle over its edges [m], so that nothing slips between two triangles
LIP: Final = 1e-9
EDGE: Final = TOLERANCE
"""Overhang where a point hits [m].

Less than SKIN, or a hidden side would protrude from a flush top.
"""
# in free air: distance up to which that of a mesh is exact [m], and error beyond [of it]
NEAR: Final = 5e-3
FAR_ERROR: Final = 0.2

# -- scene table --

SHAPES: Final = 0  # number of shapes
RADIUS: Final = 1  # radius of the tool, including SKIN [m]
CALL_PERIOD: Final = 2  # sampling period T [s]
REGIONS: Final = 3  # number of regions, in rows behind those of the shapes
MOVERS: Final = 4  # number of shapes that move
ROWS: Final = 6  # start of the first shape; each takes ROW floats
ROW: Final = 36
KIND: Final = 0
STATIC: Final = 1  # friction coefficient up to which the proxy sticks
DYNAMIC: Final = 2  # friction coefficient while it slides
# time by which a sliding proxy trails [s]: viscous friction over the coupling's stiffness
VISCOUS: Final = 3
# factors of stiffness and damping of the law, at most 1; a region has that of its pull in STIFF
STIFF: Final = 4
DAMP: Final = 5
SHIFT: Final = 6  # present offset of a shape that moves (3) [m]
STEP: Final = 9  # part of it that was moved in this tick (3) [m]
AIM: Final = 12  # offset at which it arrives, without a path (3) [m]
SPEED: Final = 15  # largest speed [m/s]; 0 for a shape that stays
POWER: Final = 16  # largest power that it puts into the device [W]
WAY: Final = 17  # start of its path: WAY_POINT floats each
WAY_POINTS: Final = 18  # number of them; 0: it moves to AIM
REPEAT: Final = 19  # time after which the path begins again [s]; 0 for never
GIVEN: Final = 20  # start of the parameters of the kind
PLANE: Final = 0.0  # point (3), outward normal (3)
SPHERE: Final = 1.0  # centre (3), radius
BOX: Final = 2.0  # centre (3), the three axes (9), half sizes (3)
CAPSULE: Final = 3.0  # one end of the axis (3), direction (3), length, radius
CYLINDER: Final = 4.0  # centre (3), direction (3), half length, radius

MESH: Final = 5.0
"""Start and number of triangles, start of tree, leaves, start of neighbours, closed (1)."""

TRIANGLES, COUNT, TREE, LEAVES, NEIGHBOURS, CLOSED = range(GIVEN, GIVEN + 6)

TRIANGLE: Final = 12  # floats per triangle: three corners, outward normal
NODE: Final = 6  # floats per node of the tree: lower corner, upper corner
WAY_POINT: Final = 4  # time [s], offset (3) [m]

# a region has a shape's row, with these in place of friction
EFFECT: Final = 1  # one of the next line
VISCOSITY, LINE = 1.0, 2.0
BAND: Final = 2  # depth over which a region's effect grows from its boundary [m]
LAG: Final = 3  # time by which a viscous region makes the proxy trail [s]

# -- memory table --

AT: Final = 0  # the proxy: centre of the tool (3) [m]
PLACED: Final = 3  # whether it has been placed: one of the next line
# not yet; yes; on another surface before; yes, but its device is lost
NEVER, ON, CARRIED, LOST = 0.0, 1.0, 2.0, 3.0
SLIDING: Final = 4  # 1 while it slides
TOUCHED: Final = 5  # number of contacts
ROUNDS: Final = 6  # rounds of the last call
INSIDE: Final = 7  # number of shapes not felt, because the tool began inside them
PROXY: Final = 8  # answer: the proxy (3) [m]
NORMAL: Final = 11  # answer: outward normal (3)
DISTANCE: Final = 14  # answer: signed distance along it, negative inside [m]
IN_CONTACT: Final = 15  # answer: 1 in contact
# start of the contacts: up to MAX_CONTACTS entries of CONTACT floats
CONTACTS: Final = 16
MAX_CONTACTS: Final = 8
# floats per contact: normal (3), gap [m], shape, triangle, multiplier [m]
CONTACT: Final = 8

GAP, SHAPE, FACE, SHARE = range(3, 7)

# scratch: triangles seen by a patch search
SEEN: Final = CONTACTS + MAX_CONTACTS * CONTACT
PATCH: Final = 96  # largest number of triangles in a patch search
# scratch: proxy (3) [m] and its contact before another triangle is tried
BACK: Final = SEEN + PATCH
NOW: Final = BACK + 3 + CONTACT  # tick of this call, as the node noted it
FORCE: Final = NOW + 1  # force on the device, as the node noted it (3) [N]
BEFORE: Final = NOW + 4  # tick of the call before
TICKS: Final = NOW + 5  # ticks between both; 0 at a start
FELT_AS: Final = NOW + 6  # factors of stiffness and damping that the answer has (2)
WAKE: Final = NOW + 8  # where a viscous region holds the proxy (3) [m]
GOAL: Final = NOW + 11  # where the proxy would be without shapes (3) [m]
ENERGY: Final = NOW + 14  # energy that moving shapes have put into the device [J]
MOST_POWER: Final = NOW + 15  # largest power of it in a tick [W]
# 1 if a shape that moves went past a proxy that something held
PASSED: Final = NOW + 16
# nearest triangle of the last call for each shape; behind them the mode of each shape, and behind
# those a ball of each without a triangle of its mesh
LAST: Final = NOW + 17
FREE: Final = 4  # floats of such a ball: centre (3), radius [m]
# felt; not felt until the tool is outside; kept in contact during a jump (before placing)
FELT, UNFELT, HELD = 0.0, 1.0, 2.0
