"""Sockets: nothing left open, waits exact to the microsecond, odd frame counts survived."""

from __future__ import annotations

import gc
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path
from types import FrameType
from typing import IO, TYPE_CHECKING, Any

import pytest
import zmq

from messages.transport.context import new_context
from messages.transport.endpoints import (
    EndpointRefusedError,
    bind,
    connect,
    is_open_place,
    is_remote,
    split,
)
from messages.transport.open_port import OpenPort
from messages.transport.sockets import Publisher, Subscription
from messages.transport.waker import Waker
from nodes.launcher.runs import RunError, new_run_dir, runtime_dir
from tests.support.launching import wait_for

if TYPE_CHECKING:
    from messages.transport.endpoints import Context

KEY = "ab" * 32


def connected(
    context: Context, place: str, *topics: str
) -> tuple[Publisher, Subscription]:
    publisher = Publisher(context, place)
    subscription = Subscription(context, [place], topics or [""])
    wait_for(publisher.listeners, "the subscription")
    return publisher, subscription


def open_files() -> int:
    return len(os.listdir("/proc/self/fd"))


def test_nothing_is_left_open(place: str) -> None:
    def once() -> None:
        context = new_context()
        publisher, subscription = connected(context, place)
        publisher.send(b"/t", b"x")
        assert subscription.receive(20_000) == (b"/t", b"x")
        subscription.close()
        publisher.close()
        context.term()

    once()
    before = open_files()
    for _ in range(5):
        once()
    assert open_files() == before
    assert not Path(place.removeprefix("ipc://")).exists()


@pytest.mark.filterwarnings("ignore:Unclosed socket:ResourceWarning")
def test_a_context_ends_whatever_line_of_a_socket_s_life_a_signal_interrupts() -> None:
    """A SIGTERM at start-up left a half-made socket, on which the context hung."""
    interrupted: list[BaseException] = []
    for line in range(1, 1000):
        left = line

        def interrupt(frame: FrameType, event: str, _: Any) -> Any:
            nonlocal left
            if frame.f_code.co_name == "__del__":
                return None  # what is raised there is lost, and nothing interrupted
            left -= event == "line"
            if event == "line" and left == 0:
                raise KeyboardInterrupt
            return interrupt

        context = new_context()
        gc.disable()  # what is raised in its callbacks (hypothesis has one) is lost, too
        sys.settrace(interrupt)
        try:
            context.socket(zmq.REQ).close()
        except KeyboardInterrupt as error:
            # What is on its way out holds its frames, and they what was half made.
            interrupted.append(error)
        finally:
            sys.settrace(None)
            gc.enable()
        end = threading.Thread(
            target=context.destroy, kwargs={"linger": 0}, daemon=True
        )
        end.start()
        end.join(20.0)
        assert context.closed
        if left > 0:
            break
    # Making and closing are more lines than that in any pyzmq (89 in 27.3).
    assert len(interrupted) > 10


@pytest.mark.parametrize("wait", [0.0, 0.0003, 0.0021, 0.0179])
def test_receive_until_waits_until_the_deadline_and_not_in_milliseconds(
    context: Context, place: str, wait: float
) -> None:
    publisher, subscription = connected(context, place)
    late = []
    for _ in range(30):
        deadline = time.monotonic() + wait
        assert subscription.receive_until(deadline) is None
        late.append(time.monotonic() - deadline)
    assert min(late) >= 0.0, "never before the deadline"
    # The best of thirty shows the resolution of the wait whatever else the machine does: whole
    # milliseconds, as ZeroMQ's own time-outs are, would be 0.1 to 0.9 ms late every time.
    assert min(late) < 0.0005
    publisher.send(b"/t", b"x")
    assert subscription.receive_until(time.monotonic() + 20.0) == (b"/t", b"x")
    assert subscription.receive_until(time.monotonic() - 1.0) is None
    subscription.close()
    publisher.close()


def test_receive_until_loses_no_wake_up(context: Context, place: str) -> None:
    """The descriptor is edge-triggered: a message between check and wait must still wake it."""
    publisher, subscription = connected(context, place)
    count = 2000

    def talk() -> None:
        for i in range(count):
            publisher.send(b"/t", str(i).encode())
            if i % 7 == 0:
                time.sleep(0.0001 * (i % 5))

    talker = threading.Thread(target=talk)
    talker.start()
    deadline = time.monotonic() + 30.0
    got = [subscription.receive_until(deadline) for _ in range(count)]
    talker.join()
    assert got == [(b"/t", str(i).encode()) for i in range(count)]
    subscription.close()
    publisher.close()


