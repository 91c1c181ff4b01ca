"""Nodes started by hand: waited for, recognised as lost, ending without their launcher."""

from __future__ import annotations

import contextlib
import math
import os
import signal
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
import zmq

from messages.transport.endpoints import bind
from messages.transport.requests import Reply, ReplySocket, decode_request
from nodes.launcher import launch_file
from nodes.launcher.child import Child
from nodes.launcher.external_child import ByHand
from nodes.launcher.supervisor import LaunchFailedError, Supervisor
from tests.support.launching import (
    DEADLINE,
    HAPTIC,
    Running,
    private_runtime_dir,
    running,
    typed,
    typed_in,
    wait_for,
)
from tests.support.setups import setup_of

if TYPE_CHECKING:
    from messages.transport.endpoints import Context
    from nodes.base.setup import Setup

SCENE = """\
summary: A coupling started by hand
run: {rate: 250.0, duration: 0.0}
nodes:
  driver: {kind: sim_driver, parameters: {device: {mass: 0.1, damping: 1.0, gravity: 9.81,
    position: 0.001}}}
  environment: {kind: environment, parameters: {surface: {kind: plane, axis: z, position: 0.0,
    normal: 1}}}
  coupling:
    kind: coupling
    by_hand: true
    parameters: {law: pd, laws: {pd: {kind: pd, stiffness: 1000.0, damping: 3.0}}}
"""


def start(launch: Running) -> subprocess.Popen[bytes]:
    """Start the coupling with the printed command."""
    wait_for(lambda: list(launch.runtime_dir.glob("runs/*/run.json")), "the run")
    with open(launch.folder / "node.txt", "ab") as errors:
        return subprocess.Popen(
            [*HAPTIC, "node", "start", "coupling"],
            env=launch.environment,
            cwd=launch.folder,
            stderr=errors,
        )


@contextlib.contextmanager
def odd_node(context: Context, **answers: object) -> Iterator[Setup]:
    """Answer requests as a foreign program might (`answers` by operation); yield its set-up."""
    over = threading.Event()
    with private_runtime_dir() as folder:
        control = f"ipc://{folder}/driver.ctl"
        inbox = ReplySocket(context)
        inbox.socket.rcvtimeo = 20
        bind(inbox.socket, control)

        def serve() -> None:
            with inbox.socket:
                while not over.is_set():
                    with contextlib.suppress(zmq.Again):
                        op = decode_request(inbox.receive()).op
                        inbox.answer(
                            msgspec.msgpack.encode(
                                Reply(op in answers, answers.get(op))
                            )
                        )

        thread = threading.Thread(target=serve)
        thread.start()
        try:
            yield setup_of(
                run_dir=str(folder),
                factory="sim.device.driver:SimDriver",
                control=control,
                lease=6.0,
                by_hand=True,
            )
        finally:
            over.set()
            thread.join()


FINISHED = {"state": "finished", "pid": 1}


@pytest.mark.parametrize(
    "answers",
    [
        {"status": 7},
        {"status": None},
        {"status": {}},
        {"status": {"state": "ready", "pid": "many"}},
        {"status": {"state": "ready", "pid": math.inf}},
        {"status": FINISHED, "report": 7},
    ],
)
def test_an_answer_that_is_none_of_the_protocol_ends_the_node_and_is_told(
    answers: dict[str, Any], context: Context
) -> None:
    """It ended the thread that watches the node; the launcher continued without."""
    with odd_node(context, **answers) as setup:
        child = ByHand(setup, 0, 0.5, True, context, lambda _: None)
        child.start(Path(setup.run_dir))
        try:
            wait_for(lambda: child.code is not None, "the end of the node")
            assert child.end.startswith("an answer that violates the protocol")
        finally:
            child.release()


def test_a_node_that_reports_no_status_has_the_last_one(context: Context) -> None:
    with odd_node(context, status=FINISHED, report={"tick": "plain"}) as setup:
        child = ByHand(setup, 0, 0.5, True, context, lambda _: None)
        child.start(Path(setup.run_dir))
        try:
            wait_for(lambda: child.code is not None, "the end of the node")
            assert child.report(Path(setup.run_dir)) == {
                "status": FINISHED,
                "tick": "plain",
            }
        finally:
            child.release()


def test_times_of_a_device_that_are_none_are_told_with_their_node(
    context: Context,
) -> None:
    with odd_node(context, device={"opening_s": "soon"}) as setup:
        supervisor = Supervisor(launch_file.read("floor_drop", {}), print, print)
        supervisor.context.term()
        supervisor.context = context
        with pytest.raises(
            LaunchFailedError,
            match=r"driver: answers device with {'opening_s': 'soon'}",
        ):
            supervisor._note_ready(Child(setup, 0, 0.5, True))


def scene(folder: Path, text: str = SCENE) -> str:
    """Write the launch file."""
    (folder / "by_hand.yaml").write_text(text)
    return str(folder / "by_hand.yaml")


@pytest.mark.slow
def test_a_node_started_by_hand_that_dies_is_lost(tmp_path: Path) -> None:
    with running(tmp_path, scene(tmp_path), ready=False) as launch:
        node = start(launch)
        try:
            wait_for(lambda: launch.ticks() > 0, "the first tick")
            node.send_signal(signal.SIGKILL)
            node.wait()
            figures = launch.finish(code=1)
            assert figures["exit_reason"].startswith(
                "coupling: ended with no answer for 5 s"
            )
            # The watchdog had the device at zero force long before.
            assert figures["final"]["force_n"] == 0.0
        finally:
            node.kill()
            node.wait()


@pytest.mark.slow
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


@pytest.mark.process
def test_a_node_that_somebody_has_started_already_is_refused_and_goes_on(
    tmp_path: Path,
) -> None:
    with running(tmp_path, scene(tmp_path), ready=False) as launch:
        node = start(launch)
        try:
            wait_for(lambda: launch.ticks() > 0, "the first tick")
            told = typed(launch, "node", "start", "coupling", code=2).stderr
            assert told.startswith(
                f"haptic: coupling: process {node.pid} is already this node; end it first"
            )
            launch.wait_ticks(50)
            assert launch.pid("coupling") == node.pid
            launch.finish(signal.SIGINT)
        finally:
            node.kill()
            node.wait()


@pytest.mark.process
def test_only_nodes_that_are_waited_for_are_started_by_hand(tmp_path: Path) -> None:
    with running(tmp_path, "floor_drop", "duration:=0") as launch:
        told = typed(launch, "node", "start", "coupling", code=2).stderr
        assert "by_hand: true" in told
    assert (
        "HOST:PORT"
        in typed_in(
            tmp_path, "node", "start", "coupling", "--bind", "nowhere", code=2
        ).stderr
    )
    environment = {**os.environ, "HAPTIC_KEYS": str(tmp_path / "none")}
    told = typed_in(
        tmp_path,
        "node",
        "start",
        "coupling",
        "--bind",
        "10.9.8.7:5600",
        code=2,
        environment=environment,
    ).stderr
    assert "haptic keys new" in told
