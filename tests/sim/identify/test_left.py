"""The noise that a fit leaves: short windows agree with long ones."""

from __future__ import annotations

import numpy as np
import pytest

from sim.device.model import DeviceModel
from sim.identify import identified_motion as motion
from sim.identify.judge_fit import left
from sim.identify.output_error import fit, windows
from sim.lab.monte_carlo.virtual import excite

T, NOISE = 0.002, 1e-5


@pytest.mark.parametrize("length", [8, 40])
def test_the_noise_left_is_the_noise_that_was_put_in(length: int) -> None:
    """Each window fits a position and a velocity: of 8 ticks, an eighth of the noise."""
    clean = excite(DeviceModel(mass=0.1, damping=1.0), T, 6.0, seed=2)
    noise = NOISE * np.random.default_rng(4).standard_normal(len(clean.position))
    clean.position[:] += noise
    theta = np.zeros(len(motion.NAMES))
    theta[motion.MOBILITY], theta[motion.DAMPING] = 1.0 / 0.1, 1.0 / 0.1
    theta[motion.FREQUENCY] = 100.0
    starts = windows(clean, length)
    found = fit(clean, starts, length, theta, (motion.MOBILITY, motion.DAMPING), 1e-6)
    size = left(clean, found, None).size
    # The spread of 3000 samples, less what was fitted: 1.5 % of it at one standard deviation.
    assert size == pytest.approx(NOISE, rel=5.0 / np.sqrt(2.0 * 3000.0))
