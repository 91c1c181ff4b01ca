"""The paper's descent reproduced with its failures, and the programmes replacing it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from nodes.cli.main import main
from nodes.laws.parse import parse_law
from nodes.stability.effective_damping import effective_damping
from sim.arrays import Array
from sim.lab.paper.descent import (
    Targets,
    best_orders,
    cost,
    damping_curve,
    free_taps,
    measured,
    minimax,
    paper_targets,
    steepest_descent,
    term_damping,
)

A, ALPHA = np.array([1.69, 1.32]), np.array([1.50, 3.47])
BAND = (0.02, 0.55)


@pytest.mark.parametrize("order", [0.3, 1.0, 1.5, 3.47])
@pytest.mark.parametrize("taps", [2, 4, 30])
@pytest.mark.parametrize("leak", [True, False])
def test_f_of_a_term_is_that_of_the_compiled_law(
    order: float, taps: int, leak: bool
) -> None:
    """Normalised at T = 2 here, in SI at T = 2 ms there: equal by another sum."""
    data = {
        "kind": "pd_alpha",
        "stiffness": 1.0,
        "damping": 1.0,
        "order": order,
        "taps": taps,
        "gains": "paper",
    }
    law = parse_law(data).compile(0.002)
    theta = np.linspace(0.05, np.pi, 40)
    offset = 0.001 * (law.h1 - 1.0) if leak else 0.0
    expected = effective_damping(law, 0.002, theta / 0.002) + offset
    # Taps of some 1e3 N/m times T: rounding of a few 1e-12 at 30 taps.
    assert term_damping(theta, order, taps, leak)[0] == pytest.approx(
        expected, abs=1e-10
    )


def test_slope_along_the_order_is_the_difference_quotient() -> None:
    theta = np.linspace(0.1, np.pi, 9)
    h = 1e-6
    for order in (0.4, 1.5, 2.0, 3.6):
        quotient = (
            term_damping(theta, order + h, 5)[0] - term_damping(theta, order - h, 5)[0]
        ) / (2 * h)
        # Central difference: h² f'''/6, and rounding 1e-16/h.
        assert term_damping(theta, order, 5)[1] == pytest.approx(quotient, abs=1e-8)


def test_the_optimum_has_its_normalisations_f_at_nyquist() -> None:
    """f(ω_N) ≈ +3 where eq. (13) asks for +1 (THEORY.md §2): most of J = 3.9."""
    targets = paper_targets()
    at_nyquist = float(damping_curve(np.array([np.pi]), A, ALPHA, 4)[0])
    assert at_nyquist == pytest.approx(3.0, abs=0.05)
    assert cost(A, ALPHA, targets, 4) == pytest.approx(
        (at_nyquist - 1.0) ** 2, rel=0.02
    )


def test_descent_goes_down_when_its_steps_are_small() -> None:
    run = steepest_descent(
        np.ones(2), np.array([0.75, 2.25]), paper_targets(), rate=1e-3, steps=300
    )
    assert (np.diff(run.cost) < 0.0).all()


@pytest.mark.slow
def test_descent_from_the_same_cost_ends_elsewhere_from_elsewhere() -> None:
    """Three targets, four unknowns: optima with J ≈ 0 form a curve."""
    targets = Targets(np.pi * np.array([0.1, 0.5, 1.0]), np.array([-1.0, -1.0, 3.0]))
    ends = [
        steepest_descent(
            np.array(gains), np.array(orders), targets, rate=0.01, steps=20000
        )
        for gains, orders in (([1.7, 1.3], [1.5, 3.4]), ([1.7, 2.4], [0.5, 2.6]))
    ]
    assert [end.outcome for end in ends] == ["converged", "converged"]
    assert max(float(end.cost[-1]) for end in ends) < 1e-6
    # Equally good by (13), nearly half an order apart: not one optimum.
    assert np.abs(ends[0].orders - ends[1].orders).max() > 0.4


def test_descent_fails_in_every_way_it_can() -> None:
    targets = paper_targets()
    assert (
        steepest_descent(
            np.ones(2), np.array([1.5, 3.47]), targets, rate=0.01, steps=2000
        ).outcome
        == "out_of_range"
    )
    assert (
        steepest_descent(
            np.ones(2), np.array([1.2, 3.0]), targets, rate=0.01, steps=500
        ).outcome
        == "slow"
    )
    assert steepest_descent(
        np.ones(2), np.array([1.2, 1.3]), targets, rate=0.5, steps=500
    ).outcome in ("diverged", "out_of_range")


def least_squares(orders: Array, targets: Targets, taps: int) -> Array:
    """Return the gains of least cost (13) for given orders; of several, the shortest."""
    basis = np.array(
        [term_damping(targets.theta, order, taps)[0] for order in orders.tolist()]
    )
    gains, *_ = np.linalg.lstsq(basis.T, targets.value, rcond=None)
    return np.asarray(gains, dtype=np.float64)


def test_gains_alone_diverge_above_the_rate_that_theory_gives() -> None:
    """For fixed orders J is quadratic: descent converges iff rate < 1/λ_max."""
    theta = np.pi * np.array([0.1, 0.5, 1.0])
    basis = np.array([term_damping(theta, order, 4)[0] for order in (1.5, 3.47)])
    limit = 1.0 / float(np.linalg.eigvalsh(basis @ basis.T).max())
    best = least_squares(ALPHA, paper_targets(), 4)
    for factor, shrinks in ((0.99, True), (1.01, False)):
        gains = best + np.linalg.eigh(basis @ basis.T)[1][:, -1]
        before = float(np.linalg.norm(gains - best))
        for _ in range(50):
            miss = gains @ basis - paper_targets().value
            gains = gains - factor * limit * 2.0 * (basis @ miss)
        assert (float(np.linalg.norm(gains - best)) < before) == shrinks


def test_the_cost_is_cheated_by_a_negative_spring() -> None:
    """A flat f = −1 is D = −1 N/m (T = 2), which damps nothing; leak-free f shows it."""
    theta = np.linspace(0.1, np.pi, 20)
    almost_a_spring = np.array([1e-9])
    assert damping_curve(theta, np.array([-1.0]), almost_a_spring, 4) == pytest.approx(
        -np.ones(20), abs=1e-8
    )
    assert damping_curve(
        theta, np.array([-1.0]), almost_a_spring, 4, leak=False
    ) == pytest.approx(np.zeros(20), abs=1e-8)


@pytest.mark.parametrize("orders", [[1.5, 3.47], [0.3, 2.2], [1.0, 2.0]])
def test_least_squares_is_stationary(orders: list[float]) -> None:
    targets = paper_targets((0.05, 0.3, 0.5))
    best = least_squares(np.array(orders), targets, 4)
    least = cost(best, np.array(orders), targets, 4)
    for step in np.random.default_rng(4).normal(size=(20, 2)) * 1e-3:
        assert cost(best + step, np.array(orders), targets, 4) >= least


def test_minimax_is_best_for_its_orders_and_its_bound_holds() -> None:
    shape = minimax(ALPHA, BAND, 3.05, 4)
    assert shape is not None
    assert abs(shape.nyquist) <= 3.05 + 1e-9
    for step in np.random.default_rng(5).normal(size=(50, 2)) * 0.02:
        other = measured(shape.gains + step, ALPHA, BAND, 4)
        # The programme sees 61 frequencies, the measure 601.
        assert other.ripple >= shape.ripple - 1e-3 or abs(other.nyquist) > 3.05


def test_what_the_search_over_orders_reaches() -> None:
    """Better than the paper's at equal f(ω_N), as good as any four taps."""
    paper = measured(A, ALPHA, BAND, 4)
    shape, programmes = best_orders(2, BAND, paper.nyquist, 4, grid=8)
    _, bound = free_taps(4, BAND, paper.nyquist)
    assert programmes > 28
    assert shape.nyquist <= paper.nyquist + 1e-6
    # 61 frequencies of the bound against 601 of the measure.
    assert bound - 2e-3 <= shape.ripple < 1.1 * bound
    assert shape.ripple < 0.6 * paper.ripple


