"""Runs on this machine: their directories, how to find them, and how they are removed.

A run is a private directory (mode 0700) in ``runs`` below the runtime directory. It contains the
sockets, one setup file per node, and ``run.json``, which tells subscribers who publishes what. It
is always removed: by the launcher, by the reaper if the launcher was killed, and by the next launch
if both were killed. Directories without the mark of a run are never touched.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import re
import shutil
import stat
import time
from collections.abc import Callable
from pathlib import Path

import msgspec

from messages import topics
from messages.errors import UsageError
from nodes.base.setup import Setup
from nodes.base.status_report import write_whole
from nodes.parameters.interface_words import interface

MAX_IPC_PATH = 107  # length limit of a Unix socket's path [bytes]
LONGEST_NAME = 32  # length limit of a node's name [letters]
# Length to which a scenario is shortened in run names; file names are limited to 255 bytes.
LONGEST_SCENARIO = 48


class RunError(UsageError):
    """There is no such run, or its directory cannot be used."""


class RunInfo(msgspec.Struct, frozen=True, kw_only=True):
    """Content of ``run.json``."""

    run: str  # its name, unique on the host
    scenario: str  # name of its launch file
    launcher: int  # process number of the launcher
    nodes: dict[str, Setup]  # all nodes by name
    launcher_started: int = 0  # start of the launcher (`started_at`)
    wall_minus_monotonic: float = 0.0  # offset from a stamp to wall time [s]
    manifest: dict[str, str] = {}  # manifest of every recording
    # Namespace of the selected chain (`within`); empty for the whole run.
    namespace: str = ""
    # manifest of a single chain, by namespace
    manifests: dict[str, dict[str, str]] = {}

    @property
    def lives(self) -> bool:
        """Whether its launcher runs."""
        return alive(self.launcher, self.launcher_started)

    @property
    def chosen(self) -> str:
        """Return the name for ``--run``: of the run, or of the selected chain."""
        return f"{self.run}/{self.namespace}" if self.namespace else self.run

    @property
    def processors(self) -> set[int]:
        """Return this host's processors on which the loop has real-time priority."""
        own = [setup.scheduling for setup in self.nodes.values() if not setup.by_hand]
        return {cpu for scheduling in own if scheduling.fifo for cpu in scheduling.cpus}

    def drivers(self) -> list[str]:
        """Return the drivers: the nodes that publish a device state."""
        from nodes.base.node_kinds import drives, load

        return [
            name for name, setup in self.nodes.items() if drives(load(setup.factory))
        ]

    def chains(self) -> list[str]:
        """Return the namespaces of the chains."""
        return list(dict.fromkeys(name.rpartition("/")[0] for name in self.drivers()))

    def within(self, namespace: str) -> RunInfo:
        """Return one chain as a run of its own, with names as seen inside it."""
        namespace = namespace.strip("/")
        inside = {
            name.removeprefix(f"{namespace}/"): setup
            for name, setup in self.nodes.items()
            if name.startswith(f"{namespace}/")
        }
        if not inside:
            known = ", ".join(filter(None, self.chains())) or "none"
            raise RunError(
                f"{self.run}: no namespace {namespace!r}; available: {known}"
            )
        return msgspec.structs.replace(
            self,
            nodes=inside,
            namespace=topics.within(self.namespace, f"/{namespace}")[1:],
            manifest=self.manifests.get(namespace, self.manifest),
        )

    def only_chain(self) -> RunInfo:
        """Return the run as seen inside its only chain; refuse several chains."""
        chains = self.chains()
        if len(chains) > 1:
            raise RunError(
                f"{self.run}: several chains: {', '.join(chains)}; choose one with"
                f" {interface.get().run(f'{self.scenario}/{chains[-1]}')}"
            )
        return self.within(chains[0]) if chains and chains[0] else self

    def publishers(self) -> dict[str, str]:
        """Return the endpoint to subscribe to, by node."""
        return {
            name: setup.listen or setup.publish for name, setup in self.nodes.items()
        }

    def endpoints(self) -> dict[str, str]:
        """Return the endpoint to subscribe to, by topic."""
        from nodes.base.node_kinds import load

        found = {}
        for name, setup in self.nodes.items():
            place = name.rpartition("/")[0]
            loop = (
                topics.within(place, topic) for topic in load(setup.factory).publishes
            )
            for topic in (*loop, topics.status(name), topics.event(name)):
                found[topic] = setup.listen or setup.publish
        return found


