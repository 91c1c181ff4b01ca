"""A design for a device with joint and lag: stable for each device it may be; its cost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nodes.laws import CompiledLaw
from nodes.stability.flexible import FlexiblePlant, flexible_radius
from sim.design.demand import CONVENTIONS, Demand, LoopCase, cases_of
from sim.design.families import certificate, certified, designed, latest_delay
from sim.design.landing import drops
from sim.stability.every_delay import Certificate

T = 0.002
RIGID = Demand(
    mass=(0.08, 0.125),
    damping=1.0,
    delay=(1.2, 1.2),
    period=T,
    radius=0.99,
    nyquist=1e4,
)
JOINT = ((0.0, 0.4, 30.0, 0.02), (0.0, 0.4, 36.0, 0.02))


@pytest.mark.thorough(
    "test_one_law_for_a_joint_all_hands_and_every_sequence_of_delays_that_lands"
)
def test_a_design_for_a_joint_keeps_it_and_one_for_a_rigid_device_does_not() -> None:
    """The bound holds at every device; the rigid design breaks it."""
    asked = replace(RIGID, beyond=JOINT)
    known, blind = designed(asked, 2), designed(replace(asked, beyond=()), 2)
    assert known.found is not None
    assert blind.found is not None
    worst = {}
    for name, law in (("known", known.found.law), ("blind", blind.found.law)):
        worst[name] = max(
            flexible_radius(law, T, FlexiblePlant(mass, 1.0, 1.2, 0.0, *beyond))
            for mass in np.geomspace(0.08, 0.125, 7).tolist()
            for beyond in JOINT
        )
    # Between verified cases the radius moves by less than this; the design keeps its bound at each.
    assert worst["known"] <= 0.99 + 1e-4
    assert worst["blind"] > 1.0
    assert known.found.h1_n_per_m < blind.found.h1_n_per_m
    # Constant delay, but every mass: the certificate asks no more, and is refused where a device is
    # unstable.
    assert certificate(known.found.law, asked) is Certificate.CERTIFIED
    assert certificate(blind.found.law, asked) is Certificate.UNSTABLE


def test_one_law_for_a_joint_all_hands_and_every_sequence_of_delays_that_lands() -> (
    None
):
    """All demands at once, none fulfilled by chance."""
    asked = replace(
        RIGID,
        mass=(0.1, 0.1),
        delay=(1.0, 1.3),
        stiffness=(0.0, 300.0),
        beyond=JOINT,
        lands=CONVENTIONS,
    )
    law = certified(lambda wanted: designed(wanted, 2), asked)
    assert law.found is not None
    assert certificate(law.found.law, asked) is Certificate.CERTIFIED
    assert all(drops(law.found.law, asked).values())
    for hand in (0.0, 100.0, 300.0):
        for beyond in JOINT:
            plant = FlexiblePlant(0.1, 1.0, 1.3, hand, *beyond)
            assert flexible_radius(law.found.law, T, plant) <= 0.99 + 1e-4
    # Half as stiff again, and it is no longer so.
    stiffer = CompiledLaw(tuple((1.5 * law.found.taps).tolist()))
    assert not all(drops(stiffer, asked).values())
    # A delay of more than a tick later is told by the poles of the device that it is.
    latest = latest_delay(law.found.law, asked)
    assert latest is not None
    for late, stable in ((latest - 1e-3, True), (latest + 1e-3, False)):
        plants = [
            FlexiblePlant(0.1, 1.0, late, hand, *beyond)
            for beyond in JOINT
            for hand in (0.0, 300.0)
        ]
        radii = [flexible_radius(law.found.law, T, plant) for plant in plants]
        assert (max(radii) < 1.0) is stable


def test_cases_are_judged_by_the_worst_that_a_device_may_be() -> None:
    asked = replace(RIGID, beyond=((0.002, 0.0, np.inf, 0.0), *JOINT))
    cases = cases_of(asked, 3, 3)
    taps = np.array([300.0, -150.0])
    radii = LoopCase(asked, cases, 2).radii(taps)
    assert radii.shape == (len(cases),)
    each = [
        LoopCase(replace(asked, beyond=(one,)), cases, 2).radii(taps)
        for one in asked.beyond
    ]
    # Roots of a polynomial with two close to 1: the square root of the machine epsilon.
    assert radii == pytest.approx(np.max(each, axis=0), abs=1e-7)
