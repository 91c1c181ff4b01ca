"""Poles of two devices with their hands, coupled to each other: an independent oracle of nodes/stability/two_hands.py."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from nodes.stability.two_hands import TwoHands

T = 0.002  # sampling period [s]


def held(mass: float, damping: float, stiffness: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """One tick of m x'' + b x' + k x = u by the matrix exponential of scipy."""
    whole = np.zeros((3, 3))
    whole[0, 1], whole[1] = 1.0, (-stiffness / mass, -damping / mass, 1.0 / mass)
    found = expm(whole * T)
    return found[:2, :2], found[:2, 2]


def loop_radius(coupling: TwoHands, devices: tuple[tuple[float, float, float], ...]) -> float:
    """Largest pole of both devices with their hands, every delay a shift register; nothing of the module under test."""
    depth = max(max(row) for row in coupling.delays) + max(len(law.taps) for law in coupling.laws)
    size = 2 * (2 + depth)
    step = np.zeros((size, size))
    for side, (mass, damping, stiffness) in enumerate(devices):
        at = side * (2 + depth)
        transition, push = held(mass, damping, stiffness)
        step[at : at + 2, at : at + 2] = transition
        step[at + 2, at] = 1.0  # x of one tick ago, and so on
        for j in range(1, depth):
            step[at + 2 + j, at + 1 + j] = 1.0
        for other in (0, 1):
            sign = 1.0 if other == side else -1.0
            there = other * (2 + depth)
            delay = coupling.delays[side][other]
            for m, tap in enumerate(coupling.laws[side].taps):
                late = delay + m
                column = there if late == 0 else there + 1 + late
                step[at : at + 2, column] -= sign * tap * push
    return float(np.abs(np.linalg.eigvals(step)).max())
