"""A design for a device with a joint and a lag: stable by the poles of each device that it may be, and what it costs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nodes.stability.flexible import FlexiblePlant, flexible_radius
from sim.design.cases import LoopCase, cases_of
from sim.design.demand import Demand
from sim.design.families import certificate, designed

T = 0.002
RIGID = Demand(mass=(0.08, 0.125), damping=1.0, delay=(1.2, 1.2), period=T, radius=0.99, nyquist=1e4)
JOINT = ((0.0, 0.4, 30.0, 0.02), (0.0, 0.4, 36.0, 0.02))


def test_a_design_for_a_joint_keeps_it_and_one_for_a_rigid_device_does_not() -> None:
    """The bound holds at every device of the demand; the rigid design breaks it on the same ones."""
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
    # No certificate for every sequence of delays is claimed where none is computed.
    assert certificate(known.found.law, asked) is None


def test_cases_are_judged_by_the_worst_that_a_device_may_be() -> None:
    asked = replace(RIGID, beyond=((0.002, 0.0, np.inf, 0.0), *JOINT))
    cases = cases_of(asked, 3, 3)
    taps = np.array([300.0, -150.0])
    radii = LoopCase(asked, cases, 2).radii(taps)
    assert radii.shape == (len(cases),)
    each = [LoopCase(replace(asked, beyond=(one,)), cases, 2).radii(taps) for one in asked.beyond]
    # Roots of a polynomial with two close to 1: the square root of the machine epsilon.
    assert radii == pytest.approx(np.max(each, axis=0), abs=1e-7)
