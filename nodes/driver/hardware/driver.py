"""Base of the driver nodes of real devices; also publishes the handle."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar, Final

import msgspec

from messages import topics
from messages.types import Handle
from nodes.base.setup import Axis
from nodes.driver.device import Device
from nodes.driver.hardware.inertia import SeenMasses
from nodes.driver.hardware.libraries import Search
from nodes.driver.hardware.mailbox import HardwareParameters, MailboxDevice
from nodes.driver.limits import lower
from nodes.driver.node import Driver
from nodes.driver.safety_setup import set_workspace
from nodes.parameters.store import ParameterError, convert

# interval of reading the handle; published on change, and each second [s]
HANDLE_PERIOD: Final = 0.02


class HardwareDriver(Driver):
    """A driver node with a real device; a kind names its class."""

    Parameters: ClassVar[type[msgspec.Struct]] = HardwareParameters
    publishes: ClassVar[tuple[str, ...]] = (*Driver.publishes, topics.HANDLE)
    hardware: ClassVar[type[MailboxDevice]]  # class of the device
    checked: ClassVar[str] = ""  # what its driver was tested against

    @classmethod
    def find(cls, parameters: Any) -> Search:
        """Search this machine for what the device needs."""
        return cls.hardware.find(parameters)

    @classmethod
    def plant(
        cls, parameters: Mapping[str, Any], name: str, axes: Sequence[Axis]
    ) -> dict[str, float]:
        """Return the scale of the device in the scene; its mass is not known yet."""
        del axes
        return {"scale": convert(parameters, cls.Parameters, name).mapping.scale}

    def make_device(self) -> Device:
        """Connect the device, forces off."""
        self.held = self.hardware(self.store.current)
        self._masses = SeenMasses()
        self.held.say = lambda text: self.events.emit_each("device_waits", text)
        self.held.connect()
        return self.held

    def loop(self) -> None:
        """Tick, and read the handle in another thread."""
        ended = threading.Event()
        thread = threading.Thread(
            target=self._watch_handle, args=(ended,), name="handle", daemon=True
        )
        thread.start()
        try:
            super().loop()
        finally:
            ended.set()
            thread.join()

    def _watch_handle(self, ended: threading.Event) -> None:
        last: Any = None
        silent = 0
        while not ended.wait(HANDLE_PERIOD):
            if self.state != "running":
                continue
            try:
                handle = self.held.handle()
            # a device's code, in a separate thread: the loop continues
            except Exception as error:  # noqa: BLE001
                self.events.emit(
                    "device",
                    f"the handle cannot be read and is not published any more: {error}",
                )
                return
            if handle is None:
                continue
            seen = (handle.orientation, handle.gripper, handle.buttons)
            silent += 1
            if seen != last or silent * HANDLE_PERIOD >= 1.0:
                last = seen
                silent = 0
                message = Handle(
                    seq=self.counted().seq, stamp=self.clock.now(), **handle._asdict()
                )
                self.events.publish(self.setup.topic(topics.HANDLE), message)

    def condition(self) -> str:
        """Return why the device gives no forces, or ""."""
        return self.held.condition()

    def check_health(self) -> None:
        """Check health, and record the device's masses (control thread)."""
        super().check_health()
        if self.state == "running":
            # a device passes through poses without any request
            self._masses.record(self.held.inertia())

    def operations(self) -> dict[str, Callable[..., Any]]:
        """Return the operations, with the device's facts, its inertia and re-centring."""
        return {
            **super().operations(),
            "facts": lambda: self.held.facts,
            "inertia": lambda: self._masses.record(self.held.inertia()),
            "recentre": self._recentre,
        }

    def _recentre(self) -> dict[str, Any]:
        def apply(seq: int) -> dict[str, Any]:
            del seq
            if any(self.driving.handed):
                raise ParameterError(
                    "re-centre while no force acts: move the device out of the wall first",
                    path=self.setup.name,
                )
            moved = self.held.recentre()
            set_workspace(
                self.driving,
                lower(self.store.current.safety, self.held.limits, self.setup.period),
            )
            return {"moved_m": list(moved)}

        # Between two ticks, because a tick with the new position and the old workspace would be a
        # fault.
        receipt: dict[str, Any] = self.changes.hand_over(apply)
        return receipt
