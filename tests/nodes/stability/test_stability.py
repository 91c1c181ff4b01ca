"""Stability and passivity: closed forms (THEORY.md §1-3), one-tick maps, lifted loop."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from nodes import arithmetic
from nodes.laws import CompiledLaw
from nodes.laws.derivatives import realise
from nodes.laws.parse import parse_law
from nodes.stability import roots
from nodes.stability.closed_loop import (
    closed_loop,
    law_figures,
    pole_radius,
    rendered,
    state_matrix,
)
from nodes.stability.effective_damping import damping_needed, effective_damping, least
from nodes.stability.plant import Plant, held_plant, held_step
from sim.device import model
from sim.device.filters import filtered

T = 0.002


def pd(stiffness: float, damping: float, period: float = T) -> CompiledLaw:
    return CompiledLaw((stiffness + damping / period, -damping / period))


def one_tick_map(
    law: CompiledLaw,
    period: float,
    mass: float,
    damping: float,
    delay: float,
    stiffness: float = 0.0,
) -> NDArray[np.float64]:
    """Return the matrix of one tick, from the simulator's own device and kernels."""
    whole, fraction = model.split_delay(delay)
    n = len(law.taps)
    size = 2 + (n - 1) + whole + 1
    columns = []
    for basis in np.eye(size):
        x, v = basis[0], basis[1]
        history, head = [0.0] * (2 * n), 0
        for older in basis[2 : 1 + n][::-1]:
            head = arithmetic.push(history, head, n, float(older))
        head = arithmetic.push(history, head, n, -x)
        forces = [arithmetic.fir(law.taps, history, head), *basis[1 + n :]]
        kept = [history[head + m] for m in range(n - 1)]
        for force, duration in (
            (forces[whole + 1], fraction * period),
            (forces[whole], (1.0 - fraction) * period),
        ):
            if duration > 0.0:
                x, v = model.advance(
                    x, v, force, model.coefficients(mass, damping, stiffness, duration)
                )
        columns.append([x, v, *kept, *forces[: whole + 1]])
    return np.array(columns).T


@pytest.mark.parametrize("beta", [0.05, 0.4, 2.0 * math.sqrt(2.0) - 2.0, 1.3, 1.95])
def test_pd_boundary_of_a_device_without_friction(beta: float) -> None:
    """κ_max = 2β(2−β)/(2+β) for b = 0, d = 0 (THEORY.md §3); just inside and just outside."""
    mass = 0.1
    limit = 2.0 * beta * (2.0 - beta) / (2.0 + beta) * mass / T**2
    damping = beta * mass / T
    assert pole_radius(pd(limit * (1.0 - 1e-7), damping), Plant(T, mass, 0.0)) < 1.0
    assert pole_radius(pd(limit * (1.0 + 1e-7), damping), Plant(T, mass, 0.0)) > 1.0
    # At the limit itself, a pole is on the circle to the rounding of the companion matrix.
    assert pole_radius(pd(limit, damping), Plant(T, mass, 0.0)) == pytest.approx(
        1.0, abs=1e-12
    )


def test_pd_boundary_peaks_where_theory_says() -> None:
    beta = np.linspace(0.01, 1.99, 100001)
    kappa = 2.0 * beta * (2.0 - beta) / (2.0 + beta)
    # The paper's peak, 12 − 8√2; a flat top seen on a grid of 2e-5.
    assert kappa.max() == pytest.approx(0.6863, abs=5e-5)
    assert beta[kappa.argmax()] == pytest.approx(2.0 * math.sqrt(2.0) - 2.0, abs=2e-5)


