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
from messages.types import ZERO, Vector
from nodes.base import realtime
from nodes.base.hang_watchdog import LastResort
from nodes.base.node import IDLE_MS, Node
from nodes.base.setup import AXIS_INDEX, Setup
from nodes.base.status_report import Counted
from nodes.compiled.layout import NEVER, state_of
from nodes.driver.calls import numbers_of
from nodes.driver.condition import Condition
from nodes.driver.device import Device, DeviceLimits
from nodes.driver.external import give
from nodes.driver.force_words import why_no_force
from nodes.driver.limits import STOP_TIME, SafetyParameters, lower, undeclared
from nodes.driver.motion import set_motion
from nodes.driver.parameters import DriverParameters, check
from nodes.driver.passivity import set_guard
from nodes.driver.plain_tick import PlainTicks
from nodes.driver.run_report import DriverReport
from nodes.driver.safety import rearm
from nodes.driver.safety_setup import set_safety, soft_stop
from nodes.driver.state import BETWEEN, DriverState
from nodes.driver.tick import BROKEN, SILENT, UNREAD, take_sample
from nodes.driver.watch import Watch
from nodes.parameters.store import ParameterError, convert

if TYPE_CHECKING:
    from nodes.compiled.library import Kernel
    from nodes.driver.compiled_tick import DriverTicks

__all__ = ["ASK_AGAIN", "SOFT_STOP", "Driver"]

# time after which an unanswered tick is published again in lockstep [s]: a node lost its answer
ASK_AGAIN = 0.5
LONGEST_PAUSE = 60.0  # longest pause of a loop in lockstep per request [s]
PAUSE_POLL = 0.01  # interval of checking requests during a pause [s]
# longest soft stop [s], after which the device counts as hanging
SOFT_STOP = STOP_TIME + 1.0


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


