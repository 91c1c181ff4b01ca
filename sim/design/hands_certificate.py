"""A certificate that a loop is stable for every hand of a box, however it changes."""

import itertools
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from nodes.laws import CompiledLaw
from nodes.stability.closed_loop import tick_matrix
from nodes.stability.plant import Plant
from sim.arrays import Array
from sim.design.hand_box import HandBox
from sim.stability.every_delay import Certificate

CELLS = 200_000  # maximum cells of a certificate: about 20 s
_BATCH = 2048  # cells checked at once


def certify_box(
    law: CompiledLaw, plant: Plant, box: HandBox, most: int = CELLS
) -> tuple[Certificate, int]:
    """Prove stability for every grasp of a box, cell by cell.

    Return whether `most` cells suffice, and the number of cells.
    """
    ticks = GraspTicks(law, plant)
    # With 1/mass as coordinate, the generator of a tick is linear in each of the three parameters,
    # so the hull of a cell's corners contains it.
    waiting = np.array(
        [((1.0 / box.mass[1], 1.0 / box.mass[0]), box.stiffness, box.damping)]
    )
    cells = 0
    while len(waiting):
        # Depth first: proven cells free memory, and a box that cannot be proven fails early at one
        # of its corners.
        batch, waiting = waiting[-_BATCH:], waiting[:-_BATCH]
        cells += len(batch)
        if cells > most:
            return Certificate.UNDECIDED, cells
        waiting = np.concatenate([waiting, ticks.halved(batch[~ticks.shrink(batch)])])
    return Certificate.CERTIFIED, cells


