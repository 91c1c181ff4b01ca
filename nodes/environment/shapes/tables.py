"""Layout of the two tables of floats that the geometry works on.

The *scene* table contains all shapes and is constant while it is touched. The *memory* table
contains the proxy's position, its contacts and the last answer. Both are flat, so that the same
source reads lists when interpreted and arrays when compiled. All lengths are in metres.
"""

from __future__ import annotations

from collections.abc import MutableSequence, Sequence
from typing import Final, TypeAlias

Table: TypeAlias = Sequence[float]
Memory: TypeAlias = MutableSequence[float]  # state of a proxy between calls
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

# -- scene table --

SHAPES: Final = 0  # number of shapes
RADIUS: Final = 1  # radius of the tool, including SKIN [m]
CALL_PERIOD: Final = 2  # sampling period T [s]
ROWS: Final = 4  # start of the first shape; each takes ROW floats
ROW: Final = 24
KIND: Final = 0
STATIC: Final = 1  # friction coefficient up to which the proxy sticks
DYNAMIC: Final = 2  # friction coefficient while it slides
# time by which a sliding proxy trails [s]: viscous friction over the coupling's stiffness
VISCOUS: Final = 3
GIVEN: Final = 4  # start of the parameters of the kind
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
CONTACTS: Final = 16  # start of the contacts: up to MAX_CONTACTS entries of CONTACT floats
MAX_CONTACTS: Final = 8
CONTACT: Final = 8  # floats per contact: normal (3), gap [m], shape, triangle, multiplier [m]

GAP, SHAPE, FACE, SHARE = range(3, 7)

SEEN: Final = CONTACTS + MAX_CONTACTS * CONTACT  # scratch: triangles seen by a patch search
PATCH: Final = 96  # largest number of triangles in a patch search
# scratch: proxy (3) [m] and its contact before another triangle is tried
BACK: Final = SEEN + PATCH
# nearest triangle of the last call for each shape; behind them the mode of each shape
LAST: Final = BACK + 3 + CONTACT
# felt; not felt until the tool is outside; kept in contact during a jump (before placing)
FELT, UNFELT, HELD = 0.0, 1.0, 2.0
