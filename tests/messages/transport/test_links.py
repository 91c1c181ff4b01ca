"""Links that ZeroMQ gives up are reconnected, and reported with the reason."""

from __future__ import annotations

import contextlib
import os
import socket
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
import zmq

from messages.transport import keys
from messages.transport.context import new_context
from messages.transport.endpoints import MAX_MESSAGE
from messages.transport.gate import Gate
from messages.transport.keys import Identity
from messages.transport.links import Links
from messages.transport.sockets import Publisher, Subscription
from sim.measure.free_ports import free_ports
from tests.support.launching import wait_for

if TYPE_CHECKING:
    from messages.transport.endpoints import Context


class Ear:
    """A maintained subscription, as in a node."""

    def __init__(self, context: Context, endpoint: str) -> None:
        self.told: list[str] = []
        self.denied: list[str] = []
        self.links = Links(context, self.told.append, self.denied.append)
        self.inbox = Subscription(context, [endpoint], ["/t"], links=self.links)

    def hears(self, publisher: Publisher, payload: bytes = b"x") -> Callable[[], bool]:
        """Whether published messages arrive."""

        def look() -> bool:
            publisher.send(b"/t", payload)
            self.maintain()
            return self.inbox.receive(20) == (b"/t", payload)

        return look

    def maintain(self, heard: int | None = None) -> None:
        """Do the work of a node's two threads."""
        self.links.poll(heard)
        self.links.maintain()

    def tended(self, found: object, heard: int | None = None) -> object:
        """Report what was found so far, and check again."""
        self.maintain(heard)
        return found

    def close(self) -> None:
        """Close everything."""
        self.links.close()
        self.inbox.close()


@pytest.mark.parametrize("size", [MAX_MESSAGE, MAX_MESSAGE + 1])
def test_a_message_above_the_limit_costs_a_connection_but_not_the_link(
    context: Context, place: str, size: int
) -> None:
    publisher, ear = Publisher(context, place), Ear(context, place)
    wait_for(ear.hears(publisher), "the publisher")
    publisher.send(b"/t", bytes(size))
    wait_for(ear.hears(publisher, b"after"), "what comes after the long one")
    # Just inside the limit it is a message like any other.
    assert bool(ear.told) == (size > MAX_MESSAGE)
    assert all(f"exceeded {MAX_MESSAGE} bytes" in told for told in ear.told)
    ear.close()
    publisher.close(0)


def test_a_publisher_respawned_after_a_message_above_the_limit_is_heard(
    context: Context, place: str
) -> None:
    publisher, ear = Publisher(context, place), Ear(context, place)
    wait_for(ear.hears(publisher), "the publisher")
    publisher.send(b"/t", bytes(MAX_MESSAGE + 1))
    publisher.close(1000)
    publisher = Publisher(context, place)
    wait_for(ear.hears(publisher), "its successor")
    ear.close()
    publisher.close(0)


class Impostor:
    """A foreign service on a port."""

    def __init__(self, port: int, greeting: bytes) -> None:
        self._server = socket.create_server(("127.0.0.1", port))
        self._greeting = greeting
        self._held: list[socket.socket] = []
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                client, _ = self._server.accept()
            except OSError:
                return
            self._held.append(client)
            client.sendall(self._greeting)

    def close(self) -> None:
        """Free the port."""
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()
        for client in self._held:
            client.close()


@pytest.mark.parametrize(
    "greeting", [b"HTTP/1.1 200 OK\r\n\r\n" * 20, b"\xff" * 300, b"SSH-2.0-x\r\n"]
)
def test_another_service_on_the_port_before_the_node(
    context: Context, me: Identity, greeting: bytes
) -> None:
    port = free_ports(1)
    impostor = Impostor(port, greeting)
    endpoint = f"tcp://127.0.0.1:{port}#{me.public}"
    ear = Ear(context, endpoint)
    wait_for(lambda: ear.tended(ear.told + ear.denied), "why nothing comes")
    impostor.close()
    assert_heard(context, endpoint, ear)


