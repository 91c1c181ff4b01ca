"""Faults from outside: on a node's port, with a revoked key, with too many connections.

An unruly subscriber speaks ZMTP 3.0 (RFC 23) on a bare socket, so that it can leave in the middle
of anything: thousands of subscriptions, heartbeats after them, oversized frames. The reaction of
libzmq depends on where the data is cut; a few hundred connections meet every case.
"""

import contextlib
import os
import random
import resource
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from unittest import mock

from messages.transport import keys
from messages.transport.endpoints import MAX_MESSAGE
from sim.drill.drill import Fault, await_strike, fault_of, with_link
from sim.measure.free_ports import free_ports
from sim.measure.haptic_commands import MeasurementError, wait_for, within
from sim.measure.rig import Rig

HELD = 1.0  # duration of an intrusion [s]
FEW = 256  # initial descriptor limit of the flooded launch
# Number of visits of an unruly subscriber, and the pause between them [s].
VISITS, PAUSE = 200, 0.02


def _keys_of(folder: Path) -> contextlib.AbstractContextManager[object]:
    """Use the keys of another machine within the block."""
    return mock.patch.dict(os.environ, HAPTIC_KEYS=str(folder))


class _Elsewhere:
    """A coupling as on another machine: started by hand, over tcp, with its own keys."""

    def __init__(self) -> None:
        self.folder = Path()
        self._node: subprocess.Popen[bytes] | None = None

    def prepare(self) -> Mapping[str, str]:
        # Below /tmp, because socket paths are limited.
        self.folder = Path(tempfile.mkdtemp(prefix="hk-", dir=Path("/tmp")))  # noqa: S108
        # The second port is for its requests.
        self.port = free_ports(2)
        made = {}
        for name in ("near", "far"):
            with _keys_of(self.folder / name):
                made[name] = keys.new_identity().public
        for name, other, called in (
            ("near", "far", "robot"),
            ("far", "near", "launcher"),
        ):
            with _keys_of(self.folder / name):
                keys.allow(called, made[other])
        self.start()
        return {"HAPTIC_KEYS": str(self.folder / "near")}

    def start(self) -> None:
        (self.folder / "r").mkdir(mode=0o700, exist_ok=True)
        self._node = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "nodes.cli.command",
                "node",
                "start",
                "coupling",
                "--bind",
                f"127.0.0.1:{self.port}",
            ],
            env={
                **os.environ,
                "HAPTIC_KEYS": str(self.folder / "far"),
                "HAPTIC_RUNTIME_DIR": str(self.folder / "r"),
            },
            cwd=self.folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def change(self, content: dict[str, Any]) -> None:
        content["nodes"]["coupling"] |= {
            "host": "127.0.0.1",
            "port": self.port,
            "key": "robot",
            "respawn_delay": 0.0,
        }
        content["run"]["port"] = free_ports(len(content["nodes"]) * 2)

    def replace(self, rig: Rig) -> None:
        """Kill it, run another service at its port for a while, and restart it."""
        assert self._node is not None  # noqa: S101  # prepare() came first
        self._node.kill()
        self._node.wait()
        impostor = socket.create_server(("127.0.0.1", self.port))
        held: list[socket.socket] = []

        def serve() -> None:
            with contextlib.suppress(OSError):
                while True:
                    held.append(impostor.accept()[0])
                    held[-1].sendall(b"HTTP/1.1 200 OK\r\n\r\n" * 20)

        threading.Thread(target=serve, daemon=True).start()
        rig.let_pass(HELD)
        came = within(lambda: held, 5.0)
        impostor.shutdown(socket.SHUT_RDWR)
        impostor.close()
        for one in held:
            one.close()
        self.start()
        await_strike(lambda: came, "anybody at the impostor's port", 0.0)

    def revoke(self, rig: Rig) -> None:
        """Revoke its key; allow it again after its lease ended it, and restart it."""
        assert self._node is not None  # noqa: S101
        with _keys_of(self.folder / "near"):
            robot = keys.key_of("robot")
            keys.revoke("robot")
            if not within(lambda: rig.states[-1].safety == "zero", 5.0):
                raise MeasurementError(
                    "a coupling whose key was revoked still commands force after 5 s"
                )
            wait_for(
                lambda: self._node is not None and self._node.poll() is not None,
                "the end of the coupling by its lease",
                20.0,
            )
            keys.allow("robot", robot)
        self.start()

    def tidy(self) -> None:
        if self._node is not None:
            # It ends with its launcher.
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._node.wait(10.0)
            self._node.kill()
            self._node.wait()
        shutil.rmtree(self.folder, ignore_errors=True)


def _send_oversize(rig: Rig) -> None:
    rig.call("link", "param.set", values={"oversize": MAX_MESSAGE + 1})
    await_strike(lambda: rig.states[-1].safety == "zero", "a link that breaks")
    rig.call("link", "param.set", values={"oversize": 0})


