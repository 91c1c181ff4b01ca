"""The noise a fit leaves, by window length, and how often an interval is right."""

from __future__ import annotations

import numpy as np
import pytest

from sim.arrays import Array
from sim.device.model import DeviceModel
from sim.identify import identified_motion as motion
from sim.identify.conclude import _Widths
from sim.identify.judge_fit import left
from sim.identify.output_error import fit, windows
from sim.lab.monte_carlo.virtual import excite

T, NOISE = 0.002, 1e-5


FREE = (motion.MOBILITY, motion.DAMPING)


def truth() -> Array:
    """Return all unknowns of 0.1 kg with 1 N s/m."""
    theta = np.zeros(len(motion.NAMES))
    theta[motion.MOBILITY], theta[motion.DAMPING] = 1.0 / 0.1, 1.0 / 0.1
    theta[motion.FREQUENCY] = 100.0
    return theta


@pytest.mark.parametrize("length", [8, 40])
def test_the_noise_left_is_the_noise_that_was_put_in(length: int) -> None:
    """Each window fits a position and a velocity: of 8 ticks, an eighth of the noise."""
    clean = excite(DeviceModel(mass=0.1, damping=1.0), T, 6.0, seed=2)
    noise = NOISE * np.random.default_rng(4).standard_normal(len(clean.position))
    clean.position[:] += noise
    theta = truth()
    starts = windows(clean, length)
    found = fit(clean, starts, length, theta, FREE, 1e-6)
    size = left(clean, found, None).size
    # The spread of 3000 samples, less what was fitted: 1.5 % of it at one standard deviation.
    assert size == pytest.approx(NOISE, rel=5.0 / np.sqrt(2.0 * 3000.0))


def test_an_interval_of_95_percent_holds_the_truth_so_often() -> None:
    """Forty runs with different noise, two unknowns each: 76 of 80 are expected within."""
    clean = excite(DeviceModel(mass=0.1, damping=1.0), T, 4.0, seed=2)
    position, starts = clean.position.copy(), windows(clean, 100)
    held = 0
    for seed in range(40):
        noise = NOISE * np.random.default_rng(seed).standard_normal(len(position))
        clean.position[:] = position + noise
        widths = _Widths(fit(clean, starts, 100, truth(), FREE, 1e-6))
        for which in FREE:
            value, half = widths.direct(which)
            held += abs(value - truth()[which]) <= half
    # Four standard deviations of a binomial below, √(80·0.95·0.05) each; 68 % would hold 54 ± 4.
    assert held >= 76 - 8
