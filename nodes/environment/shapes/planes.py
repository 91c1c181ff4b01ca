"""The proxy's step between up to eight planes: a quadratic programme, solved exactly."""

from __future__ import annotations

from messages.types import Vector
from nodes.environment.shapes.tables import CONTACT, CONTACTS, GAP, SHARE, Memory

_FLAT = 1e-14
_SLACK = 1e-13


def step_between(memory: Memory, count: int, vx: float, vy: float, vz: float) -> Vector:
    """Return the step nearest to a wanted one that stays on the free side of all planes.

    It is the v that minimises |step − v|² subject to n·step ≥ −gap for each plane. In three
    dimensions at most three planes are active, so each one, pair and triple is tried, and the first
    that satisfies the conditions of Karush, Kuhn and Tucker is the answer. The multipliers, which
    are the normal parts of the deflection [m], are written beside the planes.
    """
    best = 1e300
    bi = -1
    bj = -1
    bk = -1
    for size in range(4):
        if best <= _SLACK or count < size:
            break
        # Empty loops run once with −1, so that each function is called at one place, where numba
        # inlines it.
        for i in range(-1 if size < 1 else 0, 0 if size < 1 else count):
            for j in range(-1 if size < 2 else i + 1, 0 if size < 2 else count):
                for k in range(-1 if size < 3 else j + 1, 0 if size < 3 else count):
                    sx, sy, sz = _against(memory, vx, vy, vz, i, j, k)
                    if _all_push(memory, i, j, k):
                        worst = -1e300
                        for n in range(count):
                            worst = max(worst, _needs(memory, n, sx, sy, sz))
                        if worst < best:
                            best, bi, bj, bk = worst, i, j, k
    for n in range(count):
        memory[CONTACTS + CONTACT * n + SHARE] = 0.0
    return _against(memory, vx, vy, vz, bi, bj, bk)


def _needs(memory: Memory, i: int, vx: float, vy: float, vz: float) -> float:
    """Return the depth of a step behind a plane [m]."""
    at = CONTACTS + CONTACT * i
    return -memory[at + GAP] - (
        memory[at] * vx + memory[at + 1] * vy + memory[at + 2] * vz
    )


def _all_push(memory: Memory, i: int, j: int, k: int) -> bool:
    return (
        (i < 0 or memory[CONTACTS + CONTACT * i + SHARE] > 0.0)
        and (j < 0 or memory[CONTACTS + CONTACT * j + SHARE] > 0.0)
        and (k < 0 or memory[CONTACTS + CONTACT * k + SHARE] > 0.0)
    )


def _dot(memory: Memory, i: int, j: int) -> float:
    a = CONTACTS + CONTACT * i
    b = CONTACTS + CONTACT * j
    return (
        memory[a] * memory[b]
        + memory[a + 1] * memory[b + 1]
        + memory[a + 2] * memory[b + 2]
    )


def _against(
    memory: Memory, vx: float, vy: float, vz: float, i: int, j: int, k: int
) -> Vector:
    """Project a step on up to three planes (−1: none) and write their multipliers.

    The multipliers are 0 if the planes are almost parallel.
    """
    if i < 0:
        return vx, vy, vz
    a = _needs(memory, i, vx, vy, vz)
    b = c = 0.0
    if j >= 0:
        g = _dot(memory, i, j)
        nj = _needs(memory, j, vx, vy, vz)
        if k < 0:
            whole = 1.0 - g * g
            if whole > _FLAT:
                a, b = (a - g * nj) / whole, (nj - g * a) / whole
            else:
                a = b = 0.0
        else:
            h, m, nk = (
                _dot(memory, i, k),
                _dot(memory, j, k),
                _needs(memory, k, vx, vy, vz),
            )
            whole = 1.0 + 2.0 * g * h * m - g * g - h * h - m * m
            if whole > _FLAT:
                a, b, c = (
                    (a * (1.0 - m * m) + nj * (h * m - g) + nk * (g * m - h)) / whole,
                    (a * (h * m - g) + nj * (1.0 - h * h) + nk * (g * h - m)) / whole,
                    (a * (g * m - h) + nj * (g * h - m) + nk * (1.0 - g * g)) / whole,
                )
            else:
                a = b = c = 0.0
    for n, part in ((i, a), (j, b), (k, c)):
        if n >= 0:
            p = CONTACTS + CONTACT * n
            memory[p + SHARE] = part
            vx, vy, vz = (
                vx + part * memory[p],
                vy + part * memory[p + 1],
                vz + part * memory[p + 2],
            )
    return vx, vy, vz
