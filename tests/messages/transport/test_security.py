"""Access: keys in private files, encrypted endpoints, everybody else refused and counted."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import stat
import subprocess
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
import zmq

from messages import topics
from messages.codec import encode
from messages.transport import keys
from messages.transport.context import new_context
from messages.transport.endpoints import bind, connect, split
from messages.transport.gate import Gate
from messages.transport.keys import Identity, KeyRefusedError
from messages.transport.links import Links
from messages.transport.requests import ControlError, call
from messages.transport.sockets import Publisher, Subscription
from messages.types import Force
from sim.measure.free_ports import free_ports
from tests.support.launching import (
    DEADLINE,
    HAPTIC,
    haptic,
    running,
    typed_in,
    wait_for,
)
from tests.support.strangers import as_somebody_else

if TYPE_CHECKING:
    from messages.transport.endpoints import Context

SCENE = """\
summary: A coupling behind an encrypted endpoint, on loopback
run: {{rate: 250.0, duration: 0.0, port: {base}}}
nodes:
  driver: {{kind: sim_driver, parameters: {{device: {{mass: 0.1, damping: 1.0, gravity: 9.81,
    position: 0.001}}}}}}
  environment: {{kind: environment, parameters: {{surface: {{kind: plane, axis: z, position: 0.0,
    normal: 1}}}}}}
  coupling:
    kind: coupling
    host: 127.0.0.1
    key: robot
    port: {port}
    parameters: {{law: pd, laws: {{pd: {{kind: pd, stiffness: 1000.0, damping: 3.0}}}}}}
