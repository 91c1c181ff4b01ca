"""``study world``, ``law show``, ``study analyse`` and ``haptic.k_max(world=…)`` agree."""

from __future__ import annotations

import json
import math
from typing import Any

import haptic
import numpy as np
import pytest

from nodes.cli.main import main
from nodes.stability.occurring import position_over_force

PD = (
    "--law",
    "pd",
    "--gain",
    "3",
    "--mass",
    "0.1",
    "--damping",
    "1",
    "--delay",
    "0",
    "--rate",
    "500",
)
# THEORY.md §18, to the digits of its table
ANY_WORLD = pytest.approx(2244.217, abs=5.1e-4)


def answered(capsys: pytest.CaptureFixture[str], *words: str) -> dict[str, Any]:
    assert main([*words, "--json"]) == 0
    found: dict[str, Any] = json.loads(capsys.readouterr().out.splitlines()[-1])
    return found


def test_study_world_answers_with_each_kind_of_world(
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = answered(capsys, "study", "world", *PD)
    assert found["k_max_wall_n_per_m"] == pytest.approx(3781.866, abs=1e-3)
    assert found["k_max_any_world_n_per_m"] == ANY_WORLD
    assert found["k_max_any_hand_any_world_n_per_m"] is None
    worst = found["worst_world"]
    assert worst["mass_kg"] is None
    assert worst["damping_n_s_per_m"] is None
    assert worst["integrator"] == "lossless"
    # The place of an extremum, found to the root of its value's 1e-10.
    assert worst["stiffness_n_per_m"] == pytest.approx(1837.0, rel=1e-3)
    assert worst["frequency_hz"] == pytest.approx(
        0.20173 * 500.0 / (2.0 * 3.141592653589793), rel=1e-3
    )


def test_options_add_their_figures(capsys: pytest.CaptureFixture[str]) -> None:
    device = ("--gain", "0", "--damping", "1", "--delay", "0")
    words = ["--tool-damping", "1", "--tool-mass", "0.1", "--spring-range", "100..1000"]
    words += ["--device2-damping", "1", "--delay2", "1"]
    found = answered(capsys, "study", "world", *device, *words)
    # (b − κ)(b − 3κ) = (2κ)², κ = KT/2, with delays of 0 and 1 tick: κ = √5 − 2.
    assert found["k_max_two_hands_n_per_m"] == pytest.approx(
        1000.0 * (math.sqrt(5.0) - 2.0), rel=1e-6
    )
    assert found["k_max_any_hand_tool_any_world_n_per_m"] == pytest.approx(
        500.0, rel=1e-9
    )
    assert found["k_max_tool_any_world_n_per_m"] > 500.0
    assert (
        found["k_max_euler_tool_any_world_n_per_m"] < found["k_max_any_world_n_per_m"]
    )
    # A spring in series with one of at most 1000 N/m is softer than what the wall allows, 1003 N/m,
    # whatever its K.
    assert found["unlimited"] == ["springs"]
    assert "stepped tool" in found["about"]["tool_any_world"]
    assert found["needed"] is None
    needed = answered(capsys, "study", "world", *device, "--stiffness", "500")["needed"]
    # b b_t/(b + b_t) = KT/2
    assert needed["tool_damping_any_hand_any_world_n_s_per_m"] == pytest.approx(
        1.0, rel=1e-9
    )
    assert needed["device_damping_any_hand_any_world_n_s_per_m"] == pytest.approx(
        0.5, rel=1e-9
    )


def test_what_does_not_fit_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["study", "world", "--gain", "1", "--delay2", "1"]) == 2
    assert "--device2-damping" in capsys.readouterr().err
    assert (
        main(
            [
                "study",
                "world",
                "--law",
                "{kind: pd_windowed, stiffness: 900.0, damping: 3.0, resolution: 2.3e-5}",
            ]
        )
        == 2
    )
    assert "code of its own" in capsys.readouterr().err
    assert main(["study", "world", "--gain", "1", "--spring-range", "0..10"]) == 2
    assert "expected 0 <" in capsys.readouterr().err
    assert (
        main(
            [
                "study",
                "world",
                "--gain",
                "1",
                "--device2-damping",
                "1",
                "--delay2",
                "1e9",
            ]
        )
        == 2
    )
    assert "expected 0 to 1100" in capsys.readouterr().err


def test_law_show_and_analyse_print_the_same(
    capsys: pytest.CaptureFixture[str], tmp_path: Any
) -> None:
    law = ("pd", "--stiffness", "1000", "--gain", "3")
    shown = answered(capsys, "law", "show", *law)
    assert shown["k_max_any_world_n_per_m"] == ANY_WORLD
    assert shown["k_max_wall_n_per_m"] == pytest.approx(3781.866, abs=1e-3)
    assert shown["k_max_any_hand_any_world_n_per_m"] is None
    assert main(["law", "show", *law]) == 0
    text = capsys.readouterr().out
    assert "2244.22 N/m" in text
    assert "none certified" in text
    analysed = answered(capsys, "study", "analyse", *law, "--out", str(tmp_path))
    assert analysed["k_max_any_world_n_per_m"] == ANY_WORLD


