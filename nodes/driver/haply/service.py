"""Messages of Haply's Inverse Service (3.5): its WebSocket, and a few HTTP requests.

The first message contains the complete state; after it exactly one state answers each message sent.
Zero fields may be missing in a state. A force acts once and is then cleared; forces of several
sessions add up.
"""

from __future__ import annotations

import json
import urllib.error
import urllib.request
from typing import Any, Final

import msgspec

from messages.types import Vector

PROFILE: Final = "haptic-nodes"
MAX_BUTTONS: Final = 32  # largest number of buttons of a grip
REMEDY: Final = (
    "install and start Haply's Inverse Service 3.5, and plug the Inverse3 in"
)


class _Vector(msgspec.Struct):
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0

    def numbers(self) -> Vector:
        return self.x, self.y, self.z


class _Quaternion(_Vector):
    w: float = 1.0


class Inverse3State(msgspec.Struct):
    """State of a device; missing fields are zero.

    cursor_position, cursor_velocity, current_cursor_force: In the session's own axes [m], [m/s],
        [N].
    body_orientation: Orientation of the device's body.
    """

    cursor_position: _Vector = msgspec.field(default_factory=_Vector)
    cursor_velocity: _Vector = msgspec.field(default_factory=_Vector)
    current_cursor_force: _Vector = msgspec.field(default_factory=_Vector)
    body_orientation: _Quaternion = msgspec.field(default_factory=_Quaternion)


class Inverse3(msgspec.Struct):
    """One device of the service; without a state it was not read."""

    device_id: str = ""
    config: dict[str, Any] = {}
    status: dict[str, Any] = {}
    state: Inverse3State | None = None


class Grip(msgspec.Struct):
    """A VerseGrip and its buttons, if the service reports them."""

    state: dict[str, Any] = {}


class ServiceMessage(msgspec.Struct):
    """One message of the service."""

    inverse3: list[Inverse3] = []
    wireless_verse_grip: list[Grip] = []
    error: Any = None


_DECODER: Final = msgspec.json.Decoder(ServiceMessage)


def read(message: str | bytes) -> ServiceMessage:
    """Decode a message of the service; ValueError if it is invalid."""
    try:
        return _DECODER.decode(message)
    except (msgspec.DecodeError, RecursionError, UnicodeError) as error:
        raise ValueError(f"the service sent what it should not: {error}") from error


def buttons(service_state: ServiceMessage) -> tuple[int, bool]:
    """Return the buttons of the first grip, one bit each, and whether there are more than fit."""
    if not service_state.wireless_verse_grip:
        return 0, False
    pressed = service_state.wireless_verse_grip[0].state.get("buttons", {})
    names = sorted(pressed) if isinstance(pressed, dict) else []
    bits = sum(
        1 << n for n, name in enumerate(names[:MAX_BUTTONS]) if pressed[name] is True
    )
    return bits, len(names) > MAX_BUTTONS


def command(device: str, force: Vector | None, first: bool = False) -> str:
    """Return a message with a force, or None for the position; `first` names the session."""
    if force is None:
        commands: dict[str, Any] = {"probe_position": {}}
    else:
        # ``vector`` since 3.5; 3.1 had ``values`` and would apply no force, which the driver
        # checks.
        commands = {
            "set_cursor_force": {"vector": dict(zip("xyz", force, strict=True))}
        }
    said: dict[str, Any] = {"inverse3": [{"device_id": device, "commands": commands}]}
    if first:
        said["session"] = {"configure": {"profile": {"name": PROFILE}}}
    return json.dumps(said)


def ask(host: str, port: int, path: str) -> Any:
    """Return the answer of the service's HTTP side, or None; older versions lack some."""
    try:
        # http only
        with urllib.request.urlopen(
            f"http://{host}:{port}{path}", timeout=1.0
        ) as answer:
            service_state = json.loads(answer.read(1 << 20))
    except (OSError, ValueError, RecursionError, urllib.error.URLError):
        return None
    return (
        service_state.get("data")
        if isinstance(service_state, dict) and service_state.get("ok")
        else None
    )


# meaning of the service's events, by a word in them; those in `ENDS` end a condition
EVENTS: Final = {
    "device-disconnected": "the Inverse3 was unplugged",
    "device-busy": "another program has the Inverse3",
    "ebrake_triggered": "the emergency brake of the Inverse3 is on",
    "stall_detected": "the Inverse3 has found a motor stalled and gives no force",
    "stability_ceiling": "the Inverse3 has found the loop unstable and lowers forces",
}
ENDS: Final = ("ebrake_released", "device-connected")
