"""K_max and tolerances: closed forms, bisection on pole radii, errors of coarser models."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from nodes.cli.main import main
from nodes.laws import CompiledLaw
from nodes.laws.parse import parse_law
from nodes.stability.closed_loop import pole_radius
from nodes.stability.k_max import (
    boundaries,
    k_max,
    tolerance,
    with_spring,
    without_spring,
)
from nodes.stability.plant import Plant

T = 0.002


def derivative(kind: str, **values: object) -> CompiledLaw:
    return without_spring(parse_law({"kind": kind, "stiffness": 1.0, **values}), T)


PD = derivative("pd", damping=3.0)
HALF = derivative("pd_alpha", damping=3.0, order=0.5, taps=20, gains="paper")
THREE_HALVES = derivative("pd_alpha", damping=3.0, order=1.5, taps=4, gains="paper")
OPTIMUM = derivative("paper_optimum", damping=3.0)


def radius(law: CompiledLaw, device: Plant) -> float:
    return pole_radius(law, device)


@pytest.mark.parametrize("beta", [0.05, 0.3, 2.0 * math.sqrt(2.0) - 2.0, 1.5, 1.9])
def test_closed_form_is_theorys_without_friction(beta: float) -> None:
    """κ_max = 2β(2−β)/(2+β) (THEORY.md §3)."""
    law = derivative("pd", damping=beta * 0.1 / T)
    expected = 2.0 * beta * (2.0 - beta) / (2.0 + beta) * 0.1 / T**2
    found = k_max(law, Plant(T, 0.1, 0.0))
    assert found.method == "closed_form"
    # Differences of coefficients near 1 and 2, divided by T²/m·β: some hundred roundings at the
    # ends.
    assert found.k_max_n_per_m == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("gain", [0.0, 0.5, 3.0, 40.0, 110.0, 130.0])
@pytest.mark.parametrize(
    ("mass", "damping"), [(0.1, 1.0), (0.02, 5.0), (3.0, 0.1), (0.1, 0.0)]
)
@pytest.mark.parametrize("hand", [0.0, 400.0])
def test_closed_form_and_pole_radius_agree(
    gain: float, mass: float, damping: float, hand: float
) -> None:
    law, device = derivative("pd", damping=gain), Plant(T, mass, damping, 0.0, hand)
    exact, found = k_max(law, device, "closed_form"), k_max(law, device, "pole_radius")
    if exact.k_max_n_per_m is None or exact.k_max_n_per_m < 1e-6:
        assert found.k_max_n_per_m is None or found.k_max_n_per_m < 1e-6
    else:
        # The boundary is one root on the circle, conditioned by 1/(T²/m): roundings of 1 seen in
        # T²/m ≥ 1e-6.
        assert found.k_max_n_per_m == pytest.approx(exact.k_max_n_per_m, rel=1e-8)


@pytest.mark.parametrize(
    "law",
    [PD, HALF, THREE_HALVES, OPTIMUM],
    ids=["pd", "half", "three_halves", "optimum"],
)
@pytest.mark.parametrize("delay", [0.0, 0.4, 1.0, 2.0])
@pytest.mark.parametrize("hand", [0.0, 400.0])
def test_just_inside_and_just_outside(
    law: CompiledLaw, delay: float, hand: float
) -> None:
    device = Plant(T, 0.08, 0.9, delay, hand)
    limit = k_max(law, device).k_max_n_per_m
    assert limit is not None
    assert radius(with_spring(law, limit * (1.0 - 1e-6)), device) < 1.0
    assert radius(with_spring(law, limit * (1.0 + 1e-6)), device) > 1.0
    assert radius(with_spring(law, limit), device) == pytest.approx(1.0, abs=1e-11)


def test_nothing_below_the_boundary_is_unstable_and_h1_is_what_is_felt() -> None:
    device = Plant(T, 0.1, 1.0, 1.0)
    found = k_max(OPTIMUM, device)
    low, high = found.stable[0]
    for k in np.linspace(low + 1e-6, high - 1e-6, 60):
        assert radius(with_spring(OPTIMUM, float(k)), device) < 1.0
    # The leak of the truncated terms: K has to exceed it before anything is felt, and it is missing
    # at the top.
    assert low == pytest.approx(-OPTIMUM.h1, rel=1e-12)
    assert found.h1_max_n_per_m == pytest.approx(
        with_spring(OPTIMUM, high).h1, rel=1e-12
    )


def test_every_boundary_has_a_pole_on_the_circle() -> None:
    device = Plant(T, 0.1, 1.0, 1.0)
    for k in boundaries(HALF, device):
        from nodes.stability.closed_loop import closed_loop

        poles = np.roots(closed_loop(with_spring(HALF, k), device))
        assert np.abs(np.abs(poles) - 1.0).min() < 1e-9


def test_long_laws_have_a_boundary_too() -> None:
    law = derivative("pd_alpha", damping=3.0, order=0.5, taps=1500, gains="paper")
    device = Plant(T, 0.1, 1.0, 1.0)
    limit = k_max(law, device).k_max_n_per_m
    assert limit is not None
    assert (
        radius(with_spring(law, limit * 0.999), device)
        < 1.0
        < radius(with_spring(law, limit * 1.001), device)
    )


def test_too_much_damping_leaves_nothing_stable() -> None:
    """β = BT/m must stay below 2 for a device without friction."""
    assert (
        k_max(
            derivative("pd", damping=2.0001 * 0.1 / T), Plant(T, 0.1, 0.0)
        ).k_max_n_per_m
        is None
    )
    assert (
        k_max(
            derivative("pd", damping=1.9999 * 0.1 / T), Plant(T, 0.1, 0.0)
        ).k_max_n_per_m
        is not None
    )


def test_closed_form_is_not_claimed_where_there_is_none() -> None:
    assert k_max(OPTIMUM, Plant(T, 0.1, 1.0)).method == "pole_radius"
    assert k_max(PD, Plant(T, 0.1, 1.0, 1.0)).method == "pole_radius"
    with pytest.raises(
        ValueError, match="closed_form needs a spring or PD without delay"
    ):
        k_max(PD, Plant(T, 0.1, 1.0, 1.0), "closed_form")


@pytest.mark.parametrize("steps", [2, 5, 10])
def test_semi_implicit_euler_overstates_k_max(steps: int) -> None:
    """By 1/(1 − 1/n_sub) for light damping (THEORY.md §3): it hides part of the delay."""
    mass, gain = 0.1, 0.5
    h = T / steps
    position = np.linalg.matrix_power(np.array([[1.0, h], [0.0, 1.0]]), steps)
    pushed = sum(
        (
            np.linalg.matrix_power(np.array([[1.0, h], [0.0, 1.0]]), i)
            @ np.array([h * h / mass, h / mass])
        )
        for i in range(steps)
    )

    def stable(k: float) -> bool:
        # x, v, x one tick ago; F = (K + B/T) x − (B/T) x₋₁.
        row = np.array([k + gain / T, 0.0, -gain / T])
        step = np.zeros((3, 3))
        step[:2, :2] = position
        step[:2] -= np.outer(pushed, row)
        step[2, 0] = 1.0
        return bool(np.abs(np.linalg.eigvals(step)).max() < 1.0)

    low, high = 1.0, 1e5
    for _ in range(60):
        low, high = (
            (0.5 * (low + high), high)
            if stable(0.5 * (low + high))
            else (low, 0.5 * (low + high))
        )
    exact = k_max(derivative("pd", damping=gain), Plant(T, mass, 0.0)).k_max_n_per_m
    assert exact is not None
    # First order in β = BT/m = 0.01; the neglected term is a few β.
    assert low / exact == pytest.approx(
        1.0 / (1.0 - 1.0 / steps), rel=5 * gain * T / mass
    )


def test_tolerances_are_edges() -> None:
    device = Plant(T, 0.1, 1.0, 1.0)
    law = with_spring(PD, 1000.0)
    limits = tolerance(law, device)
    assert limits is not None
    assert limits.mass_min_kg is not None
    assert limits.delay_max_ticks is not None
    assert limits.hand_stiffness_max_n_per_m is not None
    for inside, outside in (
        (
            Plant(T, limits.mass_min_kg * 1.000001, 1.0, 1.0),
            Plant(T, limits.mass_min_kg * 0.999999, 1.0, 1.0),
        ),
        (
            Plant(T, 0.1, 1.0, limits.delay_max_ticks - 1e-6),
            Plant(T, 0.1, 1.0, limits.delay_max_ticks + 1e-6),
        ),
        (
            Plant(T, 0.1, 1.0, 1.0, limits.hand_stiffness_max_n_per_m * 0.999999),
            Plant(T, 0.1, 1.0, 1.0, limits.hand_stiffness_max_n_per_m * 1.000001),
        ),
    ):
        assert radius(law, inside) < 1.0 < radius(law, outside)


def test_an_unstable_loop_has_no_tolerance() -> None:
    assert tolerance(with_spring(PD, 1e5), Plant(T, 0.1, 1.0, 1.0)) is None


def test_kmax_answers_for_machines(capsys: pytest.CaptureFixture[str]) -> None:
    words = "study kmax --law pd --gain 3 --mass 0.1 --damping 1 --delay 0 --rate 500 --json"
    assert main(words.split()) == 0
    figures = json.loads(capsys.readouterr().out.splitlines()[-1])
    expected = k_max(PD, Plant(T, 0.1, 1.0))
    assert (
        figures["k_max_n_per_m"] == figures["h1_max_n_per_m"] == expected.k_max_n_per_m
    )
    assert figures["method"] == "closed_form"
    assert main([*words.split(), "--method", "pole_radius"]) == 0
    again = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert again["k_max_n_per_m"] == pytest.approx(figures["k_max_n_per_m"], rel=1e-9)


def test_kmax_draws_the_boundary(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [
        "study",
        "kmax",
        "--law",
        "paper_optimum",
        "--gain",
        "1..9",
        "--points",
        "5",
        "--delay",
        "1",
    ]
    assert main([*words, "--out", str(tmp_path), "--json"]) == 0
    figures = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert [point["gain"] for point in figures["points"]] == [1.0, 3.0, 5.0, 7.0, 9.0]
    assert Path(figures["plot"]).read_bytes()[:4] == b"\x89PNG"


def test_the_first_line_says_what_was_asked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    loop = "m 0.2 kg, b 1.5 N s/m, hand 50 N/m, delay 1 ticks, 1000 Hz"
    device = [
        "--mass",
        "0.2",
        "--damping",
        "1.5",
        "--hand",
        "50",
        "--delay",
        "1",
        "--rate",
        "1000",
    ]
    assert main(["study", "kmax", "--law", "pd", "--gain", "3", *device]) == 0
    assert capsys.readouterr().out.splitlines()[0] == f"pd B 3; {loop}"
    assert (
        main(["study", "analyse", "pd", "--gain", "3", *device, "--out", str(tmp_path)])
        == 2
    )
    assert "--stiffness K" in capsys.readouterr().err
    assert (
        main(
            [
                "study",
                "analyse",
                "pd",
                "--gain",
                "3",
                "--stiffness",
                "900",
                *device,
                "--out",
                str(tmp_path),
            ]
        )
        == 0
    )
    assert capsys.readouterr().out.splitlines()[0] == f"pd K 900 N/m, B 3; {loop}"


def test_law_show_says_what_it_leaves_out(capsys: pytest.CaptureFixture[str]) -> None:
    assert (
        main(
            [
                "law",
                "show",
                "{kind: pd_windowed, stiffness: 900.0, damping: 3.0, resolution: 2.3e-5}",
            ]
        )
        == 0
    )
    assert "H(1) is that of its taps, without its own code" in capsys.readouterr().out
    assert main(["law", "show", "pd", "--stiffness", "900", "--gain", "3"]) == 0
    assert "without its own code" not in capsys.readouterr().out


def test_kmax_says_when_nothing_is_stable(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "kmax", "--law", "pd", "--gain", "500", "--json"]) == 1
    assert json.loads(capsys.readouterr().out.splitlines()[-1])["k_max_n_per_m"] is None


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("study kmax --law pdq", "law.kind: 'pdq'"),
        ("study kmax --law pd", "--gain B; 0 is a bare spring"),
        ("study analyse pd", "--gain B; 0 is a bare spring"),
        (
            "study kmax --law pd --gain 3 --delay 1 --method closed_form",
            "closed_form needs",
        ),
        (
            "study kmax --law pd --gain 3 --scene press",
            "--scene: no effect here: nothing is played; add --method simulation",
        ),
        (
            "study kmax --law pd --gain 3 --horizon 900 --history position",
            "--history, --horizon: no effect here",
        ),
        (
            "study kmax --law pd --gain 3 --method simulation --grid 9",
            "--grid: no effect here: it is of --method lockstep",
        ),
        (
            "study kmax --law pd --gain 3 --points 9 --workers 2",
            "--points, --workers: no effect here",
        ),
        (
            "study kmax --law pd --gain 3 --stiffness 900",
            "--stiffness: no effect here: K is what is looked for",
        ),
        ("study design --delays 1", "--delays: no effect here: it is of --compare"),
        ("study design --compare --delay 1", "--delay: no effect here"),
        (
            "lab relatives --from-run run.mcap --delay 2",
            "--delay: no effect here: --from-run tells it",
        ),
        ("study analyse {kind:", "law: not valid YAML"),
        ("study analyse {kind: pd, stiffness: -1}", r"law.stiffness"),
    ],
)
def test_refusals_are_usage_errors(
    words: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    command, _, law = words.partition("analyse ")
    argv = [*command.split(), "analyse", law] if law else command.split()
    assert main(argv) == 2
    assert message in capsys.readouterr().err


def test_analyse_agrees_with_what_it_is_made_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert (
        main(
            [
                "study",
                "analyse",
                "paper_optimum",
                "--delay",
                "1",
                "--json",
                "--out",
                str(tmp_path),
            ]
        )
        == 0
    )
    figures = json.loads(capsys.readouterr().out.splitlines()[-1])
    law = parse_law("paper_optimum").compile(T)
    assert figures["taps_n_per_m"] == list(law.taps)
    assert figures["pole_radius"] == radius(law, Plant(T, 0.1, 1.0, 1.0))
    assert (
        figures["k_max_n_per_m"]
        == k_max(OPTIMUM, Plant(T, 0.1, 1.0, 1.0)).k_max_n_per_m
    )
    assert figures["tolerance"]["delay_max_ticks"] > 1.0
    assert Path(figures["plot"]).is_file()


@pytest.mark.thorough("test_the_end_of_a_simulated_search_is_not_told_as_no_limit")
def test_simulated_drop_reads_below_the_linear_limit(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """70 to 99 % of it (THEORY.md §4): near the limit the decay is too slow for any horizon."""
    words = (
        "study kmax --law pd --gain 3 --mass 0.1 --damping 1 --method simulation --json"
    )
    assert main(words.split()) == 0
    figures = json.loads(capsys.readouterr().out.splitlines()[-1])
    limit = k_max(PD, Plant(T, 0.1, 1.0)).k_max_n_per_m
    assert limit is not None
    assert figures["method"] == "simulation"
    assert 0.7 * limit < figures["k_max_n_per_m"] < 0.99 * limit


def test_the_end_of_a_simulated_search_is_not_told_as_no_limit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A drop that settled up to the search limit had "no K_max"."""
    monkeypatch.setattr("sim.experiments.k_max_simulated.SEARCHED", (1e-3, 0.02))
    words = [
        "study",
        "kmax",
        "--law",
        "pd",
        "--method",
        "simulation",
        "--horizon",
        "900",
        "--json",
        "--out",
        str(tmp_path),
    ]
    # 0.02 m/T² is 500 N/m: all that is tried settles.
    assert main([*words, "--gain", "3"]) == 0
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert (told["k_max_n_per_m"], told["at_least_n_per_m"]) == (
        None,
        pytest.approx(500.0),
    )
    assert main([*words[:-3], "--gain", "3"]) == 0
    assert "above 500 N/m" in capsys.readouterr().out
    assert main([*words, "--gain", "3..4", "--points", "2"]) == 0
    assert [
        one["at_least_n_per_m"]
        for one in json.loads(capsys.readouterr().out.splitlines()[-1])["points"]
    ] == [pytest.approx(500.0)] * 2
    # And where nothing settles, only what was tried is said not to.
    assert main([*words[:-3], "--gain", "200"]) == 1
    assert "nothing from 25 to 500 N/m settles" in capsys.readouterr().out


@pytest.mark.parametrize(("gain", "limit"), [("3", 3781.866), ("500", None)])
def test_nothing_rests_that_is_not_stable(
    gain: str, limit: float | None, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The stiffness for rest was shown without K_max, as if every stiffness were stable."""
    words = [
        "--stiffness",
        "900",
        "--gain",
        gain,
        "--resolution",
        "1e-8",
        "--friction",
        "0.1",
    ]
    assert (
        main(["study", "analyse", "pd", *words, "--json", "--out", str(tmp_path)]) == 0
    )
    told = json.loads(capsys.readouterr().out.splitlines()[-1])["rest"]
    expected = None if limit is None else pytest.approx(limit, rel=1e-6)
    # On the map where friction over the step is largest.
    assert (told["k_rest_n_per_m"], told["map"]["k_rest_n_per_m"][0][-1]) == (
        expected,
        expected,
    )
