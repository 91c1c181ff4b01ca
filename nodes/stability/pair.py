"""Two bodies at the ends of one coupling, exact: a device and a tool, or two devices.

The law sees their distance x = x₁ − x₂; its force acts on the first body and, negated, on the
second, each held and late by its own delay. One tick is one matrix of 4 states, or of 3 if no
spring ties either body to ground: then their common position does not matter and would be a
permanent pole at z = 1.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nodes.stability.plant import Plant, held_step


def as_one(plant: Plant) -> Plant:
    """Return a pair that moves like one mass as that mass, any other plant unchanged.

    Two undamped bodies, free and pushed at the same instants, conserve momentum: their distance
    moves like m₁ m₂/(m₁ + m₂).
    """
    partner = plant.partner
    if (
        partner is None
        or plant.anchored
        or plant.damping
        or partner.damping
        or partner.later
    ):
        return plant
    return replace(
        plant,
        mass=plant.mass * partner.mass / (plant.mass + partner.mass),
        partner=None,
    )


def reduced_mass(plant: Plant) -> float:
    """Return the mass with which the distance moves right after a push [kg]."""
    return (
        plant.mass
        if plant.partner is None
        else plant.mass * plant.partner.mass / (plant.mass + plant.partner.mass)
    )


def held_pair(
    plant: Plant,
) -> tuple[NDArray[np.float64], list[tuple[int, NDArray[np.float64]]]]:
    """Return one tick of two bodies.

    Parameters
    ----------
    plant : Plant
        With a partner.

    Returns
    -------
    matrix : ndarray, shape (s, s)
        Of the state [x, v₁ T, v₂ T], plus x₂ if a spring ties one of them to ground; lengths [m].
    pushes : list of (int, ndarray)
        Age of a force [ticks] and its effect on the state [m/N].
    """
    other = plant.other
    if other is None:
        raise ValueError("plant: has no partner")
    step = np.zeros((4, 4))
    pushes = []
    for first, one, sign in ((0, plant, 1.0), (2, other, -1.0)):
        whole, (a11, a12, a21, a22), new, old = held_step(
            replace(one, delay=one.delay, partner=None)
        )
        step[first : first + 2, first : first + 2] = [
            [a11, a12 / plant.period],
            [a21 * plant.period, a22],
        ]
        for lag, push in ((whole, new), (whole + 1, old)):
            if any(push):
                vector = np.zeros(4)
                vector[first : first + 2] = (
                    sign * push[0],
                    sign * push[1] * plant.period,
                )
                pushes.append((lag, vector))
    # From [x₁, v₁, x₂, v₂] to [x₁ − x₂, v₁, v₂, x₂].
    to = np.array(
        [
            [1.0, 0.0, -1.0, 0.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )
    back = np.array(
        [
            [1.0, 0.0, 0.0, 1.0],
            [0.0, 1.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 1.0],
            [0.0, 0.0, 1.0, 0.0],
        ]
    )
    states = 4 if plant.anchored else 3
    return (to @ step @ back)[:states, :states], [
        (lag, (to @ vector)[:states]) for lag, vector in pushes
    ]
