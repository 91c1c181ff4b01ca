"""Speed against accuracy: fronts, files, timing, and comparison with the truth."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nodes.cli.main import main
from nodes.laws import CompiledLaw
from nodes.laws.pd import PD
from nodes.stability.k_max import k_max, without_spring
from nodes.stability.plant import Plant
from sim.design.demand import Demand
from sim.design.families import best_pd
from sim.device.model import DeviceModel
from sim.lab.bench.tap_timing import TapTimings
from sim.lab.charts.conclusions import FEWEST, _correlation
from sim.lab.charts.derivative_errors import analyse
from sim.lab.charts.derivatives import largest_stable, with_stiffness
from sim.lab.charts.equal_demand import NYQUIST, RADII, keeps, laws, tuned
from sim.lab.charts.integrators import (
    DAMPING,
    MASS,
    PERIOD,
    drop,
    integrators,
    reference,
    spring_limit,
)
from sim.lab.charts.k_max_ways import light, poles, simulated
from sim.lab.charts.points import Group, Point, keep, kept, on_front, save, with_front
from sim.lab.charts.rates import GAIN, calms_down, continuous, force_error, launch
from sim.measure.stopwatch import Progress, Timing, interleaved, machine
from sim.play.one_axis import run
from sim.play.one_axis_inputs import Scene, SceneSurface

few = st.integers(0, 4).map(float)


def test_a_chart_does_not_go_on_with_what_another_version_measured(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    diary = tmp_path / "chart.part"
    groups = [Group("group", "title", "cost", "error", (Point("one", 1.0, 2.0),))]
    keep(diary, "kmax", groups)
    assert kept(diary, "kmax") == groups
    assert kept(diary, "rates") is None
    monkeypatch.setattr("sim.lab.charts.points.program", lambda: "another")
    assert kept(diary, "kmax") is None
    # It is set aside, and the new one begins without it.
    assert list(tmp_path.glob("earlier/*/chart.part"))
    keep(diary, "rates", groups)
    assert (kept(diary, "kmax"), kept(diary, "rates")) == (None, groups)


@given(points=st.lists(st.tuples(few, few | st.just(math.inf)), max_size=12))
def test_front_is_what_nothing_beats(points: list[tuple[float, float]]) -> None:
    marks = on_front([c for c, _ in points], [e for _, e in points])
    for i, (cost, error) in enumerate(points):
        beaten = any(
            other_cost <= cost
            and other_error <= error
            and (other_cost < cost or other_error < error)
            for j, (other_cost, other_error) in enumerate(points)
            if j != i
        )
        assert marks[i] == (not beaten and math.isfinite(error))


def test_front_ignores_what_is_not_a_number() -> None:
    assert on_front([1.0, 2.0], [math.nan, 3.0]) == [False, True]


def test_files_hold_every_figure(tmp_path: Path) -> None:
    group = with_front(
        Group(
            "g",
            "t",
            "c",
            "e",
            (
                Point("b", 2.0, 1.0, "f", {"x": 1}),
                Point("a", 1.0, 2.0),
                Point("c", 3.0, 3.0, "", {"y": "z"}),
            ),
        )
    )
    whole, table = save([group], {"cpu": "?"}, 1.0, tmp_path / "new")
    points = json.loads(whole.read_text())["points"]
    assert [
        (p["group"], p["name"], p["cost"], p["error"], p["on_front"]) for p in points
    ] == [
        ("g", "a", 1.0, 2.0, True),
        ("g", "b", 2.0, 1.0, True),
        ("g", "c", 3.0, 3.0, False),
    ]
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["name"] for row in rows] == ["a", "b", "c"]
    assert [(row["x"], row["y"]) for row in rows] == [("", ""), ("1", ""), ("", "z")]


def test_progress_tells_tenths_where_there_is_no_terminal() -> None:
    stream = io.StringIO()
    progress = Progress(40, stream)
    for _ in range(40):
        progress.step("work")
    lines = stream.getvalue().splitlines()
    assert len(lines) == 11
    assert lines[-1] == "100 %  work"


def test_interleaved_runs_every_job_in_every_round() -> None:
    order: list[str] = []
    jobs = {name: ((lambda name=name: order.append(name)), 2) for name in "abc"}
    told: list[str] = []
    timings = interleaved(jobs, 6, told.append)
    # One round of warming up, and six that count, each with all of them.
    assert sorted(order) == sorted("abc" * 7)
    assert all(sorted(order[i : i + 3]) == ["a", "b", "c"] for i in range(0, 21, 3))
    assert len({tuple(order[i : i + 3]) for i in range(3, 21, 3)}) > 1
    assert len(told) == 6
    assert all(
        0.0 < t.low <= t.median <= t.high and t.rounds == 6 for t in timings.values()
    )


def test_machine_is_named() -> None:
    named = machine()
    assert named["cpu"]
    assert named["cores"] >= 1


def test_crossover_lies_between_the_lengths_where_the_order_changes() -> None:
    def timing(seconds: float) -> Timing:
        return Timing(seconds, seconds, seconds, 1)

    # Straight lines n and 20: they cross at 20, which interpolation on logarithmic scales finds
    # exactly.
    found = TapTimings(
        {n: {"plain": timing(n), "numpy": timing(20.0)} for n in (5, 10, 40, 80)}, True
    )
    assert found.crossover("plain", "numpy") == pytest.approx(20.0, rel=1e-12)
    assert found.crossover("numpy", "plain") is None


def test_largest_stable_finds_the_first_change() -> None:
    assert largest_stable(lambda k: k / 321.0, 1.0, 1e4, 1e-9) == pytest.approx(
        321.0, rel=1e-8
    )
    # Unstable at first (a leak), then stable, then not.
    assert largest_stable(
        lambda k: 0.5 if 10.0 < k < 50.0 else 1.5, 1.0, 1e4, 1e-9
    ) == pytest.approx(50.0, rel=1e-8)
    assert largest_stable(lambda _: 2.0, 1.0, 1e4) == 0.0
    assert largest_stable(lambda _: 0.5, 1.0, 1e4) == pytest.approx(1e4)


def test_leak_does_not_change_the_stiffness_that_is_compared() -> None:
    from nodes.laws.derivatives import realise

    law = with_stiffness(realise("gl", 1.5, 8, 0.002), 400.0, 3.0, 1.5, 0.002)
    assert law.h1 == pytest.approx(400.0, rel=1e-9)


@pytest.mark.parametrize("radius", [0.99, 1.0 - 1e-9])
def test_equal_demand_is_kept_just_inside_and_broken_just_outside(
    radius: float,
) -> None:
    unit = without_spring(PD(stiffness=1.0, damping=1.0), 0.002)

    def way(stiffness: float, gain: float) -> CompiledLaw:
        return with_stiffness(unit, stiffness, gain, 1.0, 0.002)

    stiffness, gain = tuned(way, radius)
    # To 1e-3 along K, at this gain; the demand is kept by poles at the masses and by H(−1) = K +
    # 2B/T.
    assert keeps(way(stiffness, gain), radius)
    assert not keeps(way(1.002 * stiffness, gain), radius)
    assert stiffness + 2.0 * gain / 0.002 <= NYQUIST
    # The design's own search, global and with linear programmes over 801 masses, finds the same
    # best PD.
    if radius == 0.99:
        best = best_pd(
            Demand((0.05, 0.2), 1.0, (1.0, 1.0), 0.002, radius, NYQUIST)
        ).found
        assert best is not None
        assert stiffness == pytest.approx(best.h1_n_per_m, rel=5e-3)


def test_a_long_fir_is_less_precise_than_a_short_recursive_filter_and_easier() -> None:
    """The paper's section 3 (THEORY.md §11), over three decades to half of Nyquist."""
    fir, filtered = (
        analyse(kind, 0.5, taps, 0.002)
        for kind, taps in (("gl", 64), ("oustaloup_matched", 13))
    )
    for figure in ("error_aligned", "error_raw", "multiplies"):
        assert fir[figure] > filtered[figure]
    # Easier: no poles that could be unstable, and nothing to choose but its length.
    assert fir["largest_pole"] == 0.0 < filtered["largest_pole"] < 1.0


