"""K_max from a recorded swing, without the mass (THEORY.md §9): from real launches at two thirds of it, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from nodes.cli.main import main
from nodes.laws.parse import parse_law
from nodes.stability.k_max import k_max, without_spring
from nodes.stability.plant import Plant
from sim.paper.swing import recorded_swing, ringing
from tests.support.launching import launch_json

T = 0.002


@pytest.mark.parametrize(
    ("law", "stiffness", "apply"),
    [("pd", 2500.0, "on_arrival"), ("multi_term", 2700.0, "on_arrival"), ("pd", 900.0, "next_tick")],
)
def test_a_launch_far_inside_tells_where_the_edge_is(
    tmp_path: Path, law: str, stiffness: float, apply: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = f"pace:=lockstep duration:=1 law:={law} stiffness:={stiffness:g} apply:={apply}".split()
    path = tmp_path / launch_json(tmp_path, "floor_drop", *words)["recording"]
    kind = {"kind": "paper_optimum"} if law == "multi_term" else {"kind": "pd", "stiffness": 1.0}
    derivative = without_spring(parse_law({**kind, "damping": 3.0}), T)
    limit = k_max(derivative, Plant(T, 0.1, 1.0, 1.0 if apply == "next_tick" else 0.0)).k_max_n_per_m
    assert limit is not None
    assert stiffness < 0.75 * limit
    found = recorded_swing(path)
    # ω grows like √K up to the edge, f(ω) moves with it: a few per cent of K_max from three quarters of it.
    assert found.edge.k_exact_n_per_m == pytest.approx(limit, rel=0.03)
    assert found.decay_per_tick < 1.0
    assert found.stiffness_n_per_m == stiffness
    assert main(["study", "edge", str(path), "--json"]) == 0
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["edge"]["k_exact_n_per_m"] == found.edge.k_exact_n_per_m


@pytest.mark.parametrize(("theta", "decay"), [(0.2, 0.98), (1.0, 0.999), (0.4, 1.01)])
def test_a_swing_is_fitted_exactly(theta: float, decay: float) -> None:
    k = np.arange(120)
    x = -1e-3 + 1e-4 * decay**k * np.cos(theta * k + 0.3)
    # The fit is linear and the signal obeys it: roundings of 1e-3 over 1e-4.
    assert ringing(x) == pytest.approx((theta, decay), rel=1e-6)


def test_what_does_not_swing_is_refused() -> None:
    k = np.arange(200)
    with pytest.raises(ValueError, match="nothing swings"):
        ringing(np.zeros(200))
    with pytest.raises(ValueError, match="creeps to rest"):
        ringing(1e-3 * 0.9**k + 5e-4 * 0.8**k)


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
