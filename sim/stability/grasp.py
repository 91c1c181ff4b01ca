"""A grasp: a mass that a hand adds to the device, behind a spring and a damper."""

from __future__ import annotations

import math
from dataclasses import dataclass

from nodes.stability.flexible import FlexiblePlant


@dataclass(frozen=True)
class Grasp:
    """A fingertip or a hand on the device.

    Attributes
    ----------
    mass : float
        Mass behind the skin [kg]; a large one is a hand that does not give way.
    stiffness, damping : float
        Spring [N/m] and damper [N s/m] between device and that mass.

    Raises
    ------
    ValueError
        When a field is not positive (damping: negative) or not finite.
    """

    mass: float
    stiffness: float
    damping: float

    def __post_init__(self) -> None:
        """Check the fields."""
        for name in ("mass", "stiffness", "damping"):
            value = getattr(self, name)
            if (
                not math.isfinite(value)
                or value < 0.0
                or (value == 0.0 and name != "damping")
            ):
                raise ValueError(
                    f"{name} = {value!r}: must be finite and"
                    f" {'at least 0' if name == 'damping' else 'positive'}"
                )

    def holds(
        self, mass: float, damping: float, delay: float, stiffness: float = 0.0
    ) -> FlexiblePlant:
        """Return a device held by this grasp: two masses on a joint.

        Parameters
        ----------
        mass, damping, delay, stiffness : float
            Mass [kg] and damping [N s/m] of the device, delay [ticks], stiffness of any other
            spring to ground [N/m].
        """
        whole = mass + self.mass
        reduced = mass * self.mass / whole
        pulse = math.sqrt(self.stiffness / reduced)
        loss = self.damping / (2.0 * reduced * pulse)
        return FlexiblePlant(
            whole,
            damping,
            delay,
            stiffness,
            share=self.mass / whole,
            frequency=pulse / (2.0 * math.pi),
            loss=loss,
        )
