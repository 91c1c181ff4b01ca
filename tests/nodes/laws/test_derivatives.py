"""One contract for every realisation of D^α, and known failures reproduced.

Oracles: Mittag-Leffler functions and Gamma ratios by mpmath, rational approximants by mpmath's Padé
and scipy's bilinear transform, impulse responses by scipy's lfilter: none shares a line with the
code under test.
"""

from __future__ import annotations

import math
from pathlib import Path

import mpmath
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from nodes.laws.derivatives import derivative_kinds, realise
from nodes.laws.derivatives.gl import coefficients
from nodes.laws.parse import compile_law, parse_law
from nodes.stability.closed_loop import pole_radius, state_matrix
from nodes.stability.plant import Plant
from sim.device.model import DeviceModel
from sim.lab.charts.derivative_errors import largest_pole, lengths_taken
from sim.play.one_axis import run
from sim.play.one_axis_inputs import Scene, SceneSurface
from tests.support.realisations import (
    BDF,
    EPS,
    KINDS,
    LENGTH,
    RECURSIVE,
    T,
    apply,
    at,
    loop,
    size,
    ticks,
)

CASES = [
    pytest.param(kind, order, id=f"{kind}-{order}")
    for kind in KINDS
    for order in (0.1, 0.5, 0.9, 1.0, 1.5, 2.0, 2.5, 3.47)
    if kind != "log_binned" or order <= 2.0
]


def orders_of(kind: str) -> st.SearchStrategy[float]:
    """Return the orders that a realisation accepts."""
    return st.floats(min_value=0.01, max_value=2.0 if kind == "log_binned" else 3.99)


def test_all_families_of_the_field_are_registered() -> None:
    families = {
        "gl",
        "gl_leak_corrected",
        *BDF,
        "l1",
        *RECURSIVE,
        "exponentials",
        "log_binned",
    }
    assert families <= set(KINDS)


@pytest.mark.parametrize(("kind", "order"), CASES)
def test_loop_renders_what_taps_and_sections_say(kind: str, order: float) -> None:
    law = realise(kind, order, LENGTH[kind], T)
    samples = np.random.default_rng(1).normal(size=300)
    # Rounding only: each of at most 300 terms per sum is off by half an ulp of the largest product.
    tolerance = 300 * EPS * size(law) * float(np.max(np.abs(samples)))
    assert (
        np.max(np.abs(apply(law, samples) - loop(law, samples.tolist()))) <= tolerance
    )
    assert largest_pole(law) < 1.0
    assert law.stable_sections()


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=15)
@given(
    data=st.data(),
    left=st.floats(-2.0, 2.0),
    right=st.floats(-2.0, 2.0),
    seed=st.integers(0, 99),
)
def test_linear(
    kind: str, data: st.DataObject, left: float, right: float, seed: int
) -> None:
    law = realise(kind, data.draw(orders_of(kind)), LENGTH[kind], T)
    first, second = np.random.default_rng(seed).uniform(-1.0, 1.0, size=(2, 40))
    both = loop(law, (left * first + right * second).tolist())
    parts = left * np.array(loop(law, first.tolist())) + right * np.array(
        loop(law, second.tolist())
    )
    # Two evaluations, each rounded 40 times over terms of at most size * (|left| + |right|).
    assert np.max(np.abs(parts - both)) <= 100 * EPS * size(law) * (
        abs(left) + abs(right) + EPS
    )


@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=15)
@given(data=st.data(), period=st.floats(1e-4, 0.1))
def test_gain_goes_as_period_to_the_minus_order(
    kind: str, data: st.DataObject, period: float
) -> None:
    order = data.draw(orders_of(kind))
    law, unit = (
        realise(kind, order, LENGTH[kind], period),
        realise(kind, order, LENGTH[kind], 1.0),
    )
    scale = period**-order
    # The same numbers up to the rounding of T^−α, relative to the largest of them.
    largest = scale * max(
        [*map(abs, unit.taps), *(abs(b) for s in unit.sections for b in s[:2])]
    )
    assert (
        np.max(np.abs(np.array(law.taps) - scale * np.array(unit.taps)))
        <= 64 * EPS * largest
    )
    for (b0, b1, a1, a2), (u0, u1, c1, c2) in zip(
        law.sections, unit.sections, strict=True
    ):
        assert abs(b0 - scale * u0) <= 64 * EPS * largest
        assert abs(b1 - scale * u1) <= 64 * EPS * largest
        # Oustaloup's poles are mapped through a product with T, which may round them by an ulp.
        assert (a1, a2) == pytest.approx((c1, c2), abs=4 * EPS)