@pytest.mark.parametrize("delay", [0.0, 0.5, 1.0, 2.25])
@pytest.mark.parametrize(
    "taps", [(1.0,), (1.8, -0.8), (2.4, -2.0, 0.6), (2.0, -1.5, 0.7, -0.2)]
)
def test_heavy_device(delay: float, taps: tuple[float, ...]) -> None:
    """H(1)_max → (b − T Σ m h_m)/(T(½ + d)) for a heavy device (THEORY.md §3)."""
    damping = 4.0
    derivative = np.array(taps) - np.eye(len(taps))[0] * sum(taps)
    derivative *= 300.0
    lead = -T * float(np.dot(np.arange(len(taps)), derivative))
    limit = (damping + lead) / (T * (0.5 + delay))
    errors = []
    for mass in (1e2, 1e4):
        for side in (-1.0, 1.0):
            # First-order in 1/m: (h T/m) times a few; at 1e4 kg that is below 1e-4.
            margin = 0.3 / math.sqrt(mass)
            law = derivative.copy()
            law[0] += limit * (1.0 + side * margin)
            errors.append(
                (
                    pole_radius(CompiledLaw(tuple(law)), Plant(T, mass, damping, delay))
                    - 1.0
                )
                * side
            )
    assert min(errors) > 0.0


@pytest.mark.parametrize("delay", [0, 1, 2, 5])
def test_passive_spring_with_delay(delay: int) -> None:
    """KT/b < 2/(1+2d) (THEORY.md §2)."""
    spring = CompiledLaw((1000.0,))
    assert damping_needed(spring, T, delay) == pytest.approx(
        1000.0 * T * (1.0 + 2.0 * delay) / 2.0, rel=1e-12
    )


def test_passive_pd_without_delay_is_colgates() -> None:
    """Damping needed is KT/2 + B (paper, eq. 4)."""
    assert damping_needed(pd(1000.0, 3.0), T) == pytest.approx(
        1000.0 * T / 2.0 + 3.0, rel=1e-12
    )


@pytest.mark.parametrize(
    ("order", "bound"), [(0, 0.667), (1, 0.828), (2, 0.894), (3, 0.928)]
)
def test_published_delay_aware_bounds_at_one_tick(order: int, bound: float) -> None:
    assert 2.0 / (1.0 + 1.0 / math.cos(math.pi / (order + 3))) == pytest.approx(
        bound, abs=6e-4
    )


def lifted_damping(
    law: CompiledLaw, period: float, delay: float, aliases: int
) -> float:
    """Return the passivity limit of the loop lifted to its aliases, by eigenvalues."""
    worst = -math.inf
    n = np.arange(-aliases, aliases + 1)
    for theta in np.linspace(1e-3, math.pi, 40):
        omega = (theta + 2.0 * math.pi * n) / period
        hold = (
            (1.0 - np.exp(-1j * theta))
            / (1j * omega * period)
            * np.exp(-1j * omega * period * delay)
        )
        sample = 1.0 / (1j * omega)
        loop = law.response(np.exp(1j * theta)) * np.outer(hold, sample)
        worst = max(
            worst, -float(np.linalg.eigvalsh(0.5 * (loop + loop.conj().T)).min())
        )
    return worst


@pytest.mark.parametrize("delay", [0.0, 0.3, 0.5, 1.0, 1.7])
@pytest.mark.parametrize(
    "taps", [(1000.0,), (2500.0, -1500.0), (3000.0, -3500.0, 1700.0, -300.0)]
)
def test_passivity_at_fractional_delay_against_the_lifted_loop(
    delay: float, taps: tuple[float, ...]
) -> None:
    law = CompiledLaw(taps)
    # Aliases left out carry 1/(π² n) of the sum: 1.2e-3 at 81 aliases; the grid of 40 frequencies
    # costs as much again.
    assert damping_needed(law, T, delay) == pytest.approx(
        lifted_damping(law, T, delay, 40), rel=6e-3
    )


@given(
    st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=6),
    st.sampled_from([0.0, 0.4, 1.0, 2.0]),
    st.floats(-3.0, 1.0),
    st.floats(0.0, 1e4),
)
@settings(max_examples=50)
def test_a_passive_law_is_stable_with_any_mass_and_any_hand(
    taps: list[float], delay: float, decade: float, hand: float
) -> None:
    law = CompiledLaw(tuple(taps))
    assume(law.h1 > 1e-3)
    needed = damping_needed(law, T, delay)
    scaled = CompiledLaw(tuple(0.999 * tap / needed for tap in taps))
    # Marginal at z = 1 as H(1) T/b → 0: the slowest pole is known to the square root of rounding at
    # worst.
    assert pole_radius(scaled, Plant(T, 10.0**decade, 1.0, delay, hand)) < 1.0 + 1e-9


