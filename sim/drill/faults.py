"""The faults of the drill, each injected into real processes from outside."""

import contextlib
import ctypes.util
import mmap
import os
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from nodes.base.processor_wait import state_of
from sim.drill import begins, devices, held_up, intruders, last_line, overload, people
from sim.drill.drill import (
    Fault,
    FaultSkippedError,
    await_strike,
    fault_of,
    kill,
    with_link,
)
from sim.measure.haptic_commands import within
from sim.measure.rig import Rig

STOPPED = 0.3  # duration of a node's stop, a link's fault, a processor's loss [s]
ENOUGH = 10  # affected forces from which a link's fault counts as visible


def _stop(node: str) -> Callable[[Rig], None]:
    def strike(rig: Rig) -> None:
        pid = rig.kill(node, signal.SIGSTOP)
        await_strike(lambda: state_of(Path(f"/proc/{pid}")) == "T", f"{node} stopped")
        rig.let_pass(STOPPED)
        os.kill(pid, signal.SIGCONT)

    return strike


def _bad_link(
    count: Callable[[Rig], int], shows: str, **values: float
) -> Callable[[Rig], None]:
    """Return a strike that sets a link's faults until `count` shows their effect."""

    def strike(rig: Rig) -> None:
        before = count(rig)
        rig.call("link", "param.set", values=values)
        rig.let_pass(STOPPED)
        await_strike(lambda: count(rig) > before + ENOUGH, shows)
        rig.call("link", "param.set", values=dict.fromkeys(values, 0))

    return strike


def _counted(node: str, counter: str) -> Callable[[Rig], int]:
    return lambda rig: int(rig.call(node, "status")[counter])


def _surplus(rig: Rig) -> int:
    """Return the number of forces that a driver received beyond one per tick."""
    status = rig.call("driver", "status")
    return int(status["received"]) - int(status["ticks"])


def _missed(rig: Rig) -> int:
    return rig.states[-1].missed


class _SmallDisk:
    """A file system of 300 KB for the logger; without mount permission, a file size limit."""

    def __init__(self) -> None:
        self.folder = ""
        self.mounted = False

    def prepare(self) -> Mapping[str, str]:
        self.folder = tempfile.mkdtemp(prefix="haptic-disk-")
        command = ["mount", "-t", "tmpfs", "-o", "size=300k", "tmpfs", self.folder]
        allowed = shutil.which("mount") is not None
        self.mounted = (
            allowed
            and subprocess.run(command, capture_output=True, check=False).returncode
            == 0
        )
        return {}

    def change(self, content: dict[str, Any]) -> None:
        content["nodes"]["logger"]["parameters"]["path"] = f"{self.folder}/run.mcap"
        content["nodes"]["logger"]["respawn"] = False

    def strike(self, rig: Rig) -> None:
        pid = rig.pid("logger")
        if not self.mounted:
            resource.prlimit(pid, resource.RLIMIT_FSIZE, (300_000, 300_000))
        else:
            # Fill the space that the recording leaves.
            with (
                contextlib.suppress(OSError),
                open(f"{self.folder}/filler", "wb") as filler,
            ):
                while True:
                    filler.write(bytes(4096))
                    filler.flush()
        if not within(lambda: "logger: ended with" in rig.errors, 30.0):
            raise FaultSkippedError(
                "the logger did not notice the full disk within 30 s"
            )

    def tidy(self) -> None:
        if self.folder:
            if self.mounted:
                subprocess.run(
                    ["umount", self.folder], capture_output=True, check=False
                )
            shutil.rmtree(self.folder, ignore_errors=True)


@contextlib.contextmanager
def _hogs() -> Iterator[list[subprocess.Popen[bytes]]]:
    """Run four busy processes per processor."""
    command = [sys.executable, "-S", "-c", "while True: pass"]
    hogs = [subprocess.Popen(command) for _ in range(4 * len(os.sched_getaffinity(0)))]
    try:
        yield hogs
    finally:
        for hog in hogs:
            hog.kill()
        for hog in hogs:
            hog.wait()


def _starve(rig: Rig) -> None:
    with _hogs() as hogs:
        rig.let_pass(3 * STOPPED)
        await_strike(
            lambda: all(hog.poll() is None for hog in hogs), "all processors busy"
        )