@settings(max_examples=150)
@given(
    kind=st.sampled_from(KINDS),
    order=st.floats(min_value=0.0, max_value=4.0, exclude_min=True, exclude_max=True),
    taps=st.integers(2, 120),
    period=st.floats(1e-4, 0.05),
)
@example(kind="tustin_cfe", order=2.0 - 2 * EPS, taps=4, period=0.03125)
@example(kind="al_alaoui_cfe", order=2.0 - 2 * EPS, taps=3, period=0.03125)
def test_either_runs_or_says_why_not(
    kind: str, order: float, taps: int, period: float
) -> None:
    refusal, law = "", None
    try:
        law = realise(kind, order, taps, period)
    except ValueError as error:
        refusal = str(error)
    if law is None:
        assert refusal.startswith((f"taps = {taps}: ", f"order = {order:g}: log"))
        assert kind != "gl"
    else:
        assert law.finite
        assert law.stable_sections()


@pytest.mark.parametrize("whole", [1, 2, 3])
@pytest.mark.parametrize("kind", KINDS)
def test_whole_orders_differentiate_powers_exactly(kind: str, whole: int) -> None:
    law = realise(kind, float(whole), LENGTH[kind], 0.5)
    time = ticks(80, 0.5)
    output = apply(law, time**whole)
    # D^k t^k = k! once the taps are full, for a difference of any order of accuracy; rounding grows
    # with t^k at the end.
    assert output[-10:] == pytest.approx(
        math.factorial(whole), abs=40 * EPS * size(law) * time[-1] ** whole
    )


@pytest.mark.parametrize(
    ("kind", "near"),
    [
        pytest.param(kind, near, id=f"{kind}-{near}")
        for kind in KINDS
        for near in (1.0 - 1e-9, 1.0 + 1e-9, 2.0 - 1e-9, 2.0 + 1e-9)
        # Refused above 2; and x[k] − x[k−n] for β → 0, see test_l1_just_above_a_whole_order.
        if not (
            (kind == "log_binned" and near > 2.0) or (kind == "l1" and near % 1.0 < 0.5)
        )
    ],
)
def test_order_goes_over_into_whole_orders(kind: str, near: float) -> None:
    law = realise(kind, near, LENGTH[kind], T)
    angle = 0.05 * math.pi
    wanted = (1j * angle / T) ** round(near)
    # A lag of at most one tick per derivative (half a tick in truth) and, for memories of ~60
    # ticks, little else.
    assert abs(at(law, 0.05) / wanted - 1.0) <= round(near) * angle


def test_l1_just_above_a_whole_order_subtracts_the_oldest_sample() -> None:
    taps = realise("l1", 1.0 + 1e-12, 10, 1.0).taps
    # (1 − w)(1 − w⁸): one difference, and eight intervals. b_m = (m+1)^{1−β} − m^{1−β} → 1 but for
    # β ln(m).
    assert taps == pytest.approx(
        [1.0, -1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 1.0], abs=1e-11
    )


REFUSED = [
    # kind, order, last taps refused, first taps taken
    ("gl_leak_corrected", 0.5, 1, 2),
    ("gl_leak_corrected", 1.5, 2, 3),
    ("gl_leak_corrected", 3.47, 4, 5),
    ("bdf2", 0.5, 2, 3),
    ("bdf2", 1.5, 4, 5),
    ("bdf6", 3.47, 24, 25),
    ("l1", 1.5, 2, 3),
    ("l1", 3.47, 4, 5),
    ("tustin_cfe", 0.5, 202, 201),
    ("al_alaoui_cfe", 0.5, 202, 201),
    ("oustaloup_tustin", 0.5, 2, 3),
    ("oustaloup_matched", 0.5, 202, 201),
    ("exponentials", 0.5, 7, 8),
    ("exponentials", 0.5, 1_000_001, 1_000_000),
    ("log_binned", 0.5, 16, 17),
    ("log_binned", 1.5, 17, 18),
    ("least_squares", 0.5, 3, 4),
    ("least_squares", 0.5, 16, 15),
]


@pytest.mark.parametrize(("kind", "order", "refused", "taken"), REFUSED)
def test_first_bad_length_is_refused_by_name(
    kind: str, order: float, refused: int, taken: int
) -> None:
    with pytest.raises(ValueError, match=rf"^taps = {refused}: "):
        realise(kind, order, refused, T)
    assert realise(kind, order, taken, T).finite


def test_log_bins_refuse_orders_above_two() -> None:
    with pytest.raises(ValueError, match=r"^order = 2.001: .* up to 2"):
        realise("log_binned", 2.001, 100, T)
    assert realise("log_binned", 1.999, 100, T).finite
    # Why: a jump 512 ticks ago lies on the edge of a bin, and two differences make a click of it.
    binned = np.array(realise("log_binned", 0.5, 1000, 1.0).taps)
    exact = np.array(realise("gl", 0.5, 1000, 1.0).taps)
    clicks = np.abs(np.diff(binned, 2) - np.diff(exact, 2))
    assert clicks[510:513].max() > 100.0 * clicks[520:540].max()


@pytest.mark.parametrize("order", [0.0, -0.5, 4.0, math.nan, math.inf])
@pytest.mark.parametrize("kind", ["gl", "tustin_cfe"])
def test_orders_outside_are_refused(kind: str, order: float) -> None:
    with pytest.raises(ValueError, match=r"^order = .*\(0, 4\)"):
        realise(kind, order, 10, T)


