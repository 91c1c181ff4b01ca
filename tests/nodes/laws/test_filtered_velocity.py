"""PD with a velocity filter, first-order and adaptive windowing (THEORY.md §14)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nodes.laws.parse import LawRefusedError, compile_law, parse_law
from nodes.laws.pd import PD
from nodes.laws.pd_filtered import PDFiltered
from nodes.laws.pd_windowed import PDWindowed, windowed_slope
from nodes.recording.reader import Recording
from nodes.stability.closed_loop import pole_radius
from nodes.stability.k_max import k_max, with_spring, without_spring
from nodes.stability.plant import Plant
from sim.device.filters import filtered
from sim.device.model import DeviceModel
from sim.experiments.drop import drop_scene
from sim.experiments.settling import Criterion, settles
from sim.play.one_axis import run
from tests.support.launching import launch_json

T, STEP = 0.002, 2.3e-5


def test_filter_is_the_low_pass_of_the_backward_difference() -> None:
    law = PDFiltered(stiffness=800.0, damping=3.0, cutoff=40.0).compile(T)
    x = np.random.default_rng(1).normal(size=300) * 1e-3
    pole = np.exp(-2.0 * np.pi * 40.0 * T)
    velocity = filtered([1.0 - pole], [1.0, -pole], np.diff(x, prepend=0.0) / T)
    (b0, b1, a1, a2), taps = law.sections[0], law.taps
    ours = taps[0] * x + filtered([b0, b1], [1.0, a1, a2], x)
    assert ours == pytest.approx(800.0 * x + 3.0 * velocity, abs=1e-9)
    assert law.h1 == pytest.approx(800.0, rel=1e-14)


def test_a_high_cutoff_is_pd_and_a_low_one_costs_stiffness() -> None:
    device = Plant(T, 0.1, 1.0, 1.0)

    def limit(cutoff: float) -> float:
        derivative = without_spring(
            PDFiltered(stiffness=1.0, damping=3.0, cutoff=cutoff), T
        )
        found = k_max(derivative, device).k_max_n_per_m
        assert found is not None
        # Just inside and just outside.
        for share, stable in ((0.999, True), (1.001, False)):
            assert (
                pole_radius(
                    with_spring(derivative, share * found), Plant(T, 0.1, 1.0, 1.0)
                )
                < 1.0
            ) == stable
        return found

    plain = k_max(
        without_spring(PD(stiffness=1.0, damping=3.0), T), device
    ).k_max_n_per_m
    assert limit(1e4) == pytest.approx(plain, rel=1e-9)
    assert limit(100.0) > limit(30.0) > limit(10.0)
    # What it buys: less of the encoder's noise.
    noise = [
        PDFiltered(stiffness=1.0, damping=3.0, cutoff=f).compile(T).h_nyquist
        for f in (1e4, 100.0, 30.0)
    ]
    assert noise[0] > noise[1] > noise[2]


def ring(samples: list[float]) -> list[float]:
    return samples[::-1]


def test_window_is_long_on_a_line_and_short_at_a_corner() -> None:
    line = [k * 0.3 * STEP for k in range(40)]
    read = [round(x / STEP) * STEP for x in line]
    # Encoder steps on a straight motion: the whole window fits, its ends are wrong by half a step
    # each.
    assert windowed_slope(ring(read), 0, STEP, 20) == pytest.approx(
        0.3 * STEP, abs=STEP / 20
    )
    # The backward difference of the same is 0 or a whole step.
    assert abs(read[-1] - read[-2]) in (0.0, pytest.approx(STEP))
    corner = [0.0] * 30 + [k * 5.0 * STEP for k in range(1, 4)]
    # Three ticks after the corner a longer line would miss it by more than a step.
    assert windowed_slope(ring(corner), 0, STEP, 20) == pytest.approx(5.0 * STEP)
    # At rest, a count that flickers is not velocity.
    flicker = [0.0, STEP] * 10 + [0.0]
    assert abs(windowed_slope(ring(flicker), 0, STEP, 1)) == STEP
    assert windowed_slope(ring(flicker), 0, STEP, 20) == 0.0


def test_a_window_of_one_tick_is_pd_bit_for_bit() -> None:
    scene = drop_scene(
        DeviceModel(mass=0.1, damping=1.0, resolution=STEP), T, False, True
    )
    windowed = run(
        scene,
        PDWindowed(stiffness=900.0, damping=2.0, resolution=STEP, window=1).compile(T),
        800,
    )
    plain = run(scene, PD(stiffness=900.0, damping=2.0).compile(T), 800)
    # (K + B/T) x − B/T x₋₁ against K x + B/T (x − x₋₁): roundings of 1000 N/m on 5 mm.
    assert windowed.position == pytest.approx(plain.position, abs=1e-12)


def test_windowed_drop_settles_inside_and_not_outside() -> None:
    """K_max by simulation: the same drop and rule, an order of magnitude apart."""
    scene = drop_scene(
        DeviceModel(mass=0.1, damping=1.0, resolution=STEP, friction=0.06),
        T,
        False,
        True,
    )
    laws = [
        PDWindowed(stiffness=k, damping=3.0, resolution=STEP, window=15).compile(T)
        for k in (1000.0, 8000.0)
    ]
    assert settles(scene, laws, Criterion(1500)) == [True, False]


@pytest.mark.process
@pytest.mark.parametrize(
    "law",
    ["{kind: pd_filtered, stiffness: 900, damping: 3, cutoff: 60}",
     "{kind: pd_windowed, stiffness: 900, damping: 3, resolution: 2.3e-5}"],
)  # fmt: skip
def test_a_launch_in_lockstep_gives_the_bits_of_one_process(
    tmp_path: Path, law: str
) -> None:
    from nodes.parameters.yaml_io import parse_yaml

    chosen = tmp_path / "law.yaml"
    chosen.write_text(f"coupling: {{law: mine, laws: {{mine: {law}}}}}")
    figures = launch_json(
        tmp_path,
        "floor_buzz",
        "pace:=lockstep",
        "duration:=0.6",
        "--params",
        str(chosen),
    )
    state = Recording(tmp_path / figures["recording"]).arrays("/device/state")
    model = DeviceModel(
        mass=0.1, damping=1.0, resolution=STEP, friction=0.06, gravity=9.81
    )
    compiled = compile_law(parse_law(parse_yaml(law, "law")), T)
    trace = run(drop_scene(model, T, False, True), compiled, 300)
    assert np.array_equal(state["position"][:-1, 2], trace.measured)
    assert np.array_equal(state["force"][1:, 2], trace.force)


def test_bad_values_are_refused() -> None:
    with pytest.raises(LawRefusedError, match=r"law\.cutoff: .* above 0, got 0\.0"):
        parse_law(
            {"kind": "pd_filtered", "stiffness": 1.0, "damping": 1.0, "cutoff": 0.0}
        )
    with pytest.raises(LawRefusedError, match=r"law\.window: .* at most 64, got 65"):
        parse_law(
            {
                "kind": "pd_windowed",
                "stiffness": 1.0,
                "damping": 1.0,
                "resolution": 1e-5,
                "window": 65,
            }
        )
