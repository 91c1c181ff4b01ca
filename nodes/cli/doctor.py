"""Check this machine's real-time settings, and print remedies for those it refuses."""

import argparse
import contextlib
import ctypes
import os
import platform
import resource
import sys
import sysconfig
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal, NamedTuple

from nodes.base import realtime
from nodes.base.node_kinds import NODES, load, node_kinds
from nodes.base.setup import Scheduling
from nodes.base.wake_ups import wake_ups
from nodes.cli.main import VERBS, add_json, answer
from nodes.compiled.build import expected_seconds, find, reason
from nodes.compiled.cache import CacheRefusedError, folder
from nodes.launcher.runs import MAX_IPC_PATH, RunError, runtime_dir
from nodes.launcher.wiring import FIFO
from nodes.parameters.installed import OURS, groups
from nodes.parameters.registry import NotInstalledError, Registry

DISTRIBUTION = ("/usr",)  # where the interpreters of distributions are installed

LATE = 200e-6  # limit of a wake-up's lateness: a tenth of a tick at 500 Hz [s]
# Descriptors that a node needs at most, encrypted connections to many subscribers included.
OPEN_FILES = 256
# Bytes that a run adds to the runtime directory's path: scenario of 16 characters, time, socket.
RUN_NAME = 83


class Diagnosis(NamedTuple):
    """Result of one check."""

    # As it should be; works, but costs punctuality; or essential and missing.
    state: Literal["ok", "limited", "missing"]
    found: str  # value, or why it was refused
    remedy: str = ""  # what to do; empty if nothing


