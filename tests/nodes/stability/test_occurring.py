"""The oscillation frequency (THEORY.md §9): Colgate's condition at ω_c alone is K_max."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.stability.closed_loop import pole_radius
from nodes.stability.k_max import edge_of, k_max, with_spring, without_spring
from nodes.stability.occurring import damping_shown, edge_at
from nodes.stability.plant import Plant

T = 0.002

KINDS: dict[str, dict[str, object]] = {
    "pd": {"kind": "pd", "stiffness": 1.0},
    "half": {
        "kind": "pd_alpha",
        "stiffness": 1.0,
        "order": 0.5,
        "taps": 20,
        "gains": "paper",
    },
    "three_halves": {
        "kind": "pd_alpha",
        "stiffness": 1.0,
        "order": 1.5,
        "taps": 4,
        "gains": "paper",
    },
    "paper_optimum": {"kind": "paper_optimum"},
}
DEVICES = (Plant(T, 0.1, 1.0), Plant(T, 0.045, 0.3), Plant(T, 0.3, 2.0))


def derivative(name: str, gain: float) -> CompiledLaw:
    return without_spring(parse_law({**KINDS[name], "damping": gain}), T)


@pytest.mark.parametrize("name", KINDS)
@pytest.mark.parametrize("body", DEVICES)
@pytest.mark.parametrize("gain", [3.0, 8.0, 25.0])
@pytest.mark.parametrize("delay", [0.0, 0.5, 1.0, 2.0])
def test_colgate_at_the_frequency_that_occurs_is_k_max(
    name: str, body: Plant, gain: float, delay: float
) -> None:
    device = Plant(T, body.mass, body.damping, delay)
    law = derivative(name, gain)
    limit = k_max(law, device).k_max_n_per_m
    edge = edge_of(law, device)
    if limit is None or edge is None:
        pytest.skip("no K is stable, or the loop does not ring at its limit")
    # The boundary is solved to 1e-15 in angle; K moves by its slope along it, some 1e3 of itself.
    assert edge.k_exact_n_per_m == pytest.approx(limit, rel=1e-9)
    # Always low without R, and by what R says.
    assert edge.k_simple_n_per_m < limit
    if delay == 0.0:
        assert edge.k_simple_n_per_m / limit > 0.98
        assert edge.k_exact_n_per_m == pytest.approx(
            2.0 * (device.damping * edge.damping_factor - edge.f_n_s_per_m) / T,
            rel=1e-12,
        )
    if delay in (0.0, 1.0, 2.0):
        # Without the mass: R of a light device is wrong by (bT/m)² and less.
        seen = edge_at(law, device, edge.omega_rad_per_s, light=True)
        assert seen.k_exact_n_per_m == pytest.approx(limit, rel=1e-5)


def test_damping_shown_is_the_series_for_light_damping() -> None:
    for theta in np.linspace(0.05, 3.0, 40).tolist():
        mu = 1e-3
        shown = damping_shown(Plant(T, 0.1, mu * 0.1 / T), theta) / (mu * 0.1 / T)
        # The next term is of order (bT/m)², times the square of the tangent's growth near ω_N.
        assert shown == pytest.approx(
            1.0 + math.tan(0.5 * theta) ** 2 / 3.0,
            rel=1e-5 * (1.0 + math.tan(0.5 * theta) ** 2),
        )


@settings(max_examples=60)
@given(
    taps=st.lists(st.floats(-3000.0, 3000.0), min_size=1, max_size=5),
    mass=st.floats(0.02, 1.0),
    damping=st.floats(0.05, 5.0),
    delay=st.sampled_from([0.0, 0.25, 1.0, 1.5]),
)
def test_any_taps(taps: list[float], mass: float, damping: float, delay: float) -> None:
    device, law = Plant(T, mass, damping, delay), CompiledLaw(tuple(taps))
    limit, edge = k_max(law, device, "pole_radius").k_max_n_per_m, edge_of(law, device)
    if edge is not None and limit is not None and 1e-3 < edge.omega_rad_per_s * T < 3.1:
        assert edge.k_exact_n_per_m == pytest.approx(limit, rel=1e-6)


@pytest.mark.parametrize("name", KINDS)
def test_just_inside_is_stable_and_just_outside_is_not(name: str) -> None:
    law, device = derivative(name, 8.0), Plant(T, 0.1, 1.0)
    edge = edge_of(law, device)
    assert edge is not None
    for share, stable in ((0.999, True), (1.001, False)):
        radius = pole_radius(with_spring(law, share * edge.k_exact_n_per_m), device)
        assert (radius < 1.0) == stable


def test_frequency_must_be_below_nyquist() -> None:
    with pytest.raises(
        ValueError, match=r"^omega = 2000 rad/s: must be between 0 and 1570"
    ):
        edge_at(CompiledLaw((0.0,)), Plant(T, 0.1, 1.0), 2000.0)


@pytest.mark.parametrize("damping", [0.0, 1.0])
def test_a_hand_s_spring_counts_with_damping_and_without(damping: float) -> None:
    law, device = derivative("pd", 8.0), Plant(T, 0.1, damping, 0.5, 800.0)
    edge = edge_of(law, device)
    assert edge is not None
    assert edge.k_exact_n_per_m == pytest.approx(
        k_max(law, device).k_max_n_per_m, rel=1e-9
    )


def test_the_pages_range_of_what_leaving_r_out_costs() -> None:
    """THEORY.md §9: 0.2 to 1.5 % over three devices and gains; 9.4 % over figure 4."""

    def off(name: str, gain: float, device: Plant) -> float | None:
        edge = edge_of(derivative(name, gain), device)
        return (
            None if edge is None else 1.0 - edge.k_simple_n_per_m / edge.k_exact_n_per_m
        )

    few = [
        off(name, gain, device)
        for name in KINDS
        for gain in (3.0, 8.0, 25.0)
        for device in DEVICES
    ]
    known = [one for one in few if one is not None]
    assert (len(known), round(100.0 * min(known), 1), round(100.0 * max(known), 1)) == (
        35,
        0.2,
        1.5,
    )
    gains = np.geomspace(0.5, 60.0, 24).tolist()
    wide = [
        one
        for name in KINDS
        for gain in gains
        if (one := off(name, gain, DEVICES[0])) is not None
    ]
    assert round(100.0 * max(wide), 1) == 9.4
