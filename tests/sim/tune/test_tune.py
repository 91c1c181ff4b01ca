"""Tuning from end to end on a real launch, its steps alone, and that Ctrl-C leaves the device as it was."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nodes.laws import CompiledLaw
from nodes.laws.parse import compile_law, parse_law
from nodes.laws.pd import PD
from nodes.parameters.yaml_io import read_yaml
from nodes.stability.closed_loop import pole_radius
from nodes.stability.k_max import k_max, without_spring
from nodes.stability.plant import Plant
from sim.device.model import DeviceModel
from sim.identify.identify import identify
from sim.identify.report import figures, from_figures
from sim.population.virtual import excite
from sim.tune.design import Wanted, demand, linear_edge, model
from sim.tune.knock import STEP, factors, judge, predicted_edge
from tests.support.launching import HAPTIC, haptic, launch_json, running, wait_for

pytestmark = pytest.mark.realtime

T = 0.002
DEVICE = DeviceModel(mass=0.1, damping=1.0, friction=0.03, delay=1.3, resolution=2.3e-5)


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Tune once on a real launch in real time: one tick of delay and 0.3 of the device's own."""
    folder = tmp_path_factory.mktemp("tune")
    words = ("tune", "identify", "apply:=next_tick", "delay:=0.3", "--duration", "4", "--taps", "2", "--json")
    # Half a minute on a quiet machine; one that stalls makes it knock again.
    done = subprocess.run([*HAPTIC, *words], cwd=folder, capture_output=True, text=True, timeout=170.0, check=True)
    return folder, json.loads(done.stdout.splitlines()[-1])


def test_the_measured_edge_is_the_predicted_one(tuned: tuple[Path, dict[str, Any]]) -> None:
    _, told = tuned
    assert told["identified"]["mass_kg"]["value"] == pytest.approx(0.1, rel=0.05)
    assert told["identified"]["delay_ticks"]["value"] == pytest.approx(1.3, abs=0.05)
    # Two taps are PD's own, but either may have any sign: no softer than the best PD.
    assert told["designed"]["gain_over_pd"] >= 0.999
    verified = told["verified"]
    if verified["edge_factor"] is None:
        # A machine too loaded to answer in time tells no edge, and says so.
        assert "stalled" in verified["ended"]
    else:
        assert abs(verified["edge_error"]) <= 0.05
    # All steps but the last one came to rest: it stopped at the first sign.
    assert all(step["rests"] for step in verified["steps"][:-1])


def test_the_report_and_the_parameters_are_there(tuned: tuple[Path, dict[str, Any]]) -> None:
    folder, told = tuned
    page = (folder / told["files"]["html"]).read_text(encoding="utf-8")
    assert "data:image/png;base64," in page
    assert "95 % interval" in page
    law = read_yaml(folder / told["files"]["params"])["coupling"]["laws"]["tuned"]
    # Of two taps the best may be PD itself, which is written as such; numbers in YAML have six digits or more.
    assert compile_law(parse_law(law), T).taps == pytest.approx(told["designed"]["taps_n_per_m"], rel=1e-5)
    run = launch_json(folder, "floor_drop", "duration:=0.2", "pace:=lockstep", "--params", told["files"]["params"])
    assert run["exit_reason"] == "done"


def test_steps_run_alone_from_what_is_known(tuned: tuple[Path, dict[str, Any]]) -> None:
    folder, told = tuned
    words = ("tune", "--steps", "predict", "--out", str(folder / "tuning"), "--json")
    again = json.loads(haptic(folder, *words).stdout.splitlines()[-1])
    assert again["predicted"] == told["predicted"]
    done = haptic(folder, "tune", "--steps", "design", "--out", "nowhere", code=1)
    assert "run that step first" in done.stdout


def test_ctrl_c_leaves_the_launch_as_it_was_and_writes_what_is_known(tmp_path: Path) -> None:
    # A mass that falls while the machine stalls comes back from anywhere.
    (tmp_path / "wide.yaml").write_text("driver: {safety: {workspace: null}}", encoding="utf-8")
    with running(tmp_path, "floor_buzz", "duration:=0", "--params", "wide.yaml") as launch:

        def active() -> str:
            told = json.loads(launch.haptic("law", "list", "--json").stdout.splitlines()[-1])
            return str(told["active"])

        process = subprocess.Popen(
            [*HAPTIC, "tune", "--duration", "600", "--json"],
            cwd=tmp_path,
            env=launch.environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            process_group=0,
        )
        wait_for(lambda: active() == "identify", "the push to take over")
        # Twice, as impatient people do.
        os.killpg(process.pid, signal.SIGINT)
        os.killpg(process.pid, signal.SIGINT)
        process.communicate(timeout=60.0)
        assert active() == "pd"
        surface = json.loads(launch.haptic("param", "get", "environment", "surface", "--json").stdout.splitlines()[-1])
        assert surface["value"]["kind"] == "plane"
        launch.finish(signal.SIGINT, code=None)
    assert process.returncode in (1, 130)
    known = json.loads((tmp_path / "tuning" / "tune.json").read_text(encoding="utf-8"))
    assert known["interrupted"] == "identify"
    assert "Interrupted" in (tmp_path / "tuning" / "tune.html").read_text(encoding="utf-8")