@pytest.mark.parametrize("order", [0.3, 0.5, 1.5, 2.5])
def test_f_of_one_term_with_long_memory(order: float) -> None:
    """Infinite memory: f = T^(1−α) (2 sin(ωT/2))^(α−1) cos((α+1)(π−ωT)/2) (THEORY.md §2)."""
    unit = realise("gl", order, 4001, T)
    law = CompiledLaw(unit.taps)
    theta = np.linspace(0.1, np.pi, 200)
    f = effective_damping(law, T, theta / T) + 0.5 * T * law.h1
    expected = (
        T ** (1 - order)
        * (2 * np.sin(theta / 2)) ** (order - 1)
        * np.cos((order + 1) * (np.pi - theta) / 2)
    )
    # The missing tail, summed by parts: at most 2 |c_n|/|1 − e^{jθ}|² ≈ 2 n^(−α−1)/|Γ(−α)|/0.01.
    tail = (
        T ** (1 - order) * 200.0 * 4000.0 ** (-order - 1)
        + 1e-10 * np.abs(expected).max()
    )
    assert np.abs(f - expected).max() < tail
    assert np.sign(f[0]) == np.sign(expected[0])


@pytest.mark.parametrize("order", [0.4, 1.0, 1.6, 3.2])
@pytest.mark.parametrize("taps", [2, 5, 40])
def test_waterbed(order: float, taps: int) -> None:
    """The mean of f over (0, ω_N) is T·D(1)/2 (THEORY.md §2), by quadrature of Re{D/(1−z)}."""
    unit = CompiledLaw(realise("gl", order, taps, T).taps)
    nodes, weights = np.polynomial.legendre.leggauss(2 * taps + 60)
    theta = 0.5 * np.pi * (nodes + 1.0)
    z = np.exp(1j * theta)
    d = np.array([unit.response(complex(point)) for point in z])
    mean = 0.5 * float(np.dot(weights, T * (d / (1.0 - z)).real))
    scale = T * sum(map(abs, unit.taps))
    assert mean == pytest.approx(0.5 * T * unit.h1, abs=1e-9 * scale)
    shifted = CompiledLaw((unit.taps[0] + 1e3, *unit.taps[1:]))
    assert rendered(shifted, T, nominal=1e3).f_mean_n_s_per_m == pytest.approx(
        0.5 * T * unit.h1, abs=1e-9 * scale
    )


def test_no_linear_law_beats_the_strict_limit_without_delay() -> None:
    """H(1) T/2 ≤ damping needed, for any law: max f ≥ mean f = 0 (THEORY.md §2)."""
    rng = np.random.default_rng(7)
    for _ in range(30):
        law = CompiledLaw(tuple(rng.normal(size=rng.integers(1, 9))))
        assert damping_needed(law, T) >= 0.5 * T * law.h1 - 1e-12


def test_figures_of_the_papers_optimum() -> None:
    """Read off: f ≈ −1 over the low and middle range, f(ω_N) = 1.69 + 1.32 (THEORY.md §1, §2)."""
    law = parse_law(
        {"kind": "paper_optimum", "stiffness": 1000.0, "damping": 1.0}
    ).compile(T)
    omega = np.linspace(0.02, 0.55, 50) * np.pi / T
    f = effective_damping(law, T, omega) + 0.5 * T * (law.h1 - 1000.0)
    # "Flat" is the paper's figure, not its text: the ripple is a seventh of the level.
    assert np.abs(f + 1.0).max() < 0.14
    assert rendered(law, T, nominal=1000.0).f_nyquist_n_s_per_m == pytest.approx(
        3.0, abs=0.05
    )


@pytest.mark.parametrize("delay", [0.0, 0.25, 0.999, 1.0, 1.5, 3.0])
@pytest.mark.parametrize("hand", [0.0, 300.0])
@pytest.mark.parametrize(
    "taps", [(900.0,), (2500.0, -1500.0), (3149.0, -3928.0, 2203.0, -638.0)]
)
def test_three_ways_to_the_same_poles(
    delay: float, hand: float, taps: tuple[float, ...]
) -> None:
    """Polynomial, state matrix, and the simulator's own one-tick map."""
    law, mass, damping = CompiledLaw(taps), 0.08, 0.7
    from_polynomial = pole_radius(law, Plant(T, mass, damping, delay, hand))
    from_state = np.abs(
        np.linalg.eigvals(state_matrix(law, Plant(T, mass, damping, delay, hand)))
    ).max()
    from_ticks = np.abs(
        np.linalg.eigvals(one_tick_map(law, T, mass, damping, delay, hand))
    ).max()
    # Simple poles, a few roundings times the condition of the eigenvalues (below 1e3 here).
    assert from_polynomial == pytest.approx(from_state, rel=1e-11)
    assert from_polynomial == pytest.approx(from_ticks, rel=1e-11)


