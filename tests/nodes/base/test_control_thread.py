"""The control thread under floods, exhaustion and at its end: it keeps the lease."""

from __future__ import annotations

import contextlib
import os
import resource
import socket
import subprocess
import threading
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import pytest
import zmq

from messages.errors import AT_MOST, FORCE, Remedy
from messages.transport import keys
from messages.transport.context import new_context
from messages.transport.endpoints import connect, split
from messages.transport.gate import close_bound
from messages.transport.links import Links
from messages.transport.requests import Connection, ControlError, Request, call
from nodes.base import control_thread
from nodes.base.control_thread import ControlServer
from nodes.base.node import Node
from nodes.parameters.store import ParameterError
from sim.measure.free_ports import free_ports
from tests.support.launching import (
    DEADLINE,
    HAPTIC,
    private_runtime_dir,
    running,
    wait_for,
)
from tests.support.setups import setup_of

if TYPE_CHECKING:
    from messages.transport.endpoints import Context


def server(context: Context, folder: Path, **operations: Any) -> ControlServer:
    setup = setup_of(
        run_dir=str(folder), name="n", kind="k", control=f"ipc://{folder}/n.ctl"
    )
    node = Node(setup)
    made = ControlServer(
        node, context, Links(context, node.events.log, node.events.deny)
    )
    made._operations |= operations
    return made


def test_the_ways_out_of_a_refusal_arrive_as_data(context: Context) -> None:
    ways = (
        Remedy(AT_MOST, "the largest n.gain that is accepted is 3", {"n.gain": 3.0}),
        Remedy(FORCE, "to study it anyway, use --force"),
    )

    def refuse() -> None:
        raise ParameterError("9, limit 3", path="n.gain").with_remedies(*ways)

    with private_runtime_dir() as folder:
        control = server(context, folder, refuse=refuse)
        control.start()
        try:
            with pytest.raises(ControlError) as refusal:
                call(context, f"ipc://{folder}/n.ctl", "refuse")
        finally:
            control.stop()
    assert refusal.value.remedies == ways
    assert refusal.value.fault == "n.gain: 9, limit 3"
    assert str(refusal.value) == "; ".join(
        ["n.gain: 9, limit 3", *(one.text for one in ways)]
    )


@pytest.mark.parametrize("first", ["thread", "stop", "never started"])
def test_its_end_waits_for_nobody(context: Context, first: str) -> None:
    """A thread that has ended by itself accepts no request that would wake it."""
    with private_runtime_dir() as folder:
        control = server(context, folder)
        if first != "never started":
            control.start()
        if first == "thread":
            control._ending.set()
            control.join(DEADLINE)
        ended: list[bool] = []
        stopping = threading.Thread(
            target=lambda: ended.append(control.stop()), daemon=True
        )
        stopping.start()
        stopping.join(DEADLINE)
        assert ended == [True]


def test_forty_ends_in_a_row(context: Context) -> None:
    """One in forty hung if the thread ended just when it was woken."""
    with private_runtime_dir() as folder:
        for i in range(40):
            control = server(context, folder)
            control._socket.rcvtimeo = 1 + i % 3
            control.start()
            time.sleep(0.0005 * (i % 7))
            assert control.stop()


