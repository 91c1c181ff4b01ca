"""Tuning on real launches: only tried laws are delivered; the launch is restored."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
from dataclasses import asdict
from pathlib import Path
from typing import Any

import msgspec
import pytest

from messages.transport.requests import ControlError
from nodes.laws.parse import compile_law, parse_law
from nodes.parameters.yaml_io import read_yaml
from sim.design.demand import CONVENTIONS, Demand
from sim.design.landing import drops
from sim.device.model import DeviceModel
from sim.identify.identified_text import figures, from_figures
from sim.identify.identify import identify
from sim.lab.monte_carlo.virtual import excite
from sim.tune.design import Wanted, demand, design, model
from sim.tune.knocking import STEP, STRIDE
from sim.tune.outcome import AGREES
from tests.support.launching import (
    HAPTIC,
    Running,
    exit_code,
    launch_json,
    private_runtime_dir,
    processes_of,
    running,
    typed,
    wait_for,
)

T = 0.002
DEVICE = DeviceModel(mass=0.1, damping=1.0, friction=0.03, delay=1.3, resolution=2.3e-5)
SCENE = ("identify", "apply:=next_tick", "delay:=0.3")


def last_line(text: str) -> dict[str, Any]:
    told: dict[str, Any] = json.loads(text.splitlines()[-1])
    return told


@pytest.mark.slow
def test_other_poses_widen_the_masses_that_a_law_is_designed_for() -> None:
    found = identify(excite(DEVICE, T, 5.0, seed=3))
    _, lightest, heaviest = found.mass.known()
    asked = demand(found, Wanted(spread=1.0, poses=(0.02, 0.05)))
    assert asked.mass == (lightest - 0.02, heaviest + 0.05)
    # A pose never takes all of it away.
    assert demand(found, Wanted(spread=1.0, poses=(1.0, 0.0))).mass == (
        0.1 * lightest,
        heaviest,
    )


@pytest.mark.slow
def test_what_was_told_is_read_back() -> None:
    found = identify(excite(DEVICE, T, 5.0, seed=3))
    assert from_figures(json.loads(json.dumps(figures(found)))) == found
    asked = demand(found, Wanted())
    assert msgspec.convert(json.loads(json.dumps(asdict(asked))), Demand) == asked


def test_a_demand_holds_all_that_the_device_may_be() -> None:
    found = identify(excite(DEVICE, T, 5.0, seed=3))
    asked = demand(found, Wanted(spread=1.25))
    assert asked.mass[0] < 0.1 / 1.2 < 0.1 * 1.2 < asked.mass[1]
    assert asked.damping <= 1.0
    assert asked.delay[0] <= 1.3 <= asked.delay[1]
    assert asked.lands == CONVENTIONS
    body = model(found)
    # No joint, no lag: nothing beyond what the data ask for.
    assert isinstance(body, DeviceModel)
    assert body.delay == pytest.approx(1.3, abs=0.01)


@pytest.mark.slow
def test_a_law_lands_unless_it_is_told_otherwise() -> None:
    found = identify(excite(DEVICE, T, 5.0, seed=3))
    law, pd, asked = design(found, Wanted(taps=2))
    for one in (law, pd):
        assert one.found is not None
        assert all(drops(one.found.law, asked).values())


# A launch in lockstep takes both processors: what is compiled for identifying and designing is
# compiled before one begins.


@pytest.fixture(scope="module")
def tuned(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Tune once on a real launch in lockstep: one tick of delay, 0.3 of the device's own."""
    folder = tmp_path_factory.mktemp("tune")
    words = (
        "tune",
        *SCENE,
        "pace:=lockstep",
        "--duration",
        "4",
        "--taps",
        "2",
        "--no-land",
        "--nyquist",
        "10000",
        "--json",
    )
    with private_runtime_dir() as place:
        done = subprocess.run(
            [*HAPTIC, *words],
            cwd=folder,
            env={**os.environ, "HAPTIC_RUNTIME_DIR": str(place)},
            capture_output=True,
            text=True,
            timeout=280.0,
            check=False,
        )
    assert done.returncode == 0, done.stderr + done.stdout
    return folder, last_line(done.stdout)


