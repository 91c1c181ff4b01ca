"""Tell what real-time settings this machine grants a loop, and what to do about those it refuses."""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import os
import platform
import resource
import sys
import sysconfig
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from nodes.base import realtime
from nodes.base.node_kinds import load, node_kinds
from nodes.base.setup import Scheduling
from nodes.cli.main import add_json, answer
from nodes.compiled.build import find
from nodes.compiled.cache import CacheRefusedError, folder
from nodes.launcher.runs import MAX_IPC_PATH, RunError, runtime_dir
from nodes.launcher.wiring import FIFO
from nodes.parameters.installed import OURS, groups
from nodes.parameters.registry import NotInstalledError, Registry
from nodes.parameters.store import ParameterError

DISTRIBUTION = ("/usr",)
"""Where the interpreters of distributions are installed."""

WAKE_UPS = 250
PERIOD = 0.002
"""Wake-ups that are measured, and their period [s]: half a second at 500 Hz."""

LATE = 200e-6
"""A wake-up later than this costs a tenth of a tick at 500 Hz [s]."""

OPEN_FILES = 256
"""Descriptors that a node needs at most, encrypted connections to many listeners included."""

RUN_NAME = 83
"""What a run adds to the runtime directory's path: its name, of a scenario of 16 characters and the time, and a socket's."""


@dataclass(frozen=True)
class Diagnosis:
    """What was found about one setting."""

    name: str  # the setting
    # As it should be; works, but costs punctuality; or essential and not there.
    state: Literal["ok", "limited", "missing"]
    found: str  # value or refusal
    remedy: str = ""  # what to do; empty when nothing is to be done


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    add_json(parser)
    parser.set_defaults(run=run)


def _read(path: str) -> str | None:
    try:
        return Path(path).read_text(encoding="utf-8").strip()
    except OSError:
        return None


def _limit(kind: int) -> str:
    soft, hard = (
        ("unlimited" if value == resource.RLIM_INFINITY else str(value)) for value in resource.getrlimit(kind)
    )
    return f"{soft} (hard limit {hard})"


def _fifo() -> Diagnosis:
    allowed = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO))
    except OSError as error:
        return Diagnosis(
            "SCHED_FIFO",
            "limited",
            f"priority {FIFO} refused: {error.strerror} (rtprio limit {allowed})",
            "put '@realtime - rtprio 90' into /etc/security/limits.d/realtime.conf, add yourself to the group realtime and "
            "log in again; in a container: --cap-add SYS_NICE --ulimit rtprio=90. Until then another process may cost ticks",
        )
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return Diagnosis("SCHED_FIFO", "ok", f"priority {FIFO} granted (rtprio limit {allowed}; root needs none)")


def _throttling() -> Diagnosis:
    runtime, period = _read("/proc/sys/kernel/sched_rt_runtime_us"), _read("/proc/sys/kernel/sched_rt_period_us")
    if runtime is None or period is None:
        return Diagnosis("RT throttling", "ok", "not readable here")
    if int(runtime) < 0:
        return Diagnosis("RT throttling", "ok", "off")
    return Diagnosis(
        "RT throttling",
        "ok",
        f"FIFO may use {runtime} of every {period} µs: no hindrance to one loop with a fixed rate; several on one processor "
        "may use that up, which shows as gaps of some 50 ms; lockstep, which never sleeps, runs without FIFO because of it",
    )


def _processors() -> Diagnosis:
    available = sorted(os.sched_getaffinity(0))
    isolated = _read("/sys/devices/system/cpu/isolated")
    text = f"{len(available)} of {os.cpu_count()} available: {', '.join(map(str, available))}"
    text += f"; isolated: {isolated}" if isolated else ""
    if len(available) < 2:
        return Diagnosis(
            "processors",
            "limited",
            text,
            "give the loop a second one: with one, loggers and plots share it with the chain driver-environment-coupling",
        )
    try:
        os.sched_setaffinity(0, available[-1:])
        os.sched_setaffinity(0, available)
    except OSError as error:
        return Diagnosis(
            "processors",
            "limited",
            f"{text}; pinning refused: {error.strerror}",
            "allow sched_setaffinity in the container",
        )
    return Diagnosis("processors", "ok", f"{text}; the chain is pinned to {realtime.quietest_processor()}")


def _governor() -> Diagnosis:
    core = realtime.quietest_processor()
    governor = _read(f"/sys/devices/system/cpu/cpu{core}/cpufreq/scaling_governor")
    if governor is None:
        return Diagnosis("CPU governor", "ok", "not readable here (a virtual machine, or fixed by the firmware)")
    if governor == "performance":
        return Diagnosis("CPU governor", "ok", governor)
    return Diagnosis(
        "CPU governor",
        "limited",
        f"{governor} on processor {core}",
        "sudo cpupower frequency-set -g performance: a core that clocks down between ticks answers late",
    )