@pytest.mark.parametrize("period", [0.0, -0.002, math.nan, math.inf])
def test_periods_are_refused(period: float) -> None:
    with pytest.raises(ValueError, match=r"^period = "):
        realise("gl", 0.5, 10, period)


@pytest.mark.parametrize("kind", KINDS)
def test_overflow_is_refused(kind: str) -> None:
    # T^−α beyond 1.8e308.
    with pytest.raises(
        ValueError, match=r"^period = 1e-200 s at order = 1.9: .*overflow"
    ):
        realise(kind, 1.9, LENGTH[kind], 1e-200)


def test_unknown_realisation_names_the_known_ones() -> None:
    with pytest.raises(
        ValueError, match=r"derivative = 'crone' is not .*exponentials, gl, "
    ):
        realise("crone", 0.5, 10, T)


def test_recursion_does_not_overflow_where_the_gamma_ratio_does() -> None:
    series = coefficients(0.5, 2001)
    with mpmath.workdps(40):
        exact = (-1) ** 2000 * mpmath.binomial(mpmath.mpf(0.5), 2000)
    assert series[2000] == pytest.approx(float(exact), rel=2000 * EPS)
    with pytest.raises(OverflowError):
        math.gamma(172.0)


def test_lengths_taken_are_found_by_asking() -> None:
    assert lengths_taken("l1", 3.47, T) == (5, 2000)
    assert lengths_taken("tustin_cfe", 0.5, T) == (2, 201)
    assert lengths_taken("least_squares", 0.5, T) == (4, 15)
    assert lengths_taken("log_binned", 2.5, T) is None


@pytest.mark.parametrize("order", [0.5, 1.5])
@pytest.mark.parametrize("kind", KINDS)
def test_every_realisation_works_in_the_loop_as_a_law(kind: str, order: float) -> None:
    law = parse_law(
        {
            "kind": "pd_alpha",
            "stiffness": 300.0,
            "damping": 1.0,
            "order": order,
            "taps": LENGTH[kind],
            "gains": "paper",
            "derivative": kind,
        }
    )
    compiled = compile_law(law, T)
    # b = 3 N s/m keeps a 300 N/m spring stable at no delay by a wide margin; what is tested is that
    # the loop's own kernels and the state matrix agree about the law.
    assert pole_radius(compiled, Plant(T, 0.1, 3.0)) < 1.0
    device = DeviceModel(mass=0.1, damping=3.0, position=0.005)
    scene = Scene(
        device=device, surface=SceneSurface("anchor"), period=T, raw=False, clamp=False
    )
    trace = run(scene, compiled, 600, interpreted=True)
    state = state_matrix(compiled, Plant(T, 0.1, 3.0))
    x = np.zeros(len(state))
    x[0] = 0.005
    # The loop begins at rest where the device is: history and sections are those of a deflection
    # that has always been there.
    past = slice(2, len(x) - 1)
    x[past] = np.linalg.solve(
        np.eye(len(x) - 3) - state[past, past], state[past, 0] * 0.005
    )
    for k in range(600):
        # Two orders of the same sums, 600 times over, relative to the 5 mm that it starts with.
        assert trace.position[k] == pytest.approx(x[0], abs=1e-9 * 0.005)
        x = state @ x


def test_a_realisation_from_another_package_works_by_being_installed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elsewhere.py").write_text(
        "from nodes.laws import CompiledLaw\n\n"
        "def forward(order, taps, period):\n"
        "    return CompiledLaw((1.0 / period, -1.0 / period), ((0.0, 1.0, -order, 0.0),))\n"
    )
    info = tmp_path / "elsewhere-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: elsewhere\nVersion: 1.0\n"
    )
    (info / "entry_points.txt").write_text(
        "[haptic.derivatives]\nforward_of_elsewhere = elsewhere:forward\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    assert "forward_of_elsewhere" in derivative_kinds()
    assert realise("forward_of_elsewhere", 0.5, 2, 0.5).taps == (2.0, -2.0)
    # What it returns is checked as ours is: a pole at 1.5 is refused.
    with pytest.raises(
        ValueError,
        match=r"'forward_of_elsewhere' has a pole on or outside the unit circle",
    ):
        realise("forward_of_elsewhere", 1.5, 2, 0.5)


@pytest.mark.parametrize("period", [0.0, -T, math.inf, math.nan])
def test_a_period_is_positive_and_finite(period: float) -> None:
    with pytest.raises(ValueError, match="must be positive and finite; give 1/rate"):
        realise("gl", 0.5, 10, period)


def test_orders_and_lengths_are_refused_at_their_ends() -> None:
    for order in (0.0, 4.0, math.nan):
        with pytest.raises(ValueError, match=r"must lie in \(0, 4\)"):
            realise("gl", order, 10, T)
    for taps in (1, 1_000_001):
        with pytest.raises(ValueError, match=r"must lie in \[2, 1000000\]"):
            realise("gl", 0.5, taps, T)
    assert len(realise("gl", math.nextafter(4.0, 0.0), 2, T).taps) == 2
