"""Poles of two coupled devices with hands: oracle of sim/stability/two_hands.py."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from sim.stability.two_hands import TwoHands

T = 0.002  # sampling period [s]


def held(
    mass: float, damping: float, stiffness: float, share: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the map of a share of a tick of m x'' + b x' + k x = u, by scipy's expm."""
    whole = np.zeros((3, 3))
    whole[0, 1], whole[1] = 1.0, (-stiffness / mass, -damping / mass, 1.0 / mass)
    found = expm(whole * T * share)
    return found[:2, :2], found[:2, 2]


def loop_radius(
    coupling: TwoHands, devices: tuple[tuple[float, float, float], ...]
) -> float:
    """Return the largest pole of both devices with hands, delays as shift registers."""
    depth = (
        math.floor(max(max(row) for row in coupling.delays))
        + 1
        + max(len(law.taps) for law in coupling.laws)
    )
    size = 2 * (2 + depth)
    step = np.zeros((size, size))
    for side, (mass, damping, stiffness) in enumerate(devices):
        at = side * (2 + depth)
        transition, _ = held(mass, damping, stiffness, 1.0)
        step[at : at + 2, at : at + 2] = transition
        step[at + 2, at] = 1.0  # x of one tick ago, and so on
        for j in range(1, depth):
            step[at + 2 + j, at + 1 + j] = 1.0
        for other in (0, 1):
            sign = 1.0 if other == side else -1.0
            there = other * (2 + depth)
            delay = math.floor(coupling.delays[side][other])
            fraction = coupling.delays[side][other] - delay
            rest, newer = held(mass, damping, stiffness, 1.0 - fraction)
            older = rest @ held(mass, damping, stiffness, fraction)[1]
            for m, tap in enumerate(coupling.laws[side].taps):
                for late, push in ((delay + m, newer), (delay + m + 1, older)):
                    column = there if late == 0 else there + 1 + late
                    step[at : at + 2, column] -= sign * tap * push
    return float(np.abs(np.linalg.eigvals(step)).max())
