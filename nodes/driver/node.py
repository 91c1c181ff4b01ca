"""The driver node: the clock of the loop, and the only node that accesses the device.

At each tick it samples the position, publishes it, and waits for the force that answers this very
tick. ``realtime`` waits until the next absolute deadline and continues without an answer if it
must; ``lockstep`` waits for the answer, however long, so a run is deterministic and as fast as the
machine allows. The next state message reports the outcome of a tick.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import msgspec

from messages import topics
from nodes.base import realtime
from nodes.base.hang_watchdog import LastResort
from nodes.base.node import IDLE_MS
from nodes.base.setup import AXIS_INDEX, Setup
from nodes.base.status_report import Counted
from nodes.compiled.layout import NEVER, state_of
from nodes.driver.condition import Condition
from nodes.driver.device import Device, DeviceLimits
from nodes.driver.epoch import begin_at_epoch
from nodes.driver.external import give
from nodes.driver.force_words import why_no_force
from nodes.driver.limits import SafetyParameters, lower, undeclared
from nodes.driver.motion import set_motion
from nodes.driver.operations import DriverOperations
from nodes.driver.parameters import DriverParameters, check
from nodes.driver.passivity import set_guard
from nodes.driver.plain_tick import PlainTicks
from nodes.driver.run_report import DriverReport
from nodes.driver.safety_setup import set_safety
from nodes.driver.soft_stop import SOFT_STOP, stop_softly
from nodes.driver.state import DriverState
from nodes.driver.tick_loop import TickLoop
from nodes.driver.ticked_driver import TickedDriver
from nodes.driver.watch import Watch
from nodes.parameters.store import ParameterError, convert

if TYPE_CHECKING:
    from nodes.compiled.library import Kernel
    from nodes.driver.compiled_tick import DriverTicks

__all__ = ["Driver"]


def state_property(name: str) -> Any:
    """Return a property that stores a Node counter in the driver's state struct.

    Parameters
    ----------
    name : str
        Field of the struct.

    Returns
    -------
    property
        Reads and writes that field.
    """
    return property(
        lambda node: getattr(node.counters, name),
        lambda node, value: setattr(node.counters, name, value),
    )


class Driver(TickedDriver):
    """Base of the drivers: a kind of device defines `make_device` and adds its own parameters.

    Attributes
    ----------
    virtual : bool
        Whether the device lives in simulated time and can wait.
    device_module : str
        Module of the device's compiled calls (nodes/driver/calls.py); empty for a device written in
        Python, or in C.
    movable : str
        Names of the parameters that may change while it runs, for errors.
    """

    Parameters: ClassVar[type[msgspec.Struct]] = DriverParameters
    publishes: ClassVar[tuple[str, ...]] = (topics.DEVICE_STATE,)
    listens_to: ClassVar[tuple[str, ...]] = (topics.FORCE,)
    virtual: ClassVar[bool] = False
    kernel_module: ClassVar[str] = "nodes.driver.kernel"
    device_module: ClassVar[str] = ""
    movable: ClassVar[str] = "passivity"

    compiled: DriverTicks | None
    sent = state_property("states_sent")
    received = state_property("taken")

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        # all drivers have the same tick; a kind only makes its device
        cls.kernel_module = Driver.kernel_module

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._virtual = self.is_virtual(setup.parameters, setup.name)
        self._report = DriverReport(self.driving)
        self._condition = Condition(self, self.condition)
        self._operations = DriverOperations(self, self.driving, self._virtual)
        self.events.interrupt = self._interrupt

    def make_counters(self) -> DriverState:
        """Return the state."""
        return state_of(DriverState, self.setup.tick == "compiled")

    def counted(self) -> Counted:
        """Return the counters, with the tick that was sampled last."""
        return super().counted()._replace(seq=self.driving.asked)

    @classmethod
    def modules(cls, parameters: Mapping[str, Any]) -> set[str]:
        """Return the modules to compile: the tick, and the device's compiled calls, if any."""
        return super().modules(parameters) | {cls.device_module} - {""}

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Check pace and workspace before the launch (`Node.check`)."""
        virtual = cls.is_virtual(setup.parameters, setup.name)
        check(setup, convert(setup.parameters, cls.Parameters, setup.name), virtual)

    @classmethod
    def is_virtual(cls, parameters: Mapping[str, Any], name: str) -> bool:
        """Return whether the device lives in simulated time: here for every device of the kind."""
        del parameters, name
        return cls.virtual

    def make_device(self) -> Device:
        """Return the device, created from the parameters but not opened.

        Returns
        -------
        Device
            The device.
        """
        raise TypeError(
            f"driver kind {self.setup.kind!r} does not define make_device()"
        )

    @property
    def device(self) -> Device:
        """The device, once it is made."""
        return self._device

    def configure(self) -> None:
        """Create the device and set the conditions of the run."""
        parameters = self.store.current
        s = self.driving
        period = self.setup.period
        self._device = self.make_device()
        limits = self._device.limits
        if not self._virtual and (refusal := undeclared(parameters.safety, limits)):
            self._device.close()
            raise ParameterError(f"{refusal}", path=self.setup.name)
        axes = [AXIS_INDEX[axis] for axis in self.setup.axes]
        s.period = period
        s.realtime = self.setup.pace == "realtime"
        s.virtual = self._virtual
        s.next_tick = self.setup.apply == "next_tick"
        s.axes = len(axes)
        s.axis[:] = (*axes, 0, 0)[:3]
        # Ticks after the last write until the device lets go by itself, at the earliest.
        s.device_hold_ticks = (
            limits.hold if limits.lets_go is None else limits.lets_go
        ) / period
        held = lower(parameters.safety, limits, period, f"{self.setup.name}.safety")
        if s.realtime == 0:
            # only the tick's own answer counts
            held = msgspec.structs.replace(held, max_age=0)
        set_safety(s, parameters.safety, held, period)
        self._kept = set_motion(s, round((limits.latency or 0.0) / period, 9))
        set_guard(s, parameters.passivity)
        # A restarted driver may have a guard that a client set, not the launch file.
        written: DriverParameters = convert(
            self.setup.parameters, self.Parameters, self.setup.name
        )
        self._report.begin(
            self._device,
            held,
            written.passivity is not None and written.passivity.guard == "on",
        )
        for text in held.overruled:
            self.events.emit("limit", text)
        if limits.latency is None and s.guard_on:
            text = "the device does not report its latency: the guard assumes none"
            self.events.emit("guard", text)
        waits = self._virtual or parameters.safety.hang is None
        self._watch = Watch(self, limits, None if waits else LastResort(self.setup))
        self._open = False

    def loop(self) -> None:
        """Tick until stopped or done."""
        assert self.inbox is not None  # noqa: S101  # every subscribing kind has one
        if self.stopping:
            return
        # set first, so that a device that failed half-way is closed too
        self._open = True
        self._watch.begin("open()", self._device.limits.opening)
        self._device.open()
        self._watch.begin("")
        self.started.wait()
        self.state = "running"
        self._plain = PlainTicks(self, self._device)
        self.make_compiled()
        loop = TickLoop(
            self, self._device, self._plain, self.compiled, self._operations
        )
        s = self.driving
        s.until = self.setup.ticks or NEVER
        s.most = NEVER
        if not self.stopping:
            if s.realtime:
                begin_at_epoch(s, Path(self.setup.run_dir) / f"{self.setup.name}.epoch")
                self._report.first_seq = s.seq
                # A rate counts deadlines: the time before the first of them does not belong to the
                # run.
                self._report.first = s.epoch + s.seq * s.period
                # a virtual device waits for a debugger; a real one does not
                self._watch.begin("a tick", self.store.current.safety.hang or math.inf)
            else:
                self.inbox.set_timeout(IDLE_MS)
                self._report.first = time.monotonic()
            loop.run(s)
            self._report.last = end = (
                realtime.sleep_until(s.epoch + s.seq * s.period)
                if s.realtime
                else time.monotonic()
            )
            loop.publish_last_sample(
                s, end + self.clock.offset if s.realtime else s.seq * s.period
            )
            self._report.complete = s.seq >= s.until
            if self._report.complete:
                self.stop("done")

    @classmethod
    def largest_force(
        cls, parameters: Mapping[str, Any], name: str, period: float
    ) -> float | None:
        """Return the largest force that the launch file allows [N]; the device's may be lower."""
        safety = convert(
            parameters.get("safety", {}), SafetyParameters, f"{name}.safety"
        )
        return lower(safety, DeviceLimits(), period, f"{name}.safety").peak

    def compiled_ticks(self, kernel: Kernel) -> DriverTicks:
        """Return the compiled ticks."""
        from nodes.driver.compiled_tick import DriverTicks

        return DriverTicks(self, kernel, self._device, self._plain.jumps)

    def prepare(self, parameters: Any) -> Callable[[int], Any]:
        """Prepare a new guard with zero accounts; other parameters are fixed.

        It is refused if the launch file has a guard of its own.
        """
        if msgspec.structs.replace(
            parameters, passivity=None
        ) != msgspec.structs.replace(self.store.current, passivity=None):
            raise ParameterError(
                f"while it runs, parameters of a {self.setup.kind} are "
                f"fixed, except {self.movable}",
                path=self.setup.name,
            )
        if self._report.own_guard:
            raise ParameterError(
                "the launch file's own guard is fixed while it runs",
                path=f"{self.setup.name}.passivity",
            )

        def apply(seq: int) -> dict[str, Any]:
            set_guard(self.driving, parameters.passivity)
            return {"seq": seq}

        return apply

    def report_notes(self) -> None:
        """Publish what the rules of the tick noted as events."""
        for note in self._report.notes():
            # every change of state is published, whatever else happened
            self.events.emit(
                note.kind, note.reason, note.data, always=note.is_change, count=note.nth
            )

    def between_ticks(self, seq: int) -> None:
        """Report notes, then do the work of every node between ticks."""
        self.report_notes()
        super().between_ticks(seq)

    def check_health(self) -> None:
        """Check that the loop progresses, and report the device's condition (control thread)."""
        self._watch.check((*self.counted(), self._report.soft_stop_ticks))
        if self.state == "running":
            self._condition.report()

    def operations(self) -> dict[str, Callable[..., Any]]:
        """Return the operations, with progress, rearming, pausing and external forces."""
        limits = self._device.limits
        return {
            "progress": lambda: {
                **self._report.progress(self.setup.ticks),
                "condition": self._condition.told(),
            },
            "device": lambda: {
                "opening_s": limits.opening,
                "closing_s": limits.closing,
            },
            "rearm": self._operations.rearm,
            "stand": self._operations.pause,
            "force": lambda: {
                "why": why_no_force(self.driving, self._condition.told())
            },
            "external": lambda force: give(
                self.driving, self.store.current.external, self.setup.name, force
            ),
        }

    def condition(self) -> str:
        """Return why the device does not apply the forces that it gets, or "".

        Returns
        -------
        str
            One sentence.
        """
        return ""

    def report(self) -> dict[str, Any]:
        """Return a summary of the run."""
        return self._report.summary()

    def _interrupt(self) -> None:
        """Request the return of compiled ticks."""
        self.driving.attention = 1

    def finish(self) -> None:
        """Ramp the force down to zero and close the device, on every way out."""
        if not self._open:
            return
        self._open = False
        try:
            self._watch.begin("the soft stop", SOFT_STOP)
            stop_softly(self.driving, self._device, self._report.count_soft_stop)
        finally:
            self._watch.begin("close()", self._device.limits.closing)
            self._device.close()
            self._watch.end()
            self.report_notes()
