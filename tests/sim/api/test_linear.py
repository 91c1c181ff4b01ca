"""A law and its loop as systems of scipy and python-control, against those libraries."""

from __future__ import annotations

import warnings
from typing import Any

import haptic
import numpy as np
import pytest

from nodes.laws.parse import parse_law
from nodes.laws.presets import preset_names

PLANT = haptic.Plant(rate=500, mass=0.1, damping=1.0)
LATE = haptic.Plant(rate=500, mass=0.1, damping=1.0, delay=1.3, stiffness=200.0)
PD = haptic.PD(stiffness=1500, damping=3)
CASES: list[Any] = [
    PD,
    haptic.PDFiltered(stiffness=900, damping=2, cutoff=60),
    haptic.PDAlpha(stiffness=900, damping=2, order=1.3, taps=12, gains="paper"),
    haptic.FractionalSLS(stiffness=900, damping=8, order=0.6, relaxation=0.004),
    *(haptic.law(name) for name in preset_names()),
]
every_law = pytest.mark.parametrize("law", CASES, ids=lambda law: law.kind)


@pytest.fixture(scope="module")
def control() -> Any:
    """Import python-control here: with scipy.signal it takes a second, for every worker."""
    return pytest.importorskip("control")


def dfreqresp(system: Any, w: Any) -> Any:
    from scipy import signal  # as above

    return signal.dfreqresp(system, w)[1]


def response_of(system: Any, z: Any) -> Any:
    """Return a system's response; scipy's own makes a state space an ill-conditioned fraction."""
    if not hasattr(system, "A"):
        return dfreqresp(system, np.angle(z))
    size = len(system.A)
    inner = [np.linalg.solve(at * np.eye(size) - system.A, system.B) for at in z]
    return np.array([(system.C @ one + system.D)[0, 0] for one in inner])


@every_law
def test_a_law_has_the_response_of_its_taps_in_both_libraries(
    law: Any, control: Any
) -> None:
    z = np.exp(1j * np.linspace(0.01, np.pi, 50))
    wanted = law.compile(0.002).response(z)
    found = response_of(law.to_scipy(PLANT), z)
    # Sums of a few dozen products, and of poles close to 1: 10^5 roundings.
    scale = 1e5 * np.finfo(float).eps * np.abs(wanted).max()
    assert np.abs(found - wanted).max() < scale
    assert np.abs(law.to_control(PLANT)(z) - wanted).max() < scale
    assert law.to_scipy(PLANT).dt == law.to_control(PLANT).dt == 0.002


@pytest.mark.parametrize("plant", [PLANT, LATE])
@every_law
def test_closing_the_loop_elsewhere_gives_our_poles(
    law: Any, plant: Any, control: Any
) -> None:
    # Feedback by python-control against the state matrix of the loop; sections are eigenvalues of
    # another matrix of up to 24 states.
    closed = control.feedback(law.loop(plant).to_control(), 1)
    theirs, ours = np.abs(control.poles(closed)).max(), haptic.poles(law, plant).radius
    # A pole of multiplicity m is known to eps^(1/m); the slowest pole here is at most double.
    assert theirs == pytest.approx(ours, abs=10 * np.finfo(float).eps ** 0.5)


def test_margins_are_those_of_python_control(control: Any) -> None:
    for law, plant in ((PD, PLANT), (haptic.PD(stiffness=300, damping=0.5), LATE)):
        loop = law.loop(plant)
        with warnings.catch_warnings():
            # It warns that it computes from the frequency response, which is what we do, too.
            warnings.filterwarnings("ignore", "stability_margins", UserWarning)
            gain, phase, _, crossover = control.margin(loop.to_control())
        assert loop.gain_margin == pytest.approx(gain, rel=1e-6)
        # The crossing is interpolated between 2000 frequencies over four decades.
        assert loop.phase_margin_deg == pytest.approx(phase, abs=0.02)
        assert loop.crossover_hz == pytest.approx(crossover / (2 * np.pi), rel=1e-3)


def test_a_margin_is_the_edge_of_stability() -> None:
    loop = PD.loop(PLANT)
    assert loop.gain_margin is not None
    for factor, stable in ((1 - 1e-6, True), (1 + 1e-6, False)):
        share = factor * loop.gain_margin
        scaled = haptic.PD(stiffness=share * 1500, damping=share * 3)
        assert haptic.loop(scaled, PLANT).stable is stable
    # A loop that is unstable already has no margin.
    assert (
        haptic.loop(haptic.PD(stiffness=20_000, damping=3), PLANT).gain_margin is None
    )
    # With a negative damping at rest less gain is worse: a lower edge exists.
    assert haptic.loop(PD, PLANT).least_gain is None