def test_law_show_takes_the_least_over_a_devices_masses(
    capsys: pytest.CaptureFixture[str],
) -> None:
    law = ("pd", "--stiffness", "500", "--gain", "3", "--delay", "1")
    one, other, both = (
        answered(capsys, "law", "show", *law, *mass)["k_max_any_world_n_per_m"]
        for mass in (
            ("--mass", "0.05"),
            ("--mass", "0.4"),
            ("--mass", "0.05", "--heaviest", "0.4"),
        )
    )
    assert both <= min(one, other)
    assert both == pytest.approx(min(one, other), rel=0.05)


def worst_spring() -> float:
    """Return the least K of an edge before a massless spring of any stiffness k [N/m].

    In series with the law H = K + D(z), 1 + P H/(1 + H/k) = 0 on the unit circle.
    """
    z = np.exp(1j * np.linspace(1e-3, np.pi - 1e-3, 40001))
    over = position_over_force(z, haptic.Plant(0.002, 0.1, 1.0))
    damper = 3.0 / 0.002 * (1.0 - 1.0 / z)

    def edge(k: float) -> float:
        found = -1.0 / (over + 1.0 / k) - damper
        turn = np.flatnonzero(np.diff(np.sign(found.imag)))
        share = found.imag[turn] / (found.imag[turn] - found.imag[turn + 1])
        real = found.real[turn] + share * (found.real[turn + 1] - found.real[turn])
        return float(min(real[real > 0.0], default=np.inf))

    springs = np.geomspace(300.0, 3e6, 201)
    for _ in range(3):
        at = int(np.argmin([edge(k) for k in springs.tolist()]))
        springs = np.geomspace(springs[max(at - 1, 0)], springs[min(at + 1, 200)], 201)
    return edge(float(springs[100]))


def test_k_max_from_python() -> None:
    plant, pd = (
        haptic.Plant(0.002, 0.1, 1.0),
        {"kind": "pd", "stiffness": 1.0, "damping": 3.0},
    )
    any_world = haptic.k_max(pd, plant, world="any")
    assert any_world.k_max_n_per_m == ANY_WORLD
    assert any_world.method == "certificate"
    assert "same tick" in any_world.about
    assert haptic.k_max(pd, plant, world="any_hand").k_max_n_per_m is None
    spring = {"kind": "pd", "stiffness": 1.0, "damping": 0.0}
    late = haptic.Plant(0.002, 0.1, 1.0, 1.0)
    assert haptic.k_max(
        spring, late, world="two_hands", other=late
    ).k_max_n_per_m == pytest.approx(500.0 / 3.0, rel=1e-9)
    assert haptic.k_max(
        spring, plant, world="any_hand_tool", tool_damping=1.0
    ).k_max_n_per_m == pytest.approx(500.0, rel=1e-9)
    assert haptic.k_max(
        spring, plant, world="any_hand_wall"
    ).k_max_n_per_m == pytest.approx(1000.0, rel=1e-9)
    assert (
        haptic.k_max(spring, plant, world="euler_tool", tool_mass=0.1).k_max_n_per_m
        or 0.0
    ) < 1000.0
    assert haptic.k_max(
        pd, plant, world="spring", springs=(1e-3, float("inf"))
    ).k_max_n_per_m == pytest.approx(worst_spring(), rel=1e-6)
    assert haptic.k_max(pd, plant).k_max_n_per_m == pytest.approx(3781.866, abs=1e-3)
    with pytest.raises(ValueError, match="expected one of wall"):
        haptic.k_max(pd, plant, world="nowhere")
    with pytest.raises(ValueError, match="expected tool_damping"):
        haptic.k_max(pd, plant, world="tool")
    with pytest.raises(ValueError, match="expected no option"):
        haptic.k_max(pd, plant, world="any", tool_mass=1.0)


@pytest.mark.parametrize(
    ("world", "options", "named"),
    [
        ("spring", {"springs": 5.0}, "springs"),
        ("spring", {"springs": (1.0, 2.0, 3.0)}, "springs"),
        ("spring", {"springs": ("a", 2.0)}, "springs"),
        ("spring", {"springs": (math.nan, 2.0)}, "softest"),
        ("tool", {"tool_damping": None}, "tool_damping"),
        ("tool", {"tool_damping": math.inf}, "damping"),
        ("euler_tool", {"tool_mass": "heavy"}, "tool_mass"),
        ("two_hands", {"other": None}, "other"),
        ("two_hands", {"other": 3.0}, "other"),
    ],
)
def test_options_of_a_world_that_are_none_are_refused_by_name(
    world: str, options: dict[str, Any], named: str
) -> None:
    with pytest.raises(ValueError, match=named):
        haptic.k_max(
            {"kind": "pd", "stiffness": 1.0, "damping": 0.2},
            haptic.Plant(0.002, 0.1, 1.0),
            world=world,
            **options,
        )


def test_a_device_that_no_double_holds_has_an_answer() -> None:
    law = {"kind": "pd", "stiffness": 1.0, "damping": 0.2}
    for mass, damping in ((1e300, 1.0), (0.1, 1e300)):
        for world in ("any", "any_hand"):
            found = haptic.k_max(law, haptic.Plant(0.002, mass, damping), world=world)
            assert found.k_max_n_per_m is None or found.k_max_n_per_m > 0.0
