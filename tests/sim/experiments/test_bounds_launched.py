"""Certificates and bounds on real launches: decay just inside, growth just outside."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from nodes.launcher.scenario_files import find
from nodes.laws import CompiledLaw
from nodes.laws.parse import law_to_dict, parse_law
from nodes.laws.pd import PD
from nodes.recording.reader import Recording
from nodes.stability.k_max import edge_of, k_max, with_spring, without_spring
from nodes.stability.plant import Plant
from sim.design.demand import CONVENTIONS, Demand
from sim.design.landing import dropped
from sim.design.recorded_loop import replayed_radius
from sim.device.model import DeviceModel
from sim.experiments.drop import drop_scene, free_scene
from sim.experiments.k_max_launched import NO_LIMITS, launched, settles_launched
from sim.experiments.settling import Criterion, settles
from sim.lab.charts.derivatives import with_stiffness as with_gain
from sim.lab.charts.equal_demand import tuned
from sim.play.one_axis import run
from sim.play.one_axis_inputs import Scene
from sim.stability.every_delay import Certificate, every_delay
from sim.stability.rest import rest
from tests.support import INSTALLED
from tests.support.launching import launch_json

T, STEP = 0.002, 2.3e-5


def swing(
    folder: Path, law: CompiledLaw, delays: list[float], ticks: int
) -> np.ndarray:
    """Release 0.1 kg 10 mm from an anchor in lockstep, with the given delays of the forces."""
    content = yaml.safe_load(Path(find("floor_drop")).read_text())
    driver = content["nodes"]["driver"]
    driver["kind"] = "jittering_driver"
    driver["parameters"] |= {"delays": delays, "safety": NO_LIMITS}
    driver["parameters"]["device"] = {"mass": 0.1, "damping": 1.0, "position": 0.01}
    content["nodes"]["environment"]["parameters"]["surface"] = {
        "kind": "anchor",
        "position": [0.0, 0.0, 0.0],
    }
    content["nodes"]["coupling"]["parameters"] = {
        "law": "tried",
        "laws": {"tried": {"kind": "fir", "taps": list(law.taps), "period": T}},
        "history": "position",
        "clamp": False,
        "stability": "off",
        "ease": 0.0,
    }
    scenario = folder / "jitter.yaml"
    scenario.write_text(yaml.safe_dump(content))
    figures = launch_json(
        folder,
        str(scenario),
        "pace:=lockstep",
        f"duration:={ticks * T}",
        environment=INSTALLED,
    )
    return np.asarray(
        Recording(folder / figures["recording"]).arrays("/device/state")["position"][
            :ticks, 2
        ]
    )


@pytest.mark.slow
def test_certified_jitter_decays_and_its_counterexample_grows(tmp_path: Path) -> None:
    """At 97 % of the worse delay's stiffness, and at 102 %, with the growing sequence."""
    delays = (0.6, 1.4)
    derivative = without_spring(parse_law({"kind": "paper_optimum", "damping": 3.0}), T)
    limit = min(
        k_max(derivative, Plant(T, 0.1, 1.0, d)).k_max_n_per_m or math.inf
        for d in delays
    )
    inside, outside = (
        with_spring(derivative, 0.97 * limit),
        with_spring(derivative, 1.02 * limit),
    )
    assert (
        every_delay(inside, Plant(T, 0.1, 1.0), delays).stable is Certificate.CERTIFIED
    )
    found = every_delay(outside, Plant(T, 0.1, 1.0), delays)
    assert found.stable is Certificate.UNSTABLE
    ticks = 1200 // len(found.growing) * len(found.growing)
    repeated = list(found.growing) * (ticks // len(found.growing))
    for name, law in (("inside", inside), ("outside", outside)):
        folder = tmp_path / name
        folder.mkdir()
        position = np.abs(swing(folder, law, list(found.growing), ticks))
        quarter = ticks // 4
        rate = (position[-quarter:].max() / position[:quarter].max()) ** (
            1.0 / (ticks - quarter)
        )
        assert (rate < 1.0) == (name == "inside")
        # The launch swings as the replay of that sequence does, which other code plays; a history
        # that begins empty and the phase of the swing are left: a factor of 2 over all ticks.
        assert rate == pytest.approx(
            replayed_radius(law, Plant(T, 0.1, 1.0), repeated),
            abs=math.log(2.0) / (ticks - quarter),
        )


def resting(friction: float, height: float = 1e-4) -> Scene:
    return drop_scene(
        DeviceModel(mass=0.1, damping=1.0, friction=friction, resolution=STEP),
        T,
        False,
        True,
        height=height,
    )


@pytest.mark.slow
def test_a_launch_stops_at_the_bounds_friction_and_buzzes_just_below_the_edge() -> None:
    """PD with an encoder: a dead stop at the bound's friction; the limit by simulation."""
    law = PD(stiffness=2500.0, damping=12.0)
    compiled = law.compile(T)
    bound = rest(compiled, Plant(T, 0.1, 1.0), STEP).friction_bound_n
    described = {"kind": "pd", "stiffness": law.stiffness, "damping": law.damping}

    def still(position: np.ndarray, force: np.ndarray) -> bool:
        return float(np.ptp(position[-400:])) == 0.0 == float(np.ptp(force[-400:]))

    def simulated(friction: float) -> bool:
        trace = run(resting(friction), compiled, 2000)
        return still(trace.measured, trace.force)

    low, high = 1e-3 * bound, bound
    assert not simulated(low)
    assert simulated(high)
    while high > 1.002 * low:
        middle = math.sqrt(low * high)
        low, high = (low, middle) if simulated(middle) else (middle, high)
    assert high <= bound
    for friction, stops in ((1.001 * bound, True), (high, True), (low, False)):
        assert still(*launched(resting(friction), described, 2000)) == stops


def rate(law: dict[str, Any], mass: float, delay: float, ticks: int = 1600) -> float:
    """Return the growth per tick of a launch that swings about an anchor, over its later half."""
    scene = free_scene(
        DeviceModel(mass=mass, damping=1.0, delay=delay), T, amplitude=1e-3
    )
    position = np.abs(launched(scene, law, ticks)[0])
    eighth = ticks // 8
    return float(
        (position[-eighth:].max() / position[4 * eighth : 5 * eighth].max())
        ** (1.0 / (3 * eighth))
    )


@pytest.mark.slow
def test_launches_decay_just_below_colgates_k_at_the_occurring_frequency_and_grow_above() -> (
    None
):
    described = {
        "kind": "pd_alpha",
        "order": 1.5,
        "taps": 4,
        "gains": "paper",
        "damping": 3.0,
    }
    edge = edge_of(
        without_spring(parse_law({**described, "stiffness": 1.0}), T),
        Plant(T, 0.1, 1.0),
    )
    assert edge is not None
    assert (
        rate({**described, "stiffness": 0.995 * edge.k_exact_n_per_m}, 0.1, 0.0) < 1.0
    )
    assert (
        rate({**described, "stiffness": 1.005 * edge.k_exact_n_per_m}, 0.1, 0.0) > 1.0
    )


@pytest.mark.slow
def test_launches_keep_the_equal_demand_just_inside_and_break_it_just_outside() -> None:
    """PD tuned to the demand: every mass decays as fast; with 3 % more K the slowest fails."""
    unit = without_spring(PD(stiffness=1.0, damping=1.0), T)
    stiffness, gain = tuned(lambda k, g: with_gain(unit, k, g, 1.0, T), 0.99)
    described = {"kind": "pd", "stiffness": stiffness, "damping": gain}
    rates = {mass: rate(described, mass, 1.0) for mass in (0.05, 0.2)}
    # Two poles beat in the envelope: a part of what passes in 600 ticks.
    assert max(rates.values()) <= 0.99 + 1e-4
    worst = max(rates, key=lambda mass: rates[mass])
    assert rate(described | {"stiffness": 1.03 * stiffness}, worst, 1.0) > 0.99 + 1e-4


@pytest.mark.slow
def test_launches_land_within_the_margin_and_not_just_beyond() -> None:
    """A landing design: the drop that fails beyond the margin's masses settles within."""
    demand = Demand((0.05, 0.2), 1.0, (1.0, 1.0), T, 0.99, 1e4)
    law = parse_law("designed_d1")
    scenes = {
        mass: [
            dropped(demand, mass, *way, height)
            for way in CONVENTIONS
            for height in np.geomspace(0.005, 0.02, 7).tolist()
        ]
        for mass in (0.05, 0.05 / 1.06)
    }
    falls = [
        not settles(scene, [law.compile(T)], Criterion())[0]
        for scene in scenes[0.05 / 1.06]
    ]
    assert any(falls)
    for mass, lands in ((0.05, True), (0.05 / 1.06, False)):
        assert (
            settles_launched(
                scenes[mass][falls.index(True)], law_to_dict(law), Criterion()
            )
            == lands
        )
