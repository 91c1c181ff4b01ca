"""Faults of real devices, on the emulator of each kind; judged by the emulated arm itself.

A hand holds the arm in a wall; after the fault its force must be zero within the drill's limit,
whatever ends it: driver, servo loop, device or service. Then the fault is repaired, like a cable
plugged in again, and the loop must recover by itself.
"""

import shutil
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, NamedTuple

from messages.types import DeviceState
from sim.drill.drill import (
    LIMIT,
    RATE,
    Fault,
    FaultSkippedError,
    await_another,
    await_strike,
    fault_of,
)
from sim.emulators import inverse_service
from sim.emulators.world import World, library
from sim.measure.haptic_commands import MeasurementError, wait_for
from sim.measure.rig import Rig

DEEP: Final = 0.002  # penetration at which the arm is held [m]
FORCE_TIMEOUT = 5.0  # time limit for the arm's force to end [s]
BAD: Final = 0.3  # duration of a fault that ends by itself [s]


class DrilledKind(NamedTuple):
    """A kind of device in the drill."""

    title: str  # name in the drill
    kind: str  # kind of its driver
    section: str  # group of its parameters
    stand_in: str  # library that emulates the vendor's; empty for the service
    reads: str  # vendor's call that reads a position
    parameters: dict[str, Any]  # parameters of the device


# Every kind of real device.
KINDS: Final = (
    DrilledKind(
        "Touch", "touch_driver", "touch", "hd", "hdGetDoublev", {"serial": "1234"}
    ),
    DrilledKind(
        *("Force Dimension", "force_dimension_driver", "force_dimension"),
        *("dhd", "dhdGetPosition", {"serial": 1234, "ready_time": 1.0}),
    ),
    DrilledKind(
        "Inverse3", "inverse3_driver", "inverse3", "", "state", {"start_time": 5.0}
    ),
)