# --- integrators: the reference is scipy's matrix exponential
# --------------------------------------------------------


def test_exact_map_is_right_to_rounding() -> None:
    off = np.max(np.abs(drop(integrators()["exact map"]) - drop(reference())))
    # 250 ticks of heights below 10 mm, each rounded to 2^−53 of itself and carried on by a stable
    # map.
    assert off < 250 * 2.0**-53 * 0.01 * 10


@pytest.mark.parametrize("count", [2, 4, 10, 40])
def test_semi_implicit_euler_overstates_k_max(count: int) -> None:
    ratio = spring_limit(integrators()[f"semi-implicit Euler {count}"]) / spring_limit(
        reference()
    )
    # 1/(1 − 1/n) for b → 0; here bT/m = 0.02, which moves it by as much.
    assert ratio == pytest.approx(
        1.0 / (1.0 - 1.0 / count), rel=DAMPING * PERIOD / MASS
    )


def test_rk4_is_of_fourth_order() -> None:
    found, exact = integrators(), drop(reference())
    errors = [float(np.max(np.abs(drop(found[f"RK4 {n}"]) - exact))) for n in (1, 2, 4)]
    # Halving the step divides the error by 16, up to the next order's share bT/m = 2 %.
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.05)
    assert errors[1] / errors[2] == pytest.approx(16.0, rel=0.05)


