"""Encoder and friction (THEORY.md §5): bounds by worst motion and by simulated drops."""

from __future__ import annotations

import numpy as np
import pytest

from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.laws.pd import PD
from nodes.stability.k_max import k_max, with_spring, without_spring
from nodes.stability.plant import Plant
from sim.device.model import DeviceModel, quantise
from sim.experiments.drop import drop_scene
from sim.play.one_axis import run
from sim.play.one_axis_inputs import Scene, SceneSurface
from sim.stability.rest import ComesToRest, absolute_sum, rest, stiffest_at_rest

T, STEP = 0.002, 2.3e-5


def derivative(name: str, gain: float) -> CompiledLaw:
    data = (
        {"kind": "paper_optimum"}
        if name == "paper_optimum"
        else {"kind": "pd", "stiffness": 1.0}
    )
    return without_spring(parse_law({**data, "damping": gain}), T)


def taken_out(law: CompiledLaw, friction: float) -> float:
    """Return the energy per tick of a motion across an encoder edge, in phase with force [J]."""
    path = 1e-9
    inside, outside = 10.5 * STEP - 0.5 * path, 10.5 * STEP + 0.5 * path
    x = np.where(np.arange(4000) % 2, outside, inside)
    read = np.array([quantise(float(value), STEP) for value in x])
    assert np.ptp(read) == pytest.approx(STEP)
    force = -np.convolve(read, law.taps)[: len(x)]
    # An even number of ticks: the mean force does no work.
    work = force[100:-2] * np.diff(x)[100:-1]
    # One way round the force drives the motion, the other way it hinders it: whoever moves the
    # device chooses.
    return abs(float(work.mean())) - friction * path


@pytest.mark.parametrize(
    ("name", "gain"), [("pd", 0.0), ("pd", 3.0), ("paper_optimum", 3.0)]
)
def test_alternation_takes_out_energy_just_below_the_bound_and_none_just_above(
    name: str, gain: float
) -> None:
    law = with_spring(derivative(name, gain), 1000.0)
    limit = rest(law, T, STEP).friction_alternating_n
    # The force also follows the nanometre of motion itself: 1e-9/2.3e-5 of the error's.
    assert taken_out(law, 0.999 * limit) > 0.0 > taken_out(law, 1.001 * limit)


def still(law: CompiledLaw, friction: float, delay: float) -> bool:
    """Whether drops from twelve small heights all come to a dead stop."""
    model = DeviceModel(
        mass=0.1, damping=1.0, friction=friction, resolution=STEP, delay=delay
    )
    drops = (
        run(drop_scene(model, T, False, True, height=h), law, 2500)
        for h in np.linspace(2e-6, 3e-4, 12).tolist()
    )
    return all(float(np.ptp(drop.position[-600:])) == 0.0 for drop in drops)


@pytest.mark.parametrize("delay", [0.0, 1.0])
@pytest.mark.parametrize(
    ("name", "gain"), [("pd", 0.0), ("pd", 3.0), ("pd", 12.0), ("paper_optimum", 3.0)]
)
def test_with_the_bounds_friction_every_drop_comes_to_a_stop(
    name: str, gain: float, delay: float
) -> None:
    loop = derivative(name, gain)
    limit = k_max(loop, Plant(T, 0.1, 1.0, delay)).k_max_n_per_m
    assert limit is not None
    for share in (0.3, 0.7):
        law = with_spring(loop, share * limit)
        found = rest(law, Plant(T, 0.1, 1.0, delay), STEP)
        assert found.friction_estimated_n is not None
        assert found.friction_estimated_n <= found.friction_bound_n
        assert still(law, 1.001 * found.friction_bound_n, delay)
        assert still(law, found.friction_estimated_n, delay)
        # And without enough of it the device buzzes: the bound is not about nothing.
        assert not still(law, 1e-3 * found.friction_bound_n, delay)


