"""A device heavier at longer reach: against another integrator, and its laws' judgement."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from messages.topics import DEVICE_STATE
from nodes.cli.main import main
from nodes.coupling.judgement import Judgement
from nodes.coupling.law_book import LawBook
from nodes.coupling.parameters import CouplingParameters, PlantParameters
from nodes.launcher import launch_file
from nodes.laws.pd import PD
from nodes.recording.reader import Recording
from nodes.stability.closed_loop import pole_radius
from nodes.stability.plant import Plant
from nodes.view.stability_map import plant_of, stability_map
from sim.device.hand import Hand
from sim.device.model import DeviceModel
from sim.device.state import VirtualDevice, device_tick
from sim.experiments.term_scene import term_scene, with_device
from sim.play.launched import NotOneAxisError, from_launch
from sim.play.player import play
from tests.support.launching import launch_json

ARM = [(0.0, 0.1), (0.1, 0.3)]
"""100 to 300 g over 10 cm."""


def mass(x: float) -> float:
    return float(np.interp(x, [place for place, _ in ARM], [heavy for _, heavy in ARM]))


def test_a_free_device_keeps_the_energy_of_its_motion() -> None:
    device = VirtualDevice(
        DeviceModel(mass=0.1, velocity=0.2, mass_by_position=ARM), 0.002
    )
    for _ in range(400):
        device_tick(device.state, 0.0)
    assert device.state.x > 0.08
    # To rounding, at any period.
    assert 0.5 * mass(device.state.x) * device.state.v**2 == pytest.approx(
        0.5 * 0.1 * 0.2**2, rel=1e-12
    )


def test_its_motion_is_that_of_the_equation() -> None:
    """m(x) x'' + m'(x) x'²/2 + b x' + k x = u with the hand's mass, by scipy's Runge–Kutta."""
    hand = Hand(stiffness=20.0, damping=0.5, mass=0.05, path=[(0.0, 0.05)])
    model = DeviceModel(
        mass=0.1, damping=0.3, hand=hand, axes={"z": {"mass_by_position": ARM}}
    ).along("z")
    assert model.moving_masses == pytest.approx((0.15, 0.35))

    def errors(period: float) -> float:
        device = VirtualDevice(model, period)
        found = []
        for _ in range(round(0.6 / period)):
            device_tick(device.state, 0.5)
            found.append(device.state.x)
        return float(
            np.abs(np.array(found) - exact(np.arange(1, len(found) + 1) * period)).max()
        )

    def slope(_: float, state: np.ndarray) -> list[float]:
        x, v = state
        bend = (
            (ARM[1][1] - ARM[0][1]) / (ARM[1][0] - ARM[0][0]) if 0.0 < x < 0.1 else 0.0
        )
        return [
            v,
            (0.5 + 20.0 * (0.05 - x) - 0.8 * v - 0.5 * bend * v * v) / (mass(x) + 0.05),
        ]

    solved: Any = solve_ivp(
        slope,
        (0.0, 0.61),
        [0.0, 0.0],
        rtol=1e-10,
        atol=1e-12,
        dense_output=True,
        max_step=1e-3,
    )

    def exact(time: np.ndarray) -> np.ndarray:
        return np.asarray(solved.sol(time)[0])

    # Of the first order in the period: half of it, half the error; a hundredth of the way at 1 ms.
    coarse, fine = errors(1e-3), errors(5e-4)
    assert coarse < 0.01 * 0.1
    assert coarse / fine == pytest.approx(2.0, rel=0.1)


def test_corners_must_increase() -> None:
    with pytest.raises(
        (ValueError, msgspec.ValidationError), match=r"mass_by_position\[1\]"
    ):
        DeviceModel(mass=0.1, mass_by_position=[(0.1, 0.1), (0.1, 0.2)])


def test_a_law_is_judged_with_all_the_masses_of_the_workspace() -> None:
    """Nine masses with both ends are as bad as the worst of two hundred."""
    period, book = 0.002, LawBook("coupling", 0.002)
    plant = {"mass": 0.05, "heaviest": 0.5, "damping": 0.5}
    told = set()
    for stiffness, damping in ((100.0, 0.2), (500.0, 0.1), (1500.0, 5.0)):
        laws = {"pd": {"kind": "pd", "stiffness": stiffness, "damping": damping}}
        parameters = msgspec.convert(
            {"law": "pd", "laws": laws, "plant": plant}, CouplingParameters
        )
        law = PD(stiffness=stiffness, damping=damping).compile(period)
        verdict = Judgement("coupling", period, book).verdict(parameters, law, 0.5)
        assert verdict is not None
        assert parameters.plant is not None
        fine = [Plant(period, float(m), 0.5, 0.5) for m in np.geomspace(0.05, 0.5, 200)]
        radii = [pole_radius(law, device) for device in fine]
        # To a fiftieth of what the loop loses or gains in a tick.
        assert verdict.pole_radius == pytest.approx(
            max(radii), abs=0.02 * abs(max(radii) - 1.0)
        )
        told.add(round(verdict.plant.mass, 6))
        figures = book.figures(parameters, "pd", 0.5)
        assert figures["pole_radius"] == verdict.pole_radius
        assert figures["worst_mass_kg"] == verdict.plant.mass
        assert figures["masses_kg"] == [0.05, 0.5]
    # Now the light end is worse, and now the heavy one.
    assert {0.05, 0.5} <= told


