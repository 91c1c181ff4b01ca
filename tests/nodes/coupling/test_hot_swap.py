"""Laws and parameters change while the loop runs: receipts, refusals, schedules, watched files, and laws that break."""

from __future__ import annotations

import itertools
import json
import math
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from messages.transport.requests import ControlError
from messages.types import Event, Force, Receipt
from nodes.cli.main import main
from nodes.launcher.launch_file import read
from nodes.parameters.yaml_io import parse_yaml
from nodes.recording.reader import Recording
from sim.bench.swaps import measure
from sim.scene.from_launch import from_launch
from tests.support import FIXTURES
from tests.support.launching import RunningLaunch, launch_json, private_runtime_dir, running, wait_for

INSTALLED = FIXTURES / "installed"
WITH_PACKAGE = {"PYTHONPATH": os.pathsep.join([str(INSTALLED), os.environ.get("PYTHONPATH", "")])}

REST = 0.981
"""Force at rest under 0.1 kg [N]."""


def recorded(launch_folder: Path, figures: dict[str, Any]) -> Recording:
    return Recording(launch_folder / figures["recording"])


def receipts(recording: Recording) -> list[Receipt]:
    found: list[Receipt] = recording.messages("/coupling/receipt")
    return found


def settle(launch: RunningLaunch) -> None:
    """Wait until the mass rests: the loop's slowest pole here is 0.99, so 3000 ticks take any bounce below 1e-12."""
    launch.wait_ticks(3000)


def refusal(launch: RunningLaunch, op: str, **args: Any) -> str:
    with pytest.raises(ControlError) as raised:
        launch.call("coupling", op, **args)
    return str(raised.value)


# -- requests ------------------------------------------------------------------------------------------------------------


def test_every_request_has_its_receipt_and_equal_stiffness_swaps_without_a_step(tmp_path: Path) -> None:
    with running(tmp_path, "floor_drop", "pace:=lockstep", "duration:=0") as launch:
        settle(launch)
        answers = []

        def done(op: str, **args: Any) -> dict[str, Any]:
            answer: dict[str, Any] = launch.call("coupling", op, **args)
            answers.append(answer)
            return answer

        # The multi-term law is softer at rest than its nominal K by its leak; with that made up for, all laws here have the
        # same H(1). Its taps are some thousands of N/m, so H(1) itself is rounded at 1e-12 N/m, and 1 mm of it at 1e-15 N.
        h1 = launch.call("coupling", "law.show", law="multi_term")["h1_n_per_m"]
        done("param.set", values={"laws.multi_term.stiffness": 1000.0 + (1000.0 - h1)})
        assert launch.call("coupling", "law.show", law="multi_term")["h1_n_per_m"] == pytest.approx(1000.0, abs=1e-11)
        for name in ("multi_term", "pd", "multi_term"):
            answer = done("law.switch", law=name)
            assert answer["to"] == name
            assert answer["force_step_n"] < 1e-13
            assert answer["is"]["h1_n_per_m"] == pytest.approx(1000.0, abs=1e-11)
            launch.wait_ticks(100)
        # From K to another K at rest, the step is the difference of the forces at the present deflection.
        answer = done("param.set", values={"law": "pd", "laws.pd.stiffness": 1200.0, "laws.pd.damping": 2.0})
        assert answer["force_step_n"] == pytest.approx(200.0 * REST / 1000.0, rel=1e-6)
        assert answer["action"] == "switch"
        settle(launch)
        done(
            "param.load",
            values={"coupling": {"law": "new", "laws": {"new": {"kind": "fir", "taps": [2200.0, -1000.0]}}}},
        )
        launch.wait_ticks(100)
        dump = launch.call("coupling", "param.dump")
        figures = launch.finish(signal.SIGINT, code=0)
    recording = recorded(tmp_path, figures)
    found = receipts(recording)
    assert [receipt.revision for receipt in found] == [answer["revision"] for answer in answers] == [1, 2, 3, 4, 5, 6]
    assert [receipt.seq for receipt in found] == [answer["seq"] for answer in answers]
    assert [receipt.force_step for receipt in found] == [answer["force_step_n"] for answer in answers]
    assert [receipt.action for receipt in found] == ["set", "switch", "switch", "switch", "switch", "switch"]
    # What was before is what came after, receipt by receipt, and it is YAML with all parameters.
    assert [receipt.before for receipt in found[1:]] == [receipt.after for receipt in found[:-1]]
    assert parse_yaml(found[-1].after, "receipt") == {"law": "new", "kind": "fir", "taps": [2200.0, -1000.0]}
    assert dump["law"] == "new"
    # The force of each tick tells its law and revision, from the receipt's tick on; no tick lacks a force.
    forces: list[Force] = recording.messages("/coupling/force")
    # (A driver that waits for more than half a second asks again, and gets the same force once more.)
    by_tick = {force.seq: force for force in forces}
    assert list(by_tick) == list(range(len(by_tick)))
    for receipt in found:
        assert by_tick[receipt.seq].revision == receipt.revision
        assert by_tick[receipt.seq - 1].revision == receipt.revision - 1
    assert figures["missed"] == 0
    assert forces[-1].force[2] == pytest.approx(REST, rel=1e-9)


