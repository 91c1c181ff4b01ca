"""The loop across two machines: two network namespaces with keys of their own, and a cable with delay, jitter and loss."""

from __future__ import annotations

import json
import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from messages import keys
from nodes.clock import DRIFT, ClockOffset
from nodes.recording import Recording
from tests.launching import DEADLINE, HAPTIC, private_runtime_dir, wait_for
from tests.twohosts import Cable, Host, NoRightsError, two_hosts

SCENE = """\
summary: A coupling on another machine
run: {rate: 100.0, pace: $(var pace), duration: 1.5, host: 10.77.0.1}
arguments: {pace: {default: realtime, choices: [realtime, lockstep]}}
nodes:
  driver:
    kind: sim_driver
    parameters:
      device: {mass: 0.1, damping: 1.0, gravity: 9.81, position: 0.001}
      safety: {watchdog: 20, max_age: 10}
  environment: {kind: environment, parameters: {surface: {kind: plane, axis: z, position: 0.0, normal: 1}}}
  coupling:
    kind: coupling
    host: 10.77.0.2
    parameters: {law: pd, laws: {pd: {kind: pd, stiffness: 200.0, damping: 1.0}}, stability: warn}
  logger: {kind: logger, required: false, parameters: {path: far.mcap}}
"""


def test_the_shortest_round_trip_tells_the_offset() -> None:
    clock = ClockOffset()
    assert clock.best(0.0) == (0.0, float("inf"))
    # The other clock is 5 s ahead. Symmetric, 1 ms each way.
    clock.add(10.000, 15.001, 10.002)
    offset, error = clock.best(10.002)
    assert offset == pytest.approx(-5.0, abs=1e-12)
    assert error == pytest.approx(1e-3, abs=1e-12)
    assert clock.best(110.002)[1] == pytest.approx(1e-3 + 100.0 * DRIFT, abs=1e-12)


@pytest.mark.parametrize(("gap", "newer"), [(280.0, False), (300.0, True)])
def test_an_old_measurement_loses_worth_at_the_rate_of_drift(gap: float, newer: bool) -> None:
    clock = ClockOffset()
    clock.add(10.000, 15.001, 10.002)
    # 31 ms, nearly all of it on the way there: off by 14.5 ms, within its bound of 15.5 ms. It is worth more than 1 ms of
    # long ago when 14.5 ms / 50 ppm = 290 s have passed.
    start = 10.002 + gap
    clock.add(start - 0.031, start - 0.001 + 5.0, start)
    offset, error = clock.best(start)
    assert offset == pytest.approx(-5.0145 if newer else -5.0, abs=1e-9)
    assert abs(offset + 5.0) <= error


def test_a_clock_that_went_backwards_is_not_believed() -> None:
    clock = ClockOffset()
    clock.add(10.0, 15.0, 9.0)
    assert clock.best(10.0)[1] == float("inf")


class Pair:
    """Two machines that know each other's keys."""

    def __init__(self, near: Host, far: Host, cable: Cable, folder: Path, runtime: Path) -> None:
        self.near, self.far, self.cable, self.folder = near, far, cable, folder
        self.environments = []
        made = []
        for name in ("near", "far"):
            (runtime / name).mkdir(mode=0o700)
            (folder / name).mkdir()
            environment = {"HAPTIC_KEYS": str(folder / f"{name}-keys"), "HAPTIC_RUNTIME_DIR": str(runtime / name)}
            self.environments.append({**os.environ, **environment})
            with pytest.MonkeyPatch.context() as patch:
                patch.setenv("HAPTIC_KEYS", environment["HAPTIC_KEYS"])
                made.append(keys.new_identity().public)
        for own, (host, key) in enumerate(((far, made[1]), (near, made[0]))):
            with pytest.MonkeyPatch.context() as patch:
                patch.setenv("HAPTIC_KEYS", self.environments[own]["HAPTIC_KEYS"])
                keys.allow(host.address, key)

    def start(self, host: int, *words: str) -> subprocess.Popen[bytes]:
        """Start a haptic command on one of them; its output goes to files."""
        name = ("near", "far")[host]
        with open(self.folder / f"{name}.out", "wb") as out, open(self.folder / f"{name}.err", "wb") as err:
            return (self.near, self.far)[host].popen(
                [*HAPTIC, *words], self.environments[host], self.folder / name, out, err
            )

    def errors(self, host: int) -> str:
        """Read what one of them wrote to standard error."""
        return (self.folder / f"{('near', 'far')[host]}.err").read_text()


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.fixture
def pair(tmp_path: Path) -> Iterator[Pair]:
    try:
        with private_runtime_dir() as runtime, two_hosts(delay=0.002, jitter=0.001) as (near, far, cable):
            yield Pair(near, far, cable, tmp_path, runtime)
    except NoRightsError as error:
        pytest.skip(str(error))


def launch(pair: Pair, *assignments: str) -> tuple[dict[str, Any], str]:
    scene = pair.folder / "far.yaml"
    scene.write_text(SCENE)
    launcher = pair.start(0, "launch", str(scene), *assignments, "--json", "--no-plot")
    node = None
    try:
        wait_for(lambda: "haptic node start" in pair.errors(0) or launcher.poll() is not None, "the command")
        line = next(line for line in pair.errors(0).splitlines() if "haptic node start" in line)
        # The printed command itself, on the other machine.
        where, _, command = line.partition(": haptic ")
        assert where.endswith("on 10.77.0.2")
        node = pair.start(1, *command.split())
        assert launcher.wait(DEADLINE) == 0, pair.errors(0)
        assert node.wait(DEADLINE) == 0, pair.errors(1)
        return json.loads((pair.folder / "near.out").read_text().splitlines()[-1]), pair.errors(0)
    finally:
        _end(launcher)
        if node is not None:
            _end(node)


def test_a_coupling_on_another_machine_over_a_slow_lossy_cable(pair: Pair) -> None:
    pair.cable.loss = 0.01
    figures, errors = launch(pair)
    assert figures["exit_reason"] == "done"
    assert pair.cable.carried > 500
    assert pair.cable.lost > 0
    # Each answer crosses the cable twice: proxy there, force back. Delay is never less than that.
    assert figures["response_us"]["p50"] >= 4000.0
    coupling = figures["nodes"]["coupling"]
    assert coupling["state"] == "finished"
    assert coupling["denied"] == 0
    # Both namespaces share one kernel, so the true offset is 0; what was measured must lie within its own bound, and no
    # bound can be below half of the shortest round trip, 2 ms.
    assert abs(coupling["clock_offset"]) <= coupling["clock_error"]
    assert coupling["clock_error"] >= 0.002
    assert "coupling: is there; its clock is" in errors
    # The stamps of the far node are in the time of the launcher's host: never before the state they answer.
    recording = Recording(str(pair.folder / "near" / "far.mcap"))
    stamps: dict[str, dict[int, float]] = {}
    for topic in ("/device/state", "/coupling/force"):
        stamps[topic] = {message.seq: message.stamp for message in recording.messages(topic)}
    common = stamps["/device/state"].keys() & stamps["/coupling/force"].keys()
    assert len(common) > 100
    for seq in common:
        delay = stamps["/coupling/force"][seq] - stamps["/device/state"][seq]
        assert 0.002 - coupling["clock_error"] <= delay


def test_lockstep_over_two_machines_answers_every_tick(pair: Pair) -> None:
    figures, _ = launch(pair, "pace:=lockstep")
    assert figures["exit_reason"] == "done"
    assert figures["ticks"] == 150
    assert figures["missed"] == 0
