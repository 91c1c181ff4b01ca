"""What stands where in the two tables of floats that the geometry works on.

The *scene* table holds all shapes and never changes while it is touched. The *memory* table holds
where the proxy was, what it touched, and the answer of the last call. Both are flat, so that
interpreted code reads lists and compiled code reads arrays, from one source. All lengths are in
metres.
"""

from __future__ import annotations

from collections.abc import MutableSequence, Sequence
from typing import Final, TypeAlias

Table: TypeAlias = Sequence[float]
Memory: TypeAlias = MutableSequence[float]  # what a proxy remembers
Vector4: TypeAlias = tuple[float, float, float, float]

# height above a surface at which the proxy rests [m], so that rounding never puts it inside
SKIN: Final = 1e-10
# how deep a path must lead under that height before it counts as a hit [m]
TOLERANCE: Final = SKIN / 4.0
# distance from that height within which a surface counts as touched [m]
TOUCH: Final = 2.0 * TOLERANCE
# how far a triangle reaches over its edges, so that nothing slips between two of them [m]
LIP: Final = 1e-9
EDGE: Final = TOLERANCE
"""How far it reaches where a point hits it [m]: less than the skin, or a hidden side would stick out of a flush top."""

# -- the scene table
# ---------------------------------------------------------------------------------------------------

SHAPES: Final = 0  # number of shapes
RADIUS: Final = 1  # radius of the tool, with the skin [m]
PERIOD: Final = 2  # time between two calls [s]
ROWS: Final = 4  # where the first shape stands; each takes ROW floats
ROW: Final = 24
KIND: Final = 0
STATIC: Final = 1  # coefficient of friction up to which the proxy sticks
DYNAMIC: Final = 2  # coefficient of friction while it slides
# time by which a sliding proxy trails [s]: viscous friction over the coupling's stiffness
VISCOUS: Final = 3
GIVEN: Final = 4  # where the parameters of the kind begin
PLANE: Final = 0.0  # point (3), outward normal (3)
SPHERE: Final = 1.0  # centre (3), radius
BOX: Final = 2.0  # centre (3), the three axes (9), half sizes (3)
CAPSULE: Final = 3.0  # one end of the axis (3), direction (3), length, radius
CYLINDER: Final = 4.0  # centre (3), direction (3), half length, radius

MESH: Final = 5.0
"""Where its triangles begin, how many; where its tree, how many leaves; where its neighbours; 1 for a closed one."""

TRIANGLES, COUNT, TREE, LEAVES, NEIGHBOURS, CLOSED = range(GIVEN, GIVEN + 6)

TRIANGLE: Final = 12  # floats of a triangle: three corners, outward normal
NODE: Final = 6  # floats of a node of the tree: lower corner, upper corner

# -- the memory table
# --------------------------------------------------------------------------------------------------

AT: Final = 0  # where the proxy is: the centre of the tool (3) [m]
PLACED: Final = 3  # whether it has been placed: one of the following
# not yet; yes; beside another surface before; yes, but the device is lost
NEVER, ON, CARRIED, LOST = 0.0, 1.0, 2.0, 3.0
SLIDING: Final = 4  # 1 while it slides
TOUCHED: Final = 5  # how many surfaces it touches
ROUNDS: Final = 6  # rounds that the last call took
INSIDE: Final = 7  # how many shapes are not felt, because the tool began inside them
PROXY: Final = 8  # answer: the proxy (3) [m]
NORMAL: Final = 11  # answer: outward normal (3)
DISTANCE: Final = 14  # answer: signed distance along it, negative inside [m]
IN_CONTACT: Final = 15  # answer: 1 in contact
CONTACTS: Final = 16  # where what it touches begins: up to MOST entries of CONTACT floats
MOST: Final = 8
CONTACT: Final = 8  # floats of a contact: normal (3), gap [m], shape, triangle, multiplier [m]

GAP, SHAPE, FACE, SHARE = range(3, 7)

SEEN: Final = CONTACTS + MOST * CONTACT  # scratch: triangles seen by a search around a contact
PATCH: Final = 96  # how many triangles such a search looks at, at most
# scratch: where the proxy was (3) [m] and what it touched before it tried another triangle
BACK: Final = SEEN + PATCH
# nearest triangle of the last call, for each shape; behind them how each is felt:
LAST: Final = BACK + 3 + CONTACT
# as it is; not, until the tool is outside; held on to while it jumps (before placing)
FELT, UNFELT, HELD = 0.0, 1.0, 2.0