class GraspTicks:
    """Matrices of a tick for the grasps of many cells at once.

    The state is in lengths: position and velocity·T of device and hand. Cells are limits of 1/mass,
    stiffness and damping, shape (c, 3, 2).
    """

    def __init__(self, law: CompiledLaw, plant: Plant) -> None:
        self._plant = plant
        fraction = plant.delay - math.floor(plant.delay)
        self._durations = (fraction, 1.0 - fraction)
        unit = plant.period**2 / plant.mass
        none = np.zeros(4)
        flat = np.zeros((4, 4))
        whole = math.floor(plant.delay)

        def loop(new: Array, old: Array) -> Array:
            return tick_matrix(law, unit, flat, [(whole, new), (whole + 1, old)])

        # The loop's matrix is the shift of the delay line, plus the motion, plus the effect of the
        # two acting forces, each with its own row.
        first = np.array([unit, 0.0, 0.0, 0.0])
        self._shift = loop(none, none)
        self._newer = (loop(first, none) - self._shift)[0]
        self._older = (loop(none, first) - self._shift)[0]
        generator = np.zeros((5, 5))
        generator[0, 1] = generator[2, 3] = generator[1, 4] = 1.0
        generator[1, 0] = -plant.stiffness / plant.mass * plant.period**2
        generator[1, 1] = -plant.damping / plant.mass * plant.period
        self._alone = generator

    def _numbers(self, grasps: Array) -> Array:
        """Return spring and damper over the device's mass, then over the hand's, per tick.

        Shapes: (..., 4) from (..., 3).
        """
        period = self._plant.period
        own = 1.0 / self._plant.mass
        inverse, stiffness, damping = np.moveaxis(grasps, -1, 0)
        spring = stiffness * period**2
        damper = damping * period
        return np.stack(
            [spring * own, damper * own, spring * inverse, damper * inverse], axis=-1
        )

    def _motion(
        self, generator: Array, change: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Return the motion over a tick: free, from the newer force and from the older force.

        Shapes: (c, 4, 4), (c, 4), (c, 4). With a `change` of the generator, return its first-order
        effect, taken from the exponential of a block matrix that holds it beside the exponential
        itself.
        """
        if change is None:
            early, late = (_exponential(generator * share) for share in self._durations)
            return _joined(early, late)
        blocks = np.zeros((len(generator), 10, 10))
        blocks[:, :5, :5] = blocks[:, 5:, 5:] = generator
        blocks[:, :5, 5:] = change
        early, late = (_exponential(blocks * share) for share in self._durations)
        return _joined(
            early[:, :5, 5:], late[:, :5, :5], late[:, :5, 5:], early[:, :5, :5]
        )

    def _loop(self, motion: tuple[Array, Array, Array], moving: bool) -> Array:
        """Insert motions into the loop's matrix; `moving`: without the shift, for a derivative."""
        step, new, old = motion
        matrix = (
            np.zeros((len(step), *self._shift.shape))
            if moving
            else np.repeat(self._shift[None], len(step), axis=0)
        )
        matrix[:, :4, :4] += step
        matrix[:, :4] += new[:, :, None] * self._newer + old[:, :, None] * self._older
        return matrix

    def _bound(self, motion: tuple[Array, Array, Array]) -> Array:
        """Bound the loop's matrix for a motion of which only the modulus is known."""
        step, new, old = motion
        matrix = np.zeros((len(step), *self._shift.shape))
        matrix[:, :4, :4] += step
        matrix[:, :4] += new[:, :, None] * np.abs(self._newer) + old[
            :, :, None
        ] * np.abs(self._older)
        return matrix

    def radii(self, grasps: Array) -> Array:
        """Return the pole radius of each grasp (mass, stiffness, damping), shape (g, 3)."""
        numbers = self._numbers(np.column_stack([1.0 / grasps[:, 0], grasps[:, 1:]]))
        generator = self._alone + np.einsum("ck,kij->cij", numbers, _PARTS)
        poles = np.linalg.eigvals(self._loop(self._motion(generator), moving=False))
        return np.asarray(np.abs(poles).max(axis=1), dtype=np.float64)

    def shrink(self, cells: Array) -> NDArray[np.bool_]:
        """Check that all ticks of each cell contract in the norm of the cell's centre."""
        middles = self._numbers(cells.mean(axis=2))
        generator = self._alone + np.einsum("ck,kij->cij", middles, _PARTS)
        matrix = self._loop(self._motion(generator), moving=False)
        radius = np.abs(np.linalg.eigvals(matrix)).max(axis=1)
        sure = radius < 1.0 - 1e-9
        scale = np.where(sure, 0.5 * (1.0 + radius), 2.0 * radius)
        norm = _norms(matrix / scale[:, None, None])
        inverse = np.linalg.inv(norm)
        slopes = [
            self._loop(
                self._motion(generator, np.broadcast_to(part, generator.shape)),
                moving=True,
            )
            for part in _PARTS
        ]
        which = np.array(list(itertools.product((0, 1), repeat=3)))
        corners = self._numbers(cells[:, np.arange(3), which]) - middles[:, None]
        moved = matrix[:, None] + np.einsum("cnk,kcij->cnij", corners, np.array(slopes))
        largest = np.linalg.norm(
            norm[:, None] @ moved @ inverse[:, None], ord=2, axis=(2, 3)
        ).max(axis=1)
        # Beyond first order: bounded entry by entry by the series with all signs positive.
        size = np.abs(generator)
        change = np.einsum("ck,kij->cij", np.abs(corners).max(axis=1), np.abs(_PARTS))
        with np.errstate(over="ignore", invalid="ignore"):
            both = self._motion(size + change)
            own = self._motion(size)
            linear = self._motion(size, change)
            beyond = [
                np.maximum(a - b - c, 0.0) + _SERIES * (1.0 + a)
                for a, b, c in zip(both, own, linear, strict=True)
            ]
            rest = (
                np.abs(norm)
                @ self._bound((beyond[0], beyond[1], beyond[2]))
                @ np.abs(inverse)
            )
        # For a stiff and light grasp the bound overflows a double: no proof.
        known = np.isfinite(rest).all(axis=(1, 2))
        rest[~known] = 0.0
        return np.asarray(
            sure
            & known
            & (largest + np.linalg.norm(rest, ord=2, axis=(1, 2)) < 1.0 - 1e-9)
        )

    def halved(self, cells: Array) -> Array:
        """Cut each cell in two across the side that changes a tick most."""
        if not len(cells):
            return cells
        spans = []
        for i in range(3):
            ends = np.repeat(cells.mean(axis=2)[:, None], 2, axis=1)
            ends[:, :, i] = cells[:, i]
            numbers = self._numbers(ends)
            spans.append(np.abs(numbers[:, 1] - numbers[:, 0]).sum(axis=1))
        widest = np.argmax(spans, axis=0)
        every = np.arange(len(cells))
        low = cells.copy()
        high = cells.copy()
        low[every, widest, 1] = high[every, widest, 0] = cells[every, widest].mean(
            axis=1
        )
        return np.concatenate([low, high])


# truncation error of a series of `_TERMS` terms plus rounding, relative to a motion
_SERIES = 1e-11
_TERMS = 20  # terms for a generator with a norm of at most 1


def _exponential(matrix: Array) -> Array:
    """Return the exponential of many small matrices by scaling and squaring.

    The generator of a stiff grasp has a norm far above 1, where the series alone fails.
    """
    largest = float(np.abs(matrix).sum(axis=2).max(initial=0.0))
    halvings = max(0, math.ceil(math.log2(largest))) if largest > 1.0 else 0
    small = matrix / 2.0**halvings
    total = np.repeat(np.eye(matrix.shape[1])[None], len(matrix), axis=0)
    for k in range(_TERMS, 0, -1):
        total = np.eye(matrix.shape[1]) + small @ total / k
    for _ in range(halvings):
        total = total @ total
    return total


def _joined(
    early: Array,
    late: Array,
    late_moved: Array | None = None,
    early_still: Array | None = None,
) -> tuple[Array, Array, Array]:
    """Join the motions before and after the force arrives.

    With the derivatives (`early`, `late_moved`) given, return the derivative of the joint motion.
    """
    step = late[:, :4, :4] @ early[:, :4, :4]
    old = (late[:, :4, :4] @ early[:, :4, 4:])[:, :, 0]
    if late_moved is None or early_still is None:
        return step, late[:, :4, 4], old
    step = step + late_moved[:, :4, :4] @ early_still[:, :4, :4]
    old = old + (late_moved[:, :4, :4] @ early_still[:, :4, 4:])[:, :, 0]
    return step, late_moved[:, :4, 4], old


def _norms(matrix: Array) -> Array:
    """Return norms L in which matrices of radius below 1 contract: L'L = Σ A'^k A^k.

    The sum is computed by doubling.
    """
    gram = np.repeat(np.eye(matrix.shape[1])[None], len(matrix), axis=0)
    power = matrix
    for _ in range(24):
        moved = np.swapaxes(power, 1, 2) @ gram @ power
        gram = gram + moved
        power = power @ power
        if (
            float(
                (np.abs(moved).max(axis=(1, 2)) / np.abs(gram).max(axis=(1, 2))).max()
            )
            < 1e-12
        ):
            break
    return np.asarray(np.swapaxes(np.linalg.cholesky(gram), 1, 2), dtype=np.float64)


def _parts() -> Iterator[Array]:
    """Yield the effect of spring and damper on the generator, by the row they act on."""
    for row, sign in ((1, -1.0), (3, 1.0)):
        for column in (0, 1):
            part = np.zeros((5, 5))
            part[row, column], part[row, column + 2] = sign, -sign
            yield part


_PARTS = np.array(list(_parts()))