# --- K_max
# --------------------------------------------------------------------------------------------------


def test_pole_radius_is_the_closed_form_where_there_is_one() -> None:
    law = without_spring(PD(stiffness=1.0, damping=3.0), 0.002)
    closed = k_max(law, Plant(0.002, 0.1, 0.1), "closed_form").k_max_n_per_m
    assert poles(0.0, 1e-9) == pytest.approx(closed, rel=1e-8)
    # The formula for an undamped device is off by the damping left out, b/B = 1/30 or so.
    assert light(0.0) == pytest.approx(closed, rel=0.1 / 3.0 * 1.5)


def test_longer_horizons_read_closer_and_always_low() -> None:
    limit = poles(1.0, 1e-9)
    readings = [
        simulated(1.0, horizon, dropped=False) for horizon in (0.3, 1.0, 3.0, 10.0)
    ]
    assert readings == sorted(readings)
    # Within 1e-3, the precision of the search, never above the linear limit.
    assert readings[-1] <= limit * 1.001
    assert readings[-1] > 0.95 * limit


# --- through the processes
# --------------------------------------------------------------------------------------------


def test_force_error_knows_a_held_force() -> None:
    time = np.linspace(0.0, 1.0, 1001)
    onset = np.array([0.0, 0.5])
    held = np.where(time < 0.5, 1.0, 2.0)
    assert force_error(onset, np.array([1.0, 2.0]), time, held) == 0.0
    # Nothing before the first onset: half of the time off by 1, against a mean square of (1 + 4)/2.
    late = force_error(np.array([0.5]), np.array([2.0]), time, held)
    assert late == pytest.approx(math.sqrt(0.5 / 2.5), rel=2e-3)


def test_settles_refuses_what_is_not_finite() -> None:
    assert calms_down(np.zeros(100))
    assert not calms_down(np.full(100, math.nan))
    assert not calms_down(np.tile([0.0, 0.002], 50))


@pytest.mark.slow
def test_forces_of_the_processes_are_those_of_one_process() -> None:
    rate, stiffness = 500.0, 400.0
    found = launch(rate, "next_tick", stiffness, "lockstep")
    device = DeviceModel(mass=0.1, damping=1.0, gravity=9.81, position=0.01)
    scene = Scene(
        device=device,
        surface=SceneSurface("plane"),
        period=1.0 / rate,
        raw=False,
        clamp=True,
        next_tick=True,
    )
    trace = run(
        scene,
        PD(stiffness=stiffness, damping=GAIN).compile(scene.period),
        len(found.force),
    )
    # Lockstep through four processes: the same bits, and exactly one tick late.
    assert found.force.tolist() == trace.force.tolist()
    assert found.delay == 1.0
    assert found.onset == pytest.approx(trace.time + 1.0 / rate, abs=1e-12)
    time, wanted = continuous(stiffness)
    assert 0.0 < force_error(found.onset, found.force, time, wanted) < 0.5


# --- the command
# --------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def chart(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("chart")
    from contextlib import redirect_stdout

    out = io.StringIO()
    with redirect_stdout(out):
        code = main(
            [
                "study",
                "chart",
                "--parts",
                "derivatives,demand,integrators,kmax",
                "--quick",
                "--json",
                "--out",
                str(folder),
            ]
        )
    assert code == 0
    answer: dict[str, Any] = json.loads(out.getvalue().splitlines()[-1])
    return folder, answer