def test_more_taps_allow_less_ripple_and_waterbed_sets_the_price() -> None:
    ripples = [free_taps(taps, BAND, 3.0)[1] for taps in (3, 4, 6, 10)]
    assert ripples == sorted(ripples, reverse=True)
    taps, ripple = free_taps(10, BAND, 3.0)
    assert taps.sum() == pytest.approx(0.0, abs=1e-9)
    # Mean zero: −(1 − ripple) over the band must be paid for above it.
    assert ripple < 0.05


def test_impossible_bounds_are_refused() -> None:
    with pytest.raises(ValueError, match=r"nyquist = -1"):
        best_orders(2, BAND, -1.0, 4, grid=3)
    with pytest.raises(ValueError, match=r"nyquist = -1"):
        free_taps(4, BAND, -1.0)


@pytest.mark.slow
def test_optimise_answers_for_machines(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = "lab optimise --rates 0.03 --steps 30 --starts 3 --nyquist 3.05 --json --out".split()  # noqa: SIM905
    assert main([*words, str(tmp_path)]) == 0
    figures = json.loads(capsys.readouterr().out.splitlines()[-1])
    row = figures["descent"][0]
    assert (
        row["starts"]
        == sum(row[name] for name in ("converged", "slow", "out_of_range", "diverged"))
        == 3
    )
    laws = {shape["law"]: shape for shape in figures["shapes"]}
    assert laws["best orders"]["ripple"] < laws["paper_optimum"]["ripple"]
    assert Path(figures["plot"]).read_bytes()[:4] == b"\x89PNG"
    assert main("lab optimise --at 1.5".split()) == 2  # noqa: SIM905