@pytest.mark.parametrize("frames", [1, 3, 4, 5, 9])
@pytest.mark.parametrize("until", [False, True])
def test_messages_of_another_number_of_frames(
    context: Context, place: str, frames: int, until: bool
) -> None:
    rogue = context.socket(zmq.XPUB)
    bind(rogue, place)
    subscription = Subscription(context, [place], [""])
    assert rogue.poll(20_000)
    good = (b"/good", b"payload")
    for _ in range(3):
        rogue.send_multipart([b"/t"] * frames)
        for _ in range(3):
            rogue.send_multipart(good)
    rogue.send_multipart((b"/end", b""))
    got = []
    while (b"/end", b"") not in got:
        found = (
            subscription.receive_until(time.monotonic() + 20.0)
            if until
            else subscription.receive(20_000)
        )
        assert found is not None
        got.append(found)
        if until and found != good:
            # As the nodes do when it is not the topic they expect or its payload is refused.
            subscription.resynchronise()
    # At most the message next to a wrong one is lost with it, and what comes after is in step
    # again.
    assert got.count(good) >= 3 * 2
    if not until:
        # A lone frame is told as no message.
        assert got.count((b"", b"")) == 3 * (frames % 2)
        assert got.count(good) == 3 * 3
    subscription.close()
    rogue.close(linger=0)


def test_a_listener_cannot_talk_back(context: Context, place: str) -> None:
    publisher, subscription = connected(context, place)
    with context.socket(zmq.XSUB) as mouth:
        connect(mouth, place)
        for word in (b"\x01real", b"\x02garbage", b"", b"\x00never subscribed"):
            mouth.send(word)
        # What it sent last came first or not at all: one connection keeps its order.
        wait_for(
            lambda: publisher.listeners() == 2, "its subscription, and nothing else"
        )
    wait_for(lambda: publisher.listeners() == 1, "its end")
    publisher.send(b"/t", b"x")
    assert subscription.receive(20_000) == (b"/t", b"x")
    subscription.close()
    publisher.close()


PUBLISH = """
import sys
from messages.transport.context import new_context
from messages.transport.sockets import Publisher
publisher = Publisher(new_context(), sys.argv[1])
for line in sys.stdin:
    publisher.send(b"/t", line.strip().encode())
"""


@pytest.mark.process
@pytest.mark.smoke
def test_a_publisher_started_again_after_a_kill_is_heard_again(
    context: Context, place: str
) -> None:
    subscription = Subscription(context, [place], ["/t"])
    for life in ("first", "second", "third"):
        process = subprocess.Popen(
            [sys.executable, "-c", PUBLISH, place], stdin=subprocess.PIPE, text=True
        )

        def heard(to: IO[str] | None = process.stdin, life: str = life) -> bool:
            print(life, file=to, flush=True)
            return subscription.receive(20) == (b"/t", life.encode())

        try:
            wait_for(heard, life)
        finally:
            process.send_signal(signal.SIGKILL)
            process.communicate()
    subscription.close()


@pytest.mark.parametrize(
    "endpoint",
    [
        "tcp://10.0.0.2:5600",
        "tcp://*:5600",
        "tcp://0.0.0.0:5600",
        "tcp://eth0:5600",
        "tcp://[::]:5600",
        "tcp://host:1",
    ],
)
def test_tcp_off_loopback_needs_a_key(endpoint: str, context: Context) -> None:
    with pytest.raises(EndpointRefusedError, match="haptic keys new"):
        split(endpoint)
    with pytest.raises(EndpointRefusedError, match="haptic keys new"):
        Publisher(context, endpoint)
    with pytest.raises(EndpointRefusedError, match="haptic keys new"):
        Subscription(context, [endpoint], [""])
    assert is_remote(endpoint)
    assert split(f"{endpoint}#{KEY}") == (endpoint, KEY)


