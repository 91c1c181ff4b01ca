"""K_max from a recorded swing, no mass known (THEORY.md §9): launches far inside, random devices, and what is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nodes.cli.main import main
from nodes.laws.parse import parse_law
from nodes.recording.reader import Recording
from nodes.stability.k_max import k_max, with_spring, without_spring
from nodes.stability.plant import Plant
from sim.design.recorded_loop import measure
from sim.device.model import DeviceModel
from sim.experiments.drop import drop_scene, free_scene
from sim.paper.swing import CannotTellError, _law, _longest, _told, recorded_swing, ringing, windows
from sim.scene.loop import run
from tests.support.launching import launch_json

T = 0.002


PD_ALPHA = (
    "{laws: {half: {kind: pd_alpha, stiffness: 1800.0, damping: 8.0, order: 0.5, taps: 20, gains: paper}}, law: half}"
)


def recorded(folder: Path, words: str, law: str = "") -> Path:
    (folder / "more.yaml").write_text(f"coupling: {law or '{}'}", encoding="utf-8")
    assignments = f"pace:=lockstep duration:=1 {words}".split()
    told = launch_json(folder, "floor_drop", *assignments, "--params", "more.yaml")
    return folder / str(told["recording"])


def limit_of(path: Path, delay: float = 0.0) -> float:
    limit = k_max(without_spring(_law(Recording(path), path), T), Plant(T, 0.1, 1.0, delay)).k_max_n_per_m
    assert limit is not None
    return limit


@pytest.mark.parametrize(
    ("words", "law", "delay"),
    [
        ("law:=pd stiffness:=900 apply:=next_tick", "", 1.0),
        ("", PD_ALPHA, 0.0),
    ],
)
def test_a_launch_far_inside_tells_where_the_edge_is(
    tmp_path: Path, words: str, law: str, delay: float, capsys: pytest.CaptureFixture[str]
) -> None:
    path = recorded(tmp_path, words, law)
    limit, found = limit_of(path, delay), recorded_swing(path)
    low, high = found.k_max_n_per_m
    # The margin on each side, and what the windows differ by: nothing is noisy here, but the short memory of PDα creeps.
    assert low < limit < high < 1.06 * low
    assert found.mass_kg == pytest.approx((0.1, 0.1), rel=0.03)
    assert found.stiffness_n_per_m < 0.75 * limit
    assert found.edge.k_exact_n_per_m == pytest.approx(limit, rel=0.03)
    assert main(["study", "edge", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["k_max_n_per_m"] == [low, high]
    # A damping that nobody knows leaves a wider interval, not another one.
    wide = _told_without_damping(path)
    assert wide[0] < low < high < 1.02 * wide[1]


def _told_without_damping(path: Path) -> tuple[float, float]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sim.paper.swing.measure", lambda path: replace(measure(path), damping=None))
        return recorded_swing(path).k_max_n_per_m


DERIVATIVES: dict[str, dict[str, Any]] = {
    "pd": {"kind": "pd", "stiffness": 1.0},
    "filtered": {"kind": "pd_filtered", "stiffness": 1.0, "cutoff": 100.0},
    "half": {"kind": "pd_alpha", "stiffness": 1.0, "order": 0.5, "taps": 20, "gains": "paper"},
    "optimum": {"kind": "paper_optimum"},
}


@pytest.mark.parametrize("name", DERIVATIVES)
def test_friction_and_encoder_do_not_move_the_edge_out_of_the_interval(name: str) -> None:
    # Random devices, dropped: dry friction makes the swing die faster, which is not taken for damping.
    random = np.random.default_rng(3)
    told = 0
    for share in (0.3, 0.5, 0.5, 0.7, 0.85):
        plant = Plant(T, 10.0 ** random.uniform(-1.3, -0.5), random.uniform(0.5, 2.0), random.choice([0.0, 0.4, 1.0]))
        law = parse_law({**DERIVATIVES[name], "damping": 40.0 * plant.mass})
        derivative = without_spring(law, T)
        limit = k_max(derivative, plant).k_max_n_per_m
        assert limit is not None
        whole = with_spring(derivative, share * limit)
        device = DeviceModel(
            mass=plant.mass, damping=plant.damping, delay=plant.delay, friction=0.03, resolution=2.3e-5
        )
        trace = run(drop_scene(device, T, False, True), whole, 500)
        first, last = _longest(np.abs(trace.force) > 0.0)
        try:
            fits, ticks = windows(trace.measured[first:last])
            low, high = _told(law, whole, plant, fits, plant.damping, ticks).k_max_n_per_m
        except CannotTellError:
            continue
        told += 1
        assert low < limit < high
        assert high - low < 0.3 * limit
    assert told >= 2


@pytest.mark.parametrize(("theta", "decay"), [(0.2, 0.98), (1.0, 0.999), (0.4, 1.01)])
def test_a_swing_is_fitted_exactly(theta: float, decay: float) -> None:
    k = np.arange(120)
    fit = ringing(-1e-3 + 1e-4 * decay**k * np.cos(theta * k + 0.3))
    # The signal obeys the model: what is left is the tolerance of the search.
    assert (fit.theta, fit.decay) == pytest.approx((theta, decay), rel=1e-6)
    assert fit.residual < 1e-6


def test_what_does_not_swing_is_refused() -> None:
    k = np.arange(200)
    with pytest.raises(CannotTellError, match="nothing swings"):
        ringing(np.zeros(200))
    with pytest.raises(CannotTellError, match="creeps to rest"):
        ringing(1e-3 * 0.9**k + 5e-4 * 0.8**k)


def test_what_grows_is_refused() -> None:
    derivative = without_spring(parse_law({"kind": "pd", "stiffness": 1.0, "damping": 3.0}), T)
    plant = Plant(T, 0.1, 1.0)
    whole = with_spring(derivative, 1.02 * (k_max(derivative, plant).k_max_n_per_m or 0.0))
    trace = run(free_scene(DeviceModel(mass=0.1, damping=1.0), T), whole, 400)
    with pytest.raises(CannotTellError, match="does not decay"):
        windows(trace.measured)


@pytest.mark.parametrize(
    ("words", "law", "why"),
    [
        ("law:=pd stiffness:=2500", "{schedule: [{at: 0.3, law: multi_term}]}", "the law changed"),
        (
            "",
            "{laws: {w: {kind: pd_windowed, stiffness: 1500.0, damping: 3.0, resolution: 2.3e-5}}, law: w}",
            "own code|code of its own",
        ),
    ],
)
def test_off_the_ringing_pole_it_cannot_tell(
    tmp_path: Path, words: str, law: str, why: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = recorded(tmp_path, words, law)
    with pytest.raises(CannotTellError, match=why):
        recorded_swing(path)
    assert main(["study", "edge", str(path)]) == 1
    assert capsys.readouterr().out.startswith("cannot tell: ")


def test_study_edge_compares_laws(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "edge", "--points", "4", "--gain", "3..25", "--out", str(tmp_path), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert figures["exact_error"] < 1e-9
    # The filter's own lag makes the low-frequency reading of PD behind one worse than that of the laws of taps.
    ratios = [
        point["k_simple_n_per_m"] / point["k_exact_n_per_m"] for point in figures["points"] if "Hz" not in point["law"]
    ]
    assert 0.95 < min(ratios) < max(ratios) < 1.0
    assert 0.85 < figures["ratio_min"] < figures["ratio_max"] < 1.0
    assert len(figures["points"]) == 4 * len({point["law"] for point in figures["points"]}) == 20
    assert Path(figures["plot"]).stat().st_size > 10_000
    assert main(["study", "edge", "--gain", "3", "--out", str(tmp_path)]) == 2
    assert main(["study", "edge", str(tmp_path / "none.mcap")]) == 2