def swings_on(law: CompiledLaw, plant: Plant, friction: float) -> bool:
    """Whether one of many small starts on a two-sided spring still moves after eight seconds."""
    random = np.random.default_rng(0)
    for _ in range(60):
        size = STEP * 10.0 ** random.uniform(-1.0, 1.0)
        position, velocity = (
            float(v) for v in random.uniform(-size, size, 2) * (1.0, 1.0 / T)
        )
        body = DeviceModel(
            mass=plant.mass,
            damping=plant.damping,
            friction=friction,
            resolution=STEP,
            position=position,
            velocity=velocity,
        )
        anchor = SceneSurface("anchor", position=float(random.uniform(-STEP, STEP)))
        trace = run(
            Scene(device=body, surface=anchor, period=T, raw=False, clamp=False),
            law,
            4000,
        )
        if float(np.ptp(trace.position[-600:])) > 0.0:
            return True
    return False


def test_only_the_bound_says_that_no_limit_cycle_is_left() -> None:
    # Passive on this device, so the bound is a proof; a swing of a hundredth of a step lives on
    # above the estimate.
    law, plant = CompiledLaw((704.179, 353.287)), Plant(T, 0.0578, 3.9782)
    found = rest(law, plant, STEP)
    assert found.certain
    assert found.friction_estimated_n is not None
    beyond = 1.4 * found.friction_estimated_n
    assert swings_on(law, plant, beyond)
    assert found.free(beyond) is ComesToRest.ESTIMATED
    assert not swings_on(law, plant, found.friction_bound_n)
    assert found.free(found.friction_bound_n) is ComesToRest.PROVEN
    assert found.free(0.99 * found.friction_estimated_n) is ComesToRest.NOT_PROVEN
    assert "no bound" in found.text()


def test_spring_and_pd_are_abbott_and_okamuras() -> None:
    friction = 0.06
    spring = stiffest_at_rest(CompiledLaw((0.0,)), STEP, friction)
    assert spring == pytest.approx(2.0 * friction / STEP, rel=1e-14)
    for gain in (0.5, 2.0):
        k = stiffest_at_rest(derivative("pd", gain), STEP, friction)
        assert k == pytest.approx(2.0 * friction / STEP - 2.0 * gain / T, rel=1e-12)
        law = PD(stiffness=k, damping=gain).compile(T)
        assert rest(law, T, STEP).friction_bound_n == pytest.approx(friction, rel=1e-12)
        # Passive up to K < 2(b − B)/T, paper eq. (4): just inside it is a proof, just outside it is
        # not.
        for share, certain in ((0.999, True), (1.001, False)):
            inside = PD(stiffness=share * 2.0 * 1.0 / T, damping=gain).compile(T)
            assert rest(inside, Plant(T, 0.1, 1.0 + gain), STEP).certain == certain


def test_sections_are_summed_to_the_end() -> None:
    law = CompiledLaw((100.0,), ((50.0, -20.0, -1.6, 0.65),))
    impulse = np.zeros(2000)
    impulse[0] = 1.0
    response, y = [], [0.0, 0.0]
    for k in range(2000):
        new = (
            50.0 * impulse[k]
            + (-20.0 * impulse[k - 1] if k else 0.0)
            + 1.6 * y[0]
            - 0.65 * y[1]
        )
        y = [new, y[0]]
        response.append(new + 100.0 * impulse[k])
    assert absolute_sum(law) == pytest.approx(sum(map(abs, response)), rel=1e-9)


def test_the_newest_tap_of_a_law_with_sections_is_theirs_too() -> None:
    """A section starting against the spring was missing in h_0; K_rest was too low."""
    loop, friction = CompiledLaw((0.0,), ((-50.0, 20.0, -0.5, 0.0),)), 0.06
    k = stiffest_at_rest(loop, STEP, friction)
    # Its error's force is then just the friction.
    assert rest(with_spring(loop, k), T, STEP).friction_bound_n == pytest.approx(
        friction, rel=1e-9
    )


def test_a_hand_s_spring_is_in_the_estimate() -> None:
    """Without it, a device held by a stiff hand was said to buzz like a free one."""
    law = CompiledLaw((1000.0,))
    free, held = (rest(law, Plant(T, 0.1, 0.1, 0.0, hand), STEP) for hand in (0.0, 1e6))
    assert free.friction_estimated_n is not None
    assert free.friction_estimated_n > 0.0
    # Up to ω_N the mass takes less force than this spring gives: a spring of the law cannot make it
    # swing.
    assert (held.friction_estimated_n, held.buzz_hz) == (0.0, None)