@pytest.mark.parametrize("taps", [(900.0,), (2400.0, -1500.0), (9.0, -5.0, 2.0, -1.0)])
@pytest.mark.parametrize("delay", [0.0, 1.0, 3.0, 0.5, 1.25])
def test_the_polynomial_has_a_root_for_each_number_that_the_loop_remembers(
    delay: float, taps: tuple[float, ...]
) -> None:
    """Position, velocity, older samples and forces under way; no root at 0 beside them."""
    polynomial = closed_loop(CompiledLaw(taps), Plant(T, 0.1, 1.0, delay))
    assert len(polynomial) - 1 == 2 + len(taps) - 1 + math.ceil(delay)
    assert polynomial[0] == 1.0
    assert polynomial[-1] != 0.0


def test_fractional_delay_is_continuous_at_whole_ticks() -> None:
    law = pd(800.0, 3.0)
    for whole in (1.0, 2.0):
        at = pole_radius(law, Plant(T, 0.1, 1.0, whole))
        assert pole_radius(law, Plant(T, 0.1, 1.0, whole - 1e-9)) == pytest.approx(
            at, abs=1e-8
        )
        assert pole_radius(law, Plant(T, 0.1, 1.0, whole + 1e-9)) == pytest.approx(
            at, abs=1e-8
        )


@pytest.mark.parametrize(
    ("mass", "damping", "stiffness", "duration"),
    [
        (0.1, 1.0, 0.0, T),
        (0.1, 0.0, 0.0, T),
        (0.1, 1e-9, 0.0, T),
        (0.1, 0.0, 500.0, T),
        (0.05, 30.0, 5000.0, 0.02),
    ],
)
def test_held_step_against_the_virtual_device(
    mass: float, damping: float, stiffness: float, duration: float
) -> None:
    """The series of the matrix exponential against the closed forms of sim/device/model.py."""
    _, transition, newer, older = held_step(
        Plant(duration, mass, damping, 0.0, stiffness)
    )
    # Squaring three times loses three bits of 53, and cancels a little in the oscillating case.
    assert (*transition, *newer) == pytest.approx(
        model.coefficients(mass, damping, stiffness, duration), rel=1e-12
    )
    assert older == (0.0, 0.0)


def test_whole_and_nearly_whole_delay_give_the_same_plant() -> None:
    assert held_plant(Plant(T, 0.1, 1.0, 2.0)).whole == 2
    assert held_plant(Plant(T, 0.1, 1.0, 2.0)).numerator[2] == 0.0
    assert held_plant(Plant(T, 0.1, 1.0, 1.75)).numerator[2] > 0.0


@pytest.mark.parametrize("name", ["mass", "damping", "period", "delay", "stiffness"])
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
def test_impossible_devices_are_refused_by_name(name: str, value: float) -> None:
    device: dict[str, Any] = {
        "mass": 0.1,
        "damping": 1.0,
        "period": T,
        "delay": 0.0,
        "stiffness": 0.0,
        name: value,
    }
    with pytest.raises(ValueError, match=rf"^{name} = "):
        held_plant(Plant(**device))


def long_law(
    order: float, taps: int, stiffness: float = 1500.0, damping: float = 2.0
) -> CompiledLaw:
    data = {"kind": "pd_alpha", "stiffness": stiffness, "damping": damping, "order": order,
    "taps": taps,
            "gains": "paper"}  # fmt: skip
    return parse_law(data).compile(T)


