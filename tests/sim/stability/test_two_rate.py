"""The lifted loop: one-rate theory, a tick-by-tick simulation, and its closed form."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from nodes.cli.main import main
from nodes.laws import CompiledLaw
from nodes.laws.pd import PD
from nodes.stability.closed_loop import pole_radius
from nodes.stability.k_max import k_max
from nodes.stability.plant import Plant
from sim.device.model import advance, coefficients
from sim.stability.two_rate import TwoRate, heavy_limit, two_rate_k_max, two_rate_radius
from tests.support.pictures import assert_drawn

T = 0.002
SPRING = CompiledLaw((0.0,))


@pytest.mark.parametrize("delay", [0, 1, 2, 3])
def test_without_a_servo_it_is_the_loop_of_one_rate(delay: int) -> None:
    law = PD(stiffness=700.0, damping=2.0).compile(T)
    # The same whole delay, counted in servo ticks of two lengths.
    for ratio in (1, 4):
        device = TwoRate(0.1, 1.0, 0.0, ratio, delay * ratio)
        assert two_rate_radius(law, T, device) == pytest.approx(
            pole_radius(law, Plant(T, 0.1, 1.0, delay)), rel=1e-9
        )


def test_a_fraction_of_a_tick_is_the_fractional_delay_of_the_theory() -> None:
    law = PD(stiffness=700.0, damping=2.0).compile(T)
    for servo_ticks, delay in ((1, 0.25), (3, 0.75), (5, 1.25)):
        device = TwoRate(0.1, 1.0, 0.0, 4, servo_ticks)
        assert two_rate_radius(law, T, device) == pytest.approx(
            pole_radius(law, Plant(T, 0.1, 1.0, delay)), rel=1e-9
        )


def test_a_servo_as_fast_as_the_loop_is_pd() -> None:
    law = PD(stiffness=900.0, damping=3.0).compile(T)
    spring = CompiledLaw((900.0,))
    assert two_rate_radius(spring, T, TwoRate(0.1, 1.0, 3.0, 1)) == pytest.approx(
        pole_radius(law, Plant(T, 0.1, 1.0)), rel=1e-9
    )
    closed = k_max(
        PD(stiffness=1.0, damping=3.0).compile(T), Plant(T, 0.1, 1.0), "closed_form"
    ).k_max_n_per_m
    assert closed is not None
    # That law already has a spring of 1 N/m in it.
    assert two_rate_k_max(SPRING, T, TwoRate(0.1, 1.0, 3.0, 1)) == pytest.approx(
        closed + 1.0, rel=1e-9
    )


def grows(k: float, device: TwoRate, periods: int = 4000) -> bool:
    """Simulate both rates tick by tick: exact map, servo damper, spring force on arrival."""
    short = T / device.ratio
    step = coefficients(device.mass, device.damping, 0.0, short)
    x = before = 1e-3
    v = 0.0
    due: list[tuple[int, float]] = []
    acting, early, late = 0.0, 0.0, 0.0
    for n in range(periods * device.ratio):
        if n % device.ratio == 0:
            due.append((n + device.delay, -k * x))
        while due and due[0][0] <= n:
            acting = due.pop(0)[1]
        servo = -device.servo_damping * (x - before) / short
        before = x
        x, v = advance(x, v, acting + servo, step)
        if not abs(x) < 1e6:
            return True
        third = n * 3 // (periods * device.ratio)
        early = max(early, abs(x)) if third == 1 else early
        late = max(late, abs(x)) if third == 2 else late
    return late > early


@pytest.mark.parametrize("ratio", [2, 4])
@pytest.mark.parametrize("delay", [0, 1, 3])
def test_simulation_turns_over_at_k_max(ratio: int, delay: int) -> None:
    device = TwoRate(0.1, 1.0, 3.0, ratio, delay)
    edge = two_rate_k_max(SPRING, T, device)
    assert edge is not None
    # 1 % of stiffness moves the radius by more than 4000 periods need to tell growth from decay.
    assert not grows(0.99 * edge, device)
    assert grows(1.01 * edge, device)


@pytest.mark.parametrize("delay", [0, 1, 4, 6])
@pytest.mark.parametrize("servo", [0.0, 3.0, 20.0])
def test_a_heavy_device_has_a_closed_form(delay: int, servo: float) -> None:
    device = TwoRate(1e4, 1.0, servo, 4, delay)
    found = two_rate_k_max(SPRING, T, device)
    assert found is not None
    # What is left out is of the order of (b + B_s) T/m.
    assert found == pytest.approx(heavy_limit(device, T), rel=1e-3)


def test_a_faster_servo_gives_a_stiffer_wall() -> None:
    edges = [
        two_rate_k_max(SPRING, T, TwoRate(0.1, 1.0, 3.0, ratio, ratio))
        for ratio in (1, 2, 4, 8)
    ]
    assert all(edge is not None and math.isfinite(edge) for edge in edges)
    assert edges == sorted(edges)  # type: ignore[type-var]


def test_the_study_answers(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert (
        main(
            ["lab", "two_rate", "--ratios", "1", "4", "--json", "--out", str(tmp_path)]
        )
        == 0
    )
    told = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert_drawn(told["plot"], "rate of the servo  [Hz]", "largest stiffness  [N/m]")
    rows = told["rows"]
    assert [row["ratio"] for row in rows] == [1, 4]
    assert rows[0]["heavy_limit_n_per_m"] == pytest.approx(4.0 / (T * 1.5))


@pytest.mark.parametrize("wrong", [{"mass": 0.0}, {"ratio": 0}, {"delay": -1}])
def test_no_such_device(wrong: dict[str, float]) -> None:
    values = {
        "mass": 0.1,
        "damping": 1.0,
        "servo_damping": 3.0,
        "ratio": 2,
        "delay": 1,
    } | wrong
    with pytest.raises(ValueError, match=r"mass 0|ratio 0|delay -1"):
        TwoRate(**values)  # type: ignore[arg-type]


def test_the_end_of_a_search_is_no_limit(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    # Nothing is unstable for a while: as if the limit were beyond the last step.
    monkeypatch.setattr("sim.stability.two_rate.two_rate_radius", lambda *_: 0.5)
    assert two_rate_k_max(SPRING, T, TwoRate(0.1, 1.0, 3.0, 4)) == math.inf
    assert main(["lab", "two_rate", "--ratios", "4", "--out", str(tmp_path)]) == 0
    assert "K_max above " in capsys.readouterr().out
