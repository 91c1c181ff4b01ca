"""``import haptic`` in a notebook, on real launches; laws and plants refused as in YAML."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import haptic
import numpy as np
import pytest

from messages.errors import UsageError
from nodes.launcher.launch_file import read as read_scene
from nodes.laws.fir import FIR
from nodes.laws.pd import PD
from nodes.parameters.store import ParameterError
from sim.device.model import DeviceModel
from sim.measure.haptic_commands import DEADLINE
from tests.support import ROOT
from tests.support.launching import (
    assert_nothing_left,
    private_runtime_dir,
    processes_of,
    wait_for,
)

# A busy machine adds a warning of its own.
pytestmark = pytest.mark.filterwarnings("ignore:.*this machine is busy:UserWarning")


@pytest.fixture(scope="module")
def place() -> Iterator[Path]:
    with private_runtime_dir() as folder, pytest.MonkeyPatch.context() as patch:
        patch.setenv("HAPTIC_RUNTIME_DIR", str(folder))
        patch.chdir(folder)
        yield folder
        assert_nothing_left(folder)


def test_everything_that_is_offered_is_there_and_documented() -> None:
    for name in haptic.__all__:
        assert getattr(haptic, name).__doc__, name
    assert set(dir(haptic)) == set(haptic.__all__)
    with pytest.raises(AttributeError, match=r"it has .*launch"):
        _ = haptic.nonsense


@pytest.mark.process
@pytest.mark.smoke
def test_it_loads_nothing_until_it_is_used() -> None:
    code = (
        "import sys; before = set(sys.modules); import haptic; print(*sorted(set(sys.modules) -"
        " before))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    loaded = set(done.stdout.split())
    assert loaded.isdisjoint(
        {"numpy", "numba", "scipy", "matplotlib", "zmq", "msgspec", "asyncio", "typing"}
    ), loaded


@pytest.mark.parametrize(
    ("bad", "text"),
    [
        ({"stiffness": "a"}, r"pd\.stiffness: expected a number, got 'a'"),
        ({"stiffness": -1.0}, r"pd\.stiffness: .*above 0"),
        ({"stiffness": float("nan")}, r"pd\.stiffness: nan"),
        ({"stiffness": 1.0, "damping": -0.5}, r"pd\.damping"),
    ],
)
def test_a_law_made_in_python_is_checked_as_yaml_is(
    bad: dict[str, float], text: str
) -> None:
    with pytest.raises(ParameterError, match=text):
        PD(**bad)
    with pytest.raises(ParameterError, match=text):
        haptic.law("pd", **bad)


def test_a_device_made_in_python_is_checked_as_yaml_is() -> None:
    with pytest.raises(ParameterError, match=r"mass: .*above 0, got -1"):
        DeviceModel(mass=-1)


def test_numbers_of_numpy_are_numbers() -> None:
    made = haptic.law("pd", stiffness=np.float64(3.0), damping=np.int64(2))
    assert made == PD(stiffness=3.0, damping=2.0)
    assert isinstance(made, PD)
    assert type(made.damping) is float
    assert haptic.law(np.array([1000.0, -200.0])) == FIR(taps=(1000.0, -200.0))


def test_whatever_means_a_law_is_taken() -> None:
    plant = haptic.Plant(period=0.002, mass=0.1, damping=1.0)
    mapping = {"kind": "pd", "stiffness": 1500, "damping": 3}
    pd = haptic.law("pd", stiffness=1500, damping=3)
    # PD is h = [K + B/T, −B/T]: three ways to say the same law (THEORY.md §1).
    for law in (mapping, pd, [1500 + 3 / 0.002, -3 / 0.002], pd.compile(0.002)):
        assert haptic.poles(law, plant).radius == pytest.approx(
            haptic.poles(pd, plant).radius, abs=1e-12
        )
    assert haptic.law(pd, stiffness=800) == PD(stiffness=800.0, damping=3.0)
    with pytest.raises(TypeError, match=r"3 is no law: expected a kind, a preset"):
        haptic.law(3)  # type: ignore[arg-type]


def test_k_max_is_the_closed_form_and_the_edge_of_the_poles() -> None:
    plant = haptic.Plant(period=0.002, mass=0.1, damping=1.0)
    pd = haptic.law("pd", stiffness=1, damping=3)
    found = haptic.k_max(pd, plant)
    assert found.method == "closed_form"
    edge = found.k_max_n_per_m
    assert edge is not None
    # One part in 10⁶ on either side: far above rounding (10⁻¹⁶), far below what anybody feels.
    assert haptic.poles(haptic.law(pd, stiffness=edge * (1 - 1e-6)), plant).stable
    assert not haptic.poles(haptic.law(pd, stiffness=edge * (1 + 1e-6)), plant).stable
    assert len(found.plot().axes) == 1


def test_results_show_themselves() -> None:
    fallen = haptic.drop(
        {"kind": "pd", "stiffness": 1000, "damping": 3}, haptic.Plant(0.002, 0.1, 1.0)
    )
    assert fallen.settled
    # At rest the spring bears the weight.
    assert fallen.final_position_m == pytest.approx(-0.1 * 9.81 / 1000.0, rel=1e-6)
    table = fallen.to_pandas()
    assert len(table) == 1500
    assert "force_n" in table
    assert "settled" in fallen._repr_html_()
    assert len(haptic.plot(fallen).axes) == 2
    with pytest.raises(ValueError, match="no hand holds"):
        haptic.drop([1000.0], haptic.Plant(0.002, 0.1, 1.0, stiffness=5.0))
    with pytest.raises(ValueError, match="the floor is at 0"):
        haptic.drop([1000.0], haptic.Plant(0.002, 0.1, 1.0), height=-0.01)
    with pytest.raises(haptic.HapticError, match="is a folder"):
        haptic.read(".")


def test_what_is_played_in_space_has_its_axes_contact_and_bodies_in_one_table() -> None:
    pytest.importorskip("mujoco", reason="things that move need MuJoCo")
    found = haptic.play("puck_push", duration=1.6)
    assert found.axes == "xyz"
    assert found.position_m.shape == (800, 3)
    # The hand pushes the puck along x: it ends elsewhere than it began, the right way up.
    puck = found.bodies["puck"]
    assert puck.turn is not None
    assert puck.position[-1, 0] - puck.position[0, 0] > 1e-3
    assert np.linalg.norm(puck.turn, axis=1) == pytest.approx(1.0)
    columns = found.columns()
    assert {"contact", "normal", "proxy_m", "puck_m", "puck_qw", "tool_m"} <= set(
        columns
    )
    # What the tool is held by is the law's: K times the way between, and its damper.
    assert columns["proxy_m"] == pytest.approx(columns["tool_m"])
    assert len(found.plot().axes) == 2


def test_of_shapes_the_normal_looks_out_where_they_are_touched() -> None:
    found = haptic.play("sphere_feel", duration=0.8)
    surface = read_scene("sphere_feel", {}).nodes["environment"].parameters["surface"]
    touched = found.contact
    assert 0 < touched.sum() < len(touched)
    out = found.proxy_m[touched] - np.array(surface["position"])
    out /= np.linalg.norm(out, axis=1)[:, None]
    # The sphere is exact: its normal is the direction from its middle, but for the skin of 0.1 nm.
    assert np.abs(out - found.normal[touched]).max() < 1e-6


def test_pairs_and_chains_are_played_by_name_and_a_network_is_not() -> None:
    pair = haptic.play("hands_coupled", duration=1.0)
    first, second = (pair.bodies[name].position[:, 0] for name in ("first", "second"))
    # The law sees how far the hands are apart.
    assert pair.measured_m == pytest.approx(first - second, abs=1e-15)
    assert haptic.play("two_hands", chain="left").name == "two_hands/left"
    with pytest.raises(haptic.HapticError, match=r"2 chains \(left, right\)"):
        haptic.play("two_hands")
    with pytest.raises(haptic.HapticError, match="over a network in real time"):
        haptic.play("hands_apart", chain="left")


def test_a_loop_that_its_driver_stopped_says_when() -> None:
    assert haptic.play("floor_drop").stopped_at_tick is None
    found = haptic.play("floor_buzz", stiffness=1e5)
    assert found.stopped_at_tick is not None
    assert found.settled is False
    # From then on the brake comes down, by the slew at most: nothing is felt any more.
    assert np.abs(found.force_n[found.stopped_at_tick + 200 :]).max() < 0.5


def test_a_played_drop_tells_whether_it_settles() -> None:
    assert haptic.play("floor_drop").settled
    # K T / 2 = 9 N s/m, far above b + B = 4: the edge of PD on a mass is near 3 800 N/m.
    assert haptic.play("floor_drop", stiffness=9000).settled is False
    assert haptic.play("wall_press").settled is None
    assert haptic.play("floor_drop", duration=0.014).settled is None


@pytest.mark.process
def test_a_launch_is_the_run_in_one_process(place: Path) -> None:
    with haptic.launch(
        "floor_drop", stiffness=1500, pace="lockstep", duration=0.4, out_dir=place / "r"
    ) as run:
        summary = run.wait()
    assert (summary.exit_reason, summary.ticks) == ("done", 200)
    played = haptic.play("floor_drop", stiffness=1500, duration=0.4)
    np.testing.assert_array_equal(run.recording["position"][:-1, 2], played.measured_m)
    assert haptic.read(run.recording.path).messages["/device/state"] == 201


@pytest.mark.process
@pytest.mark.smoke
def test_the_readme_s_lines_run(place: Path) -> None:
    (block,) = re.findall(
        r"```python\n(.*?)```",
        (ROOT / "README.md").read_text(encoding="utf-8"),
        re.DOTALL,
    )
    names: dict[str, Any] = {}
    exec(compile(block, "README.md", "exec"), names)  # noqa: S102  # our own page
    # The closed form (THEORY.md §3), by the page's own numbers.
    assert names["edge"].k_max_n_per_m == pytest.approx(3781.866, abs=1e-3)
    assert list(names["table"]["position_z"][:-1]) == list(names["played"].measured_m)


# A busy machine is late, which is no matter of what is asked here.
@pytest.mark.filterwarnings("ignore::sim.api.run_summary.LaunchWarning")
@pytest.mark.process
def test_a_launch_is_changed_recorded_and_left_while_it_runs(place: Path) -> None:
    with haptic.launch("wall_press", duration=0, out_dir=place / "r") as run:
        assert run.running
        run.param["coupling.laws.pd.stiffness"] = 800
        assert haptic.connect().param["coupling.laws.pd.stiffness"] == 800
        assert (
            run.law.switch("multi_term", ramp=5)["to"] == run.law.active == "multi_term"
        )
        # A law made here joins the coupling's; its name is used again once it no longer renders.
        soft = [
            PD(stiffness=value, damping=2.0) for value in (700.0, 600.0, 500.0, 1000.0)
        ]
        switched = [run.law.switch(law)["to"] for law in soft]
        assert switched == ["pd_2", "pd_3", "pd_2", "pd_3"]
        assert run.param["coupling.laws.pd_3.stiffness"] == 1000.0
        assert run.law.switch(haptic.law("pd", stiffness=800, damping=2))["to"] == "pd"
        with pytest.raises(haptic.HapticError, match=r"law\.stiffness: .*above 0"):
            run.law.switch({"kind": "pd", "stiffness": -1})
        with pytest.raises(haptic.HapticError, match="unstable"):
            run.law.switch(PD(stiffness=1e6))
        with pytest.raises(haptic.HapticError, match="no node is named 'nobody'"):
            run.param["nobody.x"]
        with pytest.raises(haptic.HapticError, match="unstable"):
            run.param["coupling.laws.multi_term.stiffness"] = 1e6
        extra = run.record(0.3, place / "extra.mcap")
        assert len(extra["time"]) > 50
    assert run.summary.exit_reason == "stopped"
    assert not run.running
    with pytest.raises(
        haptic.HapticError, match=r"has ended, and nobody answers param\.set any more"
    ):
        run.param["coupling.laws.pd.stiffness"] = 900


@pytest.mark.slow
def test_several_chains_go_on_when_the_thread_that_started_them_has_ended(
    place: Path,
) -> None:
    with ThreadPoolExecutor(1) as pool:
        run = pool.submit(
            haptic.launch, "two_hands", duration=0, out_dir=place / "r"
        ).result()
    with run, pytest.raises(haptic.LaunchError, match="still running after 0 s"):
        run.wait(timeout=0.0)
    assert run.summary.exit_reason == "stopped"
    assert set(run.summary.all["chains"]) == {"left", "right"}


@pytest.mark.process
def test_a_scenario_that_does_not_start_says_why(place: Path) -> None:
    with pytest.raises(haptic.LaunchError, match=r"stiffness"):
        haptic.launch("floor_drop", stiffness=-1)
    with pytest.raises(haptic.LaunchError, match=r"no_such"):
        haptic.launch("no_such")


@pytest.mark.slow
@pytest.mark.parametrize("view", [False, True])
def test_a_launcher_that_is_killed_leaves_no_summary(place: Path, view: bool) -> None:
    with haptic.launch("wall_press", duration=0, view=view) as run:
        os.kill(run.info.launcher, signal.SIGKILL)
        with pytest.raises(haptic.LaunchError, match=r"exit code -9"):
            run.wait(timeout=60.0)
        assert not run.running
        with pytest.raises(haptic.LaunchError, match=r"exit code -9"):
            _ = run.recording
    wait_for(lambda: not processes_of(place), "the end of its nodes")


PROGRAM = """
import haptic, os, signal, weakref
from sim.api import python_runs
from sim.measure import started_launch
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored in the background