HELD = """
summary: A hand holds the device 3 mm below a floor
run: {rate: 500.0, cpu: any, fifo: 0}
nodes:
  driver:
    kind: sim_driver
    parameters:
      device:
        mass: 0.1
        damping: 1.0
        hand: {mass: 0.1, damping: 12.0, stiffness: 300.0, path: [[0.0, -0.003]]}
  environment: {kind: environment, parameters: {surface: {kind: plane, position: 0.0}}}
  coupling:
    kind: coupling
    parameters:
      law: pd
      laws:
        pd: {kind: pd, stiffness: 500.0, damping: 3.0}
        pd_alpha: {kind: pd_alpha, stiffness: 500.0, damping: 3.0, order: 1.2, taps: 10, gains: paper}
      fallback: {damping: 5.0}
      stability: refuse
      plant: {mass: 0.1, damping: 1.0, delay: 2.0}
  logger: {kind: logger}
"""
"""Whatever a busy machine does to the loop, the hand is damped and goes no deeper than its 3 mm. No core and no priority of
its own: other loops on the machine must not starve this one. Laws are judged for a device and a delay that are worse than
those it has, so what is refused here would still be stable."""


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RunningLaunch]:
    """One real-time loop for all refusals and failures: each must leave it as it was."""
    folder = tmp_path_factory.mktemp("held")
    (folder / "held.yaml").write_text(HELD)
    with running(folder, "./held.yaml", environment=WITH_PACKAGE) as launch:
        launch.wait_ticks(100)
        yield launch


