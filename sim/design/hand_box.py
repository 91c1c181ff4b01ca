"""A box of hands: ranges of what a grasp adds to a device."""

import itertools
import math
from dataclasses import dataclass

from sim.stability.grasp import Grasp


@dataclass(frozen=True)
class HandBox:
    """Limits of a grasp: lowest and highest value of each parameter, shape (2,)."""

    mass: tuple[float, float]  # [kg]
    stiffness: tuple[float, float]  # [N/m]
    damping: tuple[float, float]  # [N s/m]

    def __post_init__(self) -> None:
        for name in ("mass", "stiffness", "damping"):
            low, high = getattr(self, name)
            if not (0.0 <= low <= high and math.isfinite(high)) or (
                low == 0.0 and name != "damping"
            ):
                expected = (
                    "0 <= low <= high" if name == "damping" else "0 < low <= high"
                )
                raise ValueError(
                    f"{name} = {low:g}..{high:g}: expected {expected}, finite"
                )

    @property
    def sides(self) -> tuple[tuple[float, float], ...]:
        """Return the limits of mass, stiffness and damping."""
        return self.mass, self.stiffness, self.damping

    def corners(self) -> tuple[Grasp, ...]:
        """Return the grasps at the limits."""
        return tuple(
            Grasp(*values)
            for values in itertools.product(*(sorted(set(side)) for side in self.sides))
        )

    def text(self) -> str:
        """Return the box as text with units."""
        mass, stiffness, damping = (
            f"{low:g}..{high:g}" if low < high else f"{low:g}"
            for low, high in self.sides
        )
        return f"grasp of {mass} kg behind {stiffness} N/m and {damping} N s/m"