class _FewDescriptors:
    """A launch from a shell with a low soft limit of open files; nodes raise it themselves."""

    def prepare(self) -> Mapping[str, str]:
        self._limits = resource.getrlimit(resource.RLIMIT_NOFILE)
        resource.setrlimit(resource.RLIMIT_NOFILE, (FEW, self._limits[1]))
        return {}

    def strike(self, rig: Rig) -> None:
        """Connect to every socket of the driver more often than the limit."""
        resource.setrlimit(resource.RLIMIT_NOFILE, (self._limits[1],) * 2)
        driver = rig.pid("driver")
        setup = rig.run.nodes["driver"]
        clients: list[socket.socket] = []
        until = time.monotonic() + HELD
        while time.monotonic() < until and len(clients) < 4 * FEW:
            for place in (setup.control, setup.publish, setup.listen):
                # The kernel refuses if the queue is full; an ended process is noticed later.
                with contextlib.suppress(OSError):
                    clients.append(connect(place))
        for client in clients:
            client.close()
        await_strike(lambda: len(clients) > FEW, f"more than {FEW} connections", 0.0)
        _expect_the_same(rig, {"driver": driver})

    def tidy(self) -> None:
        resource.setrlimit(resource.RLIMIT_NOFILE, self._limits)


def _expect_the_same(rig: Rig, before: Mapping[str, int]) -> None:
    for node, process in before.items():
        if rig.pid(node) != process:
            raise MeasurementError(f"{node} did not survive the misuse of its sockets")


def _let_listen(content: dict[str, Any]) -> None:
    with contextlib.ExitStack() as held:
        for node in ("driver", "environment", "coupling"):
            port = held.enter_context(socket.create_server(("127.0.0.1", 0)))
            content["nodes"][node]["open_port"] = int(port.getsockname()[1])


def _visit_all(rig: Rig) -> None:
    """Misbehave at every socket of every node; no node of the loop may end."""
    before = {node: rig.pid(node) for node in ("driver", "environment", "coupling")}
    chance = random.Random(1)  # noqa: S311  # misbehaviour, not secrets
    ports = rig.run.nodes["forwarder"].parameters["ports"]
    let_in = 0
    for number in range(VISITS):
        node = list(before)[number % len(before)]
        setup = rig.run.nodes[node]
        let_in += visit(f"tcp://127.0.0.1:{ports[node]}", chance)
        # Private sockets one at a time: only the same user reaches them, and every subscription
        # costs the loop a microsecond.
        place = (setup.publish, setup.listen, setup.control)[number // len(before) % 3]
        let_in += visit(place, chance, requests=place == setup.control)
        rig.let_pass(PAUSE)
    await_strike(lambda: let_in > VISITS, "most of the listeners let in", 0.0)
    _expect_the_same(rig, before)


def faults() -> list[Fault]:
    """Return the faults from outside."""
    impostor, revoked, few = _Elsewhere(), _Elsewhere(), _FewDescriptors()
    size = MAX_MESSAGE >> 20
    visits = 2 * VISITS

    return [
        Fault(
            "oversize message",
            f"one force of more than {size} MiB",
            _send_oversize,
            change=with_link,
        ),
        fault_of(
            impostor,
            "impostor",
            "coupling over tcp killed, a web server on its port",
            impostor.replace,
        ),
        fault_of(
            revoked,
            "revoked key",
            "of a coupling over tcp, allowed again later",
            revoked.revoke,
        ),
        fault_of(few, "fd exhaustion", f"{4 * FEW} connections, {FEW} descriptors"),
        Fault(
            "unruly listeners",
            f"{visits} that subscribe 3000 times and leave",
            _visit_all,
            change=_let_listen,
        ),
    ]


GREETING = b"\xff" + bytes(8) + b"\x7f\x03\x01NULL" + bytes(16) + b"\0" + bytes(31)


def _command(name: bytes, body: bytes) -> bytes:
    content = bytes([len(name)]) + name + body
    return bytes([4, len(content)]) + content


PING = _command(b"PING", b"\0\x01abc")
# Enough in a row to fill a queue of a few dozen, then a heartbeat, both within one read of 8 KiB.
SUBSCRIPTIONS = b"".join(
    b"\0\x05\x01%04d" % i + PING * (i % 50 == 49) for i in range(3000)
)
REQUESTS = ((b"\x01\0" + b"\0\x05hello") * 20 + PING) * 50
LONG_FRAME = b"\x02" + struct.pack(">Q", 100_000) + bytes(100_000)


def connect(place: str) -> socket.socket:
    """Connect a bare socket to a ZeroMQ endpoint."""
    bare = place.partition("#")[0]
    if bare.startswith("ipc://"):
        made = socket.socket(socket.AF_UNIX)
        made.settimeout(1.0)
        try:
            made.connect(bare.removeprefix("ipc://"))
        except OSError:
            made.close()
            raise
        return made
    host, _, port = bare.removeprefix("tcp://").rpartition(":")
    return socket.create_connection((host.strip("[]"), int(port)), 1.0)


def visit(place: str, chance: random.Random, requests: bool = False) -> bool:
    """Connect, misbehave and leave; return whether the connection was accepted."""
    try:
        found = connect(place)
    except OSError:
        return False
    kind = b"DEALER" if requests else b"SUB"
    content = REQUESTS if requests else SUBSCRIPTIONS
    found.settimeout(0.5)
    # The peer may disconnect it before it has sent everything.
    with contextlib.suppress(OSError), found:
        found.sendall(
            GREETING
            + _command(
                b"READY", b"\x0bSocket-Type" + struct.pack(">I", len(kind)) + kind
            )
        )
        found.sendall(
            content[: chance.randrange(1, len(content))]
            + LONG_FRAME * chance.randrange(2)
        )
        # With or without time for the peer to read.
        time.sleep(0.01 * chance.randrange(2))
        if chance.randrange(2):
            # Reset the connection instead of closing it.
            found.setsockopt(
                socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0)
            )
    return True
