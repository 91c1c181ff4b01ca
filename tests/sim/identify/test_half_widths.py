"""Half-widths of 95 % intervals against the mean of windows that are equally informative.

If all windows have the same normal equations A, each has an estimate of its own, A⁻¹ times its
side, and the fit is their mean. Its covariance is that of a mean, and its interval Student's.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sim.arrays import Array
from sim.identify import identified_motion as motion
from sim.identify.conclude import _mechanics, _own_delay, _terms, _Widths
from sim.identify.output_error import Fit

FREE = (
    motion.MOBILITY,
    motion.DAMPING,
    motion.FRICTION,
    motion.LOAD,
    motion.DELAY,
    motion.LAG,
    motion.AVERAGE,
)
VALUES = (10.0, 20.0, 0.4, -0.5, 1.5, 0.8, 0.25)
WINDOWS, T = len(FREE) + 2, 0.002
# Student's t at 97.5 % with two degrees of freedom, in closed form
STUDENT = 0.95 * math.sqrt(2.0 / (4.0 * 0.975 * 0.025))
MOVED = 1e-3 * np.arange(1.0, len(FREE) + 1.0)
# of an inverse whose condition is about 1e3, and of the quantile's iteration
ROUNDING = 1e-6


def drawn() -> tuple[Fit, Array]:
    """Return a fit, and what the estimate of each window differs by, shape (W, 7)."""
    rng = np.random.default_rng(7)
    root = rng.standard_normal((len(FREE), len(FREE))) + 3.0 * np.eye(len(FREE))
    matrix = root @ root.T
    apart = 0.02 * rng.standard_normal((WINDOWS, len(FREE)))
    apart -= apart.mean(axis=0)
    theta = np.zeros(len(motion.NAMES))
    theta[list(FREE)] = VALUES
    found = Fit(
        theta=theta,
        free=np.array(FREE, dtype=np.int64),
        states=np.zeros((WINDOWS, 4)),
        errors=np.zeros(WINDOWS),
        matrices=np.stack([matrix] * WINDOWS),
        sides=apart @ matrix,
        starts=np.arange(WINDOWS, dtype=np.int64) * 100,
        length=100,
    )
    return found, apart


def half_width(values: Array) -> float:
    """Return the half-width of the 95 % interval of a mean."""
    return STUDENT * float(np.std(values, ddof=1)) / math.sqrt(len(values))


def moved_by(slope: Array, moved: Array) -> float:
    return float(np.abs(slope) @ moved)


@pytest.mark.parametrize("moved", [np.zeros(len(FREE)), MOVED], ids=["none", "moved"])
def test_every_half_width_is_that_of_a_mean(moved: Array) -> None:
    found, apart = drawn()
    widths = _Widths(found, moved.tolist())
    place = {which: i for i, which in enumerate(FREE)}
    for i, which in enumerate(FREE):
        value, width = widths.direct(which, 2.0)
        assert value == 2.0 * VALUES[i]
        expected = 2.0 * (half_width(apart[:, i]) + moved[i])
        assert width == pytest.approx(expected, rel=ROUNDING)
    g = VALUES[0]
    assert widths.mass_off * g == pytest.approx(
        half_width(apart[:, 0]) + moved[0], rel=ROUNDING
    )
    for which in (motion.DAMPING, motion.FRICTION, motion.LOAD):
        i = place[which]
        ratio = VALUES[i] / g
        slope = np.zeros(len(FREE))
        slope[i], slope[0] = 1.0 / g, -ratio / g
        value, width = widths.per_mass(which)
        assert value == ratio
        expected = half_width(apart @ slope) + moved_by(slope, moved)
        assert width == pytest.approx(expected, rel=ROUNDING)
    late, average = place[motion.DELAY], place[motion.AVERAGE]
    value, width = widths.total_delay()
    assert value == VALUES[late] + VALUES[average]
    assert width == pytest.approx(
        half_width(apart[:, late] + apart[:, average]) + moved[late] + moved[average],
        rel=ROUNDING,
    )


def test_noise_between_samples_widens_where_windows_agree() -> None:
    """Windows that agree by chance are as sure as their residual, and no surer."""
    found, _ = drawn()
    found.sides = 1e-3 * found.sides
    noise = 0.05
    found.errors = np.full(WINDOWS, noise**2 * (found.length - 2))
    inverse = np.linalg.inv(WINDOWS * found.matrices[0])
    widths = _Widths(found)
    assert found.rms == pytest.approx(noise, rel=1e-12)  # a few roundings
    for i, which in enumerate(FREE):
        expected = STUDENT * noise * math.sqrt(inverse[i, i])
        assert widths.direct(which)[1] == pytest.approx(expected, rel=ROUNDING)


def test_an_interval_has_its_half_width_on_both_sides() -> None:
    found, _ = drawn()
    widths = _Widths(found, MOVED.tolist())
    experiment: Any = SimpleNamespace(
        force=np.array([-5.0, 5.0]), position=np.array([0.0, 0.01]), period=T
    )
    choice: Any = SimpleNamespace(
        unsteady=0.1 * T, mode_bound=0.0, quadratic_bound=0.0, lag_bound=0.0
    )
    intervals = (
        _mechanics(experiment, widths, VALUES[1])
        | _terms(T, choice, widths)
        | {"delay": _own_delay(experiment, choice, widths)}
    )
    # The interval of 1/m: its ends are inverted.
    g, off = VALUES[0], widths.direct(motion.MOBILITY)[1]
    mass = intervals.pop("mass").known()
    assert mass == pytest.approx((1.0 / g, 1.0 / (g + off), 1.0 / (g - off)), rel=1e-12)
    # The unknown mean of the jitter adds two of its standard deviations.
    late, width = widths.total_delay()
    expected = {
        "damping": widths.per_mass(motion.DAMPING),
        "friction": widths.per_mass(motion.FRICTION),
        "load": widths.per_mass(motion.LOAD),
        "lag": widths.direct(motion.LAG, T),
        "average": widths.direct(motion.AVERAGE),
        "delay": (late, width + 0.2),
    }
    for name, (value, half) in expected.items():
        assert half > 0.0, name
        found_value, low, high = intervals[name].known()
        assert (found_value, low, high) == pytest.approx(
            (value, value - half, value + half), rel=1e-12
        ), name
