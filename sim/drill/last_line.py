"""Faults of the driver's environment: its output, device, time and parent process."""

import contextlib
import os
import shutil
import signal
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from nodes.base.processor_wait import state_of
from sim.drill.drill import RATE, Fault, await_another, await_strike, fault_of, kill
from sim.drill.faulty_device import EXIT, HANG
from sim.measure.haptic_commands import within
from sim.measure.measured_launch import processes_of
from sim.measure.rig import Rig

ORDER = "order"
HANG_LIMIT = 0.5  # time within a tick after which the device counts as hung [s]
BEHIND = 2.0  # time of a slow disk before the end, during which it stays slow [s]
LOOPED = 3  # messages recorded per tick of the loop
# A quota of 8 % in periods of 0.1 s, less than a plain 500 Hz loop needs [s].
ON, OFF, ROUNDS = 0.008, 0.092, 8
GROUPS = Path("/sys/fs/cgroup")
# Control group root, files that set a processor quota [µs], and files that remove it: version 1
# and 2.
LIMITS = (
    (
        GROUPS / "cpu",
        {"cpu.cfs_period_us": "{period}", "cpu.cfs_quota_us": "{quota}"},
        {"cpu.cfs_quota_us": "-1"},
    ),
    (GROUPS, {"cpu.max": "{quota} {period}"}, {"cpu.max": "max"}),
)
ATTEMPTS = 5  # launches killed during their start, each a little later


def _faulty(content: dict[str, Any]) -> None:
    driver = content["nodes"]["driver"]
    driver["kind"], driver["parameters"]["order"] = "faulty_driver", ORDER
    driver["parameters"]["safety"]["hang"] = HANG_LIMIT


def _break_down(what: str, said: str) -> Callable[[Rig], None]:
    def strike(rig: Rig) -> None:
        before = rig.pid("driver")
        order = rig.folder / ORDER
        order.write_text(what, encoding="ascii")
        await_strike(lambda: said in rig.errors, f"“{said}” of the driver", 15.0)
        order.unlink()
        await_another(rig, "driver", before)

    return strike


def _slow_disk(content: dict[str, Any]) -> None:
    logger = content["nodes"]["logger"]
    logger["kind"], logger["parameters"]["order"] = "slow_logger", ORDER


def _fall_behind(rig: Rig) -> None:
    """Make the logger fall so far behind that its end takes longer than a node may take."""

    def behind() -> int:
        return (
            int(rig.call("driver", "status")["ticks"])
            - int(rig.call("logger", "status")["ticks"]) // LOOPED
        )

    before = behind()
    (rig.folder / ORDER).touch()
    rig.let_pass(BEHIND)
    await_strike(
        lambda: behind() > before + RATE * BEHIND / 4.0, "a logger that falls behind"
    )


def _stop_reaper(rig: Rig) -> None:
    reapers = [
        number
        for number, line in processes_of(rig.runtime_dir).items()
        if "reaper.py" in line
    ]
    for number in reapers:
        os.kill(number, signal.SIGSTOP)
    await_strike(
        lambda: {state_of(Path(f"/proc/{number}")) for number in reapers} == {"T"},
        "the reaper stopped",
    )


def _misplace(position: str) -> Callable[[Rig], None]:
    def strike(rig: Rig) -> None:
        order = rig.folder / ORDER
        draft = order.with_suffix(".draft")
        draft.write_text(position, encoding="ascii")
        draft.rename(order)
        await_strike(lambda: rig.states[-1].safety == "fault", "the driver's fault")
        within(lambda: rig.states[-1].safety != "fault", 0.3)
        order.unlink()

    return strike


