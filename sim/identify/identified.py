"""An identified device: parameters with 95 % intervals, or the reasons why not."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from nodes.stability.flexible import FlexiblePlant
from sim.identify.altered import AlteredDevice


@dataclass(frozen=True)
class Estimate:
    """One parameter."""

    # estimate and 95 % interval in the unit of the parameter; None if it cannot be estimated
    value: float | None
    low: float | None = None
    high: float | None = None
    why: str = ""  # reason if there is no value; else empty

    def known(self) -> tuple[float, float, float]:
        """Return value, low and high; raise ValueError with the reason if there is no value."""
        if self.value is None or self.low is None or self.high is None:
            raise ValueError(self.why)
        return self.value, self.low, self.high


@dataclass(frozen=True)
class Identified:
    """An identified device."""

    # Moving mass [kg] and viscous damping [N s/m], including a hand's share; Coulomb friction [N].
    mass: Estimate
    damping: Estimate
    friction: Estimate
    # From sample to force, median over the ticks [ticks]. Includes an actuator lag that was not
    # identified separately.
    delay: Estimate
    device_delay: Estimate  # its part that the driver cannot measure [ticks]
    encoder: Estimate  # encoder step [m]
    stiffness: Estimate  # of a hand that holds the device [N/m]; 0 if none was found
    load: Estimate  # other constant force, such as weight or the pull of a hand [N]
    # Quadratic damping: force per speed squared [N s²/m²]. If not significant: 0, with the largest
    # value that would not have been detected.
    quadratic: Estimate
    lag: Estimate  # time constant of the actuator, likewise [s]
    # A second mass on a joint: frequency of the two masses [Hz], share of the mass beyond the
    # joint, damping ratio. Without a value if not significant; `low` of the frequency is the limit
    # up to which a joint would have been detected.
    frequency: Estimate
    share: Estimate
    loss: Estimate
    jitter: Estimate  # range of the delay over the ticks, 99.9 % quantile minus 0.1 % [ticks]
    # Shortest and longest delay: those two quantiles, widened by the interval of `device_delay`
    # [ticks], shape (2,).
    delay_range: tuple[float, float]
    held: bool  # whether a hand's stiffness was found
    residual: float  # root-mean-square residual of the positions [m]
    dropped: int  # windows left out because a stall or an impact disturbed them
    # number and length [ticks] of the windows
    windows: int
    ticks: int
    axis: str  # ``x``, ``y`` or ``z``
    period: float  # sampling period [s]
    # Median residual of the held-out windows [m], and the probability that a valid model leaves
    # residuals at least as far from white, by rounding alone. None without held-out windows.
    held_out: float | None = None
    whiteness: float | None = None
    # Weight of the previous sample in each reading: 0.5 for a sensor that averages two. Its mean
    # delay is part of `delay`.
    average: Estimate = Estimate(0.0, 0.0, 0.0)
    # significant terms beyond mass, damping, friction, delay and hand
    terms: tuple[str, ...] = ()
    # whether the held-out windows refute the model and no richer model explains them
    refuted: bool = False
    why: str = ""  # reason and missing term if refuted; else empty
    # Term that the residual shows and the model lacks, and its possible relative change of K_max of
    # a PD (with a damper of 0.3 m/(T (1 + 2d))). The intervals include its effect. Empty and 0 if
    # the residual is noise.
    remainder: str = ""
    remainder_k_max: float = 0.0
    # The device with each term that may explain the residual; designed laws are judged on it too.
    altered: tuple[AlteredDevice, ...] = ()
    # parameters of a refuted model, whose own fields have no value
    unbelieved: Mapping[str, Estimate] = field(default_factory=dict)

    def anyway(self) -> Identified:
        """Return a copy in which the parameters of a refuted model have their fitted values."""
        believed: dict[str, Any] = dict(self.unbelieved)
        return replace(self, **believed)

    def plant(self) -> FlexiblePlant:
        """Return the linear plant for a law, with joint and lag.

        Quadratic damping is left out because it only stabilises.
        """
        mass, damping, delay = (
            one.known()[0] for one in (self.mass, self.damping, self.delay)
        )
        joint = {}
        if self.frequency.value is not None:
            joint = {
                name: getattr(self, name).known()[0]
                for name in ("share", "frequency", "loss")
            }
        return FlexiblePlant(
            mass,
            damping,
            delay,
            self.stiffness.value or 0.0,
            self.lag.value or 0.0,
            **joint,
        )

    def steps(self, residual: float | None) -> float | None:
        """Return a residual in encoder steps, or None; rounding alone leaves 0.29."""
        return (
            None
            if self.encoder.value is None or residual is None
            else residual / self.encoder.value
        )


def refusal(found: Identified) -> str | None:
    """Return what refutes the model, so that no law may be designed; None if it holds."""
    if not found.refuted:
        return None
    return f"the recording refutes the model of the device: {found.why}"
