"""Methods that look right and are not: what THEORY.md warns of, built so that it can be measured.

`sim.paper.failures` makes each of them fail, and says by how much.
"""

from __future__ import annotations

import math

import numpy as np

from nodes.laws import CompiledLaw
from nodes.laws.derivatives import realise
from nodes.laws.derivatives.cfe import whole_order
from nodes.laws.parse import parse_law
from nodes.laws.pd import PD
from nodes.laws.pd_alpha import PDAlpha, combine
from nodes.stability.closed_loop import pole_radius
from nodes.stability.k_max import k_max, with_spring, without_spring
from nodes.stability.plant import Plant
from sim.device.model import DeviceModel, Hand
from sim.experiments.drop import Criterion, drop_scene, free_scene, settles
from sim.paper.descent import paper_targets, survey
from sim.scene.loop import run

PERIOD = 0.002
"""T of everything below [s]: the paper's."""


def optimum(damping: float) -> CompiledLaw:
    """Give the derivative part of the paper's optimum."""
    return without_spring(parse_law({"kind": "paper_optimum", "damping": damping}), PERIOD)


def model(device: Plant) -> DeviceModel:
    """Virtual device of a linear one, a hand held where it is."""
    hand = Hand(stiffness=device.stiffness, path=[(0.0, 0.0)]) if device.stiffness > 0.0 else None
    return DeviceModel(mass=device.mass, damping=device.damping, delay=device.delay, hand=hand)


def euler_k_max(substeps: int, mass: float, damping: float, period: float) -> float:
    """K_max of a spring when the device is integrated by semi-implicit Euler: by the pole radius of its own recurrence."""
    h = period / substeps
    # v⁺ = v + h(u − b v)/m, x⁺ = x + h v⁺, u held over all sub-steps.
    once = np.array(
        [[1.0, h * (1.0 - h * damping / mass), h * h / mass], [0.0, 1.0 - h * damping / mass, h / mass], [0, 0, 1]]
    )
    whole = np.linalg.matrix_power(once, substeps)

    def stable(stiffness: float) -> bool:
        closed = whole[:2, :2] - np.outer(whole[:2, 2], [stiffness, 0.0])
        return bool(np.abs(np.linalg.eigvals(closed)).max() < 1.0)

    top = 4.0 * mass / period**2
    rungs = np.geomspace(1e-6 * top, top, 400).tolist()
    outside = next((i for i, stiffness in enumerate(rungs) if not stiffness or not stable(stiffness)), None)
    if outside is None:
        return math.inf
    low, high = rungs[outside - 1], rungs[outside]
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if stable(middle) else (low, middle)
    return float(low)


def euler_bias(substeps: int) -> tuple[float, float]:
    """Overstatement of K_max by semi-implicit Euler on a heavy device, found and predicted."""
    mass, damping = 10.0, 1.0
    exact = k_max(CompiledLaw((0.0,)), Plant(PERIOD, mass, damping)).k_max_n_per_m
    assert exact is not None  # noqa: S101 - a spring on a damped mass always has a limit
    return euler_k_max(substeps, mass, damping, PERIOD) / exact, 1.0 / (1.0 - 1.0 / substeps)


def gamma_coefficient(order: float, m: int) -> float:
    """Grünwald–Letnikov coefficient by the Gamma ratio that the paper prints, in floating point."""
    from scipy.special import gamma

    with np.errstate(over="ignore", invalid="ignore"):
        return float(gamma(m - order) / (gamma(-order) * gamma(m + 1.0)))


def recursive_coefficient(order: float, m: int) -> float:
    """Grünwald–Letnikov coefficient by the recursion c_m = c_{m−1}(1 − (α+1)/m)."""
    c = 1.0
    for j in range(1, m + 1):
        c *= 1.0 - (order + 1.0) / j
    return c


def leak_law(damping: float, stiffness: float = 1000.0) -> CompiledLaw:
    """Give a PDα whose short memory leaks: α = 1.5, 4 taps, normalised gain."""
    return PDAlpha(stiffness=stiffness, damping=damping, order=1.5, taps=4, gains="paper").compile(PERIOD)


