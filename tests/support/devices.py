"""Every registered real device on its emulator, ready to be driven and disturbed."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any, NamedTuple

import msgspec
import pytest
import yaml

from messages.types import Vector
from nodes.base.node_kinds import NODES
from nodes.driver.hardware.driver import HardwareDriver
from nodes.driver.hardware.mailbox import MailboxDevice
from sim.emulators import inverse_service
from sim.emulators.world import World, library, world_beside
from tests.support import ROOT
from tests.support.launching import wait_for

LIBRARIES = {
    "touch_driver": ("hd", "touch"),
    "force_dimension_driver": ("dhd", "force_dimension"),
}
"""Emulator and parameter group of each device with a library."""

GRIPPED: dict[str, dict[str, Any]] = {
    "touch_driver": {"calibration_time": 0.5},
    "force_dimension_driver": {"ready_time": 0.2, "workspace": [[-0.2, 0.2]] * 3},
    "inverse3_driver": {"start_time": 1.0},
}
"""Parameters that keep waiting times short."""


class Bench(NamedTuple):
    """A device on its emulator.

    Attributes
    ----------
    kind : str
        Of its driver.
    driver : type
        It.
    world : World
        The arm.
    section : str
        Where its parameters stand.
    parameters : dict
        They.
    made : list of MailboxDevice
        Its devices; what is left open is closed at the end.
    """

    kind: str
    driver: type[HardwareDriver]
    world: World
    section: str
    parameters: dict[str, Any]
    made: list[MailboxDevice]

    def written(
        self, mapping: dict[str, Any] | None = None, **given: Any
    ) -> dict[str, Any]:
        """Return its parameters as in a launch file."""
        return {
            self.section: {**self.parameters, **given},
            **({"mapping": mapping} if mapping else {}),
        }

    def device(
        self, mapping: dict[str, Any] | None = None, **given: Any
    ) -> MailboxDevice:
        """Create the device, unconnected."""
        made = self.driver.hardware(
            msgspec.convert(self.written(mapping, **given), self.driver.Parameters)
        )
        self.made.append(made)
        return made

    def opened(
        self, mapping: dict[str, Any] | None = None, **given: Any
    ) -> MailboxDevice:
        """Create the device, connected and open."""
        device = self.device(mapping, **given)
        device.connect()
        device.open()
        return device

    def press(self, device: MailboxDevice, force: Vector) -> None:
        """Read and write as a driver does, until the arm receives a force.

        After a gap of its own a force without a newer reading counts for nothing (mailbox.h).
        """

        def arrives() -> bool:
            device.read_position(0)
            device.write_force(force, 0, 0.0)
            return self.world.force() == pytest.approx(force, abs=1e-12)

        wait_for(arrives, "the arm gets the force")


def real_devices() -> dict[str, type[HardwareDriver]]:
    """Return every registered driver of a real device."""
    found, _ = NODES.all()
    return {
        name: kind
        for name, kind in found.items()
        if isinstance(kind, type) and issubclass(kind, HardwareDriver)
    }


@cache
def _compiled(name: str) -> Path:
    return library(name, Path(mkdtemp(prefix="stand-in-")))[0]


@contextmanager
def bench(kind: str, folder: Path, *options: str) -> Iterator[Bench]:
    """Set up a device with its own library or service, and its own arm."""
    driver = real_devices()[kind]
    made: list[MailboxDevice] = []
    if kind in LIBRARIES:
        name, section = LIBRARIES[kind]
        # A name of its own: who holds a device is told by the name of its library.
        path = folder / f"lib{name}-{os.urandom(4).hex()}.so"
        shutil.copy(_compiled(name), path)
        stand = Bench(
            kind,
            driver,
            world_beside(path),
            section,
            {"library": str(path), **GRIPPED[kind]},
            made,
        )
        service = None
    else:
        assert kind == "inverse3_driver", f"{kind} has no stand-in yet"
        service = inverse_service.start(folder, *options)
        parameters = {
            "port": service.port,
            "events_port": service.events_port,
            **GRIPPED[kind],
        }
        stand = Bench(kind, driver, service.world, "inverse3", parameters, made)
    try:
        yield stand
    finally:
        for device in made:
            device.close()
        if service is not None:
            service.end()


needs_cc = pytest.mark.skipif(
    shutil.which("cc") is None
    and shutil.which("gcc") is None
    and shutil.which("clang") is None,
    reason="no C compiler: neither the stand-in for libHD nor the servo loop can be built",
)


SOFT = ("stiffness:=150", "damping:=0.5")
"""So soft that the varying age of each servo sample hardly matters."""


def through(stand: Bench, folder: Path, **parameters: Any) -> str:
    """Write `floor_drop` with the device in place of the virtual one."""
    content = yaml.safe_load(
        (ROOT / "launch" / "floor_drop.yaml").read_text(encoding="utf-8")
    )
    del content["model"]
    for name in ("mass", "height"):
        del content["arguments"][name]
    # The arm of the stand-in is the scene's.
    content["nodes"]["coupling"]["parameters"]["plant"] = {"mass": 0.1, "damping": 1.0}
    written = stand.written(**parameters)
    content["nodes"]["driver"] = {"kind": stand.kind, "parameters": written}
    content["nodes"]["logger"]["parameters"] = {"path": "run.mcap"}
    path = folder / "drop.yaml"
    path.write_text(json.dumps(content), encoding="utf-8")
    return str(path)