@pytest.mark.parametrize("order", [0.3, 0.7, 1.5, 2.5, 3.5])
@pytest.mark.parametrize("stiffness", [300.0, 5000.0])
def test_counted_radius_is_the_companions(
    order: float, stiffness: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    law = long_law(order, 250, stiffness)
    coefficients = closed_loop(law, Plant(T, 0.1, 1.0, 0.5))
    companion = float(roots.largest_roots(coefficients[None, :])[0])
    # The companion matrix of degree 253 is good to some thousand roundings.
    assert pole_radius(law, Plant(T, 0.1, 1.0, 0.5)) == pytest.approx(
        companion, rel=1e-11
    )
    monkeypatch.setattr(roots, "COMPANION_LIMIT", 1)
    assert pole_radius(law, Plant(T, 0.1, 1.0, 0.5)) == pytest.approx(
        companion, rel=1e-11
    )


@pytest.mark.parametrize("taps", [2000, 4001])
@pytest.mark.parametrize("order", [0.5, 1.5, 3.47])
def test_thousands_of_taps(order: float, taps: int) -> None:
    """No root is outside a slightly larger circle, one outside a slightly smaller one."""
    coefficients = closed_loop(long_law(order, taps), Plant(T, 0.1, 1.0, 1.0))
    radius = roots.largest_root(coefficients)
    assert roots.roots_outside(coefficients, radius * (1.0 + 1e-9)) == 0
    assert (roots.roots_outside(coefficients, radius * (1.0 - 1e-9)) or 0) > 0


@given(st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=30), st.floats(0.3, 3.0))
@settings(max_examples=100)
def test_count_outside_a_circle(coefficients: list[float], radius: float) -> None:
    c = np.array([1.0, *coefficients])
    moduli = np.abs(np.roots(c))
    # numpy knows multiple roots only to a root of its rounding: leave those alone.
    assume(np.abs(moduli / radius - 1.0).min(initial=1.0) > 1e-3)
    assert roots.roots_outside(c, radius) == int((moduli > radius).sum())


def test_a_ring_of_roots_on_the_circle_has_radius_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(roots, "COMPANION_LIMIT", 1)
    for degree in (3, 200, 1500):
        c = np.zeros(degree + 1)
        c[0], c[-1] = 1.0, -1.0
        assert roots.largest_root(c) == pytest.approx(1.0, abs=1e-12)
        c[-1] = -2.0
        assert roots.largest_root(c) == pytest.approx(2.0 ** (1.0 / degree), rel=1e-12)


def test_polynomials_without_a_degree_are_refused() -> None:
    with pytest.raises(ValueError, match="leading"):
        roots.largest_root(np.array([0.0, 1.0]))
    assert roots.largest_root(np.array([2.0, 0.0, 0.0])) == 0.0


@pytest.mark.parametrize("delay", [0.0, 0.5, 2.0])
def test_sections_against_the_long_tap_vector_they_stand_for(delay: float) -> None:
    """Sections and their impulse response, cut below rounding, have equal poles."""
    sections = ((900.0, -700.0, -1.7, 0.73), (-300.0, 280.0, -0.9, 0.3))
    law = CompiledLaw((1500.0, -400.0), sections)
    impulse = np.zeros(700)
    impulse[0] = 1.0
    taps = np.zeros(700)
    taps[:2] = law.taps
    for b0, b1, a1, a2 in sections:
        taps += filtered([b0, b1], [1.0, a1, a2], impulse)
    long = CompiledLaw(tuple(taps))
    assert pole_radius(law, Plant(T, 0.05, 2.0, delay)) == pytest.approx(
        pole_radius(long, Plant(T, 0.05, 2.0, delay)), rel=1e-9
    )
    assert damping_needed(law, T, delay) == pytest.approx(
        damping_needed(long, T, delay), rel=1e-9
    )
    assert least(law, T)[1] == pytest.approx(least(long, T)[1], rel=1e-9)
    with pytest.raises(ValueError, match="sections"):
        closed_loop(law, Plant(T, 0.05, 2.0, delay))