REFUSED: list[tuple[str, dict[str, Any], str]] = [
    (
        "param.set",
        {"values": {"laws.pd.stiffness": -5.0}},
        "coupling.laws.pd.stiffness: expected 'float' > 0.0, not -5.0",
    ),
    (
        "param.set",
        {"values": {"laws.pd.stiffness": math.nan}},
        "coupling.laws.pd.stiffness: nan is not a finite number",
    ),
    ("param.set", {"values": {"laws.pd.stiffness": 10**18 * 10}}, "coupling.laws.pd: pole radius"),
    (
        "param.set",
        {"values": {"laws.pd.stiffnes": 1.0}},
        "coupling.laws.pd.stiffnes: law kind pd has no such parameter",
    ),
    (
        "param.set",
        {"values": {"laws.pd.stiffness": "soft"}},
        "coupling.laws.pd.stiffness: expected a number, got 'soft'",
    ),
    ("param.set", {"values": {"nix": 1}}, "coupling.nix: no such parameter; there is: law, laws"),
    ("param.set", {"values": {"ramp": 2.5}}, "coupling.ramp: expected a whole number, got 2.5"),
    ("param.set", {"values": {"memory": 64}}, "coupling.memory: is fixed while the node runs"),
    ("param.set", {"values": {"laws.pd.damping": 2.0, "laws.pd_alpha.order": 4.0}}, "coupling.laws.pd_alpha.order"),
    ("param.set", {"values": 5}, "coupling: expected names and values, got 5"),
    ("param.set", {"value": {"ramp": 1}}, "coupling: param.set: missing a required argument: 'values'"),
    ("param.load", {"values": [1]}, "coupling: expected a mapping of parameters"),
    ("param.load", {"values": {"environment": {}}}, "coupling.environment: no such parameter; there is: law, laws"),
    (
        "param.load",
        {"values": {"laws": {"x": {"kind": "fir", "taps": [5.0, -5.0]}}}},
        "coupling.laws.x: renders H(1) = 0 N/m",
    ),
    (
        "param.load",
        {"values": {"laws": {"x": {"kind": "fir", "taps": [1.0, -3.0]}}}},
        "coupling.laws.x: renders H(1) = -2 N/m",
    ),
    ("param.load", {"values": {"laws": {"x": {"kind": "fir", "taps": [1.0] * 2049}}}}, "coupling.memory is 2048"),
    (
        "param.load",
        {"values": {"laws": {"x": {"kind": "fir", "taps": [1.0] * 8192}}}},
        "8192 taps, but coupling.memory is 2048",
    ),
    ("param.load", {"values": {"laws": {"x": {"kind": "fir", "taps": [1.0] * 120000}}}}, "a request of 1080"),
    ("param.get", {"name": "laws.nix"}, "coupling.laws.nix: no such parameter; there is: pd, pd_alpha"),
    (
        "law.switch",
        {"law": "nix"},
        "coupling.law: no law is named 'nix'; there is: pd, pd_alpha, ",
    ),
    ("law.switch", {"law": "pd_alpha", "ramp": -1}, "coupling.ramp: Expected int >= 0, got -1"),
    ("law.switch", {"law": ["pd"]}, "coupling.law: expected text, got a list"),
    ("law.show", {"law": "nix"}, "no law is named 'nix'"),
    ("nix", {}, "coupling: unknown operation 'nix'; known: "),
]


@pytest.mark.parametrize(("op", "args", "told"), REFUSED, ids=[f"{op}-{told[:40]}" for op, _, told in REFUSED])
def test_what_is_refused_is_told_and_leaves_everything_as_it_was(
    held: RunningLaunch, op: str, args: dict[str, Any], told: str
) -> None:
    before = held.call("coupling", "param.dump"), held.call("coupling", "law.list")["active"]
    assert told in refusal(held, op, **args)
    assert (held.call("coupling", "param.dump"), held.call("coupling", "law.list")["active"]) == before


def test_the_policy_is_part_of_the_parameters_and_judges_at_once(held: RunningLaunch) -> None:
    soft = {"laws.pd.stiffness": 500.0}
    hard = {"laws.pd.stiffness": 1000.0}
    text = refusal(held, "param.set", values=hard)
    assert "coupling.laws.pd: pole radius" in text
    assert "limit: < 1" in text
    assert "at a delay of 2 ticks" in text
    assert "set coupling.stability to warn" in text
    # Policy and value in one change are judged together.
    assert held.call("coupling", "param.set", values={**hard, "stability": "warn"})["action"] == "set"
    assert held.call("coupling", "param.set", values=soft)["action"] == "set"
    assert "stability: coupling.laws.pd: pole radius" in held.errors
    assert held.call("coupling", "param.set", values={**hard, "stability": "off"})["action"] == "set"
    assert "coupling.laws.pd: pole radius" in refusal(held, "param.set", values={"stability": "refuse"})
    held.call("coupling", "param.set", values={**soft, "stability": "refuse"})
    assert held.call("coupling", "param.get", name="laws.pd.stiffness") == 500.0