class Driver(Node):
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
    driving : DriverState
        State between ticks.
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
        self.driving = self.counters
        self._virtual = self.is_virtual(setup.parameters, setup.name)
        self._report = DriverReport(self.driving)
        self._condition = Condition(self, self.condition)
        self._paused_until = 0.0
        self.events.interrupt = self._interrupt

    def make_counters(self) -> Any:
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

    @property
    def target(self) -> Vector:
        """Point to which a simulated hand pulls the device in this tick [m]; zero without one."""
        return ZERO

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
            held = msgspec.structs.replace(
                held, max_age=0
            )  # only the tick's own answer counts
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
        self._open = (
            True  # set first, so that a device that failed half-way is closed too
        )
        self._watch.begin("open()", self._device.limits.opening)
        self._device.open()
        self._watch.begin("")
        self.started.wait()
        self.state = "running"
        self._plain = PlainTicks(self, self._device)
        self.make_compiled()
        ticks = self._plain.run if self.compiled is None else self.compiled.run
        s = self.driving
        s.until = self.setup.ticks or NEVER
        s.most = NEVER
        if not self.stopping:
            if s.realtime:
                self._begin_at_epoch()  # a virtual device waits for a debugger; a real one does not
                self._watch.begin("a tick", self.store.current.safety.hang or math.inf)
            else:
                self.inbox.set_timeout(IDLE_MS)
                self._report.first = time.monotonic()
            self._tick(ticks)
            self._report.last = end = (
                realtime.sleep_until(s.epoch + s.seq * s.period)
                if s.realtime
                else time.monotonic()
            )
            self._last_sample(
                end + self.clock.offset if s.realtime else s.seq * s.period
            )
            self._report.complete = s.seq >= s.until
            if self._report.complete:
                self.stop("done")

    def _tick(self, ticks: Callable[[Any], int]) -> None:
        """Run ticks; handle whatever makes them return."""
        s = self.driving
        asked = 0.0
        while s.seq < s.until and not self.stopping:
            if s.phase == BETWEEN and time.monotonic() < self._paused_until:
                self.between_ticks(s.seq)
                time.sleep(PAUSE_POLL)
                continue
            s.clock_offset = self.clock.offset
            why = ticks(s)
            if why == SILENT:
                asked = max(asked, s.sampled)
                if time.monotonic() - asked > ASK_AGAIN:
                    asked = time.monotonic()
                    self.events.emit(
                        "unanswered",
                        f"tick {s.seq} has no answer; publishing it again",
                        {"tick": s.seq},
                    )
                    payload = (
                        self._plain.payload
                        if self.compiled is None
                        else self.compiled.last_sent()
                    )
                    self.publisher.send_hop(
                        self.setup.topic(topics.DEVICE_STATE).encode(), payload
                    )
            # in the middle of a tick, work between ticks must wait
            if why == BROKEN:
                self._raise_device_error()
            elif why == UNREAD:
                s.pending_result = 1 + self._plain.take_up(s)
            elif self.events.waiting or s.notes_count:
                self.between_ticks(s.seq)

    def _raise_device_error(self) -> None:
        """Repeat the failed device call in Python, so that its exception is raised."""
        s = self.driving
        if self.compiled is not None:
            self.compiled.raise_error()
        if s.failed:
            s.failed = 0
            held = (
                not s.realtime
                or time.monotonic()
                < s.epoch + (s.written + s.device_hold_ticks) * s.period
            )
            self._device.write_force(tuple(s.handed) if held else ZERO, s.seq, 0.0)
        else:
            s.place[:] = numbers_of(
                self._device.read_position(s.seq),
                f"{self.setup.name}: {type(self._device).__name__}",
            )
            s.jumped |= self._plain.jumps.again()
            s.position_ready = 1

    def _last_sample(self, stamp: float) -> None:
        """Publish the final position of the device."""
        s = self.driving
        s.place[:] = numbers_of(self._device.read_position(s.seq), self.setup.name)
        s.jumped |= self._plain.jumps.again()
        s.target[:] = self.target
        take_sample(s, s.seq, stamp)
        self._plain.publish(s, s.seq, stamp)
        self._plain.aside(s)
        s.phase = BETWEEN

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
            "rearm": self._rearm,
            "stand": self._pause_for,
            "force": lambda: {
                "why": why_no_force(self.driving, self._condition.told())
            },
            "external": lambda force: give(
                self.driving, self.store.current.external, self.setup.name, force
            ),
        }

    def _rearm(self, beside: bool = False) -> dict[str, Any]:
        """Rearm after a stop; a real device only if somebody is `beside` it."""
        name = self.setup.name
        if not (self._virtual or beside):
            raise ParameterError(
                "the driver of a real device has stopped an unstable loop; choose a "
                "softer law, stand beside the device, then: haptic node rearm",
                path=name,
            )

        def apply(seq: int) -> dict[str, Any]:
            if not rearm(self.driving, seq):
                raise ParameterError(
                    "has not stopped the loop; nothing was changed", path=name
                )
            return {"seq": seq}

        receipt: dict[str, Any] = self.changes.hand_over(apply)
        return receipt

    def _pause_for(self, seconds: float) -> dict[str, Any]:
        """Pause the lockstep loop for `seconds` (0 resumes), to free the CPU meanwhile."""
        name = self.setup.name
        if self.driving.realtime:
            raise ParameterError(
                "only a lockstep loop can pause; a device in real time cannot wait",
                path=name,
            )
        if not (isinstance(seconds, int | float) and 0.0 <= seconds <= LONGEST_PAUSE):
            raise ParameterError(
                f"a pause of {seconds!r} s: expected 0 to {LONGEST_PAUSE:g} s",
                path=name,
            )
        self._paused_until = time.monotonic() + seconds
        self.events.notify()
        return {}

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

    def _begin_at_epoch(self) -> None:
        """Set the time of tick 0; a respawned driver continues its predecessor's count."""
        s = self.driving
        path = Path(self.setup.run_dir) / f"{self.setup.name}.epoch"
        if path.exists():
            # It was killed with a force on the device: the first force is a recovery.
            s.ramp_ticks = s.recovery_ticks
            s.always_ramp = 1
            s.epoch = float(path.read_text(encoding="ascii"))
        else:
            s.epoch = time.monotonic() + 0.002
            path.write_text(repr(s.epoch), encoding="ascii")
        s.seq = self._report.first_seq = max(
            0, math.ceil((time.monotonic() - s.epoch) / s.period)
        )
        # A rate counts deadlines: the time before the first of them does not belong to the run.
        self._report.first = s.epoch + s.seq * s.period

    def finish(self) -> None:
        """Ramp the force down to zero and close the device, on every way out."""
        if not self._open:
            return
        self._open = False
        s = self.driving
        period = self.setup.period
        x, y, z = s.handed
        try:
            self._watch.begin("the soft stop", SOFT_STOP)
            written = s.epoch + s.written * period
            for n, force in enumerate(soft_stop((x, y, z), s.slew, period), 1):
                self._report.soft_stop_ticks = n
                if (
                    s.realtime
                    and time.monotonic() >= written + s.device_hold_ticks * period
                ):
                    # The driver was held up until the device let go by itself: the force must not
                    # return.
                    force = ZERO
                self._device.write_force(force, s.seq + n - 1, 0.0)
                s.handed[:] = force
                if force == ZERO:
                    break
                if s.realtime:
                    written = time.monotonic()
                    realtime.sleep_until(written + period)
        finally:
            self._watch.begin("close()", self._device.limits.closing)
            self._device.close()
            self._watch.end()
            self.report_notes()
