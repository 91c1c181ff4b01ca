"""Possible unmodelled terms of a device, each with its effect on the recorded positions.

A term that acts as a force moves the device like any force; an encoder error adds directly. Each
shape is known up to a factor and one or two sizes, which are tried on a grid; `judge_fit` compares
the shapes with the residual of a fit.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from nodes.stability.plant import Plant, held_plant
from sim.arrays import Array
from sim.device.filters import filtered
from sim.identify.experiment import Experiment
from sim.identify.identified_motion import (
    DAMPING,
    DELAY,
    FRICTION,
    LOAD,
    MOBILITY,
    STIFFNESS,
)
from sim.identify.output_error import Fit

LOWEST = 8.0  # lowest joint frequency [Hz]; anything slower is a hand
# highest joint frequency [share of the Nyquist frequency]: above it, aliases are ambiguous
HIGHEST = 0.9
LOSSES = (0.02, 0.08)  # damping ratios of a joint
LAGS = (0.25, 0.5, 1.0, 2.0, 4.0)  # lags of the actuator [ticks]
AVERAGES = (0.15, 0.5)  # weight of the previous sample in each reading
FORCE_STEPS = (
    1e-3,
    2e-3,
    5e-3,
    1e-2,
    2e-2,
    5e-2,
    0.1,
)  # resolution of the motor's force [N]


@dataclass(frozen=True)
class Suspect:
    """An unmodelled term of one size."""

    term: str  # its name
    size: float  # grid value, in the unit of `SIZES`
    # effect on the positions, up to a factor for each of g parts, shape (g, W, L)
    shapes: Array
    start: tuple[float, ...] = ()  # initial values for a fit


# Description of each term, and the factor of its size.
SIZES: dict[str, tuple[str, float]] = {
    "flexible mode": ("a second mode at {:.0f} Hz", 1.0),
    "actuator lag": ("an actuator lag of about {:.1f} ms", 1.0),
    "quadratic damping": ("damping that grows with the square of the speed", 1.0),
    "spring": ("a spring of the device that hardens or pulls unevenly", 1.0),
    "presliding": ("friction that builds up over {:.0f} µm (presliding)", 1e6),
    "backlash": ("a backlash of about {:.2g} mm", 1e3),
    "stribeck": ("friction that falls with the speed", 1.0),
    "cogging": ("a force that repeats every {:.2g} mm", 1e3),
    "encoder ripple": ("an encoder error that repeats every {:.2g} mm", 1e3),
    "drift": ("friction or damping that changes during the run", 1.0),
    "sensor filter": (
        "a sensor that averages: {:.0f} % of the sample before in each reading",
        100.0,
    ),
    "force steps": ("a force that comes in steps of {:.2g} mN", 1e3),
    "gain by sign": ("a motor that gives more force one way than the other", 1.0),
    "deadband": (
        (
            "a force that the motor does not give as commanded: a dead band, or a gain that depends"
            " on the force"
        ),
        1.0,
    ),
}


def describe(term: str, size: float) -> str:
    """Return a term in words."""
    words, factor = SIZES[term]
    return words.format(size * factor)


class Shapes:
    """Shapes of all suspects for one fit."""

    def __init__(self, experiment: Experiment, found: Fit, modelled: Array) -> None:
        """Use the modelled motion (W, L), which is smooth and free of encoder rounding."""
        theta, period = found.theta, experiment.period
        self._period, self._length, self._theta = period, found.length, theta
        self._rows = found.starts[:, None] + np.arange(found.length)
        self._x, self._v = modelled, np.gradient(modelled, period, axis=1)
        ticks = np.arange(len(experiment.position), dtype=np.float64)
        self._ticks, self._given, self._at, self._delay = (
            ticks,
            experiment.force,
            experiment.at,
            float(theta[DELAY]),
        )
        self._force = self._mean(experiment.force)
        direction = np.sign(
            np.gradient(np.convolve(experiment.position, np.ones(5) / 5.0, "same"))
        )
        self._net = self._force - theta[FRICTION] * direction + theta[LOAD]

    def _mean(self, given: Array) -> Array:
        """Return the mean acceleration in each tick by forces at the recorded instants."""
        impulse = np.concatenate([[0.0], np.cumsum(given[:-1] * np.diff(self._at))])

        def pushed(until: Array) -> Array:
            """Return the integral of the force up to an instant [N ticks]."""
            then = np.interp(until, self._at, impulse)
            return np.asarray(then + given[-1] * np.maximum(until - self._at[-1], 0.0))

        late = self._ticks - self._delay
        return np.asarray(self._theta[MOBILITY] * (pushed(late + 1.0) - pushed(late)))

    def _moved_by(self, force: Array) -> Array:
        """Return the model's motion under an acceleration (W, L), from rest in each window."""
        plant = held_plant(
            Plant(
                self._period,
                1.0,
                float(self._theta[DAMPING]),
                0.0,
                float(self._theta[STIFFNESS]),
            )
        )
        return filtered([0.0, *plant.numerator[:2]], plant.denominator, force)

    def all(self) -> Iterator[Suspect]:
        """Yield every suspect at every size."""
        parts = (
            self._modes,
            self._lags,
            self._frictions,
            self._springs,
            self._gaps,
            self._repeated,
            self._others,
            self._read,
        )
        for part in parts:
            yield from part()

    def _modes(self) -> Iterator[Suspect]:
        highest = HIGHEST * 0.5 / self._period
        # 3 % apart: a joint that rings for about ten periods is not missed in between.
        for frequency in np.geomspace(
            LOWEST, highest, 1 + int(np.log(highest / LOWEST) / 0.03)
        ).tolist():
            pulse = 2.0 * np.pi * frequency
            for loss in LOSSES:
                plant = held_plant(
                    Plant(self._period, 1.0, 2.0 * loss * pulse, 0.0, pulse * pulse)
                )
                swing = filtered(
                    [0.0, *plant.numerator[:2]], plant.denominator, self._net
                )
                yield Suspect(
                    "flexible mode",
                    frequency,
                    swing[self._rows][None],
                    (0.3, frequency, loss),
                )

    def _lags(self) -> Iterator[Suspect]:
        for lag in LAGS:
            decay = np.exp(-1.0 / lag)
            mean = (1.0 - decay) * lag
            late = filtered([1.0 - mean, mean - decay], [1.0, -decay], self._force)
            # `judge_fit` projects out the effect of its mean delay, which the model has.
            shape = self._moved_by((late - self._force)[self._rows])
            yield Suspect("actuator lag", lag * self._period * 1e3, shape[None], (lag,))

    def _frictions(self) -> Iterator[Suspect]:
        v, sign = self._v, np.sign(self._v)
        yield Suspect(
            "quadratic damping", 0.0, self._moved_by(-v * np.abs(v))[None], (1.0,)
        )
        for speed in (0.01, 0.03):
            yield Suspect(
                "stribeck",
                speed,
                self._moved_by(-sign * np.exp(-((v / speed) ** 2)))[None],
            )
        for reach in (2e-5, 5e-5, 1e-4, 2e-4, 5e-4):
            yield Suspect(
                "presliding",
                reach,
                self._moved_by(sign - self._bristle(reach) / reach)[None],
            )

    def _bristle(self, reach: float) -> Array:
        """Return the deflection of a dragged bristle that slips beyond its reach [m]."""
        steps = np.diff(self._x, axis=1)
        out = np.zeros_like(self._x)
        z = reach * np.sign(steps[:, 0])
        for k in range(self._length):
            out[:, k] = z
            if k < self._length - 1:
                z = np.clip(z + steps[:, k], -reach, reach)
        return out

    def _springs(self) -> Iterator[Suspect]:
        x = self._x - np.median(self._x)
        yield Suspect(
            "spring", 0.0, np.stack([self._moved_by(-(x**n)) for n in (1, 2, 3)])
        )

    def _gaps(self) -> Iterator[Suspect]:
        for gap in (5e-5, 1e-4, 2e-4, 4e-4, 8e-4):
            yield Suspect("backlash", gap, self._loose(gap)[None])

    def _loose(self, gap: float) -> Array:
        """Return the position of a second mass in its gap.

        It moves freely between impacts and with the first mass after each impact.
        """
        x, v = self._x, self._v * self._period
        out = np.zeros_like(x)
        y = 0.5 * gap * np.sign(v[:, 0])
        speed = v[:, 0].copy()
        for k in range(self._length):
            out[:, k] = y
            y = y + v[:, k] - speed
            hit = np.abs(y) > 0.5 * gap
            y = np.clip(y, -0.5 * gap, 0.5 * gap)
            speed = np.where(hit, v[:, k], speed)
        return out

    def _repeated(self) -> Iterator[Suspect]:
        for pitch in np.geomspace(4e-4, 3e-2, 40).tolist():
            around = 2.0 * np.pi * self._x / pitch
            waves = np.stack([np.sin(around), np.cos(around)])
            yield Suspect("encoder ripple", pitch, waves)
            if pitch > 1e-3:
                yield Suspect(
                    "cogging", pitch, np.stack([self._moved_by(wave) for wave in waves])
                )

    def _others(self) -> Iterator[Suspect]:
        along = np.broadcast_to(
            (self._rows / self._rows.max() - 0.5)[:, :1], self._x.shape
        )
        yield Suspect(
            "drift",
            0.0,
            np.stack(
                [
                    self._moved_by(-along * self._v),
                    self._moved_by(-along * np.sign(self._v)),
                ]
            ),
        )
        force = self._force[self._rows]
        strongest = np.abs(force).max() or 1.0
        shapes = (np.tanh(force / (0.1 * strongest)), force * np.abs(force))
        yield Suspect(
            "deadband",
            0.0,
            np.stack([self._moved_by(shape) for shape in shapes]),
            (strongest,),
        )
        yield Suspect("gain by sign", 0.0, self._moved_by(np.abs(force))[None])
        largest = float(np.abs(self._given).max())
        for step in FORCE_STEPS:
            if step < largest:
                lost = self._mean(np.round(self._given / step) * step - self._given)
                yield Suspect(
                    "force steps", step, self._moved_by(lost[self._rows])[None]
                )

    def _read(self) -> Iterator[Suspect]:
        x = self._x
        before = np.concatenate(
            [3.0 * x[:, :1] - 3.0 * x[:, 1:2] + x[:, 2:3], x[:, :-1]], axis=1
        )
        for part in AVERAGES:
            # `judge_fit` projects out the effect of a delay, which leaves the blur.
            yield Suspect("sensor filter", part, (part * (before - x))[None], (part,))