@pytest.mark.slow
def test_the_law_itself_was_tried_from_below_and_the_edge_is_the_predicted_one(
    tuned: tuple[Path, dict[str, Any]],
) -> None:
    _, told = tuned
    verified = told["verified"]
    factors = [step["factor"] for step in verified["steps"]]
    assert factors[0] < 0.3
    assert 1.0 in factors
    assert verified["holds"]
    # Near the edge it decides where in an encoder step a knock begins: some steps of 2 %.
    assert abs(verified["edge_error"]) <= AGREES
    # All steps but the last one came to rest: it stopped at the first sign.
    assert all(step["rests"] for step in verified["steps"][:-1])
    low, high = verified["edge_by_poles_between_n_per_m"]
    assert (
        low
        < told["predicted"]["edge_linear_h1_n_per_m"]
        < high
        < (1.0 + AGREES) * STEP**2 * low
    )


@pytest.mark.slow
def test_what_does_not_land_says_so_everywhere_and_is_compared_with_nothing(
    tuned: tuple[Path, dict[str, Any]],
) -> None:
    folder, told = tuned
    if told["designed"]["lands"]:
        pytest.skip("this design lands although nobody asked for it")
    assert told["designed"]["gain_over_pd"] is None
    assert "fails the drop test" in told["headline"]
    assert "fails the drop test" in (folder / told["files"]["html"]).read_text(
        encoding="utf-8"
    )
    assert "FAILS the drop test" in Path(folder / told["files"]["params"]).read_text(
        encoding="utf-8"
    )


@pytest.mark.slow
def test_the_report_and_the_parameters_are_there(
    tuned: tuple[Path, dict[str, Any]],
) -> None:
    folder, told = tuned
    page = (folder / told["files"]["html"]).read_text(encoding="utf-8")
    assert "data:image/png;base64," in page
    assert page.index(told["headline"]) < page.index("95 % interval")
    assert "The push ended: done" in page
    assert "haptic tune" in page.split("command: ")[1][:2000] or "tune identify" in page
    assert "h1_n_per_m" not in page
    # A phone reads it at its own width, and the dark is the whole page's.
    assert ":root{color-scheme:light dark}" in page
    assert "width=device-width" in page
    assert re.search(r"encoder step</td><td>23</td><td>[^<]*</td><td>µm", page)
    # Three digits, and no power of ten as a program writes it.
    assert not re.search(r"<td>[^<]*\de[-+]\d", page)
    assert told["files"]["params"].endswith("tuned.yaml")
    law = read_yaml(folder / told["files"]["params"])["coupling"]["laws"]["tuned"]
    # Of two taps the best may be PD itself, which is written as such; numbers in YAML have six
    # digits or more.
    assert compile_law(parse_law(law), T).taps == pytest.approx(
        told["designed"]["taps_n_per_m"], rel=1e-5
    )
    run = launch_json(
        folder,
        "floor_drop",
        "duration:=0.2",
        "pace:=lockstep",
        "--params",
        told["files"]["params"],
    )
    assert run["exit_reason"] == "done"