"""


# -- files
# --------------------------------------------------------------------------------------------------


def test_key_files_are_private_whatever_the_umask(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HAPTIC_KEYS", str(tmp_path / "keys"))
    before = os.umask(0)
    try:
        made = keys.new_identity()
        keys.allow("robot", made.public)
    finally:
        os.umask(before)
    for path in (tmp_path / "keys").rglob("*"):
        assert stat.S_IMODE(path.stat().st_mode) == (
            0o700 if path.is_dir() else 0o600
        ), path
    assert keys.identity() == made
    assert keys.allowed() == {"robot": made.public}


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660, 0o777])
def test_key_files_open_to_others_are_refused(me: Identity, mode: int) -> None:
    (keys.key_dir() / "identity.key").chmod(mode)
    with pytest.raises(KeyRefusedError, match="0600"):
        keys.identity()


def test_links_damage_and_strangers_are_refused(me: Identity, tmp_path: Path) -> None:
    path = keys.key_dir() / "identity.key"
    elsewhere = tmp_path / "elsewhere"
    path.rename(elsewhere)
    path.symlink_to(elsewhere)
    with pytest.raises(KeyRefusedError, match=r"identity\.key"):
        keys.identity()
    path.unlink()
    with pytest.raises(KeyRefusedError, match="haptic keys new"):
        keys.identity()
    for text in (
        "",
        "x",
        f"{me.public}\n",
        f"{me.public}\n{me.public}\n",
        f"{me.secret} {me.public}",
        "\xff" * 40,
    ):
        path.unlink(missing_ok=True)
        path.write_text(text, encoding="latin-1")
        path.chmod(0o600)
        with pytest.raises(KeyRefusedError, match="haptic keys new"):
            keys.identity()


def test_nothing_is_replaced_unasked(me: Identity) -> None:
    with pytest.raises(KeyRefusedError, match="--replace"):
        keys.new_identity()
    assert keys.identity() == me
    assert keys.new_identity(replace=True) != me
    keys.allow("a", me.public)
    with pytest.raises(KeyRefusedError, match="--replace"):
        keys.allow("a", me.secret)
    assert keys.key_of("a") == me.public


@pytest.mark.parametrize(
    "name", ["", "../x", "a/b", ".hidden", "x" * 64, "a b", "-x", "x\n"]
)
def test_names_that_are_paths_are_refused(me: Identity, name: str) -> None:
    with pytest.raises(KeyRefusedError, match="name"):
        keys.allow(name, me.public)


@pytest.mark.parametrize(
    "key", ["", "00", "g" * 64, "0" * 63, "0" * 65, "\x00" * 40, "#" * 40]
)
def test_what_is_no_key_is_refused(me: Identity, key: str) -> None:
    with pytest.raises(KeyRefusedError):
        keys.allow("robot", key)
    assert keys.allowed() == {}


def test_keys_on_the_command_line(tmp_path: Path) -> None:
    environment = {**os.environ, "HAPTIC_KEYS": str(tmp_path / "k")}
    assert (
        "haptic keys new"
        in typed_in(tmp_path, "keys", "list", environment=environment).stdout
    )
    public = typed_in(tmp_path, "keys", "new", environment=environment).stdout.split()[
        0
    ]
    typed_in(tmp_path, "keys", "allow", "10.0.0.2", public, environment=environment)
    assert (
        f"10.0.0.2      {public}"
        in typed_in(tmp_path, "keys", "list", environment=environment).stdout
    )
    assert (
        "--replace"
        in typed_in(tmp_path, "keys", "new", code=2, environment=environment).stderr
    )
    assert (
        "name"
        in typed_in(
            tmp_path, "keys", "allow", "../x", public, code=2, environment=environment
        ).stderr
    )


# -- sockets
# --------------------------------------------------------------------------------------------------


class Door:
    """An encrypted publisher and request socket behind a gate, as in a node."""

    def __init__(self, context: Context, me: Identity) -> None:
        self.denied: list[str] = []
        port = free_ports(2)
        self.endpoint = f"tcp://127.0.0.1:{port}#{me.public}"
        self.control = f"tcp://127.0.0.1:{port + 1}#{me.public}"
        self.gate = Gate(context, self.denied.append)
        self.publisher = Publisher(context, self.endpoint)
        self.reply = context.socket(zmq.REP)
        bind(self.reply, self.control)
        self.publisher.watched_by(self.gate)
        self.gate.watch(self.reply)
        self.gate.start()

    def close(self) -> None:
        """Stop and close everything."""
        self.gate.stop()
        self.publisher.close(0)
        self.reply.close(linger=0)


@pytest.fixture
def door(context: Context, me: Identity) -> Iterator[Door]:
    made = Door(context, me)
    yield made
    made.close()


def hears(door: Door, subscription: Subscription) -> bool:
    """Whether a subscriber receives one of fifty messages."""
    for _ in range(50):
        door.publisher.send(b"/t", b"x")
        if subscription.receive(20) is not None:
            return True
    return False


@contextlib.contextmanager
def plainly_listening(context: Context, endpoint: str) -> Iterator[zmq.Socket[bytes]]:
    """Subscribe without a key, which this project's own sockets refuse."""
    with context.socket(zmq.SUB) as plain:
        plain.linger = 0
        plain.connect(split(endpoint)[0])
        plain.subscribe("")
        yield plain


def denied(door: Door, text: str) -> Callable[[], bool]:
    return lambda: any(text in reason for reason in door.denied)


def test_oneself_and_the_allowed_are_let_in(
    door: Door, context: Context, tmp_path: Path
) -> None:
    listener = Subscription(context, [door.endpoint], [""])
    wait_for(lambda: hears(door, listener), "oneself")
    listener.close()
    assert not door.denied


def test_an_unknown_key_hears_and_asks_nothing_until_it_is_allowed(
    door: Door, context: Context, tmp_path: Path
) -> None:
    with as_somebody_else(tmp_path / "other") as other:
        listener = Subscription(context, [door.endpoint], [""])
        wait_for(denied(door, other.public), "the refusal, with the key")
        keys.allow("door", split(door.control)[1])
        assert not hears(door, listener)
        with pytest.raises(ControlError, match="no answer"):
            call(context, door.control, "stop", timeout=0.3)
    assert not door.reply.poll(0), "no request came through"
    listener.close()
    keys.allow("other", other.public)
    with as_somebody_else(tmp_path / "other"):
        listener = Subscription(context, [door.endpoint], [""])
        wait_for(lambda: hears(door, listener), "the key that is allowed now")
        listener.close()