def test_law_show_says_which_mass_it_is(capsys: pytest.CaptureFixture[str]) -> None:
    words = [
        "law",
        "show",
        "pd",
        "--stiffness",
        "1500",
        "--gain",
        "5",
        "--mass",
        "0.05",
        "--damping",
        "0.5",
        "--delay",
        "0.5",
    ]
    assert main([*words, "--heaviest", "0.5"]) == 0
    told = capsys.readouterr().out
    assert "the worst of the device's 0.05 to 0.5 kg" in told
    assert main([*words, "--heaviest", "0.5", "--json"]) == 0
    worst = json.loads(capsys.readouterr().out)
    ends = []
    for mass in ("0.05", "0.5"):
        words[words.index("--mass") + 1] = mass
        assert main([*words, "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert "worst_mass_kg" not in found
        ends.append(found["pole_radius"])
    assert worst["pole_radius"] >= max(ends) > min(ends)
    assert worst["worst_mass_kg"] == (0.05, 0.5)[ends.index(max(ends))]


@pytest.mark.thorough(
    "tests/nodes/view/test_stability_map.py::"
    "test_what_a_device_says_of_its_masses_goes_into_the_map"
)
def test_the_map_is_of_all_masses() -> None:
    law, period = PD(stiffness=300.0, damping=2.0), 0.002
    both = stability_map(
        law, period, PlantParameters(mass=0.05, heaviest=0.5, damping=0.5), 1.0
    )
    ends = [
        stability_map(law, period, PlantParameters(mass=mass, damping=0.5), 1.0)
        for mass in (0.05, 0.5)
    ]
    assert both["pole_radius"] >= max(end["pole_radius"] for end in ends)
    assert both["k_max_n_per_m"] <= min(end["k_max_n_per_m"] for end in ends)
    assert both["delay_margin_ticks"] <= min(end["delay_margin_ticks"] for end in ends)
    rows = {row[0]: row[1:] for row in both["edge"]}
    for end in ends:
        for damping, low, high in end["edge"]:
            if damping in rows:
                mine_low, mine_high = rows[damping]
                # What is stable with all is stable with each.
                assert mine_low is None or (
                    low is not None
                    and low <= mine_low
                    and (high is None or mine_high <= high)
                )


def test_a_device_that_is_not_declared_is_taken_from_the_driver_with_all_its_masses() -> (
    None
):
    device = {
        "mass": 0.1,
        "damping": 0.5,
        "hand": {"mass": 0.05},
        "mass_by_position": [list(corner) for corner in ARM],
    }
    found = plant_of(None, {"device": device})
    assert found is not None
    assert found.mass == pytest.approx(0.15)
    assert found.heaviest == pytest.approx(0.35)


@pytest.mark.process
def test_a_launch_moves_as_one_process_does(tmp_path: Path) -> None:
    scene = with_device(
        term_scene(
            launch_file.read("sphere_feel", {"duration": 1.0, "pace": "lockstep"})
        ),
        mass_by_position=ARM,
    )
    played = play(scene.launch)
    given = tmp_path / "given.yaml"
    given.write_text(
        f"driver: {{device: {{mass_by_position: {[list(corner) for corner in ARM]}}}}}",
        encoding="utf-8",
    )
    figures = launch_json(
        tmp_path,
        "sphere_feel",
        "duration:=1.0",
        "pace:=lockstep",
        "--params",
        str(given),
    )
    states = Recording(tmp_path / figures["recording"]).messages(DEVICE_STATE)
    assert np.array_equal(played.measured, [state.position for state in states[:-1]])
    same = play(launch_file.read("sphere_feel", {"duration": 1.0}))
    assert math.dist(same.position[-1], played.position[-1]) > 1e-4


def test_the_loop_of_one_mass_refuses_it() -> None:
    launch = launch_file.read("floor_drop", {})
    changed = with_device(term_scene(launch), mass_by_position=ARM).launch
    with pytest.raises(NotOneAxisError, match="mass_by_position"):
        from_launch(changed)
