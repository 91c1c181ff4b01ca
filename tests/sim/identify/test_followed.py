"""The figure of a fit uses the identified model: joint, lag and quadratic damping."""

from __future__ import annotations

import numpy as np
import pytest

from sim.device.model import DeviceModel
from sim.identify.identify import followed, identify
from sim.lab.monte_carlo.virtual import excite_outside
from sim.play.nonideal import NonidealDevice

RIGID = DeviceModel(mass=0.1, damping=1.0, friction=0.05, resolution=1e-5, delay=1.2)
DEVICES = {
    "flexible mode": NonidealDevice(RIGID, share=0.4, frequency=40.0, loss=0.03),
    "actuator lag": NonidealDevice(RIGID, lag=4e-3),
    "quadratic damping": NonidealDevice(RIGID, quadratic=3.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("term", DEVICES)
def test_what_is_left_in_the_picture_is_what_the_fit_left(term: str) -> None:
    experiment = excite_outside(DEVICES[term], 0.002, 6.0, 5)
    found = identify(experiment)
    assert term in found.terms
    starts, positions = followed(experiment, found, 1000)
    recorded = np.array(
        [experiment.position[start : start + positions.shape[1]] for start in starts]
    )
    # All windows, with the initial states of each taken off as the fit does: nearly the same
    # samples.
    assert np.sqrt(np.mean((recorded - positions) ** 2)) < 1.1 * found.residual
