"""Base of the driver nodes of real devices: beside the loop it publishes the handle, and says why no force is felt."""

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
from nodes.driver.safety import set_workspace
from nodes.parameters.store import ParameterError, convert

# how often the handle is looked at; published when it has changed, and each second [s]
HANDLE_PERIOD: Final = 0.02


class HardwareDriver(Driver):
    """A driver node with a real device; a kind names its class."""

    Parameters: ClassVar[type[msgspec.Struct]] = HardwareParameters
    publishes: ClassVar[tuple[str, ...]] = (*Driver.publishes, topics.HANDLE)
    hardware: ClassVar[type[MailboxDevice]]  # the device
    checked: ClassVar[str] = ""  # what its driver was tested against

    @classmethod
    def find(cls, parameters: Any) -> Search:
        """Look for what the device needs on this machine."""
        return cls.hardware.find(parameters)

    @classmethod
    def plant(
        cls, parameters: Mapping[str, Any], name: str, axes: Sequence[Axis]
    ) -> dict[str, float]:
        """Return the scale at which the scene feels the device; its mass is not known before it is identified."""
        del axes
        return {"scale": convert(parameters, cls.Parameters, name).mapping.scale}

    def make_device(self) -> Device:
        """Take hold of the device, forces off."""
        self.held = self.hardware(self.store.current)
        self._masses = SeenMasses()
        self.held.say = lambda text: self.events.emit_each("device_waits", text)
        self.held.connect()
        return self.held

    def loop(self) -> None:
        """Tick, and look at the handle beside it."""
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
            except Exception as error:  # noqa: BLE001  # code of a device, in a thread of its own: the loop goes on
                self.events.emit(
                    "device", f"the handle cannot be read and is not published any more: {error}"
                )
                return
            if handle is None:
                continue
            seen = (handle.orientation, handle.gripper, handle.buttons)
            silent += 1
            if seen != last or silent * HANDLE_PERIOD >= 1.0:
                last, silent = seen, 0
                message = Handle(seq=self.counted().seq, stamp=self.clock.now(), **handle._asdict())
                self.events.publish(self.setup.topic(topics.HANDLE), message)

    def condition(self) -> str:
        """Say what keeps the device from giving forces; empty when nothing does."""
        return self.held.condition()

    def look_after(self) -> None:
        """Look which masses the device has, too (control thread)."""
        super().look_after()
        if self.state == "running":
            # a device passes through poses that nobody asks about
            self._masses.look(self.held.inertia())

    def operations(self) -> dict[str, Callable[..., Any]]:
        """Offer what the device is, the mass that a law meets on it, and to put its handle into the middle of the scene."""
        return {
            **super().operations(),
            "facts": lambda: self.held.facts,
            "inertia": lambda: self._masses.look(self.held.inertia()),
            "recentre": self._recentre,
        }

    def _recentre(self) -> dict[str, Any]:
        def apply(seq: int) -> dict[str, Any]:
            del seq
            if any(self.driving.handed):
                raise ParameterError(
                    f"{self.setup.name}: re-centre while no force acts: move the device out of the"
                    " wall first"
                )
            moved = self.held.recentre()
            set_workspace(
                self.driving, lower(self.store.current.safety, self.held.limits, self.setup.period)
            )
            return {"moved_m": list(moved)}

        # Between two ticks: a tick with the new place and the old workspace would be a fault.
        receipt: dict[str, Any] = self.changes.hand_over(apply)
        return receipt
