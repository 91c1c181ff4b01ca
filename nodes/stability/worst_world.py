"""The worst world for a law on a known device: one that oscillates just above the limit.

At the edge of "any world that answers in the same tick" the response of law and device is purely
imaginary at one frequency. A lossless mass or spring has the opposite response there, so it puts a
pole on the unit circle: the certificate is necessary, not only sufficient (THEORY.md §18).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.k_max import with_spring
from nodes.stability.loop_region import known_answer
from nodes.stability.plant import Plant
from nodes.stability.world_loop import Body
from nodes.stability.worlds import AnyWorld, world_k_max


@dataclass(frozen=True)
class WorstWorld:
    """A body that oscillates just above `k_max_n_per_m` and comes to rest just below."""

    mass_kg: float | None
    stiffness_n_per_m: float | None
    damping_n_s_per_m: float | None
    frequency_hz: float  # frequency of the oscillation [Hz]
    integrator: str  # integrator of the body (`nodes.stability.world_loop.Body`)
    k_max_n_per_m: float  # the edge [N/m]

    @property
    def text(self) -> str:
        """Description of the body and its oscillation."""
        what = (
            f"a mass of {self.mass_kg:.4g} kg"
            if self.mass_kg
            else f"a spring of {self.stiffness_n_per_m:.5g} N/m"
        )
        return (
            f"{what} ({self.integrator}), swings at {self.frequency_hz:.4g} Hz above"
            f" {self.k_max_n_per_m:.6g} N/m"
        )

    @property
    def body(self) -> Body:
        """The body."""
        return Body(
            self.mass_kg or 0.0,
            self.damping_n_s_per_m or 0.0,
            self.stiffness_n_per_m or 0.0,
            "lossless",
        )


def worst_world(derivative: CompiledLaw, plant: Plant) -> WorstWorld | None:
    """Return the worst world that answers in the same tick, at the edge of all of them.

    Parameters
    ----------
    derivative : CompiledLaw
        The law without its spring (`nodes.stability.k_max.without_spring`).
    plant : Plant
        The known device and its loop.

    Returns
    -------
    WorstWorld or None
        None if no stiffness or every one is certified, or if a wall is the worst world.
    """
    edge = world_k_max(derivative, plant, AnyWorld())
    if edge.k_max_n_per_m is None or edge.frequency_hz is None:
        return None
    theta = 2.0 * math.pi * plant.period * edge.frequency_hz
    half = math.tan(0.5 * theta)
    step = complex(2.0 * math.sin(0.5 * theta) ** 2, math.sin(theta))
    law = with_spring(derivative, edge.k_max_n_per_m).response(
        complex(math.cos(theta), math.sin(theta))
    )
    known = complex(known_answer(plant, np.array([theta]))[0])
    left = (step / law + known).imag
    if left == 0.0 or theta > math.pi * (1.0 - 1e-9):
        return None
    heavy = 0.5 * plant.period**2
    mass = heavy / (left * half) if left > 0.0 else None
    stiffness = -2.0 * half / left if left < 0.0 else None
    return WorstWorld(
        mass, stiffness, None, edge.frequency_hz, "lossless", edge.k_max_n_per_m
    )