def leak_boundary(stiffness: float = 1000.0) -> float:
    """Find the B at which the leak of `leak_law` eats all of the nominal stiffness: H(1) = 0."""
    return stiffness / (stiffness - leak_law(1.0, stiffness).h1)


def tustin_whole(stiffness: float, gain: float, order: float = 1.5) -> CompiledLaw:
    """Build a PDα whose Tustin-CFE of degree 2 is expanded for the whole α: what must not be done beyond α = 1."""
    zeros, poles = whole_order(order, 2, 1.0)
    n1, n0 = -(zeros[0] + zeros[1]).real, (zeros[0] * zeros[1]).real
    a1, a2 = -(poles[0] + poles[1]).real, (poles[0] * poles[1]).real
    scale = gain * (2.0 / PERIOD) ** order
    direct = n0 / a2
    return CompiledLaw((stiffness + scale * direct,), ((scale * (1.0 - direct), scale * (n1 - direct * a1), a1, a2),))


def tustin_split(stiffness: float, gain: float, order: float = 1.5) -> CompiledLaw:
    """Build the same PDα with the integer part split off."""
    return combine(stiffness, [(gain, realise("tustin_cfe", order, 3, PERIOD))])


def fragility(damping: float = 30.0, share: float = 0.9) -> dict[str, dict[str, tuple[float, bool]]]:
    """Tune PD and the paper's optimum to a share of their K_max at 0.1 kg and no delay, then change the loop."""
    loops = {
        "as tuned": Plant(PERIOD, 0.1, 1.0),
        "one tick of delay": Plant(PERIOD, 0.1, 1.0, 1.0),
        "half a tick of delay": Plant(PERIOD, 0.1, 1.0, 0.5),
        "half the mass": Plant(PERIOD, 0.05, 1.0),
        "twice the mass": Plant(PERIOD, 0.2, 1.0),
    }
    derivatives = {"pd": without_spring(PD(stiffness=1.0, damping=damping), PERIOD), "optimum": optimum(damping)}
    results: dict[str, dict[str, tuple[float, bool]]] = {}
    for name, derivative in derivatives.items():
        limit = k_max(derivative, loops["as tuned"]).k_max_n_per_m
        assert limit is not None  # noqa: S101 - both laws are stable at small K
        law = with_spring(derivative, share * limit)
        results[name] = {}
        for loop, device in loops.items():
            scene = free_scene(model(device), PERIOD)
            results[name][loop] = pole_radius(law, device), settles(scene, [law], Criterion(20_000))[0]
    return results


def chatter(law: CompiledLaw, friction: float, resolution: float = 2.3e-5, ticks: int = 5000) -> bool:
    """See whether a device at rest on a floor keeps chattering across an encoder edge."""
    model = DeviceModel(mass=0.1, damping=1.0, friction=friction, resolution=resolution)
    trace = run(drop_scene(model, PERIOD, False, True, height=1e-4), law, ticks)
    return bool(np.ptp(trace.position[-(ticks // 4) :]) > 0.0)


def descent_outcomes(rate: float) -> dict[str, int]:
    """Count how the paper's steepest descent ends, from a grid of starts."""
    found = survey(paper_targets(), 4, rate, 1000, 5)
    outcomes = sorted({descent.outcome for descent in found})
    return {outcome: sum(descent.outcome == outcome for descent in found) for outcome in outcomes}


def chatter_bound(name: str) -> tuple[float, float, float]:
    """Compare the friction that stops chatter with the bound Δ·H(−1)/2."""
    derivative = optimum(3.0) if name == "optimum" else without_spring(PD(stiffness=1.0, damping=3.0), PERIOD)
    law = with_spring(derivative, 1000.0)
    bound = 0.5 * 2.3e-5 * law.h_nyquist
    low, high = 0.0, 4.0 * bound
    for _ in range(12):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if chatter(law, middle) else (low, middle)
    return law.h_nyquist, high, high / bound
