"""Faults in which a force begins, returns or jumps without motion; judged by device logs."""

import os
import signal
import time
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

from messages.types import DeviceState
from nodes.base.processor_wait import state_of
from nodes.driver.limits import SafetyParameters
from sim.drill.device_log import read_log
from sim.drill.drill import (
    HOLD,
    PEAK,
    RATE,
    SLEW,
    Fault,
    await_another,
    await_strike,
    fault_of,
    kill,
)
from sim.drill.faulty_device import FAILS
from sim.drill.random_launches import pushed
from sim.drill.writes import Promise, broken
from sim.measure.haptic_commands import MeasurementError, wait_for
from sim.measure.rig import Rig

APART: Final = 0.03  # initial distance of the two devices of a pair [m]
HELD_UP: Final = (0.2, 0.4, 0.9)  # durations of a driver's stop during its ramp [s]
TAKEN_DOWN: Final = 20.0  # slew of that ramp, slow enough to be caught [N/s]
INSIDE: Final = -0.005  # position of a device that starts inside the wall [m]
# Positions to which a wall is moved while a hand presses into it [m].
PLACES: Final = (0.0015, -0.0015, 0.001, 0.0)
ORDER = "order"
LOG = "writes.log"


class LoggedDevice:
    """A virtual device in the drill's launch that logs each force it receives."""

    def __init__(self, slew: float = SLEW) -> None:
        self._slew = slew
        self._path = Path()
        # A restarted driver continues the log; its first force is ramped like a launch's.
        self._bounds = Promise(
            1.0 / RATE, PEAK, slew / RATE, HOLD, SafetyParameters().recovery
        )

    def change(self, content: dict[str, Any]) -> None:
        """Replace the launch's virtual device by the logged one."""
        driver = content["nodes"]["driver"]
        driver["kind"] = "faulty_driver"
        driver["parameters"] |= {"order": ORDER, "log": LOG}
        # Both begin inside the wall, with the whole ramp.
        driver["parameters"]["safety"] |= {"slew": self._slew, "ramp": None}

    def struck(self, rig: Rig) -> None:
        """Store the path of the log; the launch removes the file at its end."""
        self._path = rig.folder / LOG

    def judge(self, states: Sequence[DeviceState]) -> list[str]:
        """Return violations found in the log."""
        del states
        return [f"the device: {text}" for text in self.wrong[:3]]

    wrong: Sequence[str] = ()

    def ended(self) -> None:
        """Judge the log written so far."""
        log = [sample.write for sample in read_log(self._path, 1.0 / RATE)]
        # While the launch runs, a force on the device is allowed.
        self.wrong = [
            text
            for text in broken(log, self._bounds)
            if "is left on the device" not in text
        ]


class HeldUp(LoggedDevice):
    """A driver stopped while it ramps a force down because nobody answers."""

    def strike(self, rig: Rig) -> None:
        """Stop the coupling, then the driver during its ramp, and continue both; several times."""
        self.struck(rig)
        for seconds in HELD_UP:
            coupling = rig.kill("coupling", signal.SIGSTOP)
            _await_way_down(rig)
            driver = rig.kill("driver", signal.SIGSTOP)
            await_strike(
                lambda driver=driver: state_of(Path(f"/proc/{driver}")) == "T",  # type: ignore[misc]
                "the driver stopped",
            )
            rig.let_pass(seconds)
            os.kill(driver, signal.SIGCONT)
            rig.let_pass(0.1)
            os.kill(coupling, signal.SIGCONT)
            wait_for(
                lambda: rig.states[-1].safety == "active", "forces to come back", 15.0
            )
        self.ended()


def _await_way_down(rig: Rig) -> None:
    """Wait until a force is being ramped down (100 ms), polling every millisecond."""
    until = time.monotonic() + 5.0
    while time.monotonic() < until:
        state = rig.states[-1]
        if state.safety in ("damping", "zero") and any(state.force):
            return
        time.sleep(0.001)
    raise MeasurementError("not struck: a force that is taken down not within 5 s")


class Inside(LoggedDevice):
    """A device inside the wall when its driver starts, and when it restarts."""

    def change(self, content: dict[str, Any]) -> None:
        """Start at the hand's target, where the law requests 5 N at once."""
        super().change(content)
        content["nodes"]["driver"]["parameters"]["device"]["position"] = INSIDE

    def strike(self, rig: Rig) -> None:
        """Kill the driver, so that another one finds the device inside."""
        self.struck(rig)
        kill("driver")(rig)
        wait_for(
            lambda: rig.states[-1].safety == "active" and any(rig.states[-1].force),
            "forces to come back",
            15.0,
        )
        if not any(read_log(self._path, 1.0 / RATE)[0].write.force):
            raise MeasurementError(
                "not struck: the first force is zero, so that no ramp was due"
            )
        self.ended()