def test_figures_for_machines() -> None:
    law = pd(1000.0, 3.0)
    figures = law_figures(law, Plant(T, 0.1, 1.0, 1.0))
    assert figures["taps_n_per_m"] == list(law.taps)
    assert figures["h1_n_per_m"] == pytest.approx(1000.0, rel=1e-12)
    assert figures["h_nyquist_n_per_m"] == pytest.approx(
        1000.0 + 2.0 * 3.0 / T, rel=1e-12
    )
    assert figures["f_min_n_s_per_m"] == pytest.approx(-3.0, rel=1e-9)
    assert figures["f_nyquist_n_s_per_m"] == pytest.approx(3.0, rel=1e-12)
    assert figures["passive_scale"] == pytest.approx(
        1.0 / figures["damping_needed_n_s_per_m"]
    )
    assert figures["pole_radius"] == pole_radius(law, Plant(T, 0.1, 1.0, 1.0))
    assert law_figures(law, T)["pole_radius"] is None


def test_what_a_hand_adds() -> None:
    """A hand's stiffness: without coupling, oscillations decay by e^{−bT/2m} per tick."""
    weak = CompiledLaw((1e-9,))
    assert pole_radius(weak, Plant(T, 0.1, 1.0, 0.0, 400.0)) == pytest.approx(
        math.exp(-1.0 * T / 0.2), rel=1e-9
    )


@pytest.mark.parametrize(
    "wrong",
    [
        {"mass": 0.0},
        {"mass": "a"},
        {"period": 0.0},
        {"damping": -1.0},
        {"delay": math.nan},
        {"stiffness": -1.0},
    ],
)
def test_what_no_device_is_is_refused_at_once(wrong: dict[str, Any]) -> None:
    (name,) = wrong
    with pytest.raises(ValueError, match=rf"^{name} = .*: must be finite and"):
        Plant(**{"period": 0.002, "mass": 0.1, "damping": 1.0, **wrong})


def test_a_plant_is_made_of_a_rate_or_a_period() -> None:
    assert Plant(rate=500, mass=0.1, damping=1.0) == Plant(0.002, 0.1, 1.0)
    assert Plant(0.002, 0.1, 1.0).rate == pytest.approx(500.0, rel=1e-15)
    with pytest.raises(
        ValueError, match=r"period = 500 s: must be at most 1 s; .*rate=500"
    ):
        Plant(500, 0.1, 1.0)
    assert Plant(1.0, 0.1, 1.0).period == 1.0  # the longest
    with pytest.raises(TypeError, match="missing mass, damping"):
        Plant(0.002)  # type: ignore[call-overload]
    with pytest.raises(TypeError, match="missing period or rate"):
        Plant(mass=0.1, damping=1.0)  # type: ignore[call-overload]
    with pytest.raises(TypeError, match="period and rate are the same quantity"):
        Plant(0.002, 0.1, 1.0, rate=500)  # type: ignore[call-overload]
    assert type(Plant(0.002, np.float64(0.1), 1).mass) is float


@pytest.mark.parametrize("terms", [5, 100, 1000])
def test_a_transform_errs_by_a_twelfth_of_the_bound_of_its_rounding(terms: int) -> None:
    """`roots_outside` counts on 2⁻⁵² log₂(n) Σ|c|: against exact sums at some of its points."""
    chance = np.random.default_rng(terms)
    c = chance.normal(size=terms) * np.exp(-3.0 * np.arange(terms) / terms)
    points = 1 << math.ceil(math.log2(16 * terms))
    values = np.fft.rfft(c, points)
    for k in [0, 1, points // 7, points // 4, points // 2]:
        turns = [(k * j) % points / points for j in range(terms)]
        real = math.fsum(
            v * math.cos(2.0 * math.pi * t) for v, t in zip(c, turns, strict=True)
        )
        imaginary = -math.fsum(
            v * math.sin(2.0 * math.pi * t) for v, t in zip(c, turns, strict=True)
        )
        bound = 2.0**-52 * math.log2(points) * np.abs(c).sum()
        # The sums themselves err by the rounding of their cosines.
        own = 2.0**-52 * float(np.abs(c).max()) * math.sqrt(terms)
        assert abs(values[k] - complex(real, imaginary)) <= bound / 12.0 + own


def test_newton_stops_where_the_slope_is_zero() -> None:
    """(1 − w)² has a double root at w = 1, where it starts; its slope there is exactly 0."""
    assert roots._newton(np.array([1.0, -2.0, 1.0]), 0.5, 2.0) == 1.0