CLOCK = """
#define _GNU_SOURCE
#include <dlfcn.h>
#include <fcntl.h>
#include <stdlib.h>
#include <sys/mman.h>
#include <sys/time.h>
#include <time.h>
#include <unistd.h>
static volatile double *offset;
__attribute__((constructor)) static void begin(void) {
    int file = open(getenv("HAPTIC_DRILL_CLOCK"), O_RDONLY);
    void *page = mmap(0, sizeof(double), PROT_READ, MAP_SHARED, file, 0);
    if (page != MAP_FAILED) offset = page;
    close(file);
}
int clock_gettime(clockid_t clock, struct timespec *now) {
    static int (*real)(clockid_t, struct timespec *);
    if (!real) real = (int (*)(clockid_t, struct timespec *)) dlsym(RTLD_NEXT, "clock_gettime");
    int code = real(clock, now);
    if (!code && offset && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE))
        now->tv_sec += (long) *offset;
    return code;
}
int gettimeofday(struct timeval *restrict now, void *restrict zone) {
    struct timespec t;
    (void) zone;
    clock_gettime(CLOCK_REALTIME, &t);
    now->tv_sec = t.tv_sec;
    now->tv_usec = t.tv_nsec / 1000;
    return 0;
}
time_t time(time_t *out) {
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    if (out) *out = t.tv_sec;
    return t.tv_sec;
}
"""


class SteppedClock:
    """Steps the wall clock of the launch's processes with a preloaded C library."""

    def __init__(self) -> None:
        self.folder = ""

    def prepare(self) -> Mapping[str, str]:
        """Compile the library; return the environment variables that load it."""
        compiler = shutil.which("cc") or shutil.which("gcc")
        if compiler is None or ctypes.util.find_library("c") is None:
            raise FaultSkippedError(
                "no C compiler (cc): the clock is stepped by a small library that must be compiled"
            )
        # as the kernel names it
        self.folder = os.path.realpath(tempfile.mkdtemp(prefix="haptic-clock-"))
        source, library, self._offset = (
            Path(self.folder) / name for name in ("clock.c", "clock.so", "offset")
        )
        source.write_text(CLOCK, encoding="ascii")
        self._offset.write_bytes(bytes(mmap.PAGESIZE))
        done = subprocess.run(
            [compiler, "-shared", "-fPIC", "-O1", "-o", library, source, "-ldl"],
            capture_output=True,
            text=True,
            check=False,
        )
        if done.returncode:
            raise FaultSkippedError(
                f"{compiler} cannot compile the clock: {done.stderr[-300:]}"
            )
        return {"LD_PRELOAD": str(library), "HAPTIC_DRILL_CLOCK": str(self._offset)}

    def strike(self, rig: Rig) -> None:
        """Step the clock back, forward, and to the right time."""
        maps = Path(f"/proc/{rig.pid('driver')}/maps")
        await_strike(
            lambda: f"{self.folder}/clock.so" in maps.read_text(errors="replace"),
            "the driver under the stepped clock",
        )
        for seconds in (-3600.0, 7200.0, 0.0):
            self.step(seconds)
            rig.let_pass(STOPPED)

    def step(self, seconds: float) -> None:
        """Set the offset to the machine's clock [s]."""
        with open(self._offset, "r+b") as file:
            file.write(struct.pack("d", seconds))

    def tidy(self) -> None:
        """Remove the library."""
        if self.folder:
            shutil.rmtree(self.folder, ignore_errors=True)


def faults() -> list[Fault]:
    """Return all faults of the drill."""
    chain = ("driver", "environment", "coupling", "logger")
    disk = _SmallDisk()
    clock = SteppedClock()

    def link(
        name: str, what: str, count: Callable[[Rig], int], shows: str, **values: float
    ) -> Fault:
        return Fault(name, what, _bad_link(count, shows, **values), change=with_link)

    lost = _counted("link", "skipped")
    refused = _counted("driver", "refused")

    return [
        *(Fault(f"kill {node}", "SIGKILL, respawned", kill(node)) for node in chain),
        *(
            Fault(f"stop {node}", f"SIGSTOP for {STOPPED:g} s", _stop(node))
            for node in chain
        ),
        link(
            "flood",
            "300 old forces after each force",
            _surplus,
            "old forces at the driver",
            flood=300,
        ),
        link("dead link", "every force lost", lost, "forces lost", drop=1.0),
        link("lossy link", "every third force lost", lost, "forces lost", drop=0.33),
        link(
            "slow link", "20 ms late, limit 10 ms", _missed, "late forces", delay=0.02
        ),
        link(
            "reordering link",
            "up to 12 ms late, overtaking",
            _missed,
            "late forces",
            jitter=0.012,
        ),
        link(
            "garbage",
            "every second force with a bit flipped",
            refused,
            "forces refused as malformed",
            corrupt=0.5,
        ),
        fault_of(disk, "full disk", "no room under the logger", exit_code=1),
        fault_of(clock, "clock step", "wall clock −1 h, +2 h"),
        Fault(
            "starvation",
            "4 busy processes per core, no FIFO",
            _starve,
            change=last_line.no_fifo,
        ),
        *overload.faults(),
        *last_line.faults(),
        *intruders.faults(),
        *people.faults(),
        *held_up.faults(),
        *devices.faults(),
        *begins.faults(),
    ]
