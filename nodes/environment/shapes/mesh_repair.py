"""Repair of meshes of other programs: the order of the steps, and what was done as text.

Nothing is guessed: corners are joined within rounding only, and only where that closes an edge.
Holes are filled on request only.
"""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np

from nodes.environment.shapes.mesh_edges import (
    Flags,
    first_of_equal,
    following,
    open_edges,
    orient,
    pair,
    rims,
    shells_of,
)
from nodes.environment.shapes.mesh_flaws import (
    Counts,
    RepairKind,
    drop_copies,
    join_open,
    remove_flat,
    split_t_joints,
)
from nodes.environment.shapes.mesh_holes import lids
from nodes.environment.shapes.mesh_shells import shell_turns
from nodes.environment.shapes.polygons import Coordinates, Ids
from nodes.environment.shapes.triangle_sets import lowest_heights

SLIVER = 1e-9  # height up to which a triangle is flat [m]
JOINS = (
    1e-8,
    1e-7,
    1e-6,
)  # distances within which corners are joined, in turn [of the width]

TEXTS: dict[RepairKind, str] = {
    "degenerate": "{} triangles of fewer than three corners left out",
    "repeated": "{} repeated triangles left out",
    "folded": "{} triangles back to back with another left out",
    "joined": "{} corners joined, up to {:.2g} m apart",
    "flat": "{} flat triangles removed",
    "t_joints": "{} T-joints split",
    "turned_faces": "{} faces turned to agree with their neighbours",
    "shared_edges": "{} edges of more than two triangles divided by angle",
    "slits": "{} slits of two edges closed",
    "turned_shells": "{} of {} shells pointed inwards and were flipped",
    "holes": "{} holes filled",
}


class Repaired(NamedTuple):
    """A mesh after its repair."""

    points: Coordinates  # corners, shape (m, 3)
    ids: Ids  # corners of each triangle, shape (n, 3)
    partner: Ids  # paired half-edge of each half-edge, −1 for none, shape (3 n,)
    shell: Ids  # shell of each triangle, shape (n,)
    closed: Flags  # which shells are closed
    cavity: Flags  # which shells are cavities of another
    disagreeing: int  # patches whose faces cannot agree about outside
    moved: float  # largest distance over which corners were joined [m]
    counts: Counts  # how often each repair was done

    @property
    def is_solid(self) -> bool:
        """Whether every edge is closed."""
        return bool(self.closed.all())

    def texts(self, scale: float = 1.0) -> list[str]:
        """Return the repairs as text, in their order; `scale` is in metres per unit."""
        found = []
        for kind, count in self.counts.items():
            if kind == "turned_shells" and len(self.closed) == 1:
                found.append("all faces pointed inwards and were flipped")
            elif count:
                more = self.moved * scale if kind == "joined" else len(self.closed)
                found.append(TEXTS[kind].format(count, more))
        return found


def repair(
    corners: Coordinates, *, height: float = SLIVER, widest: int = 0, part: float = 0.1
) -> Repaired:
    """Repair triangles and return them with their edges paired.

    Parameters
    ----------
    corners : ndarray, shape (n, 3, 3)
        Corners of the triangles [m], finite.
    height : float
        Height up to which a triangle is flat [m].
    widest : int
        Fill holes of at most that many edges; 0 fills none.
    part : float
        Fill holes of at most that part of the width.

    Returns
    -------
    Repaired
        Without triangles if none has an area.
    """
    found = _repaired(corners, height, widest, part, False)
    pairs = found.counts["repeated"] or found.counts["t_joints"]
    if len(found.ids) and not found.is_solid and pairs:
        # One of two faces back to back may be of a seam, whose T-joint opened its edges.
        other = _repaired(corners, height, widest, part, True)
        if len(other.ids) and (other.partner < 0).sum() < (found.partner < 0).sum():
            return other
    return found


