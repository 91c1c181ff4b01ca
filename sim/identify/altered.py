"""A device altered by what the residual leaves open, and the poles of a law on it.

Each term that a recording shows and the model lacks gives one such device (`remainder`). K_max of a
reference law grades the terms before any law exists; once a law is designed, its own pole radius on
these devices gives their effect.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np

from nodes.laws import CompiledLaw
from nodes.stability.flexible import FlexiblePlant, flexible_radius


@dataclass(frozen=True)
class AlteredDevice:
    """An identified device with one more term, at the largest size the recording allows."""

    cause: str  # the term, in words
    plant: FlexiblePlant  # the linear device, including the delay of the loop
    # weight of the previous sample in each reading; its mean delay is part of the plant's
    average: float = 0.0
    # stiffness that the term adds to the law's own, or subtracts [N/m]
    spring: float = 0.0
    gain: float = 1.0  # largest factor of the law, its inverse being the least [1]
    # stiffness of a spring in the device itself, or its negative: it acts at once, whatever the
    # delay of the law [N/m]
    own_spring: float = 0.0

    def radius(self, law: CompiledLaw, period: float) -> float:
        """Return the largest pole of a law on the device, the worst sign of spring and gain.

        Parameters
        ----------
        law : CompiledLaw
            The law. The average of the sensor stands in its taps; with sections, in the delay.
        period : float
            Sampling period T [s].
        """
        springs = {self.spring, -self.spring}
        gains = {self.gain, 1.0 / self.gain}
        return max(
            _radius(law, period, plant, self.average, spring, gain)
            for plant in self.plants
            for spring in springs
            for gain in gains
        )

    @property
    def plants(self) -> tuple[FlexiblePlant, ...]:
        """The linear device with its own spring of either sign."""
        if not self.own_spring:
            return (self.plant,)
        return tuple(
            replace(self.plant, stiffness=self.plant.stiffness + sign * self.own_spring)
            for sign in (1.0, -1.0)
        )


def _radius(
    law: CompiledLaw,
    period: float,
    plant: FlexiblePlant,
    average: float,
    spring: float,
    gain: float,
) -> float:
    """Return the largest pole of a law that is amplified, beside a spring of its own [N/m]."""
    taps = np.array(law.taps) * gain
    taps[0] += spring
    sections = tuple((gain * b0, gain * b1, a1, a2) for b0, b1, a1, a2 in law.sections)
    if average and not law.sections:
        taps = np.convolve(taps, [1.0 - average, average])
        plant = replace(plant, delay=max(plant.delay - average, 0.0))
    return flexible_radius(CompiledLaw(tuple(taps.tolist()), sections), period, plant)


def worst_altered(
    law: CompiledLaw, period: float, devices: Iterable[AlteredDevice]
) -> tuple[float, str] | None:
    """Return the largest pole radius of a law over the devices, and its cause, or None."""
    return max(((one.radius(law, period), one.cause) for one in devices), default=None)


def as_record(device: AlteredDevice) -> dict[str, Any]:
    """Return a device for JSON: a rigid one has no frequency."""
    record = asdict(device)
    if not math.isfinite(device.plant.frequency):
        record["plant"]["frequency"] = None
    return record


def from_record(record: Mapping[str, Any]) -> AlteredDevice:
    """Return the device of a record: the inverse of `as_record`."""
    plant = dict(record["plant"])
    if plant["frequency"] is None:
        plant["frequency"] = math.inf
    return AlteredDevice(**{**record, "plant": FlexiblePlant(**plant)})
