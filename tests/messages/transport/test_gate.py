"""What the gate bounds: connections, descriptors, what peers send, and how long a revoked key is there."""

from __future__ import annotations

import contextlib
import os
import resource
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import zmq

from messages.transport import gate as gates
from messages.transport import keys
from messages.transport.audience import MOST_SUBSCRIPTIONS
from messages.transport.endpoints import bind, connect, split
from messages.transport.gate import Gate
from messages.transport.keys import Identity, KeyRefusedError
from messages.transport.sockets import Publisher, Subscription, new_context
from tests.support.launching import haptic, private_runtime_dir, wait_for
from tests.support.ports import free_ports
from tests.support.strangers import as_somebody_else

if TYPE_CHECKING:
    from messages.transport.endpoints import Context


class Guarded:
    """A publisher and a request socket behind a gate, as a node has them."""

    def __init__(self, context: Context, publish: str, control: str) -> None:
        self.denied: list[str] = []
        self.publish, self.control = publish, control
        self.publisher = Publisher(context, publish)
        self.reply = context.socket(zmq.REP)
        self.reply.rcvhwm = 4
        bind(self.reply, control)
        self.gate = Gate(context, self.denied.append, encrypted="#" in publish)
        self.publisher.watched_by(self.gate)
        self.gate.watch(self.reply, [control], answers=True)
        self.gate.start()

    def peers(self) -> int:
        """Count the connections of all sockets."""
        return sum(len(one.peers) for one in self.gate._watched)

    def close(self) -> None:
        """Close everything."""
        self.gate.stop()
        self.publisher.close(0)
        self.reply.close(linger=0)


@pytest.fixture
def guarded(context: Context, place: str) -> Iterator[Guarded]:
    made = Guarded(context, place, place + "c")
    yield made
    made.close()


def flood(place: str, count: int) -> list[socket.socket]:
    """Connect as often as asked and say nothing; what is not taken in waits or is refused by the kernel."""
    made = []
    for _ in range(count):
        client = socket.socket(socket.AF_UNIX if place.startswith("ipc://") else socket.AF_INET)
        client.setblocking(False)
        host, _, port = split(place)[0].removeprefix("tcp://").rpartition(":")
        # A process that is gone is seen by its exit code.
        with contextlib.suppress(BlockingIOError, ConnectionRefusedError):
            client.connect(place.removeprefix("ipc://") if place.startswith("ipc://") else (host, int(port)))
        made.append(client)
    return made


# -- how many ---------------------------------------------------------------------------------------------------------


