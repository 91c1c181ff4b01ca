"""Interrupted cells and killed kernels leave nothing behind; no interrupt is lost."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from sim.measure.interrupts import deferred
from tests.support.launching import (
    assert_nothing_left,
    private_runtime_dir,
    processes_of,
    wait_for,
)

if TYPE_CHECKING:
    from jupyter_client.manager import KernelManager

# of the kernel client's own libraries
pytestmark = pytest.mark.filterwarnings("default")


def says_ready(message: dict[str, Any]) -> bool:
    """Whether a message announces that the cell has started."""
    return message["msg_type"] == "stream" and "ready" in str(
        message["content"]["text"]
    )


def shows_progress(message: dict[str, Any]) -> bool:
    """Whether a message is the first display of a progress bar."""
    return bool(message["msg_type"] == "display_data")


def in_a_kernel(
    folder: Path,
    code: str,
    begun: Callable[[dict[str, Any]], bool],
    then: Callable[[KernelManager], None],
) -> list[dict[str, Any]]:
    """Run a cell in a kernel, act once it has started, and return its messages until idle."""
    from jupyter_client.manager import KernelManager  # half a second for every worker

    manager = KernelManager(kernel_name="python3")
    manager.start_kernel(
        cwd=str(folder), env={**os.environ, "HAPTIC_RUNTIME_DIR": str(folder)}
    )
    client = manager.blocking_client()
    told: list[dict[str, Any]] = []
    try:
        client.start_channels()
        client.wait_for_ready(timeout=60)
        request = client.execute(code)
        while manager.is_alive():
            message = client.get_iopub_msg(timeout=120)
            if message["parent_header"].get("msg_id") != request:
                continue
            told.append(message)
            if begun(message):
                then(manager)
            if (
                message["msg_type"] == "status"
                and message["content"]["execution_state"] == "idle"
            ):
                break
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)
    return told


LAUNCH = """
import haptic
run = haptic.launch("wall_press", duration=0)
assert run.ticks > 0
run.wait()
"""  # shows a progress bar while it waits

STUDY = """
import haptic, threading
threading.Timer(2.0, lambda: print("ready", flush=True)).start()
haptic.lab("relatives", mass=0.1, fresh=True)
"""


@pytest.mark.process
@pytest.mark.smoke("launch")
@pytest.mark.parametrize(
    ("code", "begun"),
    [(LAUNCH, shows_progress), pytest.param(STUDY, says_ready, marks=pytest.mark.slow)],
    ids=["launch", "study"],
)
def test_an_interrupted_cell_leaves_nothing(
    code: str, begun: Callable[[dict[str, Any]], bool]
) -> None:
    with private_runtime_dir() as folder:
        told = in_a_kernel(
            folder, code, begun, lambda manager: manager.interrupt_kernel()
        )
        (error,) = (
            message["content"] for message in told if message["msg_type"] == "error"
        )
        assert error["ename"] == "KeyboardInterrupt"
        wait_for(
            lambda: not processes_of(folder), "the end of all that it had started", 60.0
        )
        assert_nothing_left(folder)


@pytest.mark.process
def test_a_killed_kernel_takes_its_launch_with_it() -> None:
    def kill(manager: KernelManager) -> None:
        manager.provisioner.process.send_signal(signal.SIGKILL)  # type: ignore[union-attr]
        wait_for(lambda: not manager.is_alive(), "the end of the kernel")

    with private_runtime_dir() as folder:
        in_a_kernel(folder, LAUNCH, shows_progress, kill)
        wait_for(lambda: not processes_of(folder), "the end of the launch", 60.0)
        assert_nothing_left(folder)


class Finalised:
    """Interrupts during its destruction, where Python swallows exceptions."""

    def __del__(self) -> None:
        os.kill(os.getpid(), signal.SIGINT)


def test_an_interrupt_in_a_finaliser_is_not_lost() -> None:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    done = []

    def request() -> None:
        with deferred():
            Finalised()
            done.append("the rest of the block")

    try:
        with pytest.raises(KeyboardInterrupt):
            request()
        assert done
        assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    finally:
        signal.signal(signal.SIGINT, before)
