"""The loop of a device in a force field, exact: several axes that the field couples.

On a device that is the same along all axes a field F = −R v, v the way of a tick over T, and a law
that acts on all axes or on none share their eigenvectors: each eigenvalue of R is a loop of one
axis, complex where the field turns. A curl of B in a plane is the damping iB of x + iy. Where the
law acts along one normal only, on a surface without friction, the axes are coupled.

A direction that no spring holds has its way per tick as a state in place of its position, so that
it has no pole at z = 1: a pole inside the unit circle means that motion there decays.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.stability.judge import MARGINAL, Verdict
from nodes.stability.plant import Plant, held_step

# taps above which a law is not judged in a field: its matrix takes seconds
LONGEST = 400
_ANGLES = 12  # normals in a plane
_ROUNDING = 1e-12  # part of a field that rounding makes

Square = NDArray[Any]  # real or complex


def field_matrix(
    law: CompiledLaw, plant: Plant, touched: Sequence[bool], resistance: Square
) -> Square:
    """Return one tick of a device in a field as a matrix.

    Parameters
    ----------
    law : CompiledLaw
        The law, without code of its own.
    plant : Plant
        Device along each axis, hand and delay; without a partner.
    touched : sequence of bool, shape (n,)
        Whether the law acts along an axis.
    resistance : ndarray, shape (n, n)
        R of the field F = −R v [N s/m], real or complex.

    Returns
    -------
    ndarray
        Of the state per axis: x or the way of the last tick, v T, earlier x, two per section,
        earlier forces (scaled to lengths by T²/m).
    """
    whole, (a11, a12, a21, a22), new, old = held_step(plant)
    period = plant.period
    unit = plant.period**2 / plant.mass
    pushes = [(whole, new), (whole + 1, old)] if any(old) else [(whole, new)]
    lags = pushes[-1][0]
    history = max(len(law.taps) - 1, 1)
    sizes = [
        2 + (history + 2 * len(law.sections) if felt else int(plant.anchored)) + lags
        for felt in touched
    ]
    starts = np.concatenate([[0], np.cumsum(sizes)])
    size = starts[-1]
    step = np.zeros((size, size), dtype=resistance.dtype)
    ways = np.zeros((len(touched), size))
    forces = np.zeros((len(touched), size), dtype=resistance.dtype)
    for i, felt in enumerate(touched):
        o = starts[i]
        step[o : o + 2, o : o + 2] = [[a11, a12 / period], [a21 * period, a22]]
        ways[i, o] = 1.0
        if not felt and not plant.anchored:
            step[o, o] = 0.0
            continue
        ways[i, o + 2] = -1.0
        step[o + 2, o] = 1.0
        if not felt:
            continue
        forces[i, o] -= law.taps[0] * unit
        forces[i, o + 2 : o + 1 + len(law.taps)] -= np.array(law.taps[1:]) * unit
        for k in range(1, history):
            step[o + 2 + k, o + 1 + k] = 1.0
        for n, (b0, b1, a1, a2) in enumerate(law.sections):
            row = o + 2 + history + 2 * n
            step[row, [o, o + 2]] = b0 * unit, b1 * unit
            step[row, row : row + 2] = -a1, -a2
            step[row + 1, row] = 1.0
            forces[i] -= step[row]
    forces -= unit / period * (resistance @ ways)
    for i in range(len(touched)):
        o = starts[i]
        first = starts[i + 1] - lags
        for lag, (by_place, by_speed) in pushes:
            push = np.array([by_place, by_speed * period]) / unit
            if lag == 0:
                step[o : o + 2] += np.outer(push, forces[i])
            else:
                step[o : o + 2, first + lag - 1] += push
        for k in range(lags):
            if k == 0:
                step[first] = forces[i]
            else:
                step[first + k, first + k - 1] = 1.0
    return step


def judge_in_field(
    law: CompiledLaw,
    plant: Plant,
    resistance: NDArray[np.float64],
    springless: bool = False,
) -> Verdict | None:
    """Return the worst verdict on a law in a field; its `felt` says in which motion.

    Free motion, a surface that holds the device on all axes (friction, an anchor), and surfaces
    without friction of some normals.

    Parameters
    ----------
    law : CompiledLaw
        The law.
    plant : Plant
        The device.
    resistance : ndarray, shape (n, n)
        R of the field F = −R v along the computed axes [N s/m].
    springless : bool
        Whether the law has no stiffness at rest, but for rounding.

    Returns
    -------
    Verdict or None
        None for a law with code of its own or of more than `LONGEST` taps, a plant with a partner,
        and a field without velocity.
    """
    is_long = len(law.taps) > LONGEST
    if law.evaluate is not None or is_long or plant.partner is not None:
        return None
    found = []
    for text, touched, turned in _motions(resistance):
        try:
            step = field_matrix(law, plant, touched, turned)
            radius = float(np.abs(np.linalg.eigvals(step)).max())
        except (ArithmeticError, np.linalg.LinAlgError):
            radius = np.inf  # a loop that overflows
        loose = any(touched) and (springless or law.h1 == 0.0)
        neutral = (loose or plant.damping == 0.0) and not plant.anchored
        limit = 1.0 + (MARGINAL if neutral and len(touched) + loose > 1 else 0.0)
        found.append(Verdict(radius, plant, radius < limit, text))
    unstable = [one for one in found if not one.stable]
    return max(unstable or found, key=lambda one: one.pole_radius, default=None)


def _motions(
    resistance: NDArray[np.float64],
) -> Iterator[tuple[str, tuple[bool, ...], Square]]:
    """Yield motions in words, whether the law acts along each axis, and R in these axes."""
    if not resistance.any():
        return
    for value in np.linalg.eigvals(resistance):
        # Of two conjugate loops one says all.
        if value == 0.0 or np.imag(value) < 0.0:
            continue
        alone = np.array([[value]])
        yield "in free motion", (False,), alone
        yield "held on all axes", (True,), alone
    n = len(resistance)
    if n == 1:
        return
    for normal in _normals(n, resistance):
        basis, _ = np.linalg.qr(np.column_stack([normal, np.eye(n)]))
        words = ", ".join(f"{value:.2g}" for value in normal)
        touched = (True,) + (False,) * (n - 1)
        yield (
            f"sliding on a surface of normal [{words}]",
            touched,
            basis.T @ resistance @ basis,
        )


def _normals(n: int, resistance: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return the directions of a surface that are judged; one where all are equal."""
    if n == 2:
        (a, b), (c, d) = resistance
        if (a, b) == (d, -c):
            return [np.array([1.0, 0.0])]
        angles = np.arange(_ANGLES) * np.pi / _ANGLES
        turned = [np.array([np.cos(angle), np.sin(angle)]) for angle in angles]
        return turned + _steepest(resistance)
    if (resistance == resistance[0, 0] * np.eye(n)).all():
        return [np.eye(n)[0]]
    signs = product((-1, 0, 1), repeat=n)
    whole = [np.array(one, float) for one in signs if any(one)]
    turned = [one / np.linalg.norm(one) for one in whole[len(whole) // 2 :]]
    return turned + _steepest(resistance)


def _steepest(resistance: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Return normals of surfaces along which a field drives or brakes most.

    Along u, an eigenvector of (R + Rᵀ)/2, the field is extreme. On the surface whose normal is the
    part of R u, or Rᵀ u, across u, that u is a motion of its own.
    """
    found = []
    for u in np.linalg.eigh(0.5 * (resistance + resistance.T))[1].T:
        for pull in (resistance @ u, resistance.T @ u):
            across = pull - (u @ pull) * u
            size = np.linalg.norm(across)
            # Below rounding, u is an eigenvector: judged in free motion.
            if size > _ROUNDING * np.linalg.norm(resistance):
                found.append(across / size)
    return found