class _Quota:
    """A control group with a processor quota; without one, stops and continues processes."""

    def __init__(self) -> None:
        self._group: Path | None = None
        for root, self._some, self._none in LIMITS:
            group = root / f"haptic-drill-{os.getpid()}"
            with contextlib.suppress(OSError):
                group.mkdir()
                is_there = all((group / name).exists() for name in self._some)
                group.rmdir()
                if is_there:
                    self._group = group
                    break
        way = (
            "a cgroup"
            if self._group
            else "stopped and continued: no cgroup can be made"
        )
        self.what = (
            f"{ON / (ON + OFF):.0%} of a processor for the loop, no FIFO ({way})"
        )

    def prepare(self) -> Mapping[str, str]:
        if self._group:
            self._group.mkdir()
        return {}

    def strike(self, rig: Rig) -> None:
        """Throttle the loop's processes repeatedly."""
        pids = [rig.pid(node) for node in ("driver", "environment", "coupling")]
        if self._group:
            for pid in pids:
                (self._group / "cgroup.procs").write_text(str(pid), encoding="ascii")
            self._set(self._some)
            rig.let_pass(ROUNDS * (ON + OFF))
            self._set(self._none)
            await_strike(self._throttled, "a loop that is held up by its quota")
            return
        for _ in range(ROUNDS):
            for number, seconds in ((signal.SIGSTOP, OFF), (signal.SIGCONT, ON)):
                for pid in pids:
                    os.kill(pid, number)
                rig.let_pass(seconds)

    def _throttled(self) -> bool:
        assert self._group is not None  # noqa: S101
        stat = (self._group / "cpu.stat").read_text(encoding="ascii")
        return any(
            int(line.split()[1]) > 0
            for line in stat.splitlines()
            if line.startswith("nr_throttled")
        )

    def _set(self, values: Mapping[str, str]) -> None:
        assert self._group is not None  # noqa: S101
        for name, text in values.items():
            value = text.format(period=round(1e6 * (ON + OFF)), quota=round(1e6 * ON))
            (self._group / name).write_text(value, encoding="ascii")

    def tidy(self) -> None:
        if self._group:
            # All its processes have ended.
            with contextlib.suppress(OSError):
                self._group.rmdir()


def no_fifo(content: dict[str, Any]) -> None:
    """Run the loop without FIFO, which quotas and busy processes cannot delay."""
    content["run"]["fifo"] = 0


def _plain(content: dict[str, Any]) -> None:
    """Use plain ticks: compiled ones at 500 Hz can run within the quota."""
    no_fifo(content)
    content["run"]["tick"] = "plain"


def _kill_at_start(rig: Rig) -> None:
    """Start launches beside this one, and kill launcher and reaper while nodes start."""
    own = {path.parent for path in rig.runtime_dir.rglob("run.json")}
    ours = processes_of(rig.runtime_dir)

    def others() -> dict[int, str]:
        return {
            number: line
            for number, line in processes_of(rig.runtime_dir).items()
            if number not in ours
        }

    for attempt in range(ATTEMPTS):
        launcher = rig.beside("launch", str(rig.folder / "drill.yaml"), "--no-plot")
        try:
            await_strike(
                lambda attempt=attempt: len(others()) > attempt,  # type: ignore[misc]
                "nodes of a launch that starts",
                15.0,
            )
            for number, line in others().items():
                if "reaper.py" in line:
                    with contextlib.suppress(ProcessLookupError):
                        os.kill(number, signal.SIGKILL)
        finally:
            launcher.kill()
            launcher.wait()
    within(lambda: not others(), 10.0)
    if not others():
        # Directories of a killed launcher are swept by the next launch only after a minute.
        for path in {path.parent for path in rig.runtime_dir.rglob("*.json")} - own:
            shutil.rmtree(path, ignore_errors=True)


def faults() -> list[Fault]:
    """Return the faults of this module."""
    quota = _Quota()
    return [
        Fault(
            "blocked stderr",
            "coupling killed, output unread",
            kill("coupling"),
            unread=True,
        ),
        Fault(
            "hung device",
            "a force that is never taken",
            _break_down(HANG, "[driver] hung: "),
            change=_faulty,
        ),
        Fault(
            "driver exits",
            "exit(0) within a device's call",
            _break_down(EXIT, "in mid-run"),
            change=_faulty,
        ),
        Fault(
            "slow logger",
            f"{BEHIND:g} s of a slow disk, then the end",
            _fall_behind,
            change=_slow_disk,
        ),
        Fault("stopped reaper", "SIGSTOP, then the end", _stop_reaper),
        Fault(
            "huge position",
            "the device gives 1.7e308 m",
            _misplace("1.7e308"),
            change=_faulty,
        ),
        fault_of(quota, "ticks lost by quota", quota.what, change=_plain),
        Fault(
            "killed in start-up", "launcher and reaper of 5 launches", _kill_at_start
        ),
    ]