def _sleep() -> Diagnosis:
    with realtime.awake() as refused:
        if not refused:
            return Diagnosis("idle processors", "ok", f"can be kept awake ({realtime.WAKE_LATENCY})")
    return Diagnosis(
        "idle processors",
        "limited",
        refused.partition(";")[0],
        f"write access to {realtime.WAKE_LATENCY} (a udev rule, or root): without, answers come some 10 µs later",
    )


def _preemption() -> Diagnosis:
    version = platform.version()
    model = next((word for word in ("PREEMPT_RT", "PREEMPT_DYNAMIC", "PREEMPT") if word in version.split()), "")
    if not model and _read("/sys/kernel/realtime") == "1":
        model = "PREEMPT_RT"
    if model:
        return Diagnosis("kernel", "ok", f"{platform.release()}, {model}")
    return Diagnosis(
        "kernel",
        "ok",
        f"{platform.release()}, preemption model not named in its version; the wake-ups below show what it is worth",
    )


def _memlock() -> Diagnosis:
    return Diagnosis("locked memory", "ok", f"{_limit(resource.RLIMIT_MEMLOCK)} bytes; nodes lock none")


def _open_files() -> Diagnosis:
    soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    if soft != resource.RLIM_INFINITY and soft < OPEN_FILES:
        return Diagnosis(
            "open files",
            "missing",
            f"{_limit(resource.RLIMIT_NOFILE)}, needed: {OPEN_FILES}",
            f"ulimit -n {OPEN_FILES}",
        )
    return Diagnosis("open files", "ok", _limit(resource.RLIMIT_NOFILE))


def _runtime() -> Diagnosis:
    try:
        path = runtime_dir()
    except (RunError, OSError) as error:
        return Diagnosis(
            "runtime directory", "missing", str(error), "set HAPTIC_RUNTIME_DIR to a directory that you may write to"
        )
    longest = len(os.fsencode(path)) + RUN_NAME
    if longest > MAX_IPC_PATH:
        return Diagnosis(
            "runtime directory",
            "missing",
            f"{path}: socket paths would reach {longest} bytes, limit {MAX_IPC_PATH}",
            "set HAPTIC_RUNTIME_DIR to a shorter path, e.g. below /tmp",
        )
    if not os.access(path, os.W_OK | os.X_OK):
        return Diagnosis(
            "runtime directory", "missing", f"{path}: not writable", "set HAPTIC_RUNTIME_DIR to one that is"
        )
    return Diagnosis("runtime directory", "ok", f"{path}, private")


def _zeromq() -> Diagnosis:
    import zmq

    text = f"pyzmq {zmq.__version__}, libzmq {zmq.zmq_version()}"
    if not zmq.has("ipc"):
        return Diagnosis("ZeroMQ", "missing", f"{text} without ipc", "pip install --force-reinstall pyzmq")
    if not zmq.has("curve"):
        return Diagnosis(
            "ZeroMQ",
            "limited",
            f"{text} without CURVE (libsodium): no encrypted connections to other machines",
            "pip install --force-reinstall --only-binary :all: pyzmq",
        )
    return Diagnosis("ZeroMQ", "ok", f"{text} with ipc and CURVE (libsodium)")


def interpreter() -> Diagnosis:
    """Look at how this interpreter was built."""
    optimised = "-fprofile-use" in (sysconfig.get_config_var("PY_CORE_CFLAGS") or "") or "--enable-optimizations" in (
        sysconfig.get_config_var("CONFIG_ARGS") or ""
    )
    text = f"{platform.python_implementation()} {platform.python_version()}"
    if optimised:
        return Diagnosis("Python", "ok", f"{text}, built with PGO")
    if sys.base_prefix in DISTRIBUTION:
        # Distributions run the profiling build by hand, so that its flags are not in the configuration.
        return Diagnosis("Python", "ok", f"{text}, the distribution's build")
    text += ", built without PGO"
    return Diagnosis(
        "Python",
        "limited",
        text,
        "use a build with --enable-optimizations (distributions' and uv's are): nodes answer faster",
    )