# File in the directory of each run; the sweep removes only directories with it.
MARK = ".haptic-run"

_MARKED = "Directory of a run of haptic-nodes; the next launch removes it when the run is over.\n"


def runtime_dir() -> Path:
    """Return the private runtime directory of this user, created if necessary."""
    if "HAPTIC_RUNTIME_DIR" in os.environ:
        path = Path(os.environ["HAPTIC_RUNTIME_DIR"])
    elif "XDG_RUNTIME_DIR" in os.environ and os.access(
        os.environ["XDG_RUNTIME_DIR"], os.W_OK
    ):
        path = Path(os.environ["XDG_RUNTIME_DIR"]) / "haptic"
    else:
        # A predictable name in a shared directory is safe because owner and mode are checked below.
        path = Path("/tmp") / f"haptic-{os.getuid()}"  # noqa: S108
    if "#" in str(path):
        raise RunError(
            f"{path}: contains a #, which begins the key of an endpoint; set HAPTIC_RUNTIME_DIR to"
            " another path"
        )
    return _private(path)


def _private(path: Path) -> Path:
    try:
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = path.lstat()
    except OSError as error:
        # A file or dangling link in its place, or a full or read-only disk.
        raise RunError(
            f"{path}: the runtime directory cannot be created: {error.strerror}; set"
            " HAPTIC_RUNTIME_DIR to a directory of your own"
        ) from error
    if found.st_uid != os.getuid():
        raise RunError(
            f"{path}: belongs to user {found.st_uid}, must be a directory of user {os.getuid()};"
            " set HAPTIC_RUNTIME_DIR to one of your own"
        )
    if stat.S_IMODE(found.st_mode) & 0o077 or not stat.S_ISDIR(found.st_mode):
        raise RunError(
            f"{path}: must be a directory of user {os.getuid()} with mode 0700; remove it or chmod"
            " 700 it"
        )
    return path


def runs_dir() -> Path:
    """Return the directory that contains only this user's runs."""
    return _private(runtime_dir() / "runs")


def is_marked(path: Path) -> bool:
    """Whether a directory was created by this user for a run."""
    try:
        found = path.lstat()
        mark = (path / MARK).lstat()
        ours = stat.S_ISDIR(found.st_mode) and stat.S_ISREG(mark.st_mode)
        return (
            ours
            and found.st_uid == mark.st_uid == os.getuid()
            and (path / MARK).read_text("utf-8") == _MARKED
        )
    except (OSError, UnicodeDecodeError):
        return False


def place_of(run: str) -> Path:
    """Return the directory of a run; a short name is used if socket paths would be too long."""
    for name in (run, hashlib.sha256(run.encode()).hexdigest()[:8]):
        path = runs_dir() / name
        longest = len(os.fsencode(path / ("n" * LONGEST_NAME + ".listen")))
        if longest <= MAX_IPC_PATH:
            return path
    raise RunError(
        f"{path}: socket paths could reach {longest} bytes, limit {MAX_IPC_PATH}; set"
        " HAPTIC_RUNTIME_DIR to a shorter path"
    )


def name_of(scenario: str) -> str:
    """Return a new run's name: scenario, restricted to valid characters, and time."""
    plain = re.sub(r"^\.|[^\w.-]", "_", scenario)[:LONGEST_SCENARIO]
    return f"{plain}-{time.strftime('%Y%m%d-%H%M%S')}-{time.monotonic_ns() % 10**6:06d}"


def new_run_dir(run: str) -> Path:
    """Create the private directory of a run."""
    path = place_of(run)
    try:
        path.mkdir(mode=0o700)
    except FileExistsError as error:
        raise RunError(f"{path}: a run of that name already exists") from error
    (path / MARK).write_text(_MARKED, encoding="utf-8")
    return path


def hold(path: Path) -> int:
    """Lock a run's directory against the sweep until the descriptor or this process closes.

    Raises BlockingIOError if another process holds it, FileNotFoundError if it is gone.
    """
    # Open for writing, which an exclusive lock on NFS needs.
    held = os.open(path / MARK, os.O_RDWR)
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        # The sweep may have removed it before the lock.
        (path / MARK).lstat()
    except OSError:
        os.close(held)
        raise
    return held