class StandIn:
    """An emulated device in the drill's launch, and the forces on its arm."""

    def __init__(self, kind: DrilledKind) -> None:
        self.kind = kind
        self.folder = Path()
        self.world: World | None = None
        self._service: inverse_service.Started | None = None
        self._parameters: dict[str, Any] = {}
        self._wrong: list[str] = []

    @property
    def arm(self) -> World:
        """Return the arm; `prepare` must have been called."""
        assert self.world is not None  # noqa: S101  # drills prepare first
        return self.world

    def prepare(self) -> Mapping[str, str]:
        """Compile the library or start the service, and hold the arm in the wall."""
        self._wrong = []
        self.folder = Path(tempfile.mkdtemp(prefix="haptic-device-"))
        if self.kind.stand_in:
            try:
                path, self.world = library(self.kind.stand_in, self.folder)
            except OSError as error:
                raise FaultSkippedError(str(error)) from error
            self._parameters = {**self.kind.parameters, "library": str(path)}
        else:
            self._serve()
        self.arm.state.position[2] = -DEEP
        return {}

    def _serve(self, *options: str) -> None:
        service = self._service = inverse_service.start(self.folder, *options)
        self.world = service.world
        self._parameters = {
            **self.kind.parameters,
            "port": service.port,
            "events_port": service.events_port,
        }

    def change(self, content: dict[str, Any]) -> None:
        """Replace the launch's virtual device by the emulated one."""
        safety = content["nodes"]["driver"]["parameters"]["safety"]
        parameters = {"safety": safety, self.kind.section: self._parameters}
        content["nodes"]["driver"] |= {"kind": self.kind.kind, "parameters": parameters}

    def tidy(self) -> None:
        """Stop the service and remove the files."""
        if self._service is not None:
            self._service.end()
            self._service = None
        shutil.rmtree(self.folder, ignore_errors=True)

    def judge(self, states: Sequence[DeviceState]) -> list[str]:
        """Return what the arm received wrongly."""
        del states
        rules = (
            [f"{self.arm.state.broken} rules of the vendor's were broken"]
            if self.arm.state.broken
            else []
        )
        return self._wrong + rules

    def held(self) -> None:
        """Wait until a force acts on the arm, so that the fault can remove it."""
        await_strike(
            lambda: any(self.arm.force()), "a force on the arm before the fault"
        )

    def force_ends(self) -> None:
        """Wait until no force acts on the arm; record if that takes too long."""
        begun = time.monotonic()
        while any(self.arm.force()) and time.monotonic() < begun + FORCE_TIMEOUT:
            time.sleep(0.001)
        if (took := time.monotonic() - begun) > LIMIT / RATE:
            self._wrong.append(
                f"the arm had a force for {1e3 * took:.0f} ms, limit {1e3 * LIMIT / RATE:.0f} ms"
            )

    def _ends(self, rig: Rig) -> None:
        self.force_ends()
        wait_for(
            lambda: "[driver] ended: " in rig.errors, "the driver says that it is gone"
        )

    def unplug(self, rig: Rig) -> None:
        """Unplug the cable until the driver has ended, then plug it in again."""
        self.held()
        before = rig.pid("driver")
        self.arm.state.unplugged = 1
        self._ends(rig)
        self.arm.state.unplugged = 0
        await_another(rig, "driver", before)

    def swap(self, rig: Rig) -> None:
        """Unplug, and plug another device in first: it must be refused and get no force."""
        self.held()
        before = rig.pid("driver")
        serial = self.arm.state.serial
        arm = self.arm.state
        arm.unplugged = 1
        self._ends(rig)
        arm.serial = serial + 1
        arm.largest = 0.0
        arm.unplugged = 0
        wait_for(
            lambda: f"serial number {serial + 1}" in rig.errors,
            "the wrong device is named",
        )
        if arm.largest:
            self._wrong.append(f"the wrong device got {arm.largest:.3g} N")
        arm.serial = serial
        await_another(rig, "driver", before)

    def block(self, rig: Rig) -> None:
        """Make one read take 100 ms."""
        self.held()
        self.arm.state.block_ms = 100
        wait_for(lambda: self.arm.state.block_ms == 0, "the read that blocks")
        self.force_ends()
        rig.let_pass(BAD)

    def fail(self, rig: Rig) -> None:
        """Make reads fail, with their out-parameters untouched."""
        self.held()
        before = rig.pid("driver")
        self.arm.fail(self.kind.reads)
        self.force_ends()
        rig.let_pass(BAD)
        self.arm.fail("")
        # A Touch driver ends on an error of its servo loop.
        if "[driver] ended: " in rig.errors:
            await_another(rig, "driver", before)

    def slow(self, rig: Rig) -> None:
        """Make each answer take 80 ms."""
        self.held()
        self.arm.state.slow_ms = 80
        self.force_ends()
        rig.let_pass(BAD)
        self.arm.state.slow_ms = 0

    def twice(self, rig: Rig) -> None:
        """Send each state twice: the driver must end, and recover once that stops."""
        self.held()
        before = rig.pid("driver")
        self.arm.fail("twice")
        wait_for(
            lambda: "[driver] ended: " in rig.errors, "the driver gives the service up"
        )
        self.force_ends()
        self.arm.fail("")
        await_another(rig, "driver", before)

    def kill_service(self, rig: Rig) -> None:
        """Kill the service, and restart it at the same ports."""
        if self._service is None:
            raise MeasurementError(f"{self.kind.title} has no service")
        self.held()
        before = rig.pid("driver")
        ports = (self._service.port, self._service.events_port)
        self._service.process.kill()
        self._service.process.communicate()
        self._ends(rig)
        self._serve("--ports", *map(str, ports))
        await_another(rig, "driver", before)


def faults() -> list[Fault]:
    """Return the faults of each kind of device."""
    found = []
    for kind in KINDS:
        stand = StandIn(kind)
        rows: list[tuple[str, str, Callable[[Rig], None]]] = [
            ("unplugged", "its cable pulled in mid-run, then plugged in", stand.unplug),
            ("read blocks", "one read of its position takes 100 ms", stand.block),
            ("read fails", f"for {BAD:g} s, out-parameters untouched", stand.fail),
        ]
        if kind.stand_in:
            rows.append(
                (
                    "swapped",
                    "another serial number plugged in, then the right one",
                    stand.swap,
                )
            )
        else:
            rows.append(("service dies", "SIGKILL, started again", stand.kill_service))
            rows.append(
                ("service slow", f"each answer 80 ms late for {BAD:g} s", stand.slow)
            )
            rows.append(
                ("answers twice", "each state sent twice, then once again", stand.twice)
            )
        found += [
            fault_of(stand, f"{kind.title} {name}", what, strike)
            for name, what, strike in rows
        ]
    return found
