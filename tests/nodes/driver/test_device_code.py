"""A device's own code beside the loop: whatever it raises, the driver ends softly."""

from __future__ import annotations

import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from messages.types import ZERO
from nodes.base.control_thread import ControlServer
from nodes.driver.calls import Calls, DeviceCalls, Jumps, own_calls
from nodes.driver.device import DeviceLimits
from tests.support.launching import running
from tests.support.scripted import Hand, ScriptedDriver
from tests.support.scripts import BOX, moving
from tests.support.setups import setup_of


class _Counting(Hand):
    """Counts its calls in an attribute named `calls`, which is no method."""

    calls: Any = 0

    def read_position(self, seq: int) -> tuple[float, float, float]:
        self.calls += 1
        return super().read_position(seq)


class _Listing(Hand):
    def calls(self) -> list[int]:
        return [1, 2]


class _Own(Hand):
    def calls(self) -> Calls:
        return Calls(1, 2, 3)


def test_only_calls_are_taken_for_calls() -> None:
    """A device that counts its calls failed with: 'int' object is not callable."""
    limits = DeviceLimits()
    for kind in (_Counting, _Listing, Hand):
        device = kind(limits, moving)
        assert own_calls(device) is None
        assert DeviceCalls(device, lambda: ZERO, Jumps(device)).calls.read not in (0, 1)
    assert own_calls(_Own(limits, moving)) == Calls(1, 2, 3)
    device = Hand(limits, moving)
    device.calls = lambda: Calls(1, 2, 3)  # type: ignore[attr-defined]
    assert own_calls(device) is None


class _Vague(ScriptedDriver):
    """Its `condition` raises from some call on."""

    hand = Hand(DeviceLimits(peak_force=8.0, hold=1.0, workspace=BOX), moving)
    asked = 0

    def condition(self) -> str:
        self.asked += 1
        raise RuntimeError("vendor library: connection reset")


def test_a_condition_that_raises_is_told_once_and_ends_the_driver(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    driver = _Vague(
        setup_of(
            name="driver",
            kind="vague",
            axes=["x", "y", "z"],
            parameters={"safety": {"hang": None}},
        )
    )
    told: list[tuple[str, str]] = []
    monkeypatch.setattr(
        driver.events, "emit", lambda kind, text, **_: told.append((kind, text))
    )
    driver.configure()
    driver.state = "running"
    for _ in range(3):
        driver.check_health()
    expected = (
        "driver: condition() of the device failed:"
        " RuntimeError: vendor library: connection reset"
    )
    assert driver.stop_reason == expected
    assert driver.failing
    assert driver.stopping
    assert driver.asked == 1
    assert [text for kind, text in told if kind == "device"] == [
        f"{expected}; the force ramps down to zero, and the driver ends"
    ]
    # Who asks is answered, with the same words.
    assert driver.operations()["progress"]()["condition"] == expected
    assert driver.operations()["force"]()["why"]


def test_whatever_a_node_does_beside_its_loop_the_control_thread_goes_on() -> None:
    """One exception ended the thread, so the node could not be reached any more."""
    done: list[str] = []
    ended = threading.Event()
    told: list[str] = []

    def fails(error: Exception) -> Any:
        def duty() -> None:
            done.append(type(error).__name__)
            if len(done) > 20:
                ended.set()
            raise error

        return duty

    node = SimpleNamespace(
        setup=SimpleNamespace(
            name="driver", scheduling=SimpleNamespace(), control="ipc:///nowhere"
        ),
        events=SimpleNamespace(emit=lambda kind, text: told.append(f"{kind}: {text}")),
        failing=False,
        stop=lambda reason: told.append(f"stop: {reason}"),
        check_health=fails(ValueError("no number")),
    )
    closed = SimpleNamespace(close=lambda **_: None)
    server: Any = SimpleNamespace(
        _node=node,
        _ending=ended,
        _serve=lambda: None,
        _save_parameters=fails(TypeError("cannot be kept")),
        _watch_lease=lambda: done.append("lease"),
        _revert_expired=lambda: None,
        _publish_status=fails(OSError("no descriptor")),
        _links=closed,
        _socket=closed,
        _end_softly=lambda error: ControlServer._end_softly(server, error),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("nodes.base.control_thread.realtime.step_aside", lambda _: None)
        patch.setattr("nodes.base.control_thread.remove_ipc", lambda _: None)
        ControlServer.run(server)
    assert done[:4] == ["ValueError", "TypeError", "lease", "OSError"]
    assert (
        told[0]
        == "control: driver: ValueError outside the loop: no number; the node ends"
    )
    assert sum(text.startswith("stop: ") for text in told) == 1
    assert told.count("control: no descriptor") > 3


BAD = '''
from sim.device.driver import SimDriver

class Bad(SimDriver):
    """A driver whose word on its device raises once, after some ticks."""
    def condition(self):
        if self.driving.seq > 100:
            raise RuntimeError("vendor library: connection reset")
        return ""
'''


@pytest.mark.process
def test_a_launch_whose_device_cannot_tell_its_condition_ends_softly_with_its_reason(
    tmp_path: Path,
) -> None:
    package = tmp_path / "package"
    (package / "vague-1.0.dist-info").mkdir(parents=True)
    (package / "vague.py").write_text(BAD)
    (package / "vague-1.0.dist-info" / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: vague\nVersion: 1.0\n"
    )
    (package / "vague-1.0.dist-info" / "entry_points.txt").write_text(
        "[haptic.nodes]\nvague = vague:Bad\n"
    )
    scene = tmp_path / "vague.yaml"
    scene.write_text("""
summary: A hand rests in a wall, and its device cannot tell its condition
run: {rate: 500.0, duration: 0.0, axes: [x]}
nodes:
  driver:
    kind: vague
    parameters:
      safety: {peak_force: 7.9, slew: 1000.0, workspace: [[-0.1, 0.1], [-0.1, 0.1], [-0.1, 0.1]]}
      device: {mass: 0.1, hand: {mass: 0.1, damping: 3.0, stiffness: 300.0, path: [[0.0, 0.0],
        [0.1, 0.02]]}}
  environment: {kind: environment, parameters: {surface: {kind: plane, axis: x, position: 0.005,
    normal: -1}}}
  coupling:
    kind: coupling
    parameters: {law: pd, laws: {pd: {kind: pd, stiffness: 500.0, damping: 5.0}}}
""")
    with running(
        tmp_path, str(scene), environment={"PYTHONPATH": str(package)}, ready=False
    ) as launch:
        figures = launch.finish(code=1)
        assert (
            "condition() of the device failed: RuntimeError: vendor library: connection reset"
            in launch.errors
        )
        assert "Traceback" not in launch.errors
        assert "unreachable" not in launch.errors
    # 7.5 N, or what it has become, at most 2 N a tick.
    assert figures["safety"]["soft_stop_ticks"] >= 2
    assert "connection reset" in figures["exit_reason"]
    assert figures["nodes"]["driver"]["state"] == "failed"