@pytest.mark.parametrize(
    "endpoint",
    [
        "tcp://127.0.0.1:5600",
        "tcp://127.8.9.1:1",
        "tcp://[::1]:5600",
        "tcp://localhost:2",
    ],
)
def test_loopback_is_shared_by_all_users_and_needs_one_too(
    endpoint: str, context: Context
) -> None:
    for use in (
        split,
        lambda place: Publisher(context, place),
        lambda place: Subscription(context, [place], [""]),
    ):
        with pytest.raises(EndpointRefusedError, match="haptic keys new"):
            use(endpoint)
    assert split(f"{endpoint}#{KEY}") == (endpoint, KEY)
    assert not is_remote(endpoint)
    assert is_open_place(endpoint)
    assert not is_open_place(f"{endpoint}#{KEY}")


def test_what_is_opened_to_all_can_only_be_listened_to(context: Context) -> None:
    """For a display without ipc and CURVE, of any user of this machine."""
    with socket.create_server(("127.0.0.1", 0)) as found:
        port = found.getsockname()[1]
    opened = OpenPort(context, f"tcp://127.0.0.1:{port}", print)
    with context.socket(zmq.XSUB) as display:
        display.connect(f"tcp://127.0.0.1:{port}")
        display.send(b"\x01/t")
        wait_for(opened.listeners, "the subscription")
        display.send(b"a command")
        opened.send(b"/t", b"x")
        assert display.poll(20_000)
        assert display.recv_multipart() == [b"/t", b"x"]
    opened.close()
    with pytest.raises(EndpointRefusedError, match="haptic keys"):
        OpenPort(context, "tcp://10.0.0.2:5600", print)


@pytest.mark.parametrize(
    "endpoint",
    ["udp://127.0.0.1:1", "inproc://x", "nonsense", "tcp://127.0.0.1:5600#abc"],
)
def test_other_endpoints_are_refused(endpoint: str) -> None:
    with pytest.raises(ValueError, match=r"ipc://|key"):
        split(endpoint)


def test_a_taken_address_is_told(context: Context) -> None:
    first = context.socket(zmq.PUB)
    port = first.bind_to_random_port("tcp://127.0.0.1")
    with pytest.raises(EndpointRefusedError, match="cannot be bound"):
        OpenPort(context, f"tcp://127.0.0.1:{port}", print)
    first.close(linger=0)


def test_the_directory_of_the_sockets_is_private(
    place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(
        "HAPTIC_RUNTIME_DIR",
        str(Path(place.removeprefix("ipc://")).with_name("haptic")),
    )
    before = os.umask(0)
    try:
        assert runtime_dir().stat().st_mode & 0o777 == 0o700
        assert new_run_dir("r").stat().st_mode & 0o777 == 0o700
    finally:
        os.umask(before)
    with pytest.raises(RunError, match="already exists"):
        new_run_dir("r")


def test_a_hostile_directory_made_before_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trap = tmp_path / "trap"
    trap.mkdir(mode=0o700)
    (tmp_path / "link").symlink_to(trap)
    (tmp_path / "open").mkdir()
    (tmp_path / "open").chmod(0o750)
    for name in ("link", "open"):
        monkeypatch.setenv("HAPTIC_RUNTIME_DIR", str(tmp_path / name))
        with pytest.raises(RunError, match="0700"):
            runtime_dir()
    if os.getuid() == 0:
        os.chown(trap, 65534, 65534)
        monkeypatch.setenv("HAPTIC_RUNTIME_DIR", str(trap))
        with pytest.raises(RunError, match="must be a directory of user"):
            runtime_dir()


def test_a_wait_without_end_is_ended_from_another_thread_and_by_nobody_else(
    context: Context, place: str
) -> None:
    publisher, subscription = connected(context, place, "/t")
    waker = Waker(context, b"/t")
    subscription.woken_by(waker)
    subscription.set_timeout(-1)
    thread = threading.Thread(target=waker.wake)
    thread.start()
    assert subscription.next_frame() == waker.frame
    thread.join()
    # Waking is no message: neither for whoever takes whole ones, nor for those who count
    # subscriptions.
    waker.wake()
    assert subscription.receive(1000) is None
    assert publisher.listeners() == 1
    # What another process publishes under that name is a message on another topic like any other.
    publisher.send(waker.frame + b"!", b"payload")
    publisher.send(b"/t", b"after")
    assert subscription.receive(1000) == (waker.frame + b"!", b"payload")
    assert subscription.receive(1000) == (b"/t", b"after")
    subscription.close()
    waker.wake()
    publisher.close()