def add(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments."""
    parser.add_argument(
        "--report",
        action="store_true",
        help="print what a bug report needs: versions, machine, load, configuration; as Markdown",
    )
    add_json(parser)
    parser.set_defaults(run=run)


def _read(path: str) -> str | None:
    try:
        return Path(path).read_text(encoding="utf-8").strip()
    except OSError:
        return None


def _limit(kind: int) -> str:
    soft, hard = (
        ("unlimited" if value == resource.RLIM_INFINITY else str(value))
        for value in resource.getrlimit(kind)
    )
    return f"{soft} (hard limit {hard})"


def _fifo() -> Diagnosis:
    allowed = resource.getrlimit(resource.RLIMIT_RTPRIO)[0]
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(FIFO))
    except OSError as error:
        return Diagnosis(
            "limited",
            f"priority {FIFO} refused: {error.strerror} (rtprio limit {allowed})",
            "put '@realtime - rtprio 90' into /etc/security/limits.d/realtime.conf, add yourself to"
            " the group realtime and log in again; in a container: --cap-add SYS_NICE --ulimit"
            " rtprio=90. Until then another process may cost ticks",
        )
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return Diagnosis(
        "ok", f"priority {FIFO} granted (rtprio limit {allowed}; root needs none)"
    )


def _throttling() -> Diagnosis:
    runtime = _read("/proc/sys/kernel/sched_rt_runtime_us")
    period = _read("/proc/sys/kernel/sched_rt_period_us")
    if runtime is None or period is None:
        return Diagnosis("ok", "not readable here")
    if int(runtime) < 0:
        return Diagnosis("ok", "off")
    return Diagnosis(
        "ok",
        f"FIFO may use {runtime} of every {period} µs, enough for one loop with a fixed rate;"
        " several on one processor may use it up, which shows as gaps of some 50 ms; lockstep,"
        " which never sleeps, therefore runs without FIFO",
    )


def _processors() -> Diagnosis:
    available = sorted(os.sched_getaffinity(0))
    isolated = _read("/sys/devices/system/cpu/isolated")
    text = f"{len(available)} of {os.cpu_count()} available: {', '.join(map(str, available))}"
    text += f"; isolated: {isolated}" if isolated else ""
    if len(available) < 2:
        remedy = (
            "add a second processor: with one, loggers and plots share it with the chain"
            " driver-environment-coupling"
        )
        return Diagnosis("limited", text, remedy)
    try:
        os.sched_setaffinity(0, available[-1:])
        os.sched_setaffinity(0, available)
    except OSError as error:
        return Diagnosis(
            "limited",
            f"{text}; pinning refused: {error.strerror}",
            "allow sched_setaffinity in the container",
        )
    return Diagnosis(
        "ok", f"{text}; the chain is pinned to {realtime.quietest_processor()}"
    )


def _governor() -> Diagnosis:
    core = realtime.quietest_processor()
    governor = _read(f"/sys/devices/system/cpu/cpu{core}/cpufreq/scaling_governor")
    if governor is None:
        return Diagnosis(
            "ok", "not readable here (a virtual machine, or fixed by the firmware)"
        )
    if governor == "performance":
        return Diagnosis("ok", governor)
    remedy = (
        "sudo cpupower frequency-set -g performance: a core that lowers its clock between ticks"
        " answers late"
    )
    return Diagnosis("limited", f"{governor} on processor {core}", remedy)


def _sleep() -> Diagnosis:
    with realtime.awake() as refused:
        if not refused:
            return Diagnosis("ok", f"can be kept awake ({realtime.WAKE_LATENCY})")
    remedy = (
        f"write access to {realtime.WAKE_LATENCY} (a udev rule, or root); without it, answers come"
        " some 10 µs later"
    )
    return Diagnosis("limited", refused, remedy)


def _preemption() -> Diagnosis:
    models = [
        word
        for word in ("PREEMPT_RT", "PREEMPT_DYNAMIC", "PREEMPT")
        if word in platform.version().split()
    ]
    models += ["PREEMPT_RT"] if _read("/sys/kernel/realtime") == "1" else []
    unknown = "preemption model not named in its version; see the wake-ups below"
    return Diagnosis("ok", f"{platform.release()}, {models[0] if models else unknown}")


def _open_files() -> Diagnosis:
    soft = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    limit = _limit(resource.RLIMIT_NOFILE)
    if soft != resource.RLIM_INFINITY and soft < OPEN_FILES:
        return Diagnosis(
            "missing", f"{limit}, needed: {OPEN_FILES}", f"ulimit -n {OPEN_FILES}"
        )
    return Diagnosis("ok", limit)


def _runtime() -> Diagnosis:
    try:
        path = runtime_dir()
    except (RunError, OSError) as error:
        return Diagnosis(
            "missing", str(error), "set HAPTIC_RUNTIME_DIR to a writable directory"
        )
    longest = len(os.fsencode(path)) + RUN_NAME
    if longest > MAX_IPC_PATH:
        text = f"{path}: socket paths would reach {longest} bytes, limit {MAX_IPC_PATH}"
        return Diagnosis(
            "missing", text, "set HAPTIC_RUNTIME_DIR to a shorter path, e.g. below /tmp"
        )
    if not os.access(path, os.W_OK | os.X_OK):
        return Diagnosis(
            "missing",
            f"{path}: not writable",
            "set HAPTIC_RUNTIME_DIR to a writable directory",
        )
    return Diagnosis("ok", f"{path}, private")


def _zeromq() -> Diagnosis:
    import zmq

    text = f"pyzmq {zmq.__version__}, libzmq {zmq.zmq_version()}"
    if not zmq.has("ipc"):
        return Diagnosis(
            "missing", f"{text} without ipc", "pip install --force-reinstall pyzmq"
        )
    if not zmq.has("curve"):
        text += " without CURVE (libsodium): no encrypted connections to other machines"
        return Diagnosis(
            "limited", text, "pip install --force-reinstall --only-binary :all: pyzmq"
        )
    return Diagnosis("ok", f"{text} with ipc and CURVE (libsodium)")


def interpreter() -> Diagnosis:
    """Check how this interpreter was built."""
    optimised = "-fprofile-use" in (
        sysconfig.get_config_var("PY_CORE_CFLAGS") or ""
    ) or "--enable-optimizations" in (sysconfig.get_config_var("CONFIG_ARGS") or "")
    text = f"{platform.python_implementation()} {platform.python_version()}"
    if optimised:
        return Diagnosis("ok", f"{text}, built with PGO")
    if sys.base_prefix in DISTRIBUTION:
        # Distributions run the profiling build by hand, so its flags are not in the configuration.
        return Diagnosis("ok", f"{text}, the distribution's build")
    remedy = (
        "use a build with --enable-optimizations (distributions' and uv's are):"
        " nodes answer faster"
    )
    return Diagnosis("limited", f"{text}, built without PGO", remedy)


def _slack() -> Diagnosis:
    slack = ctypes.CDLL(None).prctl(30, 0, 0, 0, 0)  # PR_GET_TIMERSLACK
    if slack == 1:
        return Diagnosis("ok", "1 ns granted")
    remedy = "write access to /proc/self/timerslack_ns; without it, ticks come about 50 µs later"
    return Diagnosis("limited", f"{slack} ns; setting 1 ns refused", remedy)


def _packages() -> Diagnosis:
    """Import what other packages registered, as a launch that names it would."""
    from nodes.environment.surfaces import SURFACES
    from nodes.laws.base import LAWS
    from nodes.laws.derivatives import DERIVATIVES
    from nodes.view.comparison import PLAYERS

    registries = {
        one.group: one for one in (VERBS, NODES, LAWS, SURFACES, DERIVATIVES, PLAYERS)
    }
    broken: dict[str, str] = {}
    found = []
    for group in groups():
        registry = registries.get(group) or Registry(group, group.partition(".")[2])
        for name, point in registry.points().items():
            if point.package != OURS:
                found.append(f"{group} {name}")
                try:
                    registry.load(name)
                except NotInstalledError as error:
                    broken[found[-1]] = str(error)
    if broken:
        remedy = "repair or uninstall what cannot be imported; everything else works"
        return Diagnosis("limited", "; ".join(broken.values()), remedy)
    return Diagnosis("ok", ", ".join(found) or "none")


def _compiled_tick() -> Diagnosis:
    """Check whether compiled ticks are built, so that `run.tick: auto` can use them."""
    modules: set[str] = set()
    for factory in node_kinds().values():
        # A kind that cannot be imported, for any reason, is reported under "other packages".
        with contextlib.suppress(Exception):
            modules |= load(factory).modules({})
    try:
        entries = {module: find(module) for module in sorted(modules)}
    except CacheRefusedError as error:
        remedy = (
            "remove it, or set XDG_CACHE_HOME to a folder that only you can write to"
        )
        return Diagnosis(
            "limited", f"compiled code is not loaded from there: {error}", remedy
        )
    missing = [module for module, entry in entries.items() if entry is None]
    failed = list(filter(None, map(reason, entries.values())))
    if failed:
        return Diagnosis(
            "limited",
            f"cannot be compiled here: {'; '.join(failed)}; auto uses the plain tick",
            "repair what it names (details: python -m nodes.compiled.build MODULE), then haptic"
            " launch floor_drop --tick compiled compiles it again",
        )
    if not missing:
        return Diagnosis(
            "ok", f"built for this version and processor, auto uses it: {folder()}"
        )
    seconds, _ = expected_seconds(missing)
    return Diagnosis(
        "limited",
        f"not built for this version: {', '.join(missing)}; auto uses the plain tick",
        f"haptic launch floor_drop --tick compiled: compiles it once, about {seconds:.0f} s here;"
        " auto uses it from then on",
    )


def _punctuality(measured: dict[str, dict[str, float]]) -> Diagnosis:
    best = measured.get("fifo", measured["normal"])
    text = "; ".join(
        f"{name}: p50 {late['p50']:.0f}, p99 {late['p99']:.0f}, max {late['max']:.0f} µs late"
        for name, late in measured.items()
    )
    if best["p99"] <= LATE * 1e6:
        return Diagnosis("ok", text)
    return Diagnosis(
        "limited",
        text,
        "stop other programs on this machine, and see SCHED_FIFO, CPU governor and kernel above",
    )


# Checks made, in this order, before wake-ups are measured.
CHECKS: dict[str, Callable[[], Diagnosis]] = {
    "Python": interpreter,
    "ZeroMQ": _zeromq,
    "other packages": _packages,
    "compiled tick": _compiled_tick,
    "runtime directory": _runtime,
    "open files": _open_files,
    "processors": _processors,
    "SCHED_FIFO": _fifo,
    "RT throttling": _throttling,
    "CPU governor": _governor,
    "idle processors": _sleep,
    "kernel": _preemption,
    "locked memory": lambda: Diagnosis(
        "ok", f"{_limit(resource.RLIMIT_MEMLOCK)} bytes; nodes lock none"
    ),
}


def _findings(measured: dict[str, dict[str, float]]) -> dict[str, Diagnosis]:
    findings = {name: check() for name, check in CHECKS.items()}
    # As a node of the chain runs: pinned, and with FIFO if granted.
    cpus = [realtime.quietest_processor()]
    realtime.apply(Scheduling(cpus=cpus))
    measured["normal"] = wake_ups()
    findings["timer slack"] = _slack()
    if not any(
        "FIFO" in refused
        for refused in realtime.apply(Scheduling(cpus=cpus, fifo=FIFO))
    ):
        measured["fifo"] = wake_ups()
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    return findings | {"wake-ups": _punctuality(measured)}


def run(arguments: argparse.Namespace) -> int:
    """Run the verb."""
    if not sys.platform.startswith("linux"):
        text = f"{sys.platform}: haptic nodes run on Linux only"
        answer(
            arguments.json,
            {"fine": False, "checks": [], "wake_up_us": {}, "error": text},
            text,
        )
        return 1
    from nodes.cli.bug_report import gathered, markdown

    # Before this process is pinned, and before its own load.
    found = gathered() if arguments.report else {}
    measured: dict[str, dict[str, float]] = {}
    findings = _findings(measured)
    states = [finding.state for finding in findings.values()]
    fine = "missing" not in states
    limited = states.count("limited")
    marks = {"ok": "ok ", "limited": "!  ", "missing": "NO "}
    lines = []
    for name, finding in findings.items():
        lines.append(f"{marks[finding.state]} {name:18} {finding.found}")
        lines += [f"    {'':18} → {finding.remedy}"] if finding.remedy else []
    verdict = "nothing essential is missing" if fine else "a loop cannot run here"
    lines.append(
        f"{verdict}{f'; {limited} settings could be better' if limited else ''}"
    )
    checks = [{"name": name, **finding._asdict()} for name, finding in findings.items()]
    figures: dict[str, Any] = {"fine": fine, "checks": checks, "wake_up_us": measured}
    text = "\n".join(lines)
    if arguments.report:
        text = f"{markdown(found, checks)}\n\n{verdict}"
    answer(arguments.json, figures | found, text)
    return 0 if fine else 1
