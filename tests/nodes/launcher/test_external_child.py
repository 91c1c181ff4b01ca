"""Nodes that somebody else starts: waited for, taken as lost when they go, and ending by themselves without their launcher."""

from __future__ import annotations

import os
import signal
import subprocess
from pathlib import Path

from tests.support.launching import DEADLINE, HAPTIC, Running, running, typed, typed_in, wait_for

SCENE = """\
summary: A coupling started by hand
run: {rate: 250.0, duration: 0.0}
nodes:
  driver: {kind: sim_driver, parameters: {device: {mass: 0.1, damping: 1.0, gravity: 9.81, position: 0.001}}}
  environment: {kind: environment, parameters: {surface: {kind: plane, axis: z, position: 0.0, normal: 1}}}
  coupling:
    kind: coupling
    by_hand: true
    parameters: {law: pd, laws: {pd: {kind: pd, stiffness: 1000.0, damping: 3.0}}}
"""


def start(launch: Running) -> subprocess.Popen[bytes]:
    """Start the coupling as the launcher says."""
    wait_for(lambda: list(launch.runtime_dir.glob("runs/*/run.json")), "the run")
    with open(launch.folder / "node.txt", "ab") as errors:
        return subprocess.Popen(
            [*HAPTIC, "node", "start", "coupling"], env=launch.environment, cwd=launch.folder, stderr=errors
        )


def scene(folder: Path, text: str = SCENE) -> str:
    """Write the launch file."""
    (folder / "by_hand.yaml").write_text(text)
    return str(folder / "by_hand.yaml")


def test_a_node_started_by_hand_that_dies_is_lost(tmp_path: Path) -> None:
    with running(tmp_path, scene(tmp_path), ready=False) as launch:
        node = start(launch)
        try:
            wait_for(lambda: launch.ticks() > 0, "the first tick")
            node.send_signal(signal.SIGKILL)
            node.wait()
            figures = launch.finish(code=1)
            assert figures["exit_reason"].startswith("coupling: ended with no answer for 5 s")
            # The watchdog had the device at zero force long before.
            assert figures["final"]["force_n"] == 0.0
        finally:
            node.kill()
            node.wait()


def test_a_node_started_by_hand_ends_without_its_launcher(tmp_path: Path) -> None:
    with running(tmp_path, scene(tmp_path), ready=False) as launch:
        node = start(launch)
        try:
            wait_for(lambda: launch.ticks() > 0, "the first tick")
            os.kill(launch.process.pid, signal.SIGKILL)
            assert node.wait(DEADLINE) is not None
        finally:
            node.kill()
            node.wait()


def test_only_nodes_that_are_waited_for_are_started_by_hand(tmp_path: Path) -> None:
    with running(tmp_path, "floor_drop", "duration:=0") as launch:
        told = typed(launch, "node", "start", "coupling", code=2).stderr
        assert "by_hand: true" in told
    assert "HOST:PORT" in typed_in(tmp_path, "node", "start", "coupling", "--bind", "nowhere", code=2).stderr
    environment = {**os.environ, "HAPTIC_KEYS": str(tmp_path / "none")}
    told = typed_in(tmp_path, "node", "start", "coupling", "--bind", "10.9.8.7:5600", code=2, environment=environment).stderr
    assert "haptic keys new" in told