def test_a_law_of_an_installed_package_works(held: RunningLaunch) -> None:
    law = {"kind": "stiffening", "stiffness": 500.0, "damping": 3.0, "cubic": 1e8}
    held.call("coupling", "param.set", values={"laws.cubic": law, "law": "cubic", "ramp": 20})

    def balance() -> bool:
        depth = -held.call("driver", "progress")["position_m"][2]
        return bool(abs(500.0 * depth + 1e8 * depth**3 - 300.0 * (0.003 - depth)) < 1e-3)

    # The hand's 300 N/m from 3 mm against K x + c x³: at rest at 1.04 mm, where PD of the same K would rest at 1.13 mm.
    wait_for(balance, "the hand rests on the new law")
    assert held.call("coupling", "law.list")["active"] == "cubic"
    held.call("coupling", "param.set", values={"law": "pd", "ramp": 0})


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        ("raising", "raised ZeroDivisionError: float division by zero"),
        ("not_finite", "not a finite force"),
        ("sleepy", "budget 1000 µs"),
        ("busy", "budget 1000 µs"),
    ],
)
def test_a_law_that_breaks_at_once_is_refused_and_one_that_breaks_later_replaced(
    held: RunningLaunch, kind: str, told: str
) -> None:
    launch = held
    surface = launch.call("environment", "param.get", name="surface")
    at_once = {"kind": kind, "stiffness": 500.0}
    assert told in refusal(launch, "param.set", values={"laws.broken": at_once, "law": "broken"})
    assert launch.call("coupling", "law.list")["active"] == "pd"
    # It is well down to 4 mm; then the floor rises by 5 mm under the device.
    launch.call("coupling", "param.set", values={"laws.broken": {**at_once, "deep": 4e-3}, "law": "broken"})
    assert launch.call("coupling", "law.list")["active"] == "broken"
    launch.call("environment", "param.set", values={"surface.position": surface["position"] + 0.005})
    wait_for(lambda: launch.call("coupling", "law.list")["active"] == "fallback", "the fallback")
    assert launch.call("coupling", "law.show")["law"] == "fallback"
    # Setting something else does not bring the broken law back; naming another law brings that.
    launch.call("coupling", "param.set", values={"clamp": True})
    assert launch.call("coupling", "law.list")["active"] == "fallback"
    launch.call("environment", "param.set", values={"surface.position": surface["position"]})
    switched = launch.call("coupling", "law.switch", law="pd")
    assert (switched["from"], switched["to"]) == ("fallback", "pd")
    assert switched["was"]["h1_n_per_m"] == 0.0
    wait_for(lambda: "fallback: law 'broken' at tick" in launch.errors, "the event on the terminal")
    launch.wait_ticks(300)


def test_the_record_of_all_that(held: RunningLaunch, tmp_path: Path) -> None:
    """Last in this loop: every failure above fell back within its own tick, and was told."""
    figures = held.finish(signal.SIGINT, code=0)
    recording = recorded(held.folder, figures)
    forces = {force.seq: force for force in recording.messages("/coupling/force")}
    fallbacks = [receipt for receipt in receipts(recording) if receipt.action == "fallback"]
    told = [event for event in recording.messages("/coupling/event") if event.kind == "fallback"]
    assert len(fallbacks) == len(told) == 4
    reasons = ("raised ZeroDivisionError", "not finite", "slept: took", "computed for")
    for receipt, event, reason in zip(fallbacks, told, reasons, strict=True):
        assert isinstance(event, Event)
        assert reason in receipt.reason
        assert receipt.reason in event.reason
        assert f"at tick {receipt.seq}" in event.reason
        force = forces[receipt.seq]
        assert (force.law, force.revision) == ("fallback", receipt.revision)
        # The tick before; on a busy machine it may have been lost.
        assert forces[max(seq for seq in forces if seq < receipt.seq)].law == "broken"
        # The damper of 5 N s/m answers the 5 mm of that tick, one-sided: it pushes out of the floor, it does not pull.
        assert force.force[2] >= 0.0
        assert all(map(math.isfinite, force.force))
    revisions = [receipt.revision for receipt in receipts(recording)]
    assert revisions == list(range(1, len(revisions) + 1))


# -- many ----------------------------------------------------------------------------------------------------------------


def test_a_thousand_swaps_and_a_thousand_sets_are_not_felt_and_cost_no_tick() -> None:
    figures = measure(swaps=1000, sets=1000, blocks=20, duration=10.0)
    assert figures["requests"] == figures["receipts"] == 2000
    assert figures["refused"] == figures["lost"] == 0
    # All laws have the same H(1). At rest means that positions differ by at most 1e-17 m; the taps of two laws, 14000 N/m in
    # all, make 1.4e-13 N of that, and rounding adds as much again at most.
    assert figures["at_rest"] > 50
    assert figures["force_step_max_n"] < 3e-13
    # Missed ticks are the machine's unless busy blocks have them more often than the idle blocks beside them: of the pairs
    # in which only one missed any, 3 sigma of a fair coin may fall to the busy side, and one pair more.
    only = figures["only_busy_missed"] + figures["only_idle_missed"]
    assert figures["only_busy_missed"] <= 0.5 * only + 1.5 * math.sqrt(only) + 1.0


