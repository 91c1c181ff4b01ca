"""What a device feels of a law in a region: forces; stiffness and damping in words."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from nodes.base.setup import Effect
from nodes.coupling.felt_law import added, effective, factored, slow, trailing
from nodes.laws import CompiledLaw
from nodes.laws.parse import compile_law, parse_law
from sim.arrays import Array
from sim.device.filters import filtered

T = 0.002


@pytest.mark.parametrize(
    ("effect", "text"),
    [
        (Effect(name="e"), "K 1000 N/m, B 3 N s/m"),
        (Effect(name="e", stiffness=0.5, damping=0.25), "K 500 N/m, B 0.75 N s/m"),
        # A lag of 10 ms makes a damper of a spring: K τ.
        (Effect(name="e", stiffness=0.5, damping=0.25, lag=0.01), "K 0 N/m, B 5 N s/m"),
        (
            Effect(name="e", stiffness=0.5, damping=0.25, line=True),
            "K 500 N/m, B 0.75 N s/m, and −500 N/m from half its reach on",
        ),
        (
            Effect(name="e", stiffness=0.5, damping=0.25, lag=0.01, line=True),
            "K 500 N/m, B 10.8 N s/m, and −500 N/m from half its reach on",
        ),
    ],
)
def test_stiffness_and_damping_of_slow_motion(effect: Effect, text: str) -> None:
    """A PD of 1000 N/m and 3 N s/m has those at rest."""
    law = compile_law(parse_law({"kind": "pd", "stiffness": 1000.0, "damping": 3.0}), T)
    assert effective(law, effect, T) == text


def rendered(law: CompiledLaw, deflection: Array) -> Array:
    """Return the forces of a law from rest at zero."""
    forces = np.convolve(law.taps, deflection)[: len(deflection)]
    for b0, b1, a1, a2 in law.sections:
        forces = forces + filtered([b0, b1], [1.0, a1, a2], deflection)
    return forces


taps = st.lists(st.floats(-100.0, 100.0), min_size=1, max_size=40)
pole = st.floats(0.05, 0.9)
sections = st.lists(
    st.tuples(st.floats(-9.0, 9.0), st.floats(-9.0, 9.0), pole, pole).map(
        lambda one: (one[0], one[1], -(one[2] + one[3]), one[2] * one[3])
    ),
    max_size=2,
)
laws = st.builds(lambda t, s: CompiledLaw(tuple(t), tuple(s)), taps, sections)
MOTION = np.sin(0.3 * np.arange(60)) + (np.arange(60) % 7 == 3)


@given(laws, st.sampled_from([0.001, 0.02, 0.3, 1.0, 4.0, 30.0, 1000.0]))
def test_a_trailing_proxy_is_a_low_pass_of_the_device(
    law: CompiledLaw, ticks: float
) -> None:
    """The law gets what is left of the motion by a lag [ticks]; so it does as one law."""
    rho = ticks / (ticks + 1.0)
    assume(all(abs(rho * rho + a1 * rho + a2) > 1e-3 for *_, a1, a2 in law.sections))
    wanted = rendered(law, MOTION - filtered([1.0 - rho], [1.0, -rho], MOTION))
    size = sum(map(abs, law.taps)) + sum(
        (abs(b0) + abs(b1)) / (1.0 + a1 + a2) for b0, b1, a1, a2 in law.sections
    )
    found = rendered(trailing(law, ticks * T, T), MOTION)
    # Dividing by ρ up to e¹² leaves half of the digits; a residue divides by what is assumed.
    assert found == pytest.approx(wanted, abs=1e-7 * max(size, 1e-3))


@given(laws, laws, st.floats(0.0, 2.0), st.floats(0.0, 2.0))
def test_factors_of_rest_and_motion_and_sums_of_laws(
    law: CompiledLaw, other: CompiledLaw, stiffness: float, damping: float
) -> None:
    """What a spring of the law's stiffness at rest gives has one factor, the rest another."""
    still = sum(law.taps) + sum(
        (b0 + b1) / (1.0 + a1 + a2) for b0, b1, a1, a2 in law.sections
    )
    forces, others = rendered(law, MOTION), rendered(other, MOTION)
    wanted = stiffness * still * MOTION + damping * (forces - still * MOTION)
    near = 1e-9 * (1.0 + abs(still) + np.abs(forces).max() + np.abs(others).max())
    found = rendered(factored(law, stiffness, damping), MOTION)
    assert found == pytest.approx(wanted, abs=near)
    both = rendered(added(law, other), MOTION)
    assert both == pytest.approx(forces + others, abs=near)


@given(laws)
def test_slow_motion_feels_a_spring_and_a_damper(law: CompiledLaw) -> None:
    """On a ramp of 1 m/s, long after its start, the force is K t + B."""
    stiffness, damping = slow(law, T)
    ticks = 400  # 0.9⁴⁰⁰ is 5e-19
    times: Array = np.arange(ticks, dtype=np.float64) * T
    ramp = rendered(law, times)
    size = sum(map(abs, law.taps)) + sum(
        (abs(b0) + abs(b1)) / (1.0 + a1 + a2) ** 2 for b0, b1, a1, a2 in law.sections
    )
    at = (ticks - 1) * T
    assert ramp[-1] == pytest.approx(stiffness * at + damping, abs=1e-9 * (1.0 + size))