def test_a_request_without_an_end_does_not_hold_up_the_node(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(control_thread, "END_TIMEOUT", 0.2)
    begun, release = threading.Event(), threading.Event()

    def hang() -> None:
        begun.set()
        release.wait(DEADLINE)

    with private_runtime_dir() as folder:
        control = server(context, folder, hang=hang)
        control.start()
        with context.socket(zmq.REQ) as asking:
            asking.linger = 0
            connect(asking, f"ipc://{folder}/n.ctl")
            asking.send(msgspec.msgpack.encode(Request("hang")))
            assert begun.wait(DEADLINE)
            assert not control.stop(), "its socket is still open, and is told to be"
            release.set()
            control.join(DEADLINE)


def test_what_a_node_loads_itself_is_not_taken_for_requests(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A mesh of 327 680 triangles cut the page off from its node; its size has a limit, too."""
    memory = [100 << 20]
    monkeypatch.setattr("nodes.base.realtime.memory_bytes", lambda: memory[0])
    with private_runtime_dir() as folder:
        control = server(context, folder)
        denied: list[str] = []
        node = control._node
        monkeypatch.setattr(node.events, "deny", lambda text, _: denied.append(text))

        def grown(by: int) -> int:
            memory[0] += by
            control._review_memory()
            return len(denied)

        assert grown(control_thread.MAX_GROWTH) == 0
        with node.loading:
            assert grown(1 << 30) == 0
            memory[0] += 1 << 30
        assert grown(0) == 0
        # From there on requests count again, from one byte beyond their limit.
        assert grown(control_thread.MAX_GROWTH) == 0
        assert grown(1) == 1
        # Nor does a load hide more than the largest file takes.
        with node.loading:
            assert grown(control_thread.MAX_LOADED) == 1
            assert grown(control_thread.MAX_LOADED + 1) == 2
        assert control.stop()


def test_who_is_served_after_a_disconnection_waits_for_no_file(
    context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The thread ends all requesting peers and is there again, its endpoint not given up."""
    done: list[bool] = []

    def close(socket: zmq.Socket[bytes], endpoint: str, deadline: float) -> bool:
        done.append(close_bound(socket, endpoint, deadline))
        return done[-1]

    memory = [100 << 20]
    monkeypatch.setattr("nodes.base.realtime.memory_bytes", lambda: memory[0])
    monkeypatch.setattr(control_thread, "STATUS_PERIOD", 0.01)
    monkeypatch.setattr(control_thread, "close_bound", close)
    with private_runtime_dir() as folder:
        control = server(context, folder)
        control.start()
        place = f"ipc://{folder}/n.ctl"
        call(context, place, "clock", timeout=DEADLINE)
        # Growth counts from the first look, which may come after the first request.
        wait_for(lambda: control._usual_memory, "the usual memory is known")
        memory[0] += control_thread.MAX_GROWTH + 1
        wait_for(lambda: done, "all requesting peers are disconnected")
        call(context, place, "clock", timeout=DEADLINE)
        assert control.stop()
    assert done == [True]


def test_a_flood_of_requests_is_served_at_a_bounded_rate(context: Context) -> None:
    """A flood takes the interpreter from the loop: only the flooding client waits."""
    with private_runtime_dir() as folder:
        control = server(context, folder)
        control.start()
        line = Connection(context, f"ipc://{folder}/n.ctl")
        begun = time.monotonic()
        count = 0
        while time.monotonic() < begun + 1.0:
            line.call("clock")
            count += 1
        assert (
            count
            <= control_thread.BURST
            + control_thread.RATE * (time.monotonic() - begun)
            + 1
        )
        # Another one takes its turn between two of the flood's.
        assert "monotonic_s" in call(
            context, f"ipc://{folder}/n.ctl", "clock", timeout=DEADLINE
        )
        line.drop()
        assert control.stop()


def test_half_a_request_of_one_who_is_gone_costs_nobody_an_answer(
    context: Context,
) -> None:
    """REP of libzmq loses the answer to the next request, of any client."""
    with private_runtime_dir() as folder:
        control = server(context, folder)
        with zmq.Context() as others:
            for _ in range(20):
                with others.socket(zmq.DEALER) as gone:
                    connect(gone, f"ipc://{folder}/n.ctl")
                    # Without the empty frame that REQ puts before it.
                    gone.send(b"hello")
        # Only then the node looks at them.
        control.start()
        for _ in range(5):
            assert "monotonic_s" in call(
                context, f"ipc://{folder}/n.ctl", "clock", timeout=DEADLINE
            )
        assert control._node.events.refused > 0
        assert control.stop()


@pytest.mark.process
def test_descriptors_that_run_out_end_no_loop_with_a_force_on(tmp_path: Path) -> None:
    """ZeroMQ aborts without free descriptors: a node limits connections, or ends in time."""
    with running(tmp_path, "wall_press", "duration:=0") as launch:
        driver = launch.run.nodes["driver"].control
        pid = launch.pid("driver")
        number, before = (
            len(os.listdir(f"/proc/{pid}/fd")),
            resource.prlimit(pid, resource.RLIMIT_NOFILE),
        )
        resource.prlimit(pid, resource.RLIMIT_NOFILE, (number, before[1]))
        wait_for(
            lambda: resource.prlimit(pid, resource.RLIMIT_NOFILE) == (before[1],) * 2,
            "the node takes what it may",
        )
        with contextlib.ExitStack() as held:
            for _ in range(50):
                client = held.enter_context(socket.socket(socket.AF_UNIX))
                client.setblocking(False)
                with contextlib.suppress(BlockingIOError):
                    client.connect(driver.removeprefix("ipc://"))
            launch.wait_ticks(300)
        # Served late at the most, by the same process.
        assert launch.pid("driver") == pid
        # Now there is no more to be had.
        resource.prlimit(pid, resource.RLIMIT_NOFILE, (number, number))
        launch.finish(code=1)
        assert (
            f"[driver] descriptors: of {number} descriptors, the limit (ulimit -n), too few are"
            " left" in launch.errors
        )
        assert "SIGABRT" not in launch.errors
        # It ended in order: force down to zero, device closed.
        assert launch.figures["safety"]["soft_stop_ticks"] > 0


@pytest.mark.process
@pytest.mark.smoke
def test_a_flooded_node_without_a_launcher_ends_by_its_lease(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Strangers occupy every connection; the lease runs on the node's own clock."""
    monkeypatch.setenv("HAPTIC_KEYS", str(tmp_path / "keys"))
    me = keys.new_identity()
    port = free_ports(2)
    context = new_context()
    with private_runtime_dir() as runtime, open(tmp_path / "err", "wb") as errors:
        words = [*HAPTIC, "node", "start", "environment", "--bind", f"127.0.0.1:{port}"]
        node = subprocess.Popen(
            ["sh", "-c", "ulimit -n 256; exec \"$@\"", "sh", *words],
            env={**os.environ, "HAPTIC_RUNTIME_DIR": str(runtime)}, cwd=tmp_path, stderr=errors,
        )  # fmt: skip
        try:
            publish, control = (
                f"tcp://127.0.0.1:{port + i}#{me.public}" for i in (0, 1)
            )
            setup = setup_of(
                run="r-1",
                name="environment",
                kind="environment",
                publish=publish,
                control=control,
                lease=2.0,
                sources={
                    "/device/state": f"tcp://127.0.0.1:{free_ports(1)}#{me.public}"
                },
                by_hand=True,
                patience=1.0,
            )
            wait_for(
                lambda: b"waiting for its launcher" in (tmp_path / "err").read_bytes(),
                "the node waits",
            )
            call(
                context,
                control,
                "configure",
                timeout=DEADLINE,
                setup=msgspec.to_builtins(setup),
            )
            clients: list[socket.socket] = []

            def keep_coming() -> bool:
                for place in (publish, control):
                    client = socket.socket()
                    client.setblocking(False)
                    clients.append(client)
                    with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
                        client.connect(
                            ("127.0.0.1", int(split(place)[0].rpartition(":")[2]))
                        )
                return node.poll() is not None

            wait_for(keep_coming, "the node ends by its lease")
            for client in clients:
                client.close()
            # By its lease, or because so many took the last of its descriptors: in order both
            # times.
            assert node.returncode in (0, 1)
            assert "launcher lost: no request for 2 s" in (tmp_path / "err").read_text()
        finally:
            node.kill()
            node.wait()
            context.term()
