"""Rendered impedance: closed forms of spring, damper, hold and delay; API and verb."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import haptic
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nodes.cli.main import main
from nodes.laws.pd import PD
from nodes.stability.effective_damping import damping_needed
from nodes.stability.plant import Plant
from sim.experiments.perception import THRESHOLDS, tolerances
from sim.experiments.rendered import error_of, frequencies, passive_stiffness, rendered
from sim.lab.charts.conclusions import conclusions
from sim.lab.charts.loop_panel import BAND, loop_groups, realisations, wanted

T = 0.002


@settings(max_examples=20, deadline=None)
@given(st.floats(1.0, 5000.0), st.floats(0.0, 20.0), st.floats(0.0, 3.0))
def test_a_spring_and_a_damper_have_their_closed_forms(
    stiffness: float, damping: float, delay: float
) -> None:
    """PD: Re H = K + (B/T)(1 − cos ωT), Im H/ω = B sin(ωT)/ωT; delay costs K (d + ½) T."""
    law = PD(stiffness=stiffness, damping=damping).compile(T)
    found = rendered(law, T, delay)
    angle = 2.0 * math.pi * found.frequency_hz * T
    # Sums of two terms of the size of K + 2B/T, rounded.
    near = 1e-9 * (stiffness + 2.0 * damping / T)
    assert found.law_stiffness_n_per_m == pytest.approx(
        stiffness + damping / T * (1.0 - np.cos(angle)), rel=1e-9, abs=near
    )
    assert found.law_damping_n_s_per_m == pytest.approx(
        damping * np.sin(angle) / angle, rel=1e-9, abs=near
    )
    # At 0.1 Hz the next terms are (ωT)² = 1.6e-6 of the first, times (d + ½)³.
    lost = damping - stiffness * (delay + 0.5) * T - 0.5 * damping * 0.0
    assert found.damping_n_s_per_m[0] == pytest.approx(
        lost, abs=1e-4 * (damping + stiffness * T * (delay + 1.0) ** 3)
    )
    assert found.stiffness_n_per_m[0] == pytest.approx(
        stiffness, rel=1e-4, abs=1e-4 * damping / T
    )


def test_the_port_is_the_force_that_is_played() -> None:
    """A sine-driven hand feels the fundamental of the held, late force, summed by samples."""
    law, delay, frequency = PD(stiffness=800.0, damping=2.0).compile(T), 1.0, 40.0
    found = rendered(law, T, delay, np.array([frequency]))
    fine, ticks = 200, 500
    x = np.exp(2j * np.pi * frequency * T * np.arange(-50, ticks))
    force = np.convolve(x, law.taps)[50 : 50 + ticks]
    # Held from where it arrives, a whole tick late.
    held = np.repeat(np.concatenate([[0.0], force[:-1]]), fine)
    at = (np.arange(len(held)) + 0.5) / fine * T
    # Twenty whole periods of 12.5 ticks.
    part = slice(fine * 100, fine * 350)
    seen = np.mean(held[part] * np.exp(-2j * np.pi * frequency * at[part]))
    # 200 steps a tick, in the middle of each: (ωT/200)²/24 of it.
    assert seen.real == pytest.approx(found.stiffness_n_per_m[0], rel=1e-5)
    assert seen.imag / (2.0 * np.pi * frequency) == pytest.approx(
        found.damping_n_s_per_m[0], rel=1e-5
    )


@pytest.mark.parametrize("delay", [0.0, 1.0, 0.5])
def test_the_passive_edge_is_colgate_s_from_both_sides(delay: float) -> None:
    plant = Plant(T, 0.1, 1.0, delay)

    def spring(stiffness: float) -> object:
        return PD(stiffness=stiffness, damping=0.0).compile(T)

    edge = passive_stiffness(spring, plant)  # type: ignore[arg-type]
    if delay in (0.0, 1.0):
        # THEORY.md §2
        assert edge == pytest.approx(2.0 / (T * (1.0 + 2.0 * delay)), rel=1e-5)
    for share, passive in ((0.999, True), (1.001, False)):
        assert (
            damping_needed(PD(stiffness=share * edge, damping=0.0).compile(T), T, delay)
            <= 1.0
        ) is passive
    # B takes all of b = 1 N s/m without delay: nothing is passive beyond it.
    assert math.isnan(
        passive_stiffness(
            lambda k: PD(stiffness=k, damping=1.5).compile(T), Plant(T, 0.1, 1.0)
        )
    )


def test_a_notebook_has_response_bode_and_plane_of_a_law() -> None:
    from matplotlib.figure import Figure

    law = haptic.law("pd", stiffness=1000, damping=3)
    plant = haptic.Plant(T, 0.1, 1.0, 1.0)
    found = law.response(plant)
    assert found.frequency_hz[-1] == pytest.approx(0.5 / T)
    assert (
        found.stiffness_n_per_m == haptic.response(law, plant).stiffness_n_per_m
    ).all()
    plane = law.z_width(plant, gains=[0.0, 3.0])
    # Two methods have these two (THEORY.md §3): 251.7 and 1252.5 N/m at one tick.
    assert plane.of("pd").k_max_n_per_m == pytest.approx(
        [
            haptic.k_max(
                {"kind": "pd", "stiffness": 1, "damping": b}, plant
            ).k_max_n_per_m
            for b in (0, 3)
        ]
    )
    both = haptic.z_width(["pd", "paper_optimum"], plant, gains=[1.0, 2.0])
    assert both.names == ("pd", "paper_optimum")
    assert len(both.to_pandas()) == 4 if _has_pandas() else True
    with pytest.raises(KeyError, match="no such law here"):
        both.of("fir")
    figure = Figure()
    axes = figure.subplots(2, 1)
    assert found.plot(ax=axes) is figure
    assert law.bode(plant, ax=axes) is figure
    assert plane.plot(ax=axes[0]) is figure
    with pytest.raises(ValueError, match="expected two"):
        found.plot(ax=axes[:1])
    assert len(law.bode().axes) == 2


def _has_pandas() -> bool:
    from importlib.util import find_spec

    return find_spec("pandas") is not None


def test_what_has_no_response_says_so() -> None:
    with pytest.raises(ValueError, match="no response; play it"):
        haptic.response(
            {"kind": "pd_windowed", "stiffness": 500, "damping": 1, "resolution": 2e-5}
        )
    with pytest.raises(ValueError, match="half the rate, 250 Hz"):
        haptic.response(haptic.law("pd", stiffness=1, damping=0), frequency_hz=[251.0])
    with pytest.raises(ValueError, match="no parameter 'stiffness'"):
        haptic.z_width([100.0, -50.0])
    with pytest.raises(ValueError, match="between 0 and half the rate"):
        frequencies(T, 300.0)


def test_the_verb_tells_stiffness_damping_and_plane(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "study",
        "response",
        "--law",
        "pd",
        "--gain",
        "0..6",
        "--points",
        "3",
        "--stiffness",
        "500",
    ]
    assert main([*words, "--delay", "1", "--out", str(tmp_path), "--json"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    first = told["laws"][0]
    assert first["plane"]["gain"] == [0.0, 3.0, 6.0]
    # by a referee's table
    assert first["plane"]["k_max_n_per_m"][1] == pytest.approx(1252.48, abs=0.01)
    assert first["plane"]["passive_n_per_m"][0] == pytest.approx(
        2.0 / (3.0 * T), rel=1e-5
    )
    assert Path(told["plot"]).exists()
    assert (
        main(
            [
                "study",
                "response",
                "--law",
                "{kind: fir, taps: [100.0]}",
                "--gain",
                "0..6",
                "--out",
                str(tmp_path),
            ]
        )
        == 2
    )
    assert "no such parameter" in capsys.readouterr().err


@pytest.mark.parametrize("order", [1.0, 0.5])
def test_a_faster_loop_errs_less_and_its_error_is_the_delay_s(order: float) -> None:
    """For slow motions the impedance error is that of d + ½ ticks, ω (d + ½) T."""
    band = np.geomspace(*BAND, 30)
    name = "PD" if order == 1.0 else "exponentials 256"
    law = realisations(order)[name]
    errors = [
        error_of(law(1.0 / rate), 1.0 / rate, 1.0, wanted(order, band), band)
        for rate in (500.0, 1000.0, 2000.0, 4000.0)
    ]
    assert all(fast < slow for slow, fast in itertools.pairwise(errors))
    slow = np.geomspace(1.0, 2.0, 10)
    late = error_of(law(1.0 / 4000.0), 1.0 / 4000.0, 1.0, wanted(order, slow), slow)
    expected = float(np.sqrt(np.mean((2.0 * np.pi * slow * 1.5 / 4000.0) ** 2)))
    # Besides it the backward difference is half a tick late in its own share, and a fractional law
    # errs by its fit.
    assert late == pytest.approx(expected, rel=0.6 if order == 1.0 else 3.0)


def test_the_loop_is_charted() -> None:
    groups = loop_groups(lambda _: None, quick=True)
    assert [group.name for group in groups] == [
        "loop_impedance_1",
        "loop_impedance_0_5",
    ]
    assert all(
        point.cost > 0.0 and 0.0 < point.error < 1.0
        for group in groups
        for point in group.points
    )
    lines = conclusions(groups)
    assert len(lines) == 2
    assert "errs least" in lines[0]


def test_thresholds_of_perception_loosen_only_what_they_are_about() -> None:
    usual, felt = tolerances(0.02, felt=False), tolerances(0.02, felt=True)
    assert {usual(name) for name in ("peak_force", "k_max", "settling")} == {0.02}
    assert (
        felt("peak_force"),
        felt("rest_force"),
        felt("k_max"),
        felt("settling"),
        felt("travel"),
    ) == (0.07, 0.07, 0.08, 0.02, 0.02)
    assert all(0.0 < one.low < one.high < 1.0 and one.source for one in THRESHOLDS)