def test_a_plain_client_gets_nothing(door: Door, context: Context) -> None:
    with plainly_listening(context, door.endpoint) as plain:
        wait_for(denied(door, "without a valid handshake"), "the refusal")
        for _ in range(50):
            door.publisher.send(b"/t", b"x")
            assert not plain.poll(20)


@pytest.mark.parametrize(
    "garbage", [b"GET / HTTP/1.1\r\n\r\n", b"\xff" * 200, bytes(range(256))]
)
def test_bytes_that_are_no_handshake(
    door: Door, context: Context, garbage: bytes
) -> None:
    host, _, port = split(door.endpoint)[0].removeprefix("tcp://").rpartition(":")
    with socket.create_connection((host, int(port)), timeout=10.0) as stranger:
        stranger.sendall(garbage)
        stranger.settimeout(10.0)
        with contextlib.suppress(ConnectionError):
            while stranger.recv(4096):
                pass
    # The stranger was hung up on; who is let in still is.
    listener = Subscription(context, [door.endpoint], [""])
    wait_for(lambda: hears(door, listener), "oneself")
    listener.close()


def test_without_a_gate_nobody_is_let_in(context: Context, me: Identity) -> None:
    endpoint = f"tcp://127.0.0.1:{free_ports(1)}#{me.public}"
    publisher = Publisher(context, endpoint)
    listener = Subscription(context, [endpoint], [""])
    for _ in range(25):
        publisher.send(b"/t", b"x")
        assert listener.receive(20) is None
    assert publisher.listeners() == 0
    listener.close()
    publisher.close(0)


def test_a_forger_bound_in_a_nodes_place_is_not_heard(
    context: Context, me: Identity, tmp_path: Path
) -> None:
    """The driver expects the key `me` at an endpoint where another server answers."""
    port = free_ports(1)
    told: list[str] = []
    forgeries = new_context()
    with as_somebody_else(tmp_path / "forger") as forger:
        gate = Gate(forgeries, list[str]().append)
        keys.allow("victim", me.public)
        fake = Publisher(forgeries, f"tcp://127.0.0.1:{port}#{forger.public}")
        gate.start()
    links = Links(context, told.append, told.append)
    victim = Subscription(
        context, [f"tcp://127.0.0.1:{port}#{me.public}"], [topics.FORCE], links=links
    )
    payload = encode(Force(seq=1, stamp=0.0, force=(0.0, 0.0, 99.0)))

    def forged() -> bool:
        fake.send(topics.FORCE.encode(), payload)
        assert victim.receive(5) is None
        links.poll()
        links.maintain()
        return any("does not have the expected key" in reason for reason in told)

    wait_for(forged, "the report about the forger")
    links.close()
    victim.close()
    gate.stop()
    fake.close(0)
    forgeries.term()


class Replayer(threading.Thread):
    """A man in the middle that forwards and records the client's data, then replays it."""

    def __init__(self, target: int) -> None:
        super().__init__(daemon=True)
        self._target = target
        self._server = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._server.getsockname()[1])
        self.kept = bytearray()
        self.start()

    def run(self) -> None:
        """Forward one connection."""
        client, _ = self._server.accept()
        with client, socket.create_connection(("127.0.0.1", self._target)) as server:
            back = threading.Thread(
                target=self._pump, args=(server, client, None), daemon=True
            )
            back.start()
            self._pump(client, server, self.kept)

    @staticmethod
    def _pump(
        source: socket.socket, sink: socket.socket, keep: bytearray | None
    ) -> None:
        with contextlib.suppress(OSError):
            while data := source.recv(65536):
                if keep is not None:
                    keep += data
                sink.sendall(data)

    def replay(self) -> None:
        """Send every byte of the honest client again to the real server."""
        with socket.create_connection(
            ("127.0.0.1", self._target), timeout=10.0
        ) as again:
            again.sendall(bytes(self.kept))
            with contextlib.suppress(OSError):
                while again.recv(65536):
                    pass

    def close(self) -> None:
        """Stop listening."""
        self._server.close()