def new_node_dir(run: str) -> Path:
    """Create the directory of a node of a remote launch, or take over a killed predecessor's."""
    path = place_of(run)
    if not is_marked(path):
        new_run_dir(run)
    try:
        hold(path)
    except OSError as error:
        raise RunError(f"{path}: a run of that name already exists") from error
    return path


def started_at(pid: int) -> int:
    """Return when a process was started, which with its number identifies it; 0 if gone."""
    try:
        text = Path(f"/proc/{pid}/stat").read_text(encoding="ascii", errors="replace")
    except OSError:
        # Gone, or hidden because it belongs to another user.
        return 0
    fields = text.rsplit(")", 1)[1].split()
    return 0 if fields[0] in "ZX" else int(fields[19])


def alive(pid: int, started: int = 0) -> bool:
    """Whether a process exists and is not a zombie."""
    found = started_at(pid)
    return found > 0 and started in (0, found)


def belongs(pid: int, run_dir: Path) -> bool:
    """Whether a live process is a node of a run; guards against reused process numbers."""
    try:
        return (
            alive(pid)
            and os.fsencode(run_dir) in Path(f"/proc/{pid}/cmdline").read_bytes()
        )
    except OSError:
        # Gone, or hidden because it belongs to another user.
        return False


def write_run(path: Path, info: RunInfo) -> None:
    """Write ``run.json``."""
    write_whole(path / "run.json", info)


def read_chain(
    setup: Setup, given_up: Callable[[], bool], timeout: float = 10.0
) -> RunInfo:
    """Read the node's chain from ``run.json``, waiting until the launcher has written it."""
    path = Path(setup.run_dir) / "run.json"
    deadline = time.monotonic() + timeout
    while not path.exists():
        if time.monotonic() > deadline or given_up():
            raise OSError(
                f"{path}: the launcher has not listed the run's nodes within {timeout:g} s"
            )
        time.sleep(0.005)
    run = msgspec.json.decode(path.read_bytes(), type=RunInfo)
    try:
        return run.within(setup.namespace) if setup.namespace else run.only_chain()
    except RunError as error:
        raise OSError(
            f"{error}: a {setup.kind} node needs one chain; put {setup.name} into its namespace"
        ) from error


def _live() -> dict[Path, RunInfo]:
    """Return the live runs by directory, oldest first."""
    found = []
    for path in runs_dir().glob("*/run.json"):
        try:
            info = msgspec.json.decode(path.read_bytes(), type=RunInfo)
            started = path.stat().st_mtime
        except (FileNotFoundError, msgspec.DecodeError):
            continue
        if info.lives:
            found.append((started, path.parent, info))
    return {
        folder: info for _, folder, info in sorted(found, key=lambda item: item[:2])
    }


def runs() -> dict[str, RunInfo]:
    """Return the live runs of this user on this machine, by name."""
    return {info.run: info for info in _live().values()}


def find_run(name: str | None = None) -> RunInfo:
    """Return the live run with this name or scenario, or the only one; RunError otherwise."""
    live = runs()
    fits = [
        info
        for info in live.values()
        if name is None or name in (info.run, info.scenario)
    ]
    if len(fits) == 1:
        return fits[0]
    if not live:
        raise RunError(
            "nothing is running; start something with:"
            f" {interface.get().start('floor_drop')}"
        )
    if not fits:
        raise RunError(f"no run is named {name!r}; running: {', '.join(live)}")
    raise RunError(
        f"several runs: {', '.join(info.run for info in fits)}; choose one with"
        f" {interface.get().run('NAME')}"
    )


def sweep() -> list[str]:
    """Remove marked run directories whose launcher and nodes are gone; return their names."""
    swept = []
    for path in runs_dir().iterdir():
        # A locked directory belongs to a live launcher or to another sweep.
        with contextlib.suppress(BlockingIOError, FileNotFoundError):
            # A new directory may not be locked yet.
            if not is_marked(path) or time.time() - path.stat().st_mtime < 60.0:
                continue
            held = hold(path)
            try:
                pids = [int(entry) for entry in os.listdir("/proc") if entry.isdigit()]
                if not any(belongs(pid, path) for pid in pids):
                    shutil.rmtree(path, ignore_errors=True)
                    swept.append(path.name)
            finally:
                os.close(held)
    return swept