def _repaired(
    corners: Coordinates, height: float, widest: int, part: float, no_pairs: bool
) -> Repaired:
    """Repair triangles, without faces back to back, or with one of each where it closes."""
    counts: Counts = Counter()
    places = corners.reshape(-1, 3) + 0.0  # −0.0 is 0.0
    first, which = first_of_equal(places)
    points = places[first]
    ids = which.reshape(-1, 3)
    width = float(np.ptp(points, axis=0).max())
    raw, dropped, moved, joined = ids, Counter(counts), 0.0, 0
    ids = base = drop_copies(raw, dropped, no_pairs)
    for join in JOINS:
        if not len(ids) or not len(open_edges(ids)):
            break
        # Not in addition to a smaller distance, which may have joined half of a face's corners.
        trial: Counts = Counter()
        to, count, apart = join_open(points, base, join * width)
        new = drop_copies(to[raw], trial, no_pairs)
        if count and len(open_edges(new)) < len(open_edges(ids)):
            ids, dropped, moved, joined = new, trial, apart, count
    counts["joined"] += joined
    counts.update(dropped)
    if len(ids) and lowest_heights(points[ids])[0].min() <= height:
        ids = remove_flat(points, ids, height, counts)
    if len(ids):
        whole = ids
        ids = split_t_joints(points, ids, JOINS[-1] * width, counts, no_pairs)
        if ids is not whole:
            ids = remove_flat(points, ids, height, counts)
    if not len(ids):
        none = np.zeros(0, dtype=np.int64)
        flags = np.zeros(0, dtype=bool)
        return Repaired(points, ids, none, none, flags, flags, 0, moved, counts)
    ids, partner, disagreeing = _knit(points, ids, counts)
    if widest and (partner < 0).any():
        added = lids(points, ids, rims(partner), widest, part * width)
        if added:
            counts["holes"] += len(added)
            ids = drop_copies(np.concatenate([ids, *added]), counts, no_pairs)
            ids = remove_flat(points, ids, height, counts)
            counts["shared_edges"] = 0
            ids, partner, disagreeing = _knit(points, ids, counts)
    return _with_shells(points, ids, partner, disagreeing, moved, counts)


def _knit(points: Coordinates, ids: Ids, counts: Counts) -> tuple[Ids, Ids, int]:
    """Orient and pair triangles; the triangles, partners and patches that cannot agree."""
    ids, turned, disagreeing = orient(ids)
    partner, shared = pair(points, ids)
    if turned:
        counts["turned_faces"] += turned
    if shared:
        counts["shared_edges"] += shared
    if (partner < 0).any():
        slits = [rim for rim in rims(partner) if len(rim) == 2 and _is_slit(ids, rim)]
        for one, other in slits:
            partner[one], partner[other] = other, one
        if slits:
            counts["slits"] += len(slits)
    return ids, partner, disagreeing


def _is_slit(ids: Ids, rim: list[int]) -> bool:
    start = ids.ravel()[rim]
    end = ids.ravel()[[int(following(half)) for half in rim]]
    return bool(start[0] == end[1] and start[1] == end[0])


def _with_shells(
    points: Coordinates,
    ids: Ids,
    partner: Ids,
    disagreeing: int,
    moved: float,
    counts: Counts,
) -> Repaired:
    count, shell = shells_of(len(ids), partner)
    has_gap = np.bincount(
        shell, (partner.reshape(-1, 3) < 0).any(axis=1), minlength=count
    )
    closed = has_gap == 0
    turns = shell_turns(points[ids], shell, closed)
    if turns.turn.any():
        counts["turned_shells"] += int(turns.turn.sum())
        flip = turns.turn[shell]
        ids = ids.copy()
        partner = partner.copy()
        ids[flip] = ids[flip][:, ::-1]
        # A turned triangle's edges 0 and 1 change places.
        moved_half = np.arange(len(partner)).reshape(-1, 3)
        moved_half[flip] = moved_half[flip][:, [1, 0, 2]]
        partner = partner[moved_half.ravel()]
        known = partner >= 0
        partner[known] = moved_half.ravel()[partner[known]]
    return Repaired(
        points, ids, partner, shell, closed, turns.cavity, disagreeing, moved, counts
    )
