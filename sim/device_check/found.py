"""Devices usable from here: their libraries, places searched, and how drivers were tested."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from messages.errors import UsageError
from nodes.base.node_kinds import NODES
from nodes.driver.hardware.driver import HardwareDriver
from nodes.driver.hardware.mailbox import MailboxDevice
from nodes.launcher.scenario_files import parse_assignments
from nodes.parameters.store import convert


@dataclass(frozen=True)
class DeviceKind:
    """A kind of device."""

    kind: str  # kind of node that drives it
    found: bool  # whether its library is installed
    # Path of the library, or its name if missing; None if the device needs none.
    library: str | None
    searched: tuple[str, ...]  # places searched
    checked: str  # what its driver was tested against


def real_kinds() -> dict[str, type[HardwareDriver]]:
    """Return every installed driver of a real device, by name."""
    found, _ = NODES.all()
    return {
        name: kind
        for name, kind in found.items()
        if isinstance(kind, type) and issubclass(kind, HardwareDriver)
    }


def devices() -> list[DeviceKind]:
    """Return every kind of device, with the library it needs."""
    listed = [
        DeviceKind(
            "sim_driver", True, None, (), "closed forms and lockstep runs (no hardware)"
        )
    ]
    for name, kind in sorted(real_kinds().items()):
        library, searched = kind.find(convert({}, kind.Parameters, name))
        # If it is missing, show its name.
        named = library or searched[-1].rpartition("/")[2]
        listed.append(
            DeviceKind(name, library is not None, named, searched, kind.checked)
        )
    return listed


def text() -> str:
    """Return all kinds as text."""
    listed = devices()
    width = max(len(kind.kind) for kind in listed)
    lines = []
    for kind in listed:
        state = "ready" if kind.found else "not found"
        where = f" ({kind.library})" if kind.library else ""
        lines.append(
            f"{kind.kind:{width}}  {state}{where}; tested against {kind.checked}"
        )
        if not kind.found:
            lines += [f"{'':{width}}  looked in {place}" for place in kind.searched]
    return "\n".join(lines)


def device_of(kind: str, words: Sequence[str]) -> MailboxDevice:
    """Create an unconnected device from words such as ``touch.library:=/opt/libHD.so``."""
    known = real_kinds()
    if kind not in known:
        virtual = (
            "; the virtual device needs no check: haptic launch identify"
            if kind == "sim_driver"
            else ""
        )
        raise UsageError(
            f"{kind!r} drives no real device; available: {', '.join(sorted(known))}{virtual}"
        )
    written: dict[str, Any] = {}
    for path, value in parse_assignments(list(words)).items():
        at = written
        *outer, last = path.split(".")
        for name in outer:
            at = at.setdefault(name, {})
            if not isinstance(at, dict):
                raise UsageError(
                    f"{path}:={value}: conflicts with {name}:={at}; give only one of them"
                )
        at[last] = value
    device = known[kind].hardware(convert(written, known[kind].Parameters, kind))
    device.say = lambda text: print(text, file=sys.stderr, flush=True)
    return device