@pytest.mark.slow
def test_a_new_design_drops_what_was_measured_of_another_law(
    tuned: tuple[Path, dict[str, Any]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    shutil.copytree(tuned[0] / "tuning", tmp_path / "tuning")
    monkeypatch.chdir(tmp_path)

    def tune(*words: str, code: int = 0) -> str:
        assert exit_code("tune", *words) == code
        return capsys.readouterr().out

    again = last_line(tune("--steps", "predict", "--json"))
    assert again["predicted"] == tuned[1]["predicted"]
    # The law is the same: what was measured of it stays.
    assert again["verified"] == tuned[1]["verified"]
    other = last_line(
        tune("--steps", "design", "predict", "--taps", "2", "--no-land", "--json")
    )
    assert "verified" not in other
    assert "applied" not in other
    assert other["headline"].startswith("Not tried")
    assert not (tmp_path / "tuning" / "tuned.yaml").exists()
    assert "NOT tried" in (tmp_path / "tuning" / "designed.yaml").read_text(
        encoding="utf-8"
    )
    assert "run that step first" in tune(
        "--steps", "design", "--out", "nowhere", code=1
    )


def softer(folder: Path, factor: float) -> None:
    """Scale the law on file, as if it had been designed so."""
    file = folder / "tuning" / "tune.json"
    told = json.loads(file.read_text(encoding="utf-8"))
    designed = told["designed"]
    designed["taps_n_per_m"] = [factor * tap for tap in designed["taps_n_per_m"]]
    designed["law"] = {"kind": "fir", "taps": designed["taps_n_per_m"], "period": T}
    predicted = told["predicted"]
    for key in ("h1_n_per_m", "edge_linear_h1_n_per_m"):
        predicted[key] *= factor
    designed["h1_n_per_m"] *= factor
    # The way up from far below is another test's.
    told["predicted_steps"]["plan"]["first"] = -2 * STRIDE
    file.write_text(json.dumps(told), encoding="utf-8")


@pytest.mark.slow
def test_a_law_that_does_not_rest_is_not_delivered(
    tuned: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    shutil.copytree(tuned[0] / "tuning", tmp_path / "tuning")
    edge = tuned[1]["verified"]["edge_factor"]
    # Unstable at itself; what was predicted of it is another device's.
    softer(tmp_path, 1.3 * edge)
    with running(tmp_path, *SCENE, "pace:=lockstep", "duration:=0") as launch:
        done = typed(launch, "tune", "--steps", "verify", "apply", "--json", code=1)
        assert launch.call("coupling", "law.list")["active"] == "excitation"
        launch.finish(signal.SIGINT, code=None)
    told = last_line(done.stdout)
    assert not told["verified"]["holds"]
    assert "NOT hold" in told["headline"]
    # A knock is larger beside a law that is stiffer: by more than a step of 2 % it is not the same
    # edge.
    assert 0.6 < told["verified"]["edge_factor"] < 0.85
    # It came down to what does rest, and says how much that is.
    assert (
        0.0
        < told["verified"]["stiffest_at_rest_n_per_m"]
        < told["designed"]["h1_n_per_m"]
    )
    assert not (tmp_path / "tuning" / "tuned.yaml").exists()
    assert "applied" not in told


def state(launch: Running) -> tuple[Any, Any, Any]:
    return (
        launch.call("coupling", "law.list")["active"],
        launch.call("environment", "param.get", name="surface"),
        launch.call("driver", "param.get", name="passivity"),
    )


@pytest.mark.slow
def test_a_signal_while_a_law_is_tried_leaves_the_launch_as_it_was(
    tuned: tuple[Path, dict[str, Any]], tmp_path: Path
) -> None:
    """Its message here; SIGTERM, SIGHUP and SIGKILL in the drill, ``tune ended``."""
    shutil.copytree(tuned[0] / "tuning", tmp_path / "tuning")
    with running(tmp_path, *SCENE, "duration:=0") as launch:
        before = state(launch)
        with pytest.raises(ControlError, match="only a lockstep loop can pause"):
            launch.call("driver", "stand", seconds=1.0)
        process = subprocess.Popen(
            [*HAPTIC, "tune", "--steps", "verify", "--json"],
            cwd=tmp_path,
            env=launch.environment,
            stdout=subprocess.DEVNULL,
            process_group=0,
        )
        # The guard watches while it verifies, and only then.
        wait_for(lambda: state(launch)[2] is not None, "knocks to be under way")
        # Twice, as impatient people do.
        os.killpg(process.pid, signal.SIGINT)
        os.killpg(process.pid, signal.SIGINT)
        process.wait(timeout=60.0)
        assert state(launch) == before, launch.errors
        assert process.returncode == 128 + signal.SIGINT
        known = json.loads(
            (tmp_path / "tuning" / "tune.json").read_text(encoding="utf-8")
        )
        assert known["interrupted"] == "verify"
        assert known["verified"]["ended"] == "interrupted"
        assert "Interrupted" in (tmp_path / "tuning" / "tune.html").read_text(
            encoding="utf-8"
        )
        assert "not_put_back" not in known
        launch.finish(signal.SIGINT, code=None)


@pytest.mark.process
def test_a_launch_that_the_verb_started_ends_with_it_even_when_it_is_killed(
    tmp_path: Path,
) -> None:
    with private_runtime_dir() as place:
        process = subprocess.Popen(
            [*HAPTIC, "tune", *SCENE, "--duration", "600"],
            cwd=tmp_path,
            env={**os.environ, "HAPTIC_RUNTIME_DIR": str(place)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            process_group=0,
        )
        try:
            wait_for(
                lambda: list(place.glob("runs/*/run.json")), "the launch to be there"
            )
        finally:
            process.kill()
            process.wait()
        wait_for(
            lambda: not processes_of(place) and not list(place.glob("runs/*")),
            "everything to be gone",
        )
