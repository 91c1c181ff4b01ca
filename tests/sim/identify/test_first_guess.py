"""The linear equations behind the first guess, on motions that are known exactly."""

from __future__ import annotations

import numpy as np
import pytest

from sim.device.model import coefficients
from sim.identify.experiment import Experiment, lockstep
from sim.identify.identified_motion import (
    DAMPING,
    DELAY,
    FRICTION,
    LOAD,
    MOBILITY,
    STIFFNESS,
)
from sim.identify.identify import first_guess

T = 0.002


def moved(
    mass: float, damping: float, stiffness: float, load: float, delay: int
) -> Experiment:
    """Return a run without friction and encoder: an exact motion under forces held per tick."""
    ticks = 2000
    time = np.arange(ticks) * T
    sines = 4.0 * np.sin(2 * np.pi * 3.1 * time) + 3.0 * np.sin(2 * np.pi * 11.7 * time)
    force = mass * sines
    a11, a12, a21, a22, b1, b2 = coefficients(mass, damping, stiffness, T)
    position = np.empty(ticks)
    x = v = 0.0
    for k in range(ticks):
        position[k] = x
        u = load + (force[k - delay] if k >= delay else 0.0)
        x, v = a11 * x + a12 * v + b1 * u, a21 * x + a22 * v + b2 * u
    return lockstep(T, position, force)


@pytest.mark.parametrize("delay", [0, 3])
@pytest.mark.parametrize("rate", [0.0, 1500.0])
@pytest.mark.parametrize("mass", [0.1, 8.0])
def test_the_guess_is_the_device(mass: float, rate: float, delay: int) -> None:
    damping, load, stiffness = 10.0 * mass, 0.5 * mass, rate * mass
    found = first_guess(moved(mass, damping, stiffness, load, delay), held=rate > 0)
    # Sums in place of integrals leave 0.2 %; one point more in the bump would be 2 %.
    assert found[DELAY] == delay
    assert found[MOBILITY] == pytest.approx(1.0 / mass, rel=5e-3)
    assert found[DAMPING] == pytest.approx(damping / mass, rel=5e-3)
    assert found[STIFFNESS] == pytest.approx(stiffness / mass, rel=5e-3)
    assert found[LOAD] == pytest.approx(load / mass, rel=5e-3)
    assert found[FRICTION] == pytest.approx(0.0, abs=5e-3 * load / mass)


def test_a_guess_stays_above_a_tenth_of_a_kilogram_s_inverse() -> None:
    """A device of 50 kg is guessed as 10 kg, from which the fit goes on."""
    found = first_guess(moved(50.0, 500.0, 0.0, 25.0, 0), held=False)
    assert found[MOBILITY] == 0.1
