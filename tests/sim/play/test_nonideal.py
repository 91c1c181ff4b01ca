"""The device with defects, without any, moves as the player's exact device."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from nodes.laws.knock import Knock
from nodes.laws.pd import PD
from sim.device.model import DeviceModel
from sim.play.nonideal import NonidealDevice, pushed
from sim.play.one_axis import run
from sim.play.one_axis_inputs import Scene, SceneSurface

T, TICKS, STEP = 0.002, 400, 1e-3


@pytest.mark.parametrize("delay", [0.0, 0.3, 1.0])
def test_a_device_without_defects_swings_as_the_player_s(delay: float) -> None:
    """Two integrators and two loops: a spring pulls a device home from 1 mm."""
    device = DeviceModel(mass=0.1, damping=1.0, delay=delay, position=0.0)
    law = PD(stiffness=200.0, damping=0.0).compile(T)
    place = (STEP, math.inf, math.inf, 0.0)
    told = pushed(
        NonidealDevice(device), T, np.zeros(TICKS), np.array(law.taps), place, 0
    )
    away = DeviceModel(mass=0.1, damping=1.0, delay=delay, position=-STEP)
    scene = Scene(
        device=away, surface=SceneSurface("anchor"), period=T, raw=False, clamp=False
    )
    played = run(scene, law, TICKS)
    # 45 rad/s: a small step of T/64 errs by its square, 2e-6, of the swing in each radian; 36 of
    # them in 400 ticks. Readings are rounded to a nanometre.
    assert np.ptp(played.measured) > STEP
    np.testing.assert_allclose(told[0] - STEP, played.measured, atol=1e-4 * STEP)


def test_a_knock_on_a_model_is_the_knock_of_a_launch() -> None:
    """The history begins at zero: the damper feels the step too, in the first tick."""
    taps = PD(stiffness=300.0, damping=1.0).compile(T).taps
    device = NonidealDevice(DeviceModel(mass=0.1, damping=1.0))
    place = (STEP, math.inf, math.inf, 0.0)
    positions, forces = pushed(device, T, np.zeros(8), np.array(taps), place, 0)
    law = Knock(taps=taps, step=STEP).compile(T)
    trial: Any = law.evaluate
    trial = trial.on_axis(0)
    length = 16
    ring, head, live = [0.0] * (2 * length), length, []
    for position in positions.tolist():
        head = (head - 1) % length
        ring[head] = ring[head + length] = -position
        live.append(
            sum(tap * ring[head + m] for m, tap in enumerate(law.taps))
            + trial(ring, head)
        )
    assert forces[0] == pytest.approx(STEP * taps[0])
    np.testing.assert_allclose(live, forces, rtol=1e-9)