@pytest.mark.slow
def test_chart_answers_with_points_and_fronts(
    chart: tuple[Path, dict[str, Any]],
) -> None:
    _, answer = chart
    points = answer["points"]
    for group in {p["group"] for p in points}:
        members = [p for p in points if p["group"] == group]
        marks = on_front([p["cost"] for p in members], [p["error"] for p in members])
        assert [p["on_front"] for p in members] == marks
        assert any(marks)
        assert all(p["cost"] > 0.0 and p["error"] >= 0.0 for p in members)
    assert answer["machine"]["cpu"]


@pytest.mark.slow
def test_chart_has_every_realisation(chart: tuple[Path, dict[str, Any]]) -> None:
    from nodes.laws.derivatives import derivative_kinds

    _, answer = chart
    for order in ("0.5", "1.5"):
        families = {
            p["family"]
            for p in answer["points"]
            if p["group"] == f"derivative_time_{order}"
        }
        assert families == set(derivative_kinds())


@pytest.mark.slow
def test_chart_conclusions_are_true_to_the_data(
    chart: tuple[Path, dict[str, Any]],
) -> None:
    folder, answer = chart
    page = (folder / "chart.md").read_text()
    for line in answer["conclusions"]:
        assert line in page
    points = {(p["group"], p["name"]): p for p in answer["points"]}
    equal = next(
        line for line in answer["conclusions"] if line.startswith("At equal demand")
    )
    for order in ("0.5", "1.5"):
        group = [
            p for p in answer["points"] if p["group"] == f"equal_demand_{order}_stable"
        ]
        stiffest = max(group, key=lambda p: p["detail"]["h1_tuned_n_per_m"])
        assert stiffest["error"] == 0.0
        assert (
            f"the stiffest, {stiffest['name']}, has"
            f" {stiffest['detail']['h1_tuned_n_per_m']:.0f} N/m" in equal
        )
    assert {
        p["family"] for p in answer["points"] if p["group"] == "equal_demand_1_calm"
    } >= {"gl", "pd_filtered"}
    assert points["integrator_k_max", "exact map"]["error"] < 1e-9
    assert points["integrator_k_max", "semi-implicit Euler 10"][
        "error"
    ] == pytest.approx(1.0 / 9.0, rel=0.05)
    best = min(
        (p for p in answer["points"] if p["group"] == "derivative_time_0.5"),
        key=lambda p: p["error"],
    )
    assert f"{best['name']} is the most accurate" in answer["conclusions"][0]


@pytest.mark.slow
def test_chart_is_drawn(chart: tuple[Path, dict[str, Any]]) -> None:
    folder, answer = chart
    groups = {p["group"] for p in answer["points"]}
    for group in groups:
        assert (folder / f"chart_{group}.png").read_bytes().startswith(b"\x89PNG")
        assert b"<svg" in (folder / f"chart_{group}.svg").read_bytes()
    with (folder / "chart.csv").open(newline="") as file:
        assert len(list(csv.DictReader(file))) == len(answer["points"])


def test_unknown_part_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "chart", "--parts", "speed"]) == 2
    assert "--parts speed" in capsys.readouterr().err