def test_connections_are_bounded_before_they_cost_a_descriptor(
    guarded: Guarded, context: Context, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(gates, "MOST_PEERS", 8)
    honest = Subscription(context, [guarded.publish], ["/t"])
    wait_for(guarded.publisher.listeners, "the honest listener")
    before = len(os.listdir("/proc/self/fd"))
    clients = flood(guarded.publish, 60)
    wait_for(lambda: any("8 connections to" in told for told in guarded.denied), "the limit is told")
    most = 0
    for _ in range(50):
        most = max(most, len(os.listdir("/proc/self/fd")) - before - len(clients))
        guarded.publisher.send(b"/t", b"x")
        assert honest.receive(1000) == (b"/t", b"x")
    assert most <= 8
    for client in clients:
        client.close()
    late = Subscription(context, [guarded.publish], ["/t"])
    wait_for(lambda: guarded.publisher.listeners() == 2, "there is room again")
    for listener in (honest, late):
        listener.close()


FLOODED = """
import resource, sys, time
resource.setrlimit(resource.RLIMIT_NOFILE, (200, 200))
import zmq
from messages.transport.endpoints import bind
from messages.transport.gate import Gate
from messages.transport.sockets import Publisher, new_context
context = new_context()
publisher = Publisher(context, sys.argv[1])
reply = context.socket(zmq.REP)
bind(reply, sys.argv[2])
gate = Gate(context, lambda text: print(text, file=sys.stderr, flush=True), encrypted=False)
publisher.watched_by(gate)
gate.watch(reply, [sys.argv[2]], answers=True)
gate.start()
print("ready", flush=True)
reply.recv()
open("/dev/null").close()
reply.send(b"alive")
gate.stop()
publisher.close(0)
reply.close(linger=500)
context.term()
print("ended", flush=True)
"""


def test_a_flood_of_connections_does_not_end_a_process_with_few_descriptors(context: Context, place: str) -> None:
    """Without the gate ZeroMQ aborts at the 200th: ``Too many open files (src/ipc_listener.cpp)``."""
    process = subprocess.Popen(
        [sys.executable, "-c", FLOODED, place, place + "c"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        with context.socket(zmq.REQ) as asking:
            connect(asking, place + "c")
            # What is there before a flood stays; what comes during one may have to wait.
            clients = flood(place, 400)
            clients += flood(place + "c", 400)
            asking.send(b"alive?")
            assert not process.poll()
            for client in clients:
                client.close()
            assert asking.poll(20_000)
        assert process.stdout.readline() == "ended\n"
        assert process.wait(20.0) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close() if process.stdout else None


def test_a_door_is_found_whatever_the_machine_is_called(context: Context, me: Identity) -> None:
    port = free_ports(2)
    door = Guarded(context, f"tcp://localhost:{port}#{me.public}", f"tcp://127.0.0.1:{port + 1}#{me.public}")
    wait_for(lambda: all(one.doors for one in door.gate._watched), "both doors")
    listener = Subscription(context, [door.publish], [""])
    wait_for(door.publisher.listeners, "the listener")
    listener.close()
    door.close()


# -- how much ---------------------------------------------------------------------------------------------------------


def put_out(guarded: Guarded, reasons: list[str]) -> list[str]:
    reasons += guarded.publisher.tend()[0]
    return reasons


def test_a_listener_with_too_many_subscriptions_is_put_out(guarded: Guarded, context: Context) -> None:
    honest = Subscription(context, [guarded.publish], ["/t"])
    wait_for(guarded.publisher.listeners, "the honest listener")
    with context.socket(zmq.XSUB) as greedy:
        connect(greedy, guarded.publish)
        for i in range(MOST_SUBSCRIPTIONS):
            greedy.send(b"\x01/%d" % i)
        wait_for(lambda: guarded.publisher.listeners() == 1 + MOST_SUBSCRIPTIONS, "as many as are allowed")
        reasons: list[str] = []
        greedy.send(b"\x01/one more")
        wait_for(lambda: put_out(guarded, reasons), "one more is told")
        assert f"more than {MOST_SUBSCRIPTIONS} subscriptions" in reasons[0]
    wait_for(lambda: guarded.publisher.listeners() == 1, "only the honest one is left")
    guarded.publisher.send(b"/t", b"x")
    assert honest.receive(1000) == (b"/t", b"x")
    honest.close()


def test_a_listener_that_talks_is_put_out(guarded: Guarded, context: Context) -> None:
    with context.socket(zmq.XSUB) as talking:
        connect(talking, guarded.publish)
        talking.send(b"\x01/t")
        wait_for(guarded.publisher.listeners, "the listener")
        talking.send(b"a command")
        reasons: list[str] = []
        wait_for(lambda: put_out(guarded, reasons), "it is told")
        assert "sends messages of its own" in reasons[0]


def test_what_is_sent_upstream_does_not_stay(guarded: Guarded, context: Context) -> None:
    """A publisher takes in little between two messages, so that whoever sends much is stopped by its own full queue."""
    with context.socket(zmq.XSUB) as talking:
        talking.sndhwm = 1000
        talking.sndtimeo = 0
        connect(talking, guarded.publish)
        sent = 0
        for _ in range(500):
            with contextlib.suppress(zmq.Again):
                for _ in range(100):
                    talking.send(b"\x02" + bytes(500))
                    sent += 1
            # The loop publishes and does nothing else: nobody tends.
            guarded.publisher.send(b"/t", b"x")
            talking.poll(2)
    # 500 ticks of 16 each are 8000 at most, and what fits into sockets and queues.
    assert sent < 100_000


def test_a_request_without_an_end_is_ended(guarded: Guarded, context: Context, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gates, "MOST_GROWTH", 64 << 20)
    monkeypatch.setattr(gates, "REVIEW", 0.05)
    wait_for(lambda: guarded.gate._usual, "the gate has looked")
    with context.socket(zmq.DEALER) as endless:
        endless.sndhwm = 0
        endless.sndtimeo = 100
        connect(endless, guarded.control)
        wait_for(guarded.peers, "the connection")
        part = bytes(1 << 20)
        for _ in range(400):
            with contextlib.suppress(zmq.Again):
                endless.send(part, zmq.SNDMORE)
            if any("memory grew" in told for told in guarded.denied):
                break
            endless.poll(2)
        wait_for(lambda: any("memory grew" in told for told in guarded.denied), "it is ended and told")


# -- who --------------------------------------------------------------------------------------------------------------


@pytest.fixture
def encrypted(context: Context, me: Identity) -> Iterator[Guarded]:
    port = free_ports(2)
    made = Guarded(context, f"tcp://127.0.0.1:{port}#{me.public}", f"tcp://127.0.0.1:{port + 1}#{me.public}")
    yield made
    made.close()


def hears(guarded: Guarded, listener: Subscription, times: int = 50) -> bool:
    for _ in range(times):
        guarded.publisher.send(b"/t", b"x")
        if listener.receive(20) is not None:
            return True
    return False


def drain(listener: Subscription) -> None:
    while listener.receive(100) is not None:
        pass


def take_away(how: str, folder: Path) -> None:
    """Take the key of ``other`` away, in one of the ways in which people do."""
    allowed = folder / "allowed"
    path = allowed / "other.key"
    if how == "revoke":
        keys.revoke("other")
    elif how == "rm -rf":
        path.unlink()
        allowed.rmdir()
    elif how == "replace in place":
        # The directory's time does not change.
        path.write_text("ab" * 32 + "\n")
    elif how == "allow --replace":
        keys.allow("other", "ab" * 32, replace=True)
    elif how == "open to others":
        path.chmod(0o644)
    elif how == "garbage beside it":
        (allowed / "third.key").write_text("nonsense")
        (allowed / "third.key").chmod(0o600)


WAYS = ["revoke", "rm -rf", "replace in place", "allow --replace", "open to others", "garbage beside it"]


@pytest.mark.parametrize("how", WAYS)
def test_a_key_that_is_taken_away_ends_connections_and_lets_in_nobody(
    encrypted: Guarded, context: Context, tmp_path: Path, how: str
) -> None:
    with as_somebody_else(tmp_path / "other") as other:
        pass
    keys.allow("other", other.public)
    with as_somebody_else(tmp_path / "other"):
        listener = Subscription(context, [encrypted.publish], [""])
        asking = context.socket(zmq.REQ)
        connect(asking, encrypted.control)
    wait_for(lambda: hears(encrypted, listener), "the allowed machine hears")
    asking.send(b"before")
    assert encrypted.reply.poll(20_000)
    encrypted.reply.recv()
    encrypted.reply.send(b"done")
    assert asking.poll(20_000)
    asking.recv()
    take_away(how, keys.key_dir())
    wait_for(
        lambda: any(f"the key {other.public} is not allowed any more" in told for told in encrypted.denied),
        "it is told",
    )
    wait_for(lambda: not encrypted.peers(), "nobody is connected")
    drain(listener)
    assert not hears(encrypted, listener)
    with contextlib.suppress(zmq.Again):
        asking.send(b"after", zmq.NOBLOCK)
    assert not encrypted.reply.poll(300), "the open connection commands nothing any more"
    asking.close(linger=0)
    listener.close()
    # Oneself is still let in.
    own = Subscription(context, [encrypted.publish], [""])
    wait_for(lambda: hears(encrypted, own), "oneself")
    own.close()


def test_the_other_machines_connections_survive_a_revocation(
    encrypted: Guarded, context: Context, tmp_path: Path
) -> None:
    """All are on one address here, the hardest case: they stumble, and are let in again."""
    with as_somebody_else(tmp_path / "other") as other:
        pass
    keys.allow("other", other.public)
    own = Subscription(context, [encrypted.publish], [""])
    with as_somebody_else(tmp_path / "other"):
        listener = Subscription(context, [encrypted.publish], [""])
    wait_for(lambda: hears(encrypted, listener), "the other machine")
    keys.revoke("other")
    wait_for(lambda: encrypted.denied, "the revocation")
    drain(own)
    wait_for(lambda: hears(encrypted, own), "oneself, connected again without being asked")
    own.close()
    listener.close()


def test_without_an_identity_nobody_is_oneself(encrypted: Guarded, context: Context) -> None:
    own = Subscription(context, [encrypted.publish], [""])
    wait_for(lambda: hears(encrypted, own), "oneself")
    keys.new_identity(replace=True)
    wait_for(lambda: not encrypted.peers(), "who has the old key only is put out")
    drain(own)
    assert not hears(encrypted, own)
    own.close()


def test_revoke_on_the_command_line(tmp_path: Path, me: Identity) -> None:
    keys.allow("robot", me.public)
    environment = {**os.environ}
    told = haptic(tmp_path, "keys", "revoke", "robbie", code=2, environment=environment).stderr
    assert "there is: robot" in told
    assert "no more" in haptic(tmp_path, "keys", "revoke", "robot", environment=environment).stdout
    assert keys.allowed() == {}
    with pytest.raises(KeyRefusedError, match="none"):
        keys.revoke("../identity")
    assert keys.identity() == me


def test_limits_leave_descriptors_to_the_process() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    context = new_context()
    gate = Gate(context, list[str]().append, encrypted=False)
    with private_runtime_dir() as folder:
        sockets = []
        for i in range(3):
            sockets.append(context.socket(zmq.REP))
            bind(sockets[-1], f"ipc://{folder}/{i}")
            gate.watch(sockets[-1], [f"ipc://{folder}/{i}"])
        try:
            for few, each in ((1024, 128), (384, 96), (300, 68), (100, 8)):
                resource.setrlimit(resource.RLIMIT_NOFILE, (few, hard))
                assert gate._limit == each
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))
        gate.stop()
        for one in sockets:
            one.close(linger=0)
    context.term()