def test_a_replayed_request_is_not_heard(
    door: Door, context: Context, me: Identity
) -> None:
    wire = Replayer(int(split(door.control)[0].rpartition(":")[2]))
    asking = context.socket(zmq.REQ)
    connect(asking, f"tcp://127.0.0.1:{wire.port}#{me.public}")
    asking.send(b"the real request")
    assert door.reply.poll(20_000)
    assert door.reply.recv() == b"the real request"
    door.reply.send(b"done")
    assert asking.poll(20_000)
    wire.replay()
    wait_for(lambda: door.denied, "the replay is told")
    assert not door.reply.poll(100), "and commanded nothing"
    asking.close(linger=0)
    wire.close()


# -- a launch
# --------------------------------------------------------------------------------------------------


@pytest.mark.process
@pytest.mark.smoke
def test_a_launch_over_curve_turns_strangers_away_and_goes_on(
    tmp_path: Path, me: Identity
) -> None:
    port = free_ports(2)
    scene = tmp_path / "curve.yaml"
    scene.write_text(SCENE.format(port=port, base=free_ports(8)))
    keys.allow("robot", me.public)
    with running(tmp_path, str(scene), ready=False) as launch:
        command = [*HAPTIC, "node", "start", "coupling", "--bind", f"127.0.0.1:{port}"]
        with open(tmp_path / "node.txt", "wb") as errors:
            node = subprocess.Popen(
                command, env=launch.environment, cwd=tmp_path, stderr=errors
            )
        try:
            wait_for(lambda: launch.ticks() > 0, "the first tick")
            setup = launch.run.nodes["coupling"]
            stranger = new_context()
            with as_somebody_else(tmp_path / "stranger") as other:
                keys.allow("robot", me.public)
                spy = Subscription(stranger, [setup.publish], [""])
                with pytest.raises(ControlError, match="no answer"):
                    call(stranger, setup.control, "stop", timeout=0.3)
                with plainly_listening(stranger, setup.publish) as plain:
                    launch.wait_ticks(50)
                    assert spy.receive(0) is None
                    assert not plain.poll(0)
            spy.close()
            stranger.term()
            # As an allowed machine one sees what was counted and told.
            status = wait_for(lambda: launch.call("coupling", "status"), "the status")
            assert status["denied"] >= 2
            assert status["clock_error"] > 0.0
            figures = launch.finish(signal.SIGINT, code=None)
            assert figures["nodes"]["coupling"]["state"] == "finished"
            # Stale ones come of a busy machine; these would come of a stranger.
            assert {
                figures["safety"]["refused"][why]
                for why in ("future", "replayed", "not_finite")
            } == {0}
            assert node.wait(timeout=DEADLINE) == 0
            assert f"unknown key {other.public}" in (tmp_path / "node.txt").read_text()
        finally:
            if node.poll() is None:
                node.kill()
                node.wait()


def refused(folder: Path, text: str, environment: dict[str, Any]) -> str:
    scene = folder / "scene.yaml"
    scene.write_text(text)
    return typed_in(
        folder, "launch", str(scene), code=2, environment=environment
    ).stderr


def test_a_launch_abroad_without_keys_is_refused_with_what_to_do(
    tmp_path: Path,
) -> None:
    environment = {"HAPTIC_KEYS": str(tmp_path / "none")}
    text = SCENE.format(port=5900, base=5910)
    assert "haptic keys new" in refused(tmp_path, text, environment)
    abroad = text.replace("host: 127.0.0.1", "host: 10.9.8.7").replace(
        "    key: robot\n", ""
    )
    assert "haptic keys allow 10.9.8.7 KEY" in refused(tmp_path, abroad, environment)


@pytest.mark.process
def test_the_cost_of_curve_is_measured_in_one_run(tmp_path: Path) -> None:
    done = haptic(
        tmp_path, "bench", "curve", "--rounds", "2", "--ticks", "20", "--json"
    )
    found = json.loads(done.stdout.splitlines()[-1])
    assert found["ratio"] > 0.0
    assert len(found["ratio_of_rounds"]) == 2
    for kind in ("ipc", "curve"):
        assert (
            0.0 < found["response_us"][kind]["p50"] <= found["response_us"][kind]["p99"]
        )
