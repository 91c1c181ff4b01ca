"""Supervision of a run as in ROS 2: start, respawn, required nodes, and a complete end.

An end goes in order: first the driver (which brings the force to zero, and has the time that its
device declares), then the rest of the chain, last the loggers, so that every message is recorded.
Each node is asked with SIGINT, then SIGTERM, then SIGKILL; a stopped one is woken up first. Who
asks a second time (Ctrl-C) waits less for all but the driver, which needs its time to bring the
force down.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from messages.errors import HapticError
from messages.transport.context import new_context
from messages.transport.requests import ControlError, call
from nodes.base import realtime
from nodes.base.node_kinds import load
from nodes.launcher import runs
from nodes.launcher.chain_load import Load, Meter, measured_load, warning
from nodes.launcher.child import Child
from nodes.launcher.ending import burden, end
from nodes.launcher.external_child import ByHand
from nodes.launcher.launch_spec import Launch
from nodes.launcher.reaper_process import ReaperProcess
from nodes.launcher.run_end import write_end
from nodes.launcher.wiring import (
    chain_manifest,
    chains_of,
    manifest_of,
    settle_tick,
    wire,
    with_forwarder,
)


class LaunchFailedError(HapticError):
    """A launch that could not start or had to end; the text names node and reason."""


class Supervisor:
    """Starts and ends the nodes of one launch."""

    def __init__(
        self,
        launch: Launch,
        say: Callable[[str], None],
        warn: Callable[[str], None],
        files: Mapping[str, bytes] = MappingProxyType({}),
    ) -> None:
        self._launch = launch
        # what the run's directory contains from the beginning, by name
        self._files = files
        self._say, self._warn = say, warn
        self.run = runs.name_of(launch.scenario)
        self.reports: dict[str, dict[str, Any]] = {}
        self.exit_reason = ""
        self.failed_node = ""  # name of the node whose failure ended the launch
        self.tick = launch.run.tick
        self.failed = False
        self.failures: list[str] = []
        self.startup_s = 0.0
        self.load: Load | None = None  # load of the chains' processors
        self.unjudged: dict[str, str] = {}  # nodes not judged for stability, and why
        self._stop_asked = ""
        self.interrupted = self._hurry = False
        self._begun = 0.0
        self.run_dir = Path()
        self.context = new_context()
        self.children: dict[str, Child] = {}
        self._reaper: ReaperProcess | None = None
        self._meter: Meter | None = None  # once the driver has started

    def stop(self, reason: str) -> None:
        """Request the end. Safe in a signal handler."""
        self._stop_asked = self._stop_asked or reason

    def interrupt(self, reason: str) -> None:
        """Request the end for a user; a second request hurries. Safe in a signal handler."""
        self._hurry = self.interrupted
        self.interrupted = True
        self.stop(reason)

    @property
    def ending(self) -> bool:
        """Whether the end was requested, by a signal or by a lost node."""
        return bool(self._stop_asked)

    def supervise(self, progress: Callable[[Supervisor], None] | None = None) -> None:
        """Run the launch from start to end."""
        with contextlib.ExitStack() as held:
            held.callback(self.context.term)  # also where no run directory can be made
            if self._launch.run.stays_awake and (
                refused := held.enter_context(realtime.awake())
            ):
                self._warn(
                    f"{refused}; processors sleep between ticks, and answer later; see haptic"
                    " doctor"
                )
            self._supervise(progress, held)

    def _supervise(
        self, progress: Callable[[Supervisor], None] | None, held: contextlib.ExitStack
    ) -> None:
        self._begun = time.monotonic()
        runs.sweep()
        run_dir = runs.new_run_dir(self.run)
        held.callback(os.close, runs.hold(run_dir))
        self.run_dir = run_dir
        for name, content in self._files.items():
            (run_dir / name).write_bytes(content)
        try:
            offset = time.time() - time.monotonic()
            if self._launch.run.tick == "compiled":
                # Report mistakes before half a minute of compiling.
                whole = with_forwarder(self._launch)
                wire(whole, self.run, run_dir, manifest_of(whole, self.run, offset))
            self._launch = with_forwarder(
                settle_tick(self._launch, self._say, self._warn)
            )
            self.tick = self._launch.run.tick
            manifest = manifest_of(self._launch, self.run, offset)
            setups = wire(self._launch, self.run, run_dir, manifest)
            self._warn_of_overload()
            self.unjudged = {
                name: why
                for name, setup in setups.items()
                if (why := load(setup.factory).unjudged(setup))
            }
            for why in self.unjudged.values():
                self._warn(f"stability not judged: {why}")
            info = runs.RunInfo(
                run=self.run,
                scenario=self._launch.scenario,
                launcher=os.getpid(),
                launcher_started=runs.started_at(os.getpid()),
                nodes=setups,
                wall_minus_monotonic=offset,
                manifest=manifest,
                manifests={
                    chain: chain_manifest(self._launch, manifest, chain)
                    for chain in chains_of(self._launch)
                    if chain
                },
            )
            self._reaper = ReaperProcess(run_dir, self._warn)
            for name, setup in setups.items():
                spec = self._launch.nodes[name]
                respawns = spec.respawn_max if spec.respawn else 0
                given = setup, respawns, spec.respawn_delay, spec.required
                child = (
                    ByHand(*given, self.context, self._say)
                    if setup.by_hand
                    else Child(*given)
                )
                self.children[name] = child
                self._start_child(child)
            runs.write_run(run_dir, info)
            self._await_ready()
            # From here on: nodes that start again are imported elsewhere, too, and then go where
            # they belong.
            held.enter_context(realtime.off(info.processors))
            self._start_driver()
            self._meter = Meter(
                {
                    name: child.process.pid
                    for name, child in self._hops().items()
                    if child.process
                }
            )
            self._watch(progress)
        finally:
            self._end_all()
            self._note_load()
            for child in self.children.values():
                child.release()
            shutil.rmtree(run_dir, ignore_errors=True)
            if self._reaper is not None:
                self._reaper.dismiss()

    def _hops(self) -> dict[str, Child]:
        """Return the nodes of the chains that have a process here."""
        return {
            name: child
            for name, child in self.children.items()
            if child.hops and child.process is not None
        }

    def _warn_of_overload(self) -> None:
        available = len(os.sched_getaffinity(0))
        processors = 1 if isinstance(self._launch.run.cpu, int) else available
        if text := warning(
            self._launch, chains_of(self._launch), self.tick, processors
        ):
            self._warn(text)

    def _note_load(self) -> None:
        """Record the processors' load, once the driver has started."""
        if self._meter is None:
            return
        cores = {
            cpu
            for child in self._hops().values()
            for cpu in child.setup.scheduling.cpus
        }
        drivers = [name for name, child in self.children.items() if child.drives]
        self.load = measured_load(
            self._launch,
            self.tick,
            self._meter,
            self.reports,
            drivers,
            len(cores) or len(os.sched_getaffinity(0)),
        )

    def _start_child(self, child: Child) -> None:
        child.start(self.run_dir)
        self._store_child(child)

    def _store_child(self, child: Child) -> None:
        if self._reaper is not None:
            self._reaper.write_down(child)

    def _await_ready(self) -> None:
        begun = time.monotonic()
        # All nodes wait for those started by hand.
        patience = max(child.patience for child in self.children.values())
        for name, child in self.children.items():
            while not self._stop_asked:
                # Check the others too: this node may wait for one that has ended.
                for other, there in self.children.items():
                    if not there.running:
                        raise LaunchFailedError(
                            f"{other}: ended during start with {there.end}"
                        )
                state = child.state(self.context)
                if state in ("ready", "running"):
                    self._note_ready(child)
                    break
                if time.monotonic() - begun > patience:
                    raise LaunchFailedError(
                        f"{name}: still {state} after {patience:g} s{burden()}"
                    )
                time.sleep(0.01)

    def _note_ready(self, child: Child) -> None:
        child.ready, child.ready_at = True, time.monotonic()
        if child.drives:
            # A driver in another language may not know this request.
            with contextlib.suppress(ControlError):
                times = call(
                    self.context,
                    child.setup.control,
                    "device",
                    timeout=1.0 + child.distance,
                )
                try:
                    child.opening, child.closing = (
                        float(times["opening_s"]),
                        float(times["closing_s"]),
                    )
                except (KeyError, OverflowError, TypeError, ValueError) as error:
                    raise LaunchFailedError(
                        f"{child.setup.name}: answers device with {times!r:.100}"
                    ) from error
            self._store_child(child)

    def _start_driver(self) -> None:
        for child in self.children.values():
            if child.drives and child.running and not self._stop_asked:
                call(
                    self.context,
                    child.setup.control,
                    "start",
                    timeout=10.0 + child.distance,
                )
        self.startup_s = time.monotonic() - self._begun

    def _watch(self, progress: Callable[[Supervisor], None] | None) -> None:
        next_progress = 0.0
        while not self._stop_asked:
            if self._reaper is not None:
                self._reaper.check(self.children.values())
            for name, child in self.children.items():
                self._check_child(name, child)
            if time.monotonic() >= next_progress:
                next_progress = time.monotonic() + 0.2
                if self._meter is not None:
                    self._meter.sample()
                if progress is not None:
                    progress(self)
            time.sleep(0.01)
        self.exit_reason = self.exit_reason or self._stop_asked

    def _check_child(self, name: str, child: Child) -> None:
        if child.to_start and child.running:
            self._restart_driver(child)
        if child.over or child.running:
            return
        if child.again_at is not None:
            if time.monotonic() >= child.again_at:
                child.restarts += 1
                self._warn(f"{name}: started again ({child.restarts})")
                self._start_child(child)
                child.to_start = child.drives
            return
        if child.drives and child.is_done(self.run_dir):
            child.over = True
            reason = (
                self._read_report(name).get("status", {}).get("reason", "") or "done"
            )
            # The longest of several chains decides.
            if all(other.over for other in self.children.values() if other.drives):
                self.exit_reason = reason
                self.stop(reason)
            return
        child.unreported = child.drives and child.code == 0
        if child.respawns < 0 or child.restarts < child.respawns:
            self._warn(
                f"{name}: ended with {child.end}; starting it again in {child.delay:g} s"
            )
            child.again_at = time.monotonic() + child.delay
        else:
            child.over = True
            reason = f"{name}: ended with {child.end}{self._own_reason(name, child)}"
            if child.required:
                self.failed = True
                self.failed_node = name
                self.exit_reason = reason
                self.stop(reason)
            if child.required or child.ended_badly:
                self.failures.append(reason)
            self._warn(f"{reason}{'; ending the launch' if child.required else ''}")

    def _own_reason(self, name: str, child: Child) -> str:
        """Return the reason that a failed node gave at an orderly end; else empty."""
        status = self._read_report(name).get("status", {})
        said = (
            str(status.get("reason", ""))
            if child.code == 1 and status.get("state") == "failed"
            else ""
        )
        return f": {said.removeprefix(f'{name}: ')}" if said else ""

    def _restart_driver(self, child: Child) -> None:
        # It is not there yet at the first tries; the other nodes are looked after in between.
        state = child.state(self.context, 0.05)
        with contextlib.suppress(ControlError):
            if state == "ready":
                self._note_ready(child)
                call(
                    self.context,
                    child.setup.control,
                    "start",
                    timeout=0.5 + child.distance,
                )
            # If the answer was lost, the driver runs already.
            child.to_start = state not in ("ready", "running")

    def _end_all(self) -> None:
        try:
            write_end(
                self.run_dir, self.exit_reason or self._stop_asked, self.failed_node
            )
        except OSError as error:
            # On a full disk the nodes still end in order.
            self.failures.append(f"{self.run_dir}: {error.strerror}")
            self._warn(self.failures[-1])
        groups = (
            [child for child in self.children.values() if child.drives],
            [
                child
                for child in self.children.values()
                if not child.drives and not child.listens
            ],
            [child for child in self.children.values() if child.listens],
        )
        for group in groups:
            for failure in end(group, self._warn, lambda: self._hurry):
                self.failures.append(failure)
                self._warn(failure)
        for name, child in self.children.items():
            self._read_report(name)
            if child.ended_badly and not child.over:
                self.failures.append(f"{name}: ended with {child.end}")

    def _read_report(self, name: str) -> dict[str, Any]:
        report = self.reports.get(name) or self.children[name].report(self.run_dir)
        if report:
            self.reports[name] = report
        return report