def wake_ups(period: float = PERIOD, count: int = WAKE_UPS) -> dict[str, float]:
    """Measure how late this thread wakes up from sleeping to absolute times."""
    late = []
    start = time.monotonic()
    for k in range(1, count + 1):
        late.append(realtime.sleep_until(start + k * period) - (start + k * period))
    late.sort()
    return {
        "p50": round(late[count // 2] * 1e6, 1),
        "p99": round(late[min(int(0.99 * count), count - 1)] * 1e6, 1),
        "max": round(late[-1] * 1e6, 1),
    }


def _slack() -> Diagnosis:
    slack = ctypes.CDLL(None).prctl(30, 0, 0, 0, 0)  # PR_GET_TIMERSLACK
    if slack == 1:
        return Diagnosis("timer slack", "ok", "1 ns granted")
    return Diagnosis(
        "timer slack",
        "limited",
        f"{slack} ns; setting 1 ns refused",
        "write access to /proc/self/timerslack_ns: ticks come about 50 µs later without",
    )


def _packages() -> Diagnosis:
    """Import what other packages have installed beside us, as a launch would that names it."""
    broken: dict[str, str] = {}
    found = []
    for group in groups():
        registry = Registry(group, group.partition(".")[2])
        for name, point in registry.points().items():
            if point.package != OURS:
                found.append(f"{group} {name}")
                try:
                    registry.load(name)
                except NotInstalledError as error:
                    broken[found[-1]] = str(error)
    if broken:
        return Diagnosis(
            "other packages",
            "limited",
            "; ".join(broken.values()),
            "mend or uninstall what cannot be imported; everything else works meanwhile",
        )
    return Diagnosis("other packages", "ok", ", ".join(found) or "none")


def _compiled_tick() -> Diagnosis:
    """Look whether `run.tick: auto` finds the compiled ticks: it takes what is built, and never waits for the compiler."""
    modules: set[str] = set()
    for factory in node_kinds().values():
        # A kind that cannot be imported is named under "other packages".
        with contextlib.suppress(ParameterError):
            modules |= load(factory).modules({})
    try:
        missing = sorted(module for module in modules if find(module) is None)
    except CacheRefusedError as error:
        return Diagnosis(
            "compiled tick",
            "limited",
            f"compiled code is not taken from there: {error}",
            "remove it, or set XDG_CACHE_HOME to a folder that only you may write to",
        )
    if not missing:
        return Diagnosis("compiled tick", "ok", f"built for this version and processor, auto takes it: {folder()}")
    return Diagnosis(
        "compiled tick",
        "limited",
        f"not built for this version: {', '.join(missing)}; auto takes the plain tick",
        "haptic launch floor_drop --tick compiled: has it compiled once, some ten seconds; auto takes it from then on",
    )


def _punctuality(measured: dict[str, dict[str, float]]) -> Diagnosis:
    best = measured.get("fifo", measured["normal"])
    text = "; ".join(
        f"{name}: p50 {late['p50']:.0f}, p99 {late['p99']:.0f}, max {late['max']:.0f} µs late"
        for name, late in measured.items()
    )
    if best["p99"] <= LATE * 1e6:
        return Diagnosis("wake-ups", "ok", text)
    return Diagnosis(
        "wake-ups",
        "limited",
        text,
        "stop what else runs on this machine, and see SCHED_FIFO, CPU governor and kernel above",
    )


def _findings(measured: dict[str, dict[str, float]]) -> Iterator[Diagnosis]:
    checks: tuple[Callable[[], Diagnosis], ...] = (
        interpreter,
        _zeromq,
        _packages,
        _compiled_tick,
        _runtime,
        _open_files,
        _processors,
        _fifo,
        _throttling,
        _governor,
        _sleep,
        _preemption,
        _memlock,
    )
    for check in checks:
        yield check()
    # As a node of the chain would run: pinned, and with FIFO where it is granted.
    cpus = [realtime.quietest_processor()]
    realtime.apply(Scheduling(cpus=cpus))
    measured["normal"] = wake_ups()
    yield _slack()
    if not any("FIFO" in refused for refused in realtime.apply(Scheduling(cpus=cpus, fifo=FIFO))):
        measured["fifo"] = wake_ups()
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    yield _punctuality(measured)


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    if not sys.platform.startswith("linux"):
        text = f"{sys.platform}: haptic nodes run on Linux only"
        answer(arguments.json, {"fine": False, "checks": [], "wake_up_us": {}, "error": text}, text)
        return 1
    measured: dict[str, dict[str, float]] = {}
    findings = list(_findings(measured))
    fine = all(finding.state != "missing" for finding in findings)
    marks = {"ok": "ok ", "limited": "!  ", "missing": "NO "}
    lines = []
    for finding in findings:
        lines.append(f"{marks[finding.state]} {finding.name:18} {finding.found}")
        if finding.remedy:
            lines.append(f"    {'':18} → {finding.remedy}")
    limited = sum(finding.state == "limited" for finding in findings)
    verdict = "nothing essential is missing" if fine else "a loop cannot run here"
    lines.append(f"{verdict}{f'; {limited} settings could be better' if limited else ''}")
    figures: dict[str, Any] = {
        "fine": fine,
        "checks": [asdict(finding) for finding in findings],
        "wake_up_us": measured,
    }
    answer(arguments.json, figures, "\n".join(lines))
    return 0 if fine else 1
