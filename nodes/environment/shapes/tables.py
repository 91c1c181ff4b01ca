"""What stands where in the two tables of floats that the geometry works on.

The *scene* table holds all shapes and never changes while it is touched. The *memory* table holds where the proxy was, what
it touched, and the answer of the last call. Both are flat, so that interpreted code reads lists and compiled code reads
arrays, from one source. All lengths are in metres.
"""

from __future__ import annotations

from typing import Final

SKIN: Final = 1e-10
"""Height above a surface at which the proxy rests [m], so that rounding never puts it inside."""

TOLERANCE: Final = SKIN / 4.0
"""How deep a path must lead under that height before it counts as a hit [m]."""

TOUCH: Final = 2.0 * TOLERANCE
"""Distance from that height within which a surface counts as touched [m]."""

LIP: Final = 1e-9
"""How far a triangle reaches over its edges, so that nothing slips between two of them [m]."""

# -- the scene table ---------------------------------------------------------------------------------------------------

SHAPES: Final = 0
"""Number of shapes."""

RADIUS: Final = 1
"""Radius of the tool, with the skin [m]."""

PERIOD: Final = 2
"""Time between two calls [s]."""

ROWS: Final = 4
"""Where the first shape stands; each takes ROW floats."""

ROW: Final = 24

KIND: Final = 0
STATIC: Final = 1
"""Coefficient of friction up to which the proxy sticks."""

DYNAMIC: Final = 2
"""Coefficient of friction while it slides."""

VISCOUS: Final = 3
"""Time by which a sliding proxy trails [s]: viscous friction over the coupling's stiffness."""

GIVEN: Final = 4
"""Where the parameters of the kind begin."""

PLANE: Final = 0.0
"""Point (3), outward normal (3)."""

SPHERE: Final = 1.0
"""Centre (3), radius."""

BOX: Final = 2.0
"""Centre (3), the three axes (9), half sizes (3)."""

CAPSULE: Final = 3.0
"""One end of the axis (3), direction (3), length, radius."""

CYLINDER: Final = 4.0
"""Centre (3), direction (3), half length, radius."""

MESH: Final = 5.0
"""Where its triangles begin, how many; where its tree, how many leaves; where its neighbours; 1 for a closed one."""

TRIANGLES: Final = GIVEN
COUNT: Final = GIVEN + 1
TREE: Final = GIVEN + 2
LEAVES: Final = GIVEN + 3
NEIGHBOURS: Final = GIVEN + 4
CLOSED: Final = GIVEN + 5

TRIANGLE: Final = 12
"""Floats of a triangle: three corners, outward normal."""

NODE: Final = 6
"""Floats of a node of the tree: lower corner, upper corner."""

# -- the memory table --------------------------------------------------------------------------------------------------

AT: Final = 0
"""Where the proxy is: the centre of the tool (3) [m]."""

PLACED: Final = 3
"""1 once it has been placed."""

SLIDING: Final = 4
"""1 while it slides."""

TOUCHED: Final = 5
"""How many surfaces it touches."""

ROUNDS: Final = 6
"""Rounds that the last call took."""

PROXY: Final = 8
"""Answer: the proxy (3) [m]."""

NORMAL: Final = 11
"""Answer: outward normal (3)."""

DISTANCE: Final = 14
"""Answer: signed distance along it, negative inside [m]."""

IN_CONTACT: Final = 15
"""Answer: 1 in contact."""

CONTACTS: Final = 16
"""Where what it touches begins: up to MOST entries of CONTACT floats."""

MOST: Final = 8

CONTACT: Final = 8
"""Floats of a contact: normal (3), gap [m], shape, triangle, multiplier [m]."""

GAP: Final = 3
SHAPE: Final = 4
FACE: Final = 5
SHARE: Final = 6

SEEN: Final = CONTACTS + MOST * CONTACT
"""Scratch: triangles seen by a search around a contact."""

PATCH: Final = 96
"""How many triangles such a search looks at, at most."""

BACK: Final = SEEN + PATCH
"""Scratch: where the proxy was (3) [m] and what it touched before it tried another triangle."""

LAST: Final = BACK + 3 + CONTACT
"""Nearest triangle of the last call, for each shape."""


def memory_size(shapes: int) -> int:
    """Count the floats that a proxy on so many shapes remembers."""
    return LAST + shapes
