"""Peers cannot end a process, fill it, or stay when their key is revoked."""

from __future__ import annotations

import contextlib
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import zmq

from messages.transport import keys
from messages.transport.endpoints import bind, connect
from messages.transport.gate import Gate, Reopening, close_bound
from messages.transport.keys import Identity, KeyRefusedError
from messages.transport.open_port import OpenPort
from messages.transport.sockets import Publisher, Subscription
from sim.drill.intruders import visit
from sim.measure.free_ports import free_ports
from tests.support import slowly
from tests.support.launching import DEADLINE, typed_in, wait_for
from tests.support.strangers import as_somebody_else

if TYPE_CHECKING:
    from messages.transport.endpoints import Context


class Guarded:
    """A publisher and a request socket behind a gate, as in a node."""

    def __init__(self, context: Context, publish: str, control: str) -> None:
        self.denied: list[str] = []
        self.publish, self.control = publish, control
        self.gate = Gate(context, self.denied.append, self.evict)
        self.publisher = Publisher(context, publish)
        self.reply = context.socket(zmq.REP)
        bind(self.reply, control)
        self.reopening = Reopening(self.reply, [control])
        self.publisher.watched_by(self.gate)
        self.gate.watch(self.reply)
        self.gate.start()

    def evict(self) -> None:
        """Evict connections as nodes/base/process.py does."""
        self.publisher.evict()
        self.reopening.ask()

    def listeners(self) -> int:
        """Maintain both sockets as the node's threads do, and count subscribers."""
        self.reopening.maintain()
        return self.publisher.listeners()

    def close(self) -> None:
        """Close everything."""
        self.gate.stop()
        self.publisher.close(0)
        self.reply.close(linger=0)


# -- what nobody can end
# ------------------------------------------------------------------------------------------------

VISITED = """
import sys, threading, time
import zmq
from messages.transport.endpoints import bind
from messages.transport.open_port import OpenPort
from messages.transport.context import new_context
from messages.transport.sockets import Publisher
context = new_context(aside=True)
publisher = Publisher(context, sys.argv[1], listen=[sys.argv[2]])
port = OpenPort(context, sys.argv[3], print)
reply = context.socket(zmq.REP)
bind(reply, sys.argv[4])
threading.Thread(target=sys.stdin.read, daemon=True).start()
print("ready", flush=True)
for seq in range(1_000_000):
    # Time for a leaving subscriber's data to fill a queue, while the node is stalled.
    time.sleep(0.05)
    publisher.send(b"/t", b"x")
    publisher.maintain()
    port.send(b"/t", b"x")
    port.keep()
    try:
        if reply.recv(zmq.NOBLOCK) == b"alive?":
            reply.send(b"yes")
            break
        reply.send(b"no")
    except zmq.Again:
        pass
publisher.close(0)
port.close(0)
reply.close(linger=500)
context.term()
print("ended", flush=True)
"""


@pytest.mark.process
@pytest.mark.parametrize("which", ["hop", "listeners", "open port", "requests"])
def test_no_listener_however_unruly_ends_the_process(
    context: Context, place: str, which: str
) -> None:
    """ZeroMQ aborts on a heartbeat to a peer that left while its input was stopped."""
    places = {
        "hop": place,
        "listeners": place + "l",
        "open port": f"tcp://127.0.0.1:{free_ports(1)}",
        "requests": place + "c",
    }
    command = [sys.executable, "-c", VISITED, *places.values()]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "ready\n"
            chance = random.Random(22)  # noqa: S311  # misbehaviour, not secrets
            for _ in range(120):
                assert visit(places[which], chance, requests=which == "requests"), (
                    f"ended: {process.poll()}"
                )
            with context.socket(zmq.REQ) as asking:
                connect(asking, places["requests"])
                asking.send(b"alive?")
                assert asking.poll(20_000)
            assert process.stdout.readline() == "ended\n"
            assert process.wait(20.0) == 0
        finally:
            process.kill()


def test_an_endpoint_closed_and_bound_again_is_the_new_one_s(
    context: Context, place: str
) -> None:
    """Builds of libzmq that leave the file made the wait for its removal last 10 s."""
    for round_ in range(50):
        reply = context.socket(zmq.REP)
        bind(reply, place)
        with context.socket(zmq.REQ) as asking:
            asking.linger = 0
            connect(asking, place)
            asking.send(b"%d" % round_)
            assert reply.poll(int(1e3 * DEADLINE)), "nobody is heard there"
            assert reply.recv() == b"%d" % round_
            # Before the asking one leaves: it stays connected to a listener that has ended.
            assert close_bound(reply, place, time.monotonic() + DEADLINE)
        assert reply.closed