def test_a_node_that_ends_in_the_middle_of_a_greeting_is_no_intruder(
    context: Context, place: str
) -> None:
    """`haptic stop` during a start was reported as an attack."""
    name = place.removeprefix("ipc://")
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(name)
        server.listen()
        ear = Ear(context, place)
        server.settimeout(0.05)
        gone = 0

        def ends() -> bool:
            nonlocal gone
            ear.maintain()
            with contextlib.suppress(TimeoutError):
                client, _ = server.accept()
                client.close()
                gone += 1
            return gone > 5

        wait_for(ends, "nodes that end when they are greeted")
    os.unlink(name)
    publisher = Publisher(context, place)
    wait_for(ear.hears(publisher), "the node that stays")
    assert not ear.denied
    ear.close()
    publisher.close(0)


def assert_heard(context: Context, endpoint: str, ear: Ear) -> None:
    gate = Gate(context, list[str]().append)
    publisher = Publisher(context, endpoint)
    publisher.watched_by(gate)
    gate.start()
    wait_for(ear.hears(publisher), "the true node")
    ear.close()
    gate.stop()
    publisher.close(0)


@pytest.mark.parametrize("curve", [False, True])
def test_a_publisher_without_the_key_in_place_of_a_killed_one(
    context: Context, me: Identity, curve: bool
) -> None:
    port = free_ports(1)
    endpoint = f"tcp://127.0.0.1:{port}#{me.public}"
    other = new_context()
    with other.socket(zmq.XPUB) as forger:
        if curve:
            forger.curve_server = True
            forger.curve_secretkey = zmq.curve_keypair()[1]
        forger.bind(f"tcp://127.0.0.1:{port}")
        ear = Ear(context, endpoint)
        wait_for(
            lambda: ear.tended(
                [one for one in ear.denied if "does not have the expected key" in one]
            ),
            "who it is not",
        )
        # Long enough for ZeroMQ to give it up.
        wait_for(
            lambda: ear.tended(ear.told or len(ear.denied) > 2), "it goes on trying"
        )
    other.term()
    assert_heard(context, endpoint, ear)


def test_silence_is_told_with_the_state_of_the_link(
    context: Context, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("messages.transport.links.CONNECTED_SILENCE", 0.1)
    publisher, ear = Publisher(context, place), Ear(context, place)
    wait_for(ear.hears(publisher), "the publisher")
    wait_for(lambda: ear.tended(ear.told, heard=7), "the silence")
    assert "no message for 0.1 s (connected)" in ear.told[0]
    told = len(ear.told)
    for heard in range(8, 40):
        ear.maintain(heard)
    assert len(ear.told) == told, "who hears is not silent"
    ear.close()
    publisher.close(0)


def test_who_is_connected_and_starved_is_waited_for(
    context: Context, place: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A starved peer was reconnected every 3 s, so the loop never met again."""
    monkeypatch.setattr("messages.transport.links.SILENCE", 0.02)
    publisher, ear = Publisher(context, place), Ear(context, place)
    wait_for(ear.hears(publisher), "the publisher")
    begun = time.monotonic()
    while time.monotonic() - begun < 0.2:
        ear.maintain(7)
        ear.inbox.receive(5)
    assert ear.told == []
    ear.close()
    publisher.close(0)


def test_a_revoked_key_is_not_listened_to_any_more(
    context: Context, me: Identity, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    port = free_ports(1)
    own = os.environ["HAPTIC_KEYS"]
    # The other machine: it lets this one in, and publishes.
    monkeypatch.setenv("HAPTIC_KEYS", str(tmp_path / "far"))
    far = keys.new_identity()
    keys.allow("near", me.public)
    there = new_context()
    endpoint = f"tcp://127.0.0.1:{port}#{far.public}"
    gate = Gate(there, list[str]().append)
    publisher = Publisher(there, endpoint)
    publisher.watched_by(gate)
    gate.start()
    monkeypatch.setenv("HAPTIC_KEYS", own)
    keys.allow("far", far.public)
    ear = Ear(context, endpoint)
    wait_for(ear.hears(publisher), "the allowed machine")
    keys.revoke("far")
    ear.maintain()
    assert "no longer allowed here" in ear.told[-1]
    while ear.inbox.receive(200) is not None:
        pass
    for _ in range(50):
        publisher.send(b"/t", b"a command")
        ear.maintain()
        assert ear.inbox.receive(10) is None
    ear.close()
    gate.stop()
    publisher.close(0)
    there.term()