class Moved(LoggedDevice):
    """A wall that is moved while a hand presses into it."""

    def strike(self, rig: Rig) -> None:
        """Move it towards the hand and away, each time with another force step."""
        self.struck(rig)
        moved_at = []
        for place in PLACES:
            receipt = rig.call(
                "environment", "param.set", values={"surface.position": place}
            )
            moved_at.append(int(receipt["seq"]))
            rig.let_pass(3.0 * SafetyParameters().recovery)
        await_strike(
            lambda: rig.errors.count("a force step of") >= len(PLACES),
            "the force step of each move",
        )
        self.ended()
        self.wrong = [
            *self.wrong,
            *pushed(read_log(self._path, 1.0 / RATE), moved_at)[0],
        ]


class Vague(LoggedDevice):
    """A device whose `condition` raises: its driver ends softly and is restarted."""

    def strike(self, rig: Rig) -> None:
        """Make `condition` raise until the driver has ended."""
        self.struck(rig)
        before = rig.pid("driver")
        order = rig.folder / ORDER
        order.write_text(f"{FAILS}condition", encoding="ascii")
        await_strike(
            lambda: "condition() of the device failed" in rig.errors,
            "what the driver says",
        )
        await_strike(
            lambda: "driver: ended with exit code 1" in rig.errors,
            "the end of the driver",
        )
        order.unlink()
        last = read_log(self._path, 1.0 / RATE)[-1]
        await_another(rig, "driver", before)
        self.ended()
        if any(last.write.force):
            self.wrong = [
                *self.wrong,
                f"{last.write.force} N were left on it by a driver that ended",
            ]


class Apart:
    """Two devices that are apart when their driver starts, and when it restarts."""

    def change(self, content: dict[str, Any]) -> None:
        """Make the device a pair, whose hands hold it 30 mm apart."""
        driver = content["nodes"]["driver"]
        safety = driver["parameters"]["safety"]
        member = {
            name: {
                "kind": "sim_driver",
                "parameters": {
                    "hold": HOLD,
                    "device": {
                        "mass": 0.05,
                        "damping": 0.1,
                        "position": place,
                        "hand": {
                            "mass": 0.1,
                            "damping": 5.0,
                            "stiffness": 500.0,
                            "path": [[0.0, place]],
                        },
                    },
                },
            }
            for name, place in (("first", APART), ("second", 0.0))
        }
        driver["kind"] = "paired_driver"
        driver["parameters"] = {
            "safety": {**safety, "workspace": [[-0.2, 0.2]] * 3, "ramp": None},
            **member,
        }
        content["nodes"]["environment"]["parameters"]["surface"] = {"kind": "anchor"}
        content["run"]["axes"] = ["x"]

    def strike(self, rig: Rig) -> None:
        """Kill the driver, so that another one finds the devices apart."""
        kill("driver")(rig)
        wait_for(
            lambda: rig.errors.count("apart without a motion") >= 2,
            "both drivers align",
            15.0,
        )
        rig.let_pass(1.0)

    def judge(self, states: Sequence[DeviceState]) -> list[str]:
        """Return force jumps: each tick of the offset adds K·v·T, and B·v once."""
        wrong = []
        for before, after in pairwise(states):
            ticks = after.seq - before.seq
            step = abs(after.force[0] - before.force[0])
            # The law is K = 1000 N/m, B = 3 N s/m; the offset fades at 0.05 m/s, and the hands
            # move no faster.
            allowed = 2.0 * (1000.0 * 0.05 / RATE * ticks + 3.0 * 0.05)
            if ticks > 0 and after.force[0] != 0.0 and step > allowed:
                wrong.append(
                    f"the force changed by {step:.3g} N in {ticks} ticks, which the fading offset"
                    f" makes {allowed:.3g} N"
                )
        return wrong[:3]


def faults() -> list[Fault]:
    """Return the faults of this module."""
    rows: list[tuple[Any, str, str]] = [
        (
            Inside(),
            "start inside",
            (
                f"a device {-1e3 * INSIDE:g} mm inside of the wall, its driver killed: another"
                " finds it so"
            ),
        ),
        (
            Moved(),
            "moved surface",
            f"the wall moved {len(PLACES)} times by up to 3 mm while a hand presses",
        ),
        (
            Apart(),
            "start apart",
            f"a pair {1e3 * APART:g} mm apart, its driver killed: another finds it so",
        ),
        (
            HeldUp(TAKEN_DOWN),
            "held up on the way down",
            "driver stopped 0.2 to 0.9 s while it takes a force down",
        ),
        (Vague(), "vague device", "condition() of the device raises"),
    ]
    return [fault_of(made, name, what) for made, name, what in rows]