def test_a_socket_whose_endpoint_cannot_be_unbound_is_closed_all_the_same(
    context: Context, place: str
) -> None:
    reply = context.socket(zmq.REP)
    bind(reply, place)
    assert not close_bound(reply, f"{place}-another", time.monotonic() + DEADLINE)
    assert reply.closed


@pytest.mark.slow
def test_a_listener_that_fills_the_memory_of_an_open_port_is_put_out(
    context: Context, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("messages.transport.open_port.MAX_GROWTH", 16 << 20)
    monkeypatch.setattr("messages.transport.open_port._CHECK_INTERVAL", 0.05)
    told: list[str] = []
    port = OpenPort(context, place, told.append)
    port.keep()
    honest = context.socket(zmq.SUB)
    honest.connect(place)
    honest.subscribe("/t")
    with context.socket(zmq.SUB) as stalled:
        stalled.rcvhwm = 1
        stalled.connect(place)
        stalled.subscribe("/")
        wait_for(lambda: port.listeners() == 2, "both")

        def is_put_out() -> bool:
            for _ in range(100):
                port.send(b"/stalled", bytes(60_000))
            port.keep()
            return bool(told)

        wait_for(is_put_out, "its end")
    assert "all listeners there are disconnected" in told[0]

    def is_heard() -> bool:
        port.send(b"/t", b"x")
        return bool(honest.poll(20))

    wait_for(is_heard, "who only listens is back")
    honest.close(linger=0)
    port.close(0)


# -- who
# --------------------------------------------------------------------------------------------------


@pytest.fixture
def encrypted(context: Context, me: Identity) -> Iterator[Guarded]:
    port = free_ports(2)
    made = Guarded(
        context,
        f"tcp://127.0.0.1:{port}#{me.public}",
        f"tcp://127.0.0.1:{port + 1}#{me.public}",
    )
    yield made
    made.close()


def hears(guarded: Guarded, listener: Subscription, times: int = 50) -> bool:
    for _ in range(times):
        guarded.listeners()
        guarded.publisher.send(b"/t", b"x")
        if listener.receive(20) is not None:
            return True
    return False


def drain(listener: Subscription) -> None:
    while listener.receive(100) is not None:
        pass


def take_away(how: str, folder: Path) -> None:
    """Remove the key of ``other`` in one of the usual ways."""
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


WAYS = [
    "revoke",
    "rm -rf",
    "replace in place",
    "allow --replace",
    "open to others",
    "garbage beside it",
]


@pytest.mark.parametrize("how", slowly(WAYS, but=["revoke", "replace in place"]))
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
        lambda: any(
            f"the key {other.public} is no longer allowed" in told
            for told in encrypted.denied
        ),
        "it is told",
    )
    wait_for(lambda: not encrypted.listeners(), "nobody is connected")
    drain(listener)
    assert not hears(encrypted, listener)
    with contextlib.suppress(zmq.Again):
        asking.send(b"after", zmq.NOBLOCK)
    assert not encrypted.reply.poll(300), (
        "the open connection commands nothing any more"
    )
    asking.close(linger=0)
    listener.close()
    # Oneself is still let in.
    own = Subscription(context, [encrypted.publish], [""])
    wait_for(lambda: hears(encrypted, own), "oneself")
    own.close()


def test_the_other_machines_connections_survive_a_revocation(
    encrypted: Guarded, context: Context, tmp_path: Path
) -> None:
    """All share one address here, the hardest case: they reconnect."""
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
    wait_for(
        lambda: hears(encrypted, own), "oneself, connected again without being asked"
    )
    own.close()
    listener.close()


def test_without_an_identity_nobody_is_oneself(
    encrypted: Guarded, context: Context
) -> None:
    own = Subscription(context, [encrypted.publish], [""])
    wait_for(lambda: hears(encrypted, own), "oneself")
    keys.new_identity(replace=True)
    wait_for(lambda: not encrypted.listeners(), "who has the old key only is put out")
    drain(own)
    assert not hears(encrypted, own)
    own.close()


def test_revoke_on_the_command_line(tmp_path: Path, me: Identity) -> None:
    keys.allow("robot", me.public)
    told = typed_in(tmp_path, "keys", "revoke", "robbie", code=2).stderr
    assert "available: robot" in told
    assert "no longer allowed" in typed_in(tmp_path, "keys", "revoke", "robot").stdout
    assert keys.allowed() == {}
    with pytest.raises(KeyRefusedError, match="none"):
        keys.revoke("../identity")
    assert keys.identity() == me