class Thing: pass

things = [Thing()]
weakref.finalize(things[0], os.kill, os.getpid(), signal.SIGINT)

def interrupted_in_a_finaliser(call):
    def interrupted(*args):
        things.clear()  # what is raised in there is printed and forgotten
        return call(*args)
    return interrupted

{before}
run = haptic.launch("wall_press", duration=0)
{between}
print(run.ticks, flush=True)
run.wait()
"""
FINALISED = "{0} = interrupted_in_a_finaliser({0})".format
ENDS = {
    "interrupted": (signal.SIGINT, "", ""),
    "killed": (signal.SIGKILL, "", ""),
    "interrupted in a finaliser while it starts": (
        0,
        FINALISED("started_launch.runs"),
        "",
    ),
    "interrupted in a finaliser while it waits": (
        0,
        "",
        FINALISED("python_runs.progress"),
    ),
}


@pytest.mark.process
@pytest.mark.parametrize("end", ENDS)
def test_a_program_that_ends_leaves_nothing(place: Path, end: str) -> None:
    number, before, between = ENDS[end]
    code = PROGRAM.format(before=before, between=between)
    with private_runtime_dir() as folder:
        program = subprocess.Popen(
            [sys.executable, "-c", code],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "HAPTIC_RUNTIME_DIR": str(folder)},
            cwd=folder,
        )
        assert program.stdout is not None
        try:
            assert before or int(program.stdout.readline()) > 0
            if number:
                program.send_signal(number)
            # an uncaught KeyboardInterrupt ends a program as the signal would
            assert program.wait(DEADLINE) == -(number or signal.SIGINT)
        finally:
            program.kill()
            program.wait()
            program.stdout.close()
        wait_for(lambda: not processes_of(folder), "the end of the launch")
        assert_nothing_left(folder)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: haptic.compare(["pd"]), r"e\.g\. haptic\.PD\(stiffness="),
        (
            lambda: haptic.play("floor_drop", law="pd_filterd"),
            "did you mean pd_filtered",
        ),
        (
            lambda: haptic.play("floor_drop", law=haptic.PD),
            r"did you mean haptic\.PD\(stiffness=",
        ),
        (lambda: haptic.play("floor_drop", params=["x"]), "params: expected a mapping"),  # type: ignore[arg-type]
        (lambda: haptic.play("floor_drop", without=[3]), "without: expected names"),  # type: ignore[list-item]
        (
            lambda: haptic.play("floor_drop", without="loger"),
            "no node 'loger'.*mean logger",
        ),
    ],
)
def test_a_newcomers_mistake_names_the_way_out(call: Any, text: str) -> None:
    with pytest.raises((UsageError, ParameterError, TypeError), match=text):
        call()


def test_one_node_is_left_out_by_its_name() -> None:
    whole = haptic.play("floor_drop", duration=0.1)
    np.testing.assert_array_equal(
        haptic.play("floor_drop", duration=0.1, without="logger").position_m,
        whole.position_m,
    )