# -- schedules -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ramp", [0, 100])
def test_scheduled_swaps_are_recorded_and_have_the_bits_of_one_process(tmp_path: Path, ramp: int) -> None:
    figures = launch_json(tmp_path, "floor_swap", "pace:=lockstep", f"ramp:={ramp}")
    recording = recorded(tmp_path, figures)
    found = receipts(recording)
    assert [(receipt.seq, receipt.action, receipt.reason, receipt.ramp) for receipt in found] == [
        (1000, "switch", "schedule", 0),
        (2000, "switch", "schedule", ramp),
    ]
    # PDα is leak-corrected: the same H(1) as PD, at rest no step but rounding of 1 N. Multi-term is softer by its leak.
    assert found[0].force_step < 1e-13
    assert found[1].force_step == pytest.approx(216.423 * 0.000981, rel=1e-4)
    forces: list[Force] = recording.messages("/coupling/force")
    trace = from_launch(read("floor_swap", {"pace": "lockstep", "ramp": ramp})).play()
    assert [force.force[2].hex() for force in forces[: len(trace.force)]] == [
        value.hex() for value in trace.force.tolist()
    ]
    if ramp:
        # Faded, the force never changes by more per tick than it would within a law: no jump to be felt.
        steps = [abs(b.force[2] - a.force[2]) for a, b in itertools.pairwise(forces[1900:2300])]
        assert max(steps) < 0.02


SCHEDULED = (
    HELD.replace("fifo: 0", "fifo: 0, duration: 3.0")
    .replace(
        "      fallback:",
        """        recursive:
          {kind: pd_alpha, stiffness: 500.0, damping: 1.0, order: 0.8, taps: 6, gains: physical, derivative: oustaloup_matched}
      schedule: [{at: 2.0, law: recursive}]
      fallback:""",
    )
    .replace("stability: refuse", "stability: 'off'")
)


@pytest.mark.parametrize("ramp", [0, 40])
def test_a_scheduled_recursive_law_has_the_bits_of_one_process(tmp_path: Path, ramp: int) -> None:
    # Long before the history is full, and when the swap replays less than all: memory is shorter than the run.
    text = SCHEDULED.replace("fifo: 0", "fifo: 0, pace: lockstep").replace(
        "law: recursive}", f"law: recursive, ramp: {ramp}}}"
    )
    (tmp_path / "recursive.yaml").write_text(text.replace("      fallback:", "      memory: 300\n      fallback:"))
    figures = launch_json(tmp_path, "./recursive.yaml")
    forces = {force.seq: force.force[2] for force in recorded(tmp_path, figures).messages("/coupling/force")}
    scene = from_launch(read(str(tmp_path / "recursive.yaml"), {}))
    assert scene.swaps[0].law.sections
    expected = scene.play().force.tolist()
    assert [forces[seq].hex() for seq in range(len(expected))] == [value.hex() for value in expected]


def test_a_scheduled_law_runs_along_and_follows_a_change_before_its_time(tmp_path: Path) -> None:
    (tmp_path / "scheduled.yaml").write_text(SCHEDULED)
    with running(tmp_path, "./scheduled.yaml") as launch:
        launch.call("coupling", "param.set", values={"laws.recursive.damping": 2.0})
        figures = launch.finish()
    recording = recorded(tmp_path, figures)
    found = receipts(recording)
    assert [receipt.action for receipt in found] == ["set", "switch"]
    # Tick 1000, or on a busy machine the first one after it that reached the coupling.
    ticks = [force.seq for force in recording.messages("/coupling/force")]
    assert found[-1].seq == min(seq for seq in ticks if seq >= 1000)
    assert json.loads(found[-1].after)["damping"] == 2.0
    # D^0.8 of 1 mm that have been held for 2 s is near zero however it is realised: well below the 0.56 N of the spring.
    assert found[-1].force_step < 0.3


# -- the watched file ----------------------------------------------------------------------------------------------------