@pytest.mark.parametrize("step", ["apply", "verify"])
def test_ctrl_c_while_a_law_is_tried_leaves_the_launch_as_it_was(
    tuned: tuple[Path, dict[str, Any]], tmp_path: Path, step: str
) -> None:
    (tmp_path / "tuning").mkdir()
    shutil.copy(tuned[0] / "tuning" / "tune.json", tmp_path / "tuning")
    with running(tmp_path, "identify", "apply:=next_tick", "delay:=0.3", "duration:=0") as launch:

        def now() -> tuple[Any, Any, Any]:
            return (
                launch.call("coupling", "law.list")["active"],
                launch.call("environment", "param.get", name="surface"),
                launch.call("driver", "param.get", name="passivity"),
            )

        before = now()
        process = subprocess.Popen(
            [*HAPTIC, "tune", "--steps", "apply", "verify", "--json"],
            cwd=tmp_path,
            env=launch.environment,
            stdout=subprocess.DEVNULL,
            process_group=0,
        )
        # The guard watches while it verifies, and only then.
        wait_for(lambda: now()[2] is not None if step == "verify" else now()[0] == "soft", f"{step} to be under way")
        os.killpg(process.pid, signal.SIGINT)
        os.killpg(process.pid, signal.SIGINT)
        process.wait(timeout=60.0)
        assert now() == before
        launch.finish(signal.SIGINT, code=None)
    assert process.returncode == 130
    known = json.loads((tmp_path / "tuning" / "tune.json").read_text(encoding="utf-8"))
    assert known["interrupted"] == step
    if step == "verify":
        assert known["verified"]["ended"] == "interrupted"
    assert "not_put_back" not in known


@pytest.mark.parametrize(("preset", "delay"), [("designed_d0", 0.0), ("designed_d1", 1.0)])
def test_knocking_finds_the_edge_that_the_poles_have(preset: str, delay: float) -> None:
    """Without friction and encoder the loop is linear, and pole radii tell the edge by another method."""
    law = parse_law({"kind": preset}).compile(T)
    low, high = 1.0, 10.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        stable = pole_radius(CompiledLaw(tuple(middle * tap for tap in law.taps)), Plant(T, 0.1, 1.0, delay)) < 1.0
        low, high = (middle, high) if stable else (low, middle)
    bare = DeviceModel(mass=0.1, damping=1.0, delay=delay)
    found = predicted_edge(law, bare, T, 1e-3, factors(1.0, 1.2 * low), None, None)
    assert found.factor is not None
    # What dies slowly is still there after the window: some steps below the edge, and at most one above it.
    assert low / STEP**5 <= found.factor <= low * STEP
    assert all(step.rests for step in found.steps[:-1])


def test_the_verdict_at_its_edge() -> None:
    swing = np.array([1.0, -1.0] * 150) * 1e-3
    decayed = np.concatenate([swing[:200], 0.2499 * swing[200:]])
    ringing = np.concatenate([swing[:200], 0.2501 * swing[200:]])
    assert judge(np.asarray(decayed), 1e-3, 1.0).rests
    assert not judge(np.asarray(ringing), 1e-3, 1.0).rests
    assert not judge(np.full(300, np.nan), 1e-3, 1.0).rests


def test_what_was_told_is_read_back() -> None:
    found = identify(excite(DEVICE, T, 5.0, seed=3))
    assert from_figures(json.loads(json.dumps(figures(found)))) == found


def test_a_demand_holds_all_that_the_device_may_be() -> None:
    found = identify(excite(DEVICE, T, 5.0, seed=3))
    asked = demand(found, Wanted(spread=1.25))
    assert asked.mass[0] < 0.1 / 1.2 < 0.1 * 1.2 < asked.mass[1]
    assert asked.damping <= 1.0
    assert asked.delay[0] <= 1.3 <= asked.delay[1]
    assert model(found).delay == pytest.approx(1.3, abs=0.01)


def test_the_linear_edge_is_where_a_pole_reaches_the_circle() -> None:
    found = identify(excite(DEVICE, T, 5.0, seed=3))
    law = PD(stiffness=300.0, damping=2.0).compile(T)
    edge = linear_edge(law, found)
    scaled = PD(stiffness=300.0 * edge, damping=2.0 * edge)
    known = Plant(T, found.mass.known()[0], found.damping.known()[0], found.delay.known()[0])
    boundary = k_max(without_spring(scaled, T), known).k_max_n_per_m
    assert boundary == pytest.approx(300.0 * edge, rel=1e-6)
