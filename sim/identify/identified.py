"""A device as a recording tells it: each parameter with a 95 % interval or the reason why not, and whether the model holds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from nodes.stability.flexible import FlexiblePlant
from sim.identify.altered import AlteredDevice


@dataclass(frozen=True)
class Estimate:
    """One parameter."""

    # Estimate and 95 % interval in the unit of the parameter; None where it cannot be told.
    value: float | None
    low: float | None = None
    high: float | None = None
    why: str = ""  # why not; empty when it can

    def known(self) -> tuple[float, float, float]:
        """Give value, low and high of a parameter; ValueError says why it could not be told."""
        if self.value is None or self.low is None or self.high is None:
            raise ValueError(self.why)
        return self.value, self.low, self.high


@dataclass(frozen=True)
class Identified:
    """A device as a recording tells it."""

    # Moving mass [kg] and viscous damping [N s/m], a hand's share included; Coulomb friction [N].
    mass: Estimate
    damping: Estimate
    friction: Estimate
    # From the sample to the force taking effect, median over the ticks [ticks]. A lag that is not
    # told apart is in it.
    delay: Estimate
    device_delay: Estimate  # the part of it that the driver does not see [ticks]
    encoder: Estimate  # encoder step [m]
    stiffness: Estimate  # of a hand that holds the device [N/m]; 0 when none was found
    load: Estimate  # constant force that acts besides: weight, or the pull of a hand [N]
    # Damping that grows with the speed: force per speed squared [N s²/m²]. 0 where the data do not
    # ask for it, with the largest that they would not have shown.
    quadratic: Estimate
    lag: Estimate  # time constant of the actuator [s]; likewise
    # A second mass on a joint: frequency of the two against each other [Hz], part of the mass
    # beyond the joint, damping ratio. Without a value where the data show none; `low` of the
    # frequency is up to where they would have.
    frequency: Estimate
    share: Estimate
    loss: Estimate
    jitter: Estimate  # spread of the delay over the ticks, 99.9 % quantile minus 0.1 % [ticks]
    # Shortest and longest delay: those two quantiles, widened by the interval of `device_delay`
    # [ticks], shape (2,).
    delay_range: tuple[float, float]
    held: bool  # whether a hand's stiffness was found
    residual: float  # Root-mean-square distance of the model's positions from the measured ones [m]
    dropped: int  # windows left out because a stall or a knock spoilt them
    # How many windows of how many ticks.
    windows: int
    ticks: int
    axis: str  # the axis
    period: float  # sampling period [s]
    # The residual of the middle one of the windows that the fit has not seen [m], and the
    # probability that a model that holds leaves one at least so far from white, by rounding alone;
    # None where there are none.
    held_out: float | None = None
    whiteness: float | None = None
    # Part of the sample before in each reading: 0.5 for a sensor that averages two. Its mean delay
    # is in `delay`.
    average: Estimate = Estimate(0.0, 0.0, 0.0)
    # What the model has beyond mass, damping, friction, delay and hand because the data ask for it.
    terms: tuple[str, ...] = ()
    # whether the held-out windows refute the model, and no richer one explains them
    refuted: bool = False
    why: str = ""  # what refutes it, and what the data ask for; empty for a model that holds
    # What the residual asks for that the model does not have, and by how much of itself that may
    # change K_max of a PD (a damper of 0.3 m/(T (1 + 2d))). The intervals hold what it may move.
    # Empty and 0 where the residual is noise.
    remainder: str = ""
    remainder_k_max: float = 0.0
    # The device with each term that may be what is left: what a designed law is judged on as well.
    altered: tuple[AlteredDevice, ...] = ()
    # What a refuted model says of its parameters, which have no value then.
    unbelieved: Mapping[str, Estimate] = field(default_factory=dict)

    def anyway(self) -> Identified:
        """Believe a refuted model: give its parameters the values that the best fit of it has."""
        believed: dict[str, Any] = dict(self.unbelieved)
        return replace(self, **believed)

    def plant(self) -> FlexiblePlant:
        """Give the linear device that a law is coupled to, joint and lag included; quadratic damping only calms."""
        mass, damping, delay = (one.known()[0] for one in (self.mass, self.damping, self.delay))
        joint = {}
        if self.frequency.value is not None:
            joint = {
                name: getattr(self, name).known()[0] for name in ("share", "frequency", "loss")
            }
        return FlexiblePlant(
            mass, damping, delay, self.stiffness.value or 0.0, self.lag.value or 0.0, **joint
        )

    def steps(self, residual: float | None) -> float | None:
        """Give a residual in encoder steps; None when either is not known. 0.29 is what rounding alone leaves."""
        return (
            None
            if self.encoder.value is None or residual is None
            else residual / self.encoder.value
        )


def refusal(found: Identified) -> str | None:
    """Say what refutes an identified device, on which nothing may be designed then; None for a model that holds."""
    if not found.refuted:
        return None
    return f"the recording refutes the model of the device: {found.why}"
