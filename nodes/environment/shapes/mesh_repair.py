"""Repair of meshes of other programs: the order of the steps, and what was done as text.

Nothing is guessed: corners are joined within rounding only, and only where that closes an edge.
Holes are filled on request only, except where all of them are too narrow for a tool.
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
from nodes.environment.shapes.mesh_holes import lids, loops, shell_areas
from nodes.environment.shapes.mesh_shells import shell_turns
from nodes.environment.shapes.polygons import Coordinates, Ids
from nodes.environment.shapes.triangle_sets import lowest_heights

SLIVER = 1e-9  # height up to which a triangle is flat [m]
NARROW = 2e-5  # breadth up to which a hole has no room for the default tool [m]
_NARROW_EDGES = 100  # of such a hole
_ROUNDS = 4  # in which holes are filled: a lid may divide the next one
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
    "narrow": f"{{}} holes filled that are narrower than {NARROW:.0e} m",
    "holes": "{} holes filled",
    "pieces": "{} small loose pieces of sheets left out",
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
    corners: Coordinates,
    *,
    height: float = SLIVER,
    narrow: float = NARROW,
    widest: int = 0,
    part: float = 0.1,
) -> Repaired:
    """Repair triangles and return them with their edges paired.

    Parameters
    ----------
    corners : ndarray, shape (n, 3, 3)
        Corners of the triangles [m], finite.
    height : float
        Height up to which a triangle is flat [m].
    narrow : float
        Fill all holes if none is broader [m].
    widest : int
        Fill holes of at most that many edges; 0 fills none.
    part : float
        Fill holes of at most that breadth [of the width], and leave out loose pieces of sheets
        of at most that breadth whose area is at most that part of all.

    Returns
    -------
    Repaired
        Without triangles if none has an area.
    """
    limits = _Limits(height, narrow, widest, part)
    found = _repaired(corners, limits, False)
    pairs = found.counts["repeated"] or found.counts["t_joints"]
    if len(found.ids) and not found.is_solid and pairs:
        # One of two faces back to back may be of a seam, whose T-joint opened its edges.
        other = _repaired(corners, limits, True)
        if len(other.ids) and (other.partner < 0).sum() < (found.partner < 0).sum():
            return other
    return found


class _Limits(NamedTuple):
    """What is repaired: the parameters of `repair`."""

    height: float
    narrow: float
    widest: int
    part: float


class _Knitted(NamedTuple):
    """Triangles whose edges are paired."""

    ids: Ids
    partner: Ids
    disagreeing: int  # patches whose faces cannot agree about outside

    @property
    def is_closed(self) -> bool:
        """Whether every edge has a partner."""
        return bool((self.partner >= 0).all())


def _repaired(corners: Coordinates, limits: _Limits, no_pairs: bool) -> Repaired:
    """Repair triangles, without faces back to back, or with one of each where it closes."""
    height = limits.height
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
    mesh = _knit(points, ids, counts)
    if not mesh.is_closed:
        trial = counts.copy()
        full = _fill_narrow(points, mesh, limits.narrow, trial)
        if full.is_closed:
            mesh, counts = full, trial
        elif limits.widest:
            mesh = _fill_small(points, mesh, limits, width, counts)
    return _with_shells(points, *mesh, moved, counts)


def _fill_narrow(
    points: Coordinates, mesh: _Knitted, broadest: float, counts: Counts
) -> _Knitted:
    """Fill all holes if none is broader than that [m]; else return the mesh as it is."""
    full = mesh
    for _ in range(_ROUNDS):
        _, shell = shells_of(len(full.ids), full.partner)
        rim = loops(full.ids, rims(full.partner))
        found: list[Ids] = []
        for lid in lids(points, full.ids, shell, rim, _NARROW_EDGES):
            if lid.breadth > broadest or lid.is_piece:
                return mesh
            found.append(lid.ids)
        counts["narrow"] += len(found)
        # A lid stays though its corners may be those of a face: it is another wedge's.
        full = _knit_again(points, np.concatenate([full.ids, *found]), counts)
        if full.is_closed:
            return full
    return mesh


def _fill_small(
    points: Coordinates, mesh: _Knitted, limits: _Limits, width: float, counts: Counts
) -> _Knitted:
    """Fill small holes, and leave out small loose pieces of sheets."""
    broadest = limits.part * width
    for _ in range(_ROUNDS):
        _, shell = shells_of(len(mesh.ids), mesh.partner)
        rim = loops(mesh.ids, rims(mesh.partner))
        found = [
            lid
            for lid in lids(points, mesh.ids, shell, rim, limits.widest)
            if lid.breadth <= broadest
        ]
        pieces = np.unique([lid.shell for lid in found if lid.is_piece]).astype(int)
        areas = shell_areas(points, mesh.ids, shell)
        if areas[pieces].sum() > limits.part * areas.sum():
            pieces = pieces[:0]  # no loose pieces, but most of the mesh
        full = [
            lid.ids for lid in found if not lid.is_piece and lid.shell not in pieces
        ]
        if not full and not len(pieces):
            break
        trial = counts.copy()
        trial["holes"] += len(full)
        trial["pieces"] += len(pieces)
        ids = np.concatenate([mesh.ids[~np.isin(shell, pieces)], *full])
        # Copies are left out, as they will be when the closed mesh is read from its file.
        closer = _knit_again(points, drop_copies(ids, Counter()), trial)
        if (closer.partner < 0).sum() >= (mesh.partner < 0).sum():
            break
        mesh = closer
        counts.clear()
        counts.update(trial)
        if mesh.is_closed:
            break
    return mesh


def _knit_again(points: Coordinates, ids: Ids, counts: Counts) -> _Knitted:
    """Orient and pair triangles anew, with their lids."""
    counts["shared_edges"] = counts["slits"] = 0
    return _knit(points, ids, counts)


def _knit(points: Coordinates, ids: Ids, counts: Counts) -> _Knitted:
    """Orient and pair triangles."""
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
    return _Knitted(ids, partner, disagreeing)


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
