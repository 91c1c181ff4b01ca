"""Faults of what the driver stands on: its output, its device, its time, its parent."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
from collections.abc import Callable
from typing import Any

from sim.drill.drill import Fault, another, kill
from sim.drill.faulty_device import HANG
from sim.measure.launches import processes_of, within
from sim.measure.rig import Rig

ORDER = "order"
HANG_LIMIT = 0.5
"""After so long within one tick the drill's device is taken to hang [s]."""

ON, OFF, ROUNDS = 0.015, 0.085, 8
"""A quota of 15 % in periods of 0.1 s [s]."""

ATTEMPTS = 5
"""Launches killed while they start, each a little later."""


def _faulty(content: dict[str, Any]) -> None:
    driver = content["nodes"]["driver"]
    driver["kind"] = "faulty_driver"
    driver["parameters"]["order"] = ORDER
    driver["parameters"]["safety"]["hang"] = HANG_LIMIT


def _hang(rig: Rig) -> None:
    before = rig.pid("driver")
    order = rig.folder / ORDER
    order.write_text(HANG, encoding="ascii")
    within(lambda: "[driver] hung: " in rig.errors, 15.0)
    order.unlink()
    within(lambda: another(rig, "driver", before), 15.0)


def _misplace(position: str) -> Callable[[Rig], None]:
    def strike(rig: Rig) -> None:
        order = rig.folder / ORDER
        draft = order.with_suffix(".draft")
        draft.write_text(position, encoding="ascii")
        draft.rename(order)
        within(lambda: rig.states[-1].safety == "fault", 5.0)
        within(lambda: rig.states[-1].safety != "fault", 0.3)
        order.unlink()

    return strike


def _quota(rig: Rig) -> None:
    """Hold up all that share the loop's quota, again and again."""
    pids = [rig.pid(node) for node in ("driver", "environment", "coupling")]
    for _ in range(ROUNDS):
        for number, seconds in ((signal.SIGSTOP, OFF), (signal.SIGCONT, ON)):
            for pid in pids:
                os.kill(pid, number)
            within(lambda: rig.process.poll() is not None, seconds)


def _kill_at_start(rig: Rig) -> None:
    """Start launches beside this one, and kill launcher and reaper of each while its nodes are being started."""
    own = {path.parent for path in rig.runtime_dir.rglob("run.json")}
    ours = processes_of(rig.runtime_dir)

    def others() -> dict[int, str]:
        return {number: line for number, line in processes_of(rig.runtime_dir).items() if number not in ours}

    for attempt in range(ATTEMPTS):
        launcher = rig.beside("launch", str(rig.folder / "drill.yaml"), "--no-plot")
        within(lambda attempt=attempt: len(others()) > attempt, 15.0)  # type: ignore[misc]
        for number, line in others().items():
            if "reaper.py" in line:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(number, signal.SIGKILL)
        launcher.kill()
        launcher.wait()
    within(lambda: not others(), 10.0)
    if not others():
        # The directories that a killed launcher leaves are the next launch's to sweep, after a minute.
        for path in {path.parent for path in rig.runtime_dir.rglob("*.json")} - own:
            shutil.rmtree(path, ignore_errors=True)


def faults() -> list[Fault]:
    """List them."""
    return [
        Fault(
            name="blocked stderr",
            what="coupling killed, output unread",
            strike=kill("coupling"),
            unread=True,
        ),
        Fault(name="hung device", what="a force that is never taken", strike=_hang, change=_faulty),
        Fault(name="huge position", what="the device gives 1.7e308 m", strike=_misplace("1.7e308"), change=_faulty),
        Fault(name="ticks lost by quota", what="85 of every 100 ms without a processor", strike=_quota),
        Fault(name="killed in start-up", what="launcher and reaper of 5 launches", strike=_kill_at_start),
    ]
