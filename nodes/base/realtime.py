"""Kernel settings for a loop: one core for the chain, FIFO scheduling, exact timers.

Pinning driver, environment and coupling, their I/O threads included, to one core gives most of the
gain in the median and needs no privilege. FIFO reduces the tail from milliseconds to half of one,
but only together with pinning. Both are inherited by threads created later, so they are set before
the ZeroMQ context.
"""

import contextlib
import ctypes
import functools
import gc
import os
import signal
import sys
import time
from collections.abc import Collection, Iterator
from pathlib import Path

from messages.transport.context import ASIDE
from nodes.base.setup import Scheduling

PR_SET_PDEATHSIG = 1

# a process that holds it open limits the time to wake a processor [µs] (PM QoS)
WAKE_LATENCY = "/dev/cpu_dma_latency"


def apply(scheduling: Scheduling) -> list[str]:
    """Set affinity, scheduler and timer slack of the calling thread; return what was refused."""
    refused = []
    if scheduling.cpus:
        try:
            os.sched_setaffinity(0, scheduling.cpus)
        except OSError as error:
            refused.append(
                f"processors {scheduling.cpus}: {error.strerror}; the node runs on any processor"
            )
    if scheduling.fifo:
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(scheduling.fifo))
        except OSError as error:
            refused.append(
                f"SCHED_FIFO {scheduling.fifo}: {error.strerror}; see haptic doctor"
            )
    try:
        Path("/proc/self/timerslack_ns").write_text("1", encoding="ascii")
    except OSError as error:
        refused.append(
            f"timer slack 1 ns: {error.strerror}; ticks come about 50 µs later"
        )
    return refused


def quietest_processor(interrupts: str = "/proc/interrupts") -> int:
    """Return the available processor with the fewest device interrupts, which delay ticks."""
    available = os.sched_getaffinity(0)
    counts = dict.fromkeys(sorted(available), 0)
    try:
        with open(interrupts, encoding="ascii", errors="replace") as table:
            columns = [
                int(name.removeprefix("CPU")) for name in table.readline().split()
            ]
            for line in table:
                name, *numbers = line.split()[: len(columns) + 1]
                # timers and calls between processors have names, and follow the load
                if name.rstrip(":").isdigit():
                    for processor, number in zip(columns, numbers, strict=False):
                        if processor in counts:
                            counts[processor] += int(number)
    except OSError:
        return max(available)
    return min(reversed(counts), key=counts.__getitem__)


@contextlib.contextmanager
def off(processors: Collection[int]) -> Iterator[None]:
    """Exclude the calling thread, and what it starts, from a loop's processors.

    No priority interrupts a system call of another process.
    """
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, before - set(processors) or before)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


@contextlib.contextmanager
def awake() -> Iterator[str]:
    """Prevent processors from sleeping until the block ends; yield the refusal, or "".

    Sleeping delays each tick by 10 µs; staying awake costs power.
    """
    try:
        held = os.open(WAKE_LATENCY, os.O_WRONLY)
    except OSError as error:
        yield f"{WAKE_LATENCY}: {error.strerror}"
        return
    try:
        os.write(held, (0).to_bytes(4, sys.byteorder))
        yield ""
    finally:
        os.close(held)


def step_aside(scheduling: Scheduling) -> None:
    """Move the calling thread off the chain's core and below its priority.

    It stays above other processes, because it may hold the GIL.
    """
    if scheduling.aside:
        # refused as `cpus` is if the node was started on other processors, which `apply` reports
        with contextlib.suppress(OSError):
            os.sched_setaffinity(0, scheduling.aside)
    if os.sched_getscheduler(0) == os.SCHED_FIFO:
        priority = max(1, os.sched_getparam(0).sched_priority - ASIDE)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))


def quiet_interpreter() -> None:
    """Minimise the interpreter's own work in ticks: no old garbage, fast thread switches."""
    # not collected before: of 26 000 objects 500 are garbage, and finding them takes 5 to 10 ms
    gc.freeze()
    # From here on a few at a time, whatever the settings at start: those of a command are rare.
    gc.set_threshold(700, 10, 10)
    gc.enable()
    # The control thread must release the GIL within a fraction of a tick (default: 5 ms).
    sys.setswitchinterval(5e-5)


def die_with_parent(parent: int | None = None) -> None:
    """Request SIGTERM from the kernel when the launcher dies, so that no node outlives it."""
    parent = os.getppid() if parent is None else parent
    ctypes.CDLL(None, use_errno=True).prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != parent:
        raise SystemExit(128 + signal.SIGTERM)


def sleep_until(deadline: float) -> float:
    """Sleep until an absolute time [s]. Return the time of waking."""
    now = time.monotonic()
    while now < deadline:
        time.sleep(deadline - now)
        now = time.monotonic()
    return now


@functools.cache
def _statm() -> int:
    return os.open("/proc/self/statm", os.O_RDONLY | os.O_CLOEXEC)


def memory_bytes() -> int:
    """Return the resident memory of this process [bytes], without opening a file.

    The file stays open, so that a process without free descriptors can still report.
    """
    pages = int(os.pread(_statm(), 256, 0).split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")
