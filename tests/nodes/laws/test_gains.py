"""Gains of PDα: whole orders, the leak of a short memory, paper and physical units."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import special

from nodes.laws import CompiledLaw
from nodes.laws.parse import LawRefusedError, law_to_dict, parse_law
from nodes.laws.presets import PRESETS

T = 0.002


def pd_alpha(
    order: float, taps: int = 12, gains: str = "physical", **more: float
) -> CompiledLaw:
    values = {"stiffness": 1e6, "damping": 1.0, **more}
    return parse_law(
        {"kind": "pd_alpha", "order": order, "taps": taps, "gains": gains, **values}
    ).compile(T)


def test_order_one_is_pd() -> None:
    pd = parse_law({"kind": "pd", "stiffness": 1e6, "damping": 1.0}).compile(T)
    fractional = pd_alpha(1.0)
    assert fractional.taps[:2] == pytest.approx(pd.taps, rel=1e-15)
    assert not any(fractional.taps[2:])


def test_order_two_is_the_second_difference() -> None:
    taps = pd_alpha(2.0, stiffness=1.0).taps
    assert taps[:3] == pytest.approx((1.0 + T**-2, -2.0 * T**-2, T**-2), rel=1e-15)
    assert not any(taps[3:])


@pytest.mark.parametrize("order", [1.0, 2.0, 3.0])
def test_taps_approach_whole_orders_linearly(order: float) -> None:
    whole = np.array(pd_alpha(order).taps)
    scale = T**-order
    for epsilon in (1e-3, 1e-5, 1e-7):
        for sign in (1.0, -1.0):
            near = np.array(pd_alpha(order + sign * epsilon).taps)
            # d/dα of T^−α c_m: |ln T| ≈ 6.2 times c_m (≤ 3 up to order 3), plus dc_m/dα (≤ 11).
            assert np.abs(near - whole).max() <= 30.0 * epsilon * scale


@pytest.mark.parametrize("order", [0.3, 0.5, 1.5, 2.5, 3.47])
@pytest.mark.parametrize("taps", [2, 4, 50, 4001])
def test_leak_of_the_truncated_derivative(order: float, taps: int) -> None:
    """Σ_{m≤n} (−1)^m C(α, m) = (−1)^n C(α−1, n): stiffness that truncation adds to K."""
    law = pd_alpha(order, taps, stiffness=1.0)
    n = taps - 1
    leak = T**-order * (-1.0) ** n * special.binom(order - 1.0, n)
    # The taps cancel: their sum is exact to some roundings of their size; binom of scipy is good to
    # about 1e-10.
    rounding = taps * 2.0**-52 * sum(map(abs, law.taps))
    assert law.h1 - 1.0 == pytest.approx(leak, rel=1e-9, abs=rounding + 1e-12)
    if n > 3 and abs(leak) > 10 * rounding:
        assert (law.h1 > 1.0) == (order < 1.0 or 2.0 < order < 3.0)


@pytest.mark.parametrize("order", [0.25, 0.75, 1.0, 1.5, 2.5, 3.75])
@pytest.mark.parametrize("period", [0.00025, 0.002, 0.004])
@pytest.mark.parametrize("taps", [2, 4, 10, 500])
def test_paper_gain_is_f_at_nyquist_of_the_sum_that_renders(
    order: float, period: float, taps: int
) -> None:
    """H(−1) = K + (2/T)·f(ω_N), and f(ω_N) = B for any n (paper, eq. 9; THEORY.md §1)."""
    data = {
        "kind": "pd_alpha",
        "stiffness": 1.0,
        "damping": 3.0,
        "order": order,
        "taps": taps,
        "gains": "paper",
    }
    law = parse_law(data).compile(period)
    # taps roundings of the largest tap, in units of f.
    rounding = taps * 2.0**-52 * period * sum(map(abs, law.taps))
    assert 0.5 * period * (law.h_nyquist - 1.0) == pytest.approx(3.0, abs=rounding)


@pytest.mark.parametrize("damping", [1.0, 3.0])
def test_paper_optimum_has_the_sum_of_its_gains_at_nyquist(damping: float) -> None:
    law = parse_law(
        {"kind": "paper_optimum", "damping": damping, "stiffness": 700.0}
    ).compile(T)
    # A few roundings of H(−1), some 1e4 N/m.
    assert 0.5 * T * (law.h_nyquist - 700.0) == pytest.approx(
        damping * (1.69 + 1.32), rel=1e-13
    )


@pytest.mark.parametrize("order", [0.25, 0.75, 1.5, 2.5, 3.75])
@pytest.mark.parametrize("period", [0.00025, 0.002, 0.004])
def test_unlimited_gain_is_f_at_nyquist_of_unlimited_memory(
    order: float, period: float
) -> None:
    data = {
        "kind": "pd_alpha",
        "stiffness": 1.0,
        "damping": 3.0,
        "order": order,
        "taps": 4001,
        "gains": "unlimited",
    }
    law = parse_law(data).compile(period)
    f = 0.5 * period * (law.h_nyquist - 1.0)
    # At z = −1 the series Σ|c_m| settles like an alternating or a positive one, tail below
    # n^−α/|Γ(1−α)|.
    assert f == pytest.approx(3.0, rel=2.0 * 4000.0**-order + 1e-12)


def test_unlimited_is_the_same_as_measuring_time_so_that_the_period_is_two() -> None:
    """The paper's T is 2 ms; in milliseconds T = 2 (THEORY.md §2)."""
    preset = {
        **PRESETS["paper_optimum"],
        "stiffness": 1.0,
        "damping": 1.0,
        "gains": "unlimited",
    }
    ours = np.array(parse_law(preset).compile(T).taps)
    milliseconds = np.array(
        parse_law({**preset, "gains": "physical"}).compile(2.0).taps
    )
    ours[0] -= 1.0
    milliseconds[0] -= 1.0
    # A few roundings of T^-α and of the power of T/2.
    assert ours == pytest.approx(milliseconds * 2.0 / T, rel=1e-13)


@pytest.mark.parametrize(
    ("order", "taps", "low", "high"),
    [
        (0.3, 4, 1.0, 1.05),
        (1.7, 4, 0.98, 1.01),
        (3.47, 4, 0.97, 1.0),
        (3.47, 2, 0.3, 0.5),
    ],
)
def test_paper_and_unlimited_differ_by_what_the_memory_lacks(
    order: float, taps: int, low: float, high: float
) -> None:
    data = {
        "kind": "pd_alpha",
        "stiffness": 1.0,
        "damping": 3.0,
        "order": order,
        "taps": taps,
    }
    paper, unlimited = (
        parse_law({**data, "gains": unit}).compile(T).h_nyquist - 1.0
        for unit in ("paper", "unlimited")
    )
    assert low < unlimited / paper < high


def test_gains_must_be_said() -> None:
    with pytest.raises(LawRefusedError, match=r"^law\.gains: is missing"):
        parse_law(
            {
                "kind": "pd_alpha",
                "stiffness": 1.0,
                "damping": 1.0,
                "order": 0.5,
                "taps": 4,
            }
        )


def test_paper_optimum_is_what_the_paper_prints() -> None:
    law = law_to_dict(parse_law("paper_optimum"))
    assert [term["gain"] for term in law["terms"]] == [1.69, 1.32]
    assert [term["order"] for term in law["terms"]] == [1.50, 3.47]
    assert (law["taps"], law["gains"]) == (4, "paper")