@pytest.mark.slow
def test_bench_taps_answers(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert (
        main(
            [
                "bench",
                "taps",
                "--taps",
                "4,300",
                "--rounds",
                "2",
                "--json",
                "--out",
                str(tmp_path),
            ]
        )
        == 0
    )
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert answer["same_bits"] is True
    assert [p["taps"] for p in answer["points"]] == [4, 300]
    # 300 taps in a Python loop against one call into numpy: a factor of ten or so, whatever the
    # machine.
    assert answer["fastest"]["300"] not in {"plain", "unrolled"}
    # A window looks back over up to 15 samples, a filter multiplies four times.
    assert answer["laws_us"]["pd_windowed"] > answer["laws_us"]["pd_filtered"] > 0.0
    assert (tmp_path / "bench_taps.png").exists()


def test_the_best_gain_at_equal_demand_is_not_lost_between_two_tries() -> None:
    way = next(way for name, _, way, _ in laws(1.0, quick=True) if name == "pd")
    best, at = tuned(way, RADII["stable"])
    # The demand's edge is the least of two masses' edges: a peak with a kink, found again by a
    # dense walk about it.
    for gain in np.geomspace(0.7 * at, 1.4 * at, 61).tolist():
        assert not keeps(way(1.002 * best, gain), RADII["stable"])
    assert keeps(way(best, at), RADII["stable"])


@pytest.mark.slow
def test_a_stopped_chart_leaves_what_it_has_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    done: list[str] = []

    def integrator_groups(step: Callable[[str], None], quick: bool) -> list[Group]:
        del step, quick
        done.append("integrators")
        rows = (
            ("exact map", 1.0, 0.0),
            ("semi-implicit Euler 10", 2.0, 0.1),
            ("Runge-Kutta 4", 3.0, 1e-9),
        )
        points = tuple(Point(*row) for row in rows)
        names = ("integrator_trajectory", "integrator_k_max")
        return [Group(name, name, "cost", "error", points) for name in names]

    def stopped(step: Callable[[str], None], quick: bool) -> list[Group]:
        del step, quick
        raise KeyboardInterrupt

    monkeypatch.setattr(
        "sim.lab.charts.integrators.integrator_groups", integrator_groups
    )
    monkeypatch.setattr("sim.lab.charts.k_max_ways.kmax_groups", stopped)
    words = [
        "study",
        "chart",
        "--parts",
        "integrators,kmax",
        "--quick",
        "--out",
        str(tmp_path),
        "--json",
    ]
    assert main(words) == 1
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert told["failures"] == ["kmax: interrupted; the same command goes on here"]
    assert {point["group"] for point in told["points"]} == {
        "integrator_trajectory",
        "integrator_k_max",
    }
    assert Path(told["page"]).is_file()
    assert main(words) == 1
    again = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert again["points"] == told["points"]
    assert done == ["integrators"]


@pytest.mark.slow
def test_the_panel_of_proxies_has_closed_forms_meshes_and_bodies(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(
            [
                "study",
                "chart",
                "--parts",
                "proxies",
                "--quick",
                "--json",
                "--out",
                str(tmp_path),
            ]
        )
        == 0
    )
    answer = json.loads(capsys.readouterr().out.splitlines()[-1])
    points = {p["name"]: p for p in answer["points"]}
    assert {p["family"] for p in points.values()} == {"closed form", "mesh", "body"}
    assert all(p["cost"] > 0.0 for p in points.values())
    # Of the closed form it keeps the skin's distance, 1e-4 µm, and rounding.
    assert points["sphere"]["error"] == pytest.approx(1e-4, rel=1e-3)
    # Half the edges: between half and a quarter of the error.
    assert 0.2 < points["mesh 1280"]["error"] / points["mesh 320"]["error"] < 0.6
    soft, stiff = points["body, 0.5 ms steps"], points["body, 0.5 ms steps, stiff"]
    # 2 N on MuJoCo's usual contact with a tool of 50 g, about 3 kN/m (`MovingScene.stiffness`
    # measures it): some 0.6 mm.
    assert 400.0 < soft["error"] < 900.0
    assert stiff["error"] < 0.1 * soft["error"]
    assert "a tool that is a body" in answer["conclusions"][0]
    assert (tmp_path / "chart_proxy_error.png").read_bytes().startswith(b"\x89PNG")


def test_ranks_of_a_few_laws_are_no_verdict() -> None:
    """Perfect order of seven happens by chance once in 2520, and is not reported."""
    for count in (3, 6, FEWEST - 1):
        told = _correlation(list(range(count)), list(range(count)))
        assert (
            told
            == f"{count} laws, too few for a rank correlation of error and stiffness"
        )
    rising = list(map(float, range(12)))
    ranks = "rank correlation of error and stiffness"
    assert _correlation(rising, rising).startswith(
        f"accuracy costs stiffness: {ranks} +1.00, n = 12, p = "
    )
    assert _correlation(rising, rising[::-1]).startswith(
        f"accuracy brings stiffness: {ranks} -1.00"
    )
    # By Spearman's own table: rs = 0.14 of eight is p = 0.74.
    shuffled = [3.0, 7.0, 0.0, 5.0, 2.0, 6.0, 1.0, 4.0]
    told = _correlation(list(map(float, range(8))), shuffled)
    assert told.startswith("accuracy is not seen to matter")
    assert "n = 8" in told