def test_saving_the_watched_file_changes_the_running_law_all_or_nothing(tmp_path: Path) -> None:
    (tmp_path / "watching.yaml").write_text(
        HELD.replace("    kind: coupling\n", "    kind: coupling\n    watch: coupling.yaml\n")
    )
    watched = tmp_path / "coupling.yaml"
    watched.write_text("coupling: {laws: {pd: {stiffness: 510.0}}}\n")

    def now(launch: RunningLaunch, name: str) -> Any:
        return launch.call("coupling", "param.get", name=name)

    with running(tmp_path, "./watching.yaml") as launch:
        assert now(launch, "laws.pd") == {"kind": "pd", "stiffness": 510.0, "damping": 3.0}
        watched.write_text("coupling: {laws: {pd: {stiffness: 530.0}}, ramp: 5}\n")
        wait_for(lambda: now(launch, "laws.pd.stiffness") == 530.0, "the saved stiffness")
        assert now(launch, "ramp") == 5
        assert now(launch, "laws.pd.damping") == 3.0
        for content, told in (
            (
                "laws: {pd: {stiffness: 490.0, damping: -1.0}}",
                "coupling.laws.pd.damping: expected 'float' >= 0.0, not -1.0",
            ),
            ("laws: {pd: {stiffness: 490.0}", "not valid YAML"),
            ("laws: {pd: {stiffness: 490.0}, pd: {stiffness: 490.0}}", "'pd' stands twice"),
            ("law: nix", "no law is named 'nix'"),
        ):
            watched.write_text(content)
            wait_for(lambda told=told: told in launch.errors, told)  # type: ignore[misc]
            assert now(launch, "laws.pd.stiffness") == 530.0
        # A slow writer: nothing is applied until it has closed the file, then all of it.
        with open(watched, "w", encoding="utf-8") as file:
            file.write("laws: {pd: {stiffness: 54")
            file.flush()
            launch.wait_ticks(250)
            assert now(launch, "laws.pd.stiffness") == 530.0
            file.write("0.0}}\n")
        wait_for(lambda: now(launch, "laws.pd.stiffness") == 540.0, "the slowly saved stiffness")
        figures = launch.finish(signal.SIGINT, code=0)
    found = receipts(recorded(tmp_path, figures))
    assert [json.loads(receipt.after)["stiffness"] for receipt in found] == [530.0, 540.0]
    refused = [event for event in recorded(tmp_path, figures).messages("/coupling/event") if event.kind == "refused"]
    assert len(refused) == 4
    assert all("the running parameters are untouched" in event.reason for event in refused)


# -- the command line ----------------------------------------------------------------------------------------------------


