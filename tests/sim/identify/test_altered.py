"""The poles of a designed law on every device that a residual leaves open."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from nodes.laws import CompiledLaw
from nodes.stability.closed_loop import pole_radius
from nodes.stability.flexible import FlexiblePlant, flexible_radius
from nodes.stability.plant import Plant
from sim.device.model import DeviceModel
from sim.drill.given_design import given_prediction
from sim.identify.altered import AlteredDevice, as_record, from_record, worst_altered
from sim.identify.identify import identify
from sim.lab.monte_carlo.tuned import true_edge
from sim.lab.monte_carlo.virtual import excite_outside
from sim.play.nonideal import NonidealDevice
from sim.tune.design import linear_edge, remainder_refusal
from sim.tune.knocking import scaled
from sim.tune.tuning_text import predicted_rows
from tests.support import thoroughly

T = 0.002
RIGID = DeviceModel(mass=0.1, damping=1.0, friction=0.03, delay=1.2, resolution=23e-6)
LAW = CompiledLaw((500.0 + 2.0 / T, -2.0 / T))


def test_a_spring_and_a_gain_act_on_the_law_with_either_sign() -> None:
    plant = FlexiblePlant(0.1, 1.0, 1.2)

    def radius(gain: float, spring: float) -> float:
        taps = (gain * LAW.taps[0] + spring, gain * LAW.taps[1])
        return pole_radius(CompiledLaw(taps), Plant(T, 0.1, 1.0, 1.2))

    found = AlteredDevice("both", plant, spring=40.0, gain=1.1).radius(LAW, T)
    ways = [
        radius(gain, spring) for gain in (1.1, 1.0 / 1.1) for spring in (40.0, -40.0)
    ]
    assert found == pytest.approx(max(ways), abs=1e-9)
    assert found > radius(1.0, 0.0)


def test_a_spring_of_the_device_acts_without_the_delay_of_the_law() -> None:
    found = AlteredDevice("own", FlexiblePlant(0.1, 1.0, 1.2), own_spring=40.0).radius(
        LAW, T
    )
    ways = [
        flexible_radius(LAW, T, FlexiblePlant(0.1, 1.0, 1.2, stiffness=sign * 40.0))
        for sign in (1.0, -1.0)
    ]
    assert found == pytest.approx(max(ways), abs=1e-12)
    assert found < AlteredDevice(
        "law's", FlexiblePlant(0.1, 1.0, 1.2), spring=40.0
    ).radius(LAW, T)


def test_a_sensor_that_averages_stands_in_the_taps_and_a_section_in_its_place() -> None:
    device = AlteredDevice("average", FlexiblePlant(0.1, 1.0, 1.5), average=0.5)
    averaged = CompiledLaw(tuple(np.convolve(LAW.taps, [0.5, 0.5]).tolist()))
    at_once = FlexiblePlant(0.1, 1.0, 1.0)
    assert device.radius(LAW, T) == pytest.approx(
        flexible_radius(averaged, T, at_once), abs=1e-12
    )
    filtered = CompiledLaw((300.0,), ((400.0, -400.0, -0.5, 0.0),))
    assert AlteredDevice("gain", at_once, gain=1.2).radius(
        filtered, T
    ) == pytest.approx(
        max(
            flexible_radius(
                CompiledLaw((300.0 * g,), ((400.0 * g, -400.0 * g, -0.5, 0.0),)),
                T,
                at_once,
            )
            for g in (1.2, 1.0 / 1.2)
        ),
        abs=1e-12,
    )


def test_a_record_is_read_back_with_and_without_a_joint() -> None:
    for joint in ({}, {"share": 0.3, "frequency": 60.0, "loss": 0.02}):
        device = AlteredDevice(
            "one", FlexiblePlant(0.1, 1.0, 1.2, **joint), 0.1, 5.0, 1.01
        )
        assert (
            from_record(json.loads(json.dumps(as_record(device), allow_nan=False)))
            == device
        )


@pytest.mark.parametrize(
    "odd",
    thoroughly(
        [{"gain_by_sign": 0.02}, {"cogging": 0.002}],
        "test_a_law_that_what_is_left_open_makes_unstable_is_refused",
        but=[{"gain_by_sign": 0.02}],
    ),
)
def test_a_law_that_what_is_left_open_makes_unstable_is_refused(
    odd: dict[str, Any],
) -> None:
    """Close to the edge of the fit it is; far below it is not, and the true device agrees."""
    device = NonidealDevice(RIGID, **odd)
    found = identify(excite_outside(device, T, 4.0, seed=1))
    assert found.altered
    edge = linear_edge(LAW, found.plant(), T)
    near, far = scaled(LAW, 0.9995 * edge), scaled(LAW, 0.5 * edge)
    assert flexible_radius(near, T, found.plant()) < 1.0
    why = remainder_refusal(near, found)
    assert why is not None
    assert "(limit: < 1) on a device with" in why
    assert remainder_refusal(far, found) is None
    radius, _ = worst_altered(far, T, found.altered) or (0.0, "")
    assert flexible_radius(far, T, found.plant()) <= radius < 1.0
    # What is refused first lies below the true edge.
    truth = true_edge(LAW, device, T)
    assert truth is not None
    least = min(
        share
        for share in np.linspace(0.8, 1.02, 45)
        if remainder_refusal(scaled(LAW, share * edge), found)
    )
    assert least * edge <= truth * (1.0 + 1e-6)


def test_a_device_whose_residual_is_noise_leaves_nothing_open() -> None:
    assert worst_altered(LAW, T, ()) is None
    rigid = NonidealDevice(RIGID)
    found = identify(excite_outside(rigid, T, 4.0, seed=1))
    assert found.altered == ()
    assert worst_altered(LAW, T, found.altered) is None
    assert remainder_refusal(scaled(LAW, 100.0), found) is None


def test_it_is_told_beside_the_prediction() -> None:
    found = given_prediction(1.0)
    told = dict(
        predicted_rows(replace(found, remainder_pole_radius=0.97, remainder_worst="X"))
    )
    assert (
        told["on what the recording leaves open"] == "stable; pole radius 0.9700 with X"
    )
    assert "on what the recording leaves open" not in dict(predicted_rows(found))
