"""Emulator of Haply's Inverse Service: WebSocket server, HTTP, events, and one Inverse3.

As the vendor's service does: the first message is the complete inventory, then one state answers
each message; zeros are omitted from a state; a force expires soon after its message; forces of
other sessions are added. It serves the arm of a world file (sim/emulators/world.py) with its
faults. ``fail`` names ``state`` to omit it, ``session`` to end the session, ``twice`` to send each
state twice, ``nested`` to send JSON nested 50 000 deep, ``buttons`` to send 1500 of them:

    python -m sim.emulators.inverse_service WORLD [--cold SECONDS] [--version 3.1]
"""

import argparse
import json
import signal
import subprocess
import sys
import threading
import time
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final, NamedTuple

from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import Server, ServerConnection, serve

from sim.emulators.world import World

FORGETS: Final = 0.02  # time without a message after which the force is zero [s]
DEVICE: Final = "04BA"


def _vector(numbers: tuple[float, float, float]) -> dict[str, float]:
    """Return a vector as JSON; zeros are omitted."""
    return {
        name: value for name, value in zip("xyz", numbers, strict=True) if value != 0.0
    }


class Service:
    """The service; version ``3.1`` uses another name for forces than later versions."""

    def __init__(self, world: World, version: str) -> None:
        self._world, self._version = world, version
        world.state.watchdog = FORGETS
        world.state.forces = 1

    def _inventory(self) -> dict[str, Any]:
        device = {
            "device_id": DEVICE,
            "config": {"basis": {"permutation": "XYZ"}, "handedness": "right"},
            "status": {"power_supply": True},
            "state": self._state(),
        }
        connected = not self._world.state.unplugged
        return {"inverse3": [device] if connected else [], "session_id": 1}

    def _state(self) -> dict[str, Any] | None:
        """Return the state in the device's axes (right, forward, up), without identities."""
        read = self._world.read()
        if read is None:
            return None
        (x, y, z), (vx, vy, vz) = read
        fx, fy, fz = (
            a + b
            for a, b in zip(self._world.force(), self._world.state.other, strict=True)
        )
        state = {
            "cursor_position": _vector((-y, x, z)),
            "cursor_velocity": _vector((-vy, vx, vz)),
            "current_cursor_force": _vector((-fy, fx, fz)),
        }
        return {name: value for name, value in state.items() if value}

    def serve(self, connection: ServerConnection) -> None:
        """Serve one session."""
        world = self._world
        try:
            connection.send(json.dumps(self._inventory()))
            world.state.open += 1
            for message in connection:
                self._take(json.loads(message))
                if world.state.frozen:
                    # Running, but silent.
                    while world.state.frozen:
                        time.sleep(0.002)
                failing = world.state.fail if world.state.fails else b""
                if failing == b"session":
                    connection.close()
                    return
                state = None if failing == b"state" else self._state()
                device = {"device_id": DEVICE} | (
                    {} if state is None else {"state": state}
                )
                document: dict[str, Any] = {
                    "inverse3": [] if world.state.unplugged else [device]
                }
                if failing == b"nested":
                    connection.send('{"more": ' + "[" * 50_000 + "]" * 50_000 + "}")
                    continue
                if failing == b"buttons":
                    document["wireless_verse_grip"] = [
                        {"state": {"buttons": {f"{n:04}": True for n in range(1500)}}}
                    ]
                elif world.state.buttons:
                    document["wireless_verse_grip"] = [
                        {"state": {"buttons": {"a": bool(world.state.buttons & 1)}}}
                    ]
                if world.state.positive:
                    document |= {"something_new": [1, 2], "warning": "motor saturated"}
                for _ in range(2 if failing == b"twice" else 1):
                    connection.send(json.dumps(document))
        except ConnectionClosed:
            return
        finally:
            world.state.open -= 1

    def _take(self, said: dict[str, Any]) -> None:
        for device in said.get("inverse3", []):
            commands = device["commands"]
            if device["device_id"] != DEVICE:
                self._world.state.broken += 1
            if "set_cursor_force" in commands and not self._world.state.unplugged:
                name = "values" if self._version == "3.1" else "vector"
                force = commands["set_cursor_force"].get(name)
                if force is not None:
                    self._world.push((force["y"], -force["x"], force["z"]))

    def answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer an HTTP request; pass WebSocket requests on."""
        del connection
        if request.headers.get("Upgrade"):
            return None
        data: Any = {
            "/version": self._version,
            "/sessions": [],
            "/inverse3/0/config/basis": {"permutation": "XYZ"},
        }.get(request.path)
        body = json.dumps(
            {
                "ok": data is not None,
                "data": data,
                "error": None if data is not None else "unknown",
            }
        ).encode()
        return Response(
            HTTPStatus.OK, "OK", Headers({"Content-Length": str(len(body))}), body
        )

    def events(self, connection: ServerConnection) -> None:
        """Send an event for each change of the world's ``cause`` and ``unplugged``."""
        before = (0, 0)
        try:
            while True:
                now = (int(self._world.state.cause), int(self._world.state.unplugged))
                if now[0] != before[0]:
                    event = "ebrake_triggered" if now[0] else "ebrake_released"
                    connection.send(
                        json.dumps({"type": "device-safety-triggered", "event": event})
                    )
                if now[1] != before[1]:
                    connection.send(
                        json.dumps(
                            {
                                "type": "device-disconnected"
                                if now[1]
                                else "device-connected"
                            }
                        )
                    )
                before = now
                time.sleep(0.01)
        except ConnectionClosed:
            return


class Started(NamedTuple):
    """A running service."""

    process: subprocess.Popen[str]
    world: World  # arm of its device
    # Ports for states and events.
    port: int
    events_port: int

    def end(self) -> None:
        """Terminate the service."""
        self.process.terminate()
        # Also closes its output.
        self.process.communicate()


def start(folder: Path, *options: str) -> Started:
    """Start the service in its own process, with the arm that existed before, if any."""
    world = World(folder / "inverse3.world")
    command = [sys.executable, "-P", "-m", __name__, str(world.path), *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None  # noqa: S101  # it is a pipe
    line = process.stdout.readline()
    if not line:
        raise OSError(f"the emulated service ended with code {process.wait()}")
    port, events_port = map(int, line.split())
    return Started(process, world, port, events_port)


def main() -> None:
    """Serve until terminated."""
    parser = argparse.ArgumentParser(
        description=__doc__.split("\n", maxsplit=1)[0] if __doc__ else ""
    )
    parser.add_argument("world", type=Path)
    parser.add_argument(
        "--cold",
        type=float,
        default=0.0,
        help="time after the start without a device [s]",
    )
    parser.add_argument("--version", default="3.5")
    parser.add_argument(
        "--ports", type=int, nargs=2, default=(0, 0), help="ports for states and events"
    )
    arguments = parser.parse_args()
    world = World(arguments.world)
    service = Service(world, arguments.version)
    if arguments.cold:
        world.state.unplugged = 1

        def warm() -> None:
            world.state.unplugged = 0

        threading.Timer(arguments.cold, warm).start()
    servers: list[Server] = [
        serve(
            service.serve,
            "localhost",
            arguments.ports[0],
            process_request=service.answer,
            compression=None,
        ),
        serve(service.events, "localhost", arguments.ports[1], compression=None),
    ]
    print(*(server.socket.getsockname()[1] for server in servers), flush=True)
    for server in servers:
        threading.Thread(target=server.serve_forever, daemon=True).start()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))
    signal.pause()


if __name__ == "__main__":
    main()