class Verbs:
    """The command ``haptic`` within this process: the same code, without half a second of start-up each time."""

    def __init__(self, runtime_dir: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
        monkeypatch.setenv("HAPTIC_RUNTIME_DIR", str(runtime_dir))
        self._capsys = capsys

    def __call__(self, *words: str, code: int = 0) -> tuple[str, str]:
        """Run one command; give what it wrote to standard output and standard error."""
        self._capsys.readouterr()
        try:
            found = main(list(words))
        except SystemExit as end:
            found = int(str(end.code))
        out, err = self._capsys.readouterr()
        assert found == code, err
        return out, err

    def answered(self, *words: str) -> dict[str, Any]:
        """Run one command with --json."""
        found: dict[str, Any] = json.loads(self(*words, "--json")[0].splitlines()[-1])
        return found


def test_the_command_line_beside_a_running_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with running(tmp_path, "floor_drop", "duration:=0") as launch:
        monkeypatch.chdir(tmp_path)
        haptic = Verbs(launch.runtime_dir, monkeypatch, capsys)
        answered = haptic.answered
        assert "pd_alpha" in launch.haptic("law", "list").stdout

        assert set(answered("node", "list")["nodes"]) == {"driver", "environment", "coupling", "logger"}
        assert answered("node", "info", "/coupling")["status"]["state"] == "running"
        assert answered("param", "list", "coupling")["nodes"]["coupling"]["laws.pd.stiffness"] == 1000.0
        assert haptic("param", "get", "/coupling", "laws.pd.stiffness")[0] == "1000.0\n"
        changed = answered("param", "set", "coupling", "laws.pd.stiffness", "1500", "laws.pd.damping", "4")
        assert changed["receipt"]["action"] == "set"
        assert changed["values"] == {"laws.pd.stiffness": 1500, "laws.pd.damping": 4}
        haptic("param", "dump", "coupling", "-o", "dump.yaml")
        assert "File exists" in haptic("param", "dump", "coupling", "-o", "dump.yaml", code=1)[1]
        (tmp_path / "designed.yaml").write_text(
            "coupling: {law: designed, laws: {designed: {kind: fir, taps: [2000.0, -1000.0]}}}\n"
        )
        assert answered("param", "load", "coupling", "designed.yaml")["receipt"]["to"] == "designed"
        assert answered("law", "list")["active"] == "designed"
        assert answered("law", "show")["taps_n_per_m"] == [2000.0, -1000.0]
        switched = answered("law", "switch", "pd_alpha", "--ramp", "10")
        assert (switched["from"], switched["to"], switched["ramp"]) == ("designed", "pd_alpha", 10)
        assert {"h1_n_per_m", "h_nyquist_n_per_m", "pole_radius", "f_min_n_s_per_m"} <= set(switched["is"])
        assert switched["was"]["taps_n_per_m"] == [2000.0, -1000.0]
        assert answered("param", "get", "coupling", "ramp")["value"] == 0
        assert answered("param", "load", "coupling", "dump.yaml")["receipt"]["to"] == "pd"
        assert haptic("param", "dump", "coupling")[0].splitlines()[:2] == ["coupling:", "  law: pd"]
        out, err = haptic("param", "set", "coupling", "laws.pd.stiffness", ".nan", "--json", code=1)
        assert "nan is not a finite number" in json.loads(out)["error"]
        assert "nan is not a finite number" in err
        for words, told in (
            (("param", "set", "coupling", "ramp"), "'ramp' has no value"),
            (("param", "set", "coupling", "ramp", "1", "ramp", "2"), "ramp stands twice"),
            (("param", "set", "coupling", "ramp", "[1"), "not valid YAML"),
            (("param", "get", "copling", "ramp"), "did you mean coupling?"),
            (("param", "load", "coupling", "nix.yaml"), "No such file"),
            (("node", "list", "--run", "nix"), "no run is named 'nix'"),
        ):
            assert told in haptic(*words, code=2)[1]
        for asked in ("law switch nix", "law show nix", "param set driver safety.ramp 1"):
            assert haptic(*asked.split(), code=1)[1].startswith("haptic: ")


def test_laws_are_shown_without_a_running_loop(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with private_runtime_dir() as runtime_dir:
        haptic = Verbs(runtime_dir, monkeypatch, capsys)

        def shown(*words: str) -> dict[str, Any]:
            return haptic.answered("law", "show", *words)

        by_flags = shown("pd", "--rate", "500", "--stiffness", "1000", "--gain", "3")
        # Paper, eq. 1 at T = 2 ms: K + B/T and −B/T.
        assert by_flags["taps_n_per_m"] == [2500.0, -1500.0]
        assert (by_flags["h1_n_per_m"], by_flags["h_nyquist_n_per_m"]) == (1000.0, 4000.0)
        assert 0.9 < by_flags["pole_radius"] < 1.0
        assert shown("pd", "stiffness:=1000", "damping:=3") == by_flags
        assert shown("{kind: pd, stiffness: 1000, damping: 3}", "--rate", "500") == by_flags
        launched = shown("--launch", "floor_drop")
        for key in ("taps_n_per_m", "h1_n_per_m", "pole_radius", "rate_hz", "law"):
            assert launched[key] == by_flags[key]
        assert shown("multi_term", "--launch", "floor_drop", "stiffness:=1200")["stiffness"] == 1200.0
        assert len(shown("paper_optimum", "--rate", "250", "--delay", "1", "--mass", "0.2")["taps_n_per_m"]) == 4
        assert "pole radius" in haptic("law", "show", "paper_optimum")[0]
        for words in (("nix", "--rate", "500"), ("pd", "--rate", "0"), ("pd", "--rate", "500"), ()):
            haptic("law", "show", *words, code=2)