def test_scipy_s_loop_is_law_times_device() -> None:
    loop = PD.loop(LATE)
    w = np.linspace(0.01, 3.0, 40)
    both = dfreqresp(loop.to_scipy(), w)
    law = dfreqresp(PD.to_scipy(LATE), w)
    device = dfreqresp(loop.device_to_scipy(), w)
    assert np.allclose(both, law * device, rtol=1e-9)


def test_what_has_no_transfer_function_says_so(control: Any) -> None:
    own = haptic.PDWindowed(stiffness=1000, damping=3, resolution=1e-5)
    for call in (own.to_scipy, own.to_control, own.loop):
        with pytest.raises(ValueError, match="code of its own"):
            call(PLANT)
    pair = PLANT.paired_with(
        haptic.Plant(rate=500, mass=0.2, damping=0.5, stiffness=100.0)
    )
    with pytest.raises(ValueError, match="a pair has no transfer function"):
        PD.loop(pair)
    with pytest.raises(ValueError, match="ill-conditioned"):
        CASES[3].loop(PLANT).to_scipy()


def test_every_plot_draws_into_given_axes() -> None:
    from matplotlib.figure import Figure

    axes = Figure().subplots(2, 3)
    loop = PD.loop(PLANT)
    loop.plot(ax=axes[:, 0])
    loop.nyquist(ax=axes[0, 1])
    loop.root_locus(ax=axes[1, 1], most=3000.0)
    haptic.k_max(PD, PLANT).plot(ax=axes[0, 2])
    haptic.poles(PD, PLANT).plot(ax=axes[1, 2])
    assert all(one.lines for one in axes.flat)
    # The locus ends at the poles of the largest stiffness, and starts at the free device.
    locus = loop.locus(np.array([1e-9, 1500.0]))
    assert np.abs(locus[1]).max() == pytest.approx(loop.radius, rel=1e-12)
    assert np.abs(locus[0]).max() == pytest.approx(1.0, abs=1e-6)


def test_laws_are_compared_by_what_the_single_functions_give() -> None:
    soft, designed = haptic.PD(stiffness=800, damping=3), haptic.law("designed_d0")
    laws = {"soft": soft, "stiff": PD, "d0": designed}
    found = haptic.compare(laws, PLANT, resolution=1e-5)
    assert found.law.tolist() == list(laws)
    for row, law in zip(found.rows(), laws.values(), strict=True):
        edge = haptic.k_max(law, PLANT).k_max_n_per_m
        assert row["k_max_wall_n_per_m"] == pytest.approx(edge, rel=1e-12)
        compiled = law.compile(0.002)
        assert row["h1_n_per_m"] == pytest.approx(sum(compiled.taps), rel=1e-12)
        # (Δ/2) Σ|h_m| (THEORY.md §5)
        assert row["rest_friction_n"] == pytest.approx(
            0.5e-5 * sum(map(abs, compiled.taps))
        )
    # |H| of PD grows up to half the rate: |H(−1)| = K + 2B/T.
    assert found.noise_gain_n_per_m[0] == pytest.approx(800 + 2 * 3 / 0.002)
    assert found.k_max_any_world_n_per_m[0] == pytest.approx(2244.217, abs=1e-3)
    assert found.lands.tolist() == [True, True, True]
    figure = found.plot()
    legend = figure.axes[0].get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == list(laws)
    assert "k_max_wall_n_per_m" in str(found)


def test_laws_with_the_same_kind_are_numbered_and_own_code_has_no_edges() -> None:
    own = haptic.PDWindowed(stiffness=1000, damping=3, resolution=1e-5)
    found = haptic.compare([own, own], PLANT)
    assert found.law.tolist() == ["pd_windowed", "pd_windowed 2"]
    assert np.isnan(found.k_max_wall_n_per_m).all()
    assert haptic.compare(own, PLANT).law.tolist() == ["pd_windowed"]
    # a law of another period is named
    with pytest.raises(haptic.HapticError, match=r"^good: law\.period: these taps"):
        haptic.compare(
            {"good": "designed_d0"}, haptic.Plant(rate=1000, mass=0.1, damping=1)
        )
    with pytest.raises(ValueError, match="none to compare"):
        haptic.compare([], PLANT)


def test_several_results_are_drawn_over_each_other() -> None:
    plays = {
        f"{k} N/m": haptic.play("floor_drop", stiffness=k, duration=0.2)
        for k in (800, 1600)
    }
    figure = haptic.plot(plays)
    assert [line.get_label() for line in figure.axes[0].lines] == list(plays)
    assert len(haptic.plot(list(plays.values())).axes[0].lines) == 2
    with pytest.raises(TypeError, match="no axes in common"):
        haptic.plot([*plays.values(), PD.loop(PLANT)])
    with pytest.raises(TypeError, match="nothing to plot"):
        haptic.plot([])


def test_a_law_in_yaml_gives_the_same_system() -> None:
    mapping = {"kind": "pd", "stiffness": 1500, "damping": 3}
    assert haptic.loop(mapping, PLANT).radius == parse_law(mapping).loop(PLANT).radius
