"""Requests of a page: parameters and laws as in ``haptic``, delay, undo, recording, stop.

A page can also change the delay of a virtual device; the coupling first judges its law with the new
delay. If the launch file allows it (``pointer: {beyond: true}``), a page may pass the stability
limit on such a device, and restart a driver that stopped the loop.

Each request becomes one control request to a node, which validates it as any other; its receipt or
refusal goes back to the page unchanged. A page cannot name an operation, a file or a program.
"""

from __future__ import annotations

import inspect
import signal
import subprocess
import time
from collections.abc import Callable, Mapping
from typing import Any, get_type_hints

import msgspec
import zmq

from messages.errors import HapticError
from messages.transport.context import new_context
from messages.transport.requests import Connection, call
from nodes.base.log_line import read_lines
from nodes.base.node_kinds import load
from nodes.client.launches import roles
from nodes.client.moved_device import set_device
from nodes.launcher.child import PYTHON
from nodes.launcher.runs import RunInfo
from nodes.parameters.store import convert
from nodes.view.law_edges import in_hardness, with_hardness

TIMEOUT = 10.0  # time limit of a change: judging a law with thousands of taps takes seconds [s]
# Time limit of a read: a restarted node never answers requests to its predecessor [s].
READ_TIMEOUT = 2.0
# Changes of the same parameters within this time are one undo step, as when dragging a slider [s].
TOGETHER = 1.0
STEPS = 100  # limit of undo steps stored


JUDGES = (
    "stability",
    "fallback",
    "budget",
    "plant",
)  # parameters that a page cannot change


class CommandError(HapticError):
    """A refused request of a page."""


class Commander:
    """Sends a page's requests to the nodes of a run.

    One thread uses it, except for `stop` and `end`.
    """

    def __init__(self, run: RunInfo) -> None:
        self._run = run
        self._context = new_context()
        self._lines: dict[str, Connection] = {}
        self._undo: list[tuple[str, dict[str, Any], dict[str, Any], float]] = []
        self._recorder: subprocess.Popen[bytes] | None = None
        self._recordings = 0
        self._path = self._failure = ""
        known = roles(run)
        # Node names; empty if the run has none.
        self.driver, self.coupling = known.get("driver", ""), known.get("coupling", "")
        # Whether pages may pass the stability limit and rearm the driver, and change the device's
        # delay; whether the device reports its masses, and whether it is virtual.
        self.beyond = self.delays = self._tells_inertia = self.is_virtual = False
        if self.driver:
            driver = run.nodes[self.driver]
            kind = load(driver.factory)
            self._tells_inertia = hasattr(kind, "hardware")
            self.is_virtual = bool(getattr(kind, "virtual", False))
            if self.is_virtual:
                self.beyond = bool(
                    (driver.parameters.get("pointer") or {}).get("beyond")
                )
                device = getattr(
                    convert(driver.parameters, kind.Parameters, driver.name),
                    "device",
                    None,
                )
                self.delays = (
                    bool(self.coupling)
                    and driver.pace == "realtime"
                    and hasattr(device, "delay")
                )

    def _endpoint(self, node: str) -> str:
        if node not in self._run.nodes:
            raise CommandError(
                f"{self._run.run}: no node is named {node!r}; available:"
                f" {', '.join(self._run.nodes)}"
            )
        return self._run.nodes[node].control

    def ask(
        self, node: str, op: str, timeout: float = TIMEOUT, /, **args: object
    ) -> Any:
        """Send one request to a node and return its answer."""
        endpoint = self._endpoint(node)
        if node not in self._lines:
            self._lines[node] = Connection(self._context, endpoint)
        try:
            return self._lines[node].call(op, timeout, **args)
        except HapticError as error:
            raise CommandError(error.fault).with_remedies(*error.remedies) from error
        except (ValueError, OverflowError, TypeError, zmq.ZMQError) as error:
            # Values that cannot be encoded, and the end of the context.
            raise CommandError(str(error)) from error

    def do(self, request: Mapping[str, Any]) -> Any:
        """Execute a page's request."""
        known: dict[str, Callable[..., Any]] = {
            "set": self._set,
            "law": self._set_law,
            "delay": self._set_delay,
            "switch": self._switch,
            "undo": self._undo_last,
            "again": self._start_again,
            "stop": self.stop,
            "record": self._record,
        }
        op = request.get("op")
        if not isinstance(op, str) or op not in known:
            raise CommandError(
                f"unknown request {str(op)[:100]!r}; a page can ask: {', '.join(known)}"
            )
        arguments = {
            key: value for key, value in request.items() if key not in ("op", "id")
        }
        types = get_type_hints(known[op])
        try:
            inspect.signature(known[op]).bind(**arguments)
            for name, value in arguments.items():
                msgspec.convert(value, types[name])
        except (TypeError, msgspec.ValidationError) as error:
            raise CommandError(f"{op}: {error}") from error
        return known[op](**arguments)

    def _set(self, node: str, values: dict[str, Any]) -> dict[str, Any]:
        return self._change(node, values)

    def _change(
        self, node: str, values: dict[str, Any], **args: object
    ) -> dict[str, Any]:
        before = {}
        for name in values:
            if name.partition(".")[0] in JUDGES:
                raise CommandError(
                    f"{node}.{name}: a page cannot change it, because it limits the page's own"
                    " changes"
                )
            try:
                before[name] = self.ask(node, "param.get", name=name)
            except CommandError:
                # Not set so far: undo restores the group that contains it.
                upper = name.rpartition(".")[0]
                before[upper] = self.ask(node, "param.get", name=upper)
        receipt: dict[str, Any] = self.ask(node, "param.set", values=values, **args)
        self._remember(node, before, values)
        return {"node": node, "values": values, "receipt": receipt}

    def _set_law(
        self, field: str, value: Any, beyond: bool = False, law: str = ""
    ) -> dict[str, Any]:
        """Change one parameter of the active law; an unmodified preset is stored as a law.

        `law` names the law whose control the page shows; if another law is active, nothing changes.
        ``hardness`` scales a law without a stiffness as a whole, to this H(1) [N/m].
        """
        force = self._forced(beyond)
        listed = self.ask(self.coupling, "law.list")
        name = listed["active"]
        if law not in ("", name):
            raise CommandError(
                f"{name} is now active, not {law}; {law}.{field} is unchanged."
            )
        if field == "hardness":
            return self._scale(name, listed["laws"][name], value, force)
        laws = self.ask(self.coupling, "param.get", name="laws")
        if isinstance(laws.get(name), dict):
            return self._change(self.coupling, {f"laws.{name}.{field}": value}, **force)
        return self._change(
            self.coupling, {f"laws.{name}": {"kind": name, field: value}}, **force
        )

    def _scale(
        self,
        name: str,
        described: Mapping[str, Any],
        hardness: Any,
        force: Mapping[str, Any],
    ) -> dict[str, Any]:
        """Scale a law as a whole, so that its H(1) is `hardness` [N/m]."""
        period = self._run.nodes[self.coupling].period
        try:
            wanted = msgspec.convert(hardness, float)
            scaled = with_hardness(described, wanted, period)
        except (HapticError, msgspec.ValidationError) as error:
            raise CommandError(f"{name}: {error}") from error
        try:
            return self._change(self.coupling, {f"laws.{name}": scaled}, **force)
        except CommandError as error:
            error.remedies = in_hardness(error.remedies, scaled, wanted)
            raise

    def _forced(self, beyond: bool) -> dict[str, Any]:
        """Return the option for a change past the stability limit; refuse it if not allowed."""
        if beyond and not self.beyond:
            raise CommandError(
                f"{self.driver} may not pass the stability limit; only a virtual"
                " device may, if its launch file has pointer: {beyond: true}"
            )
        return {"force": True} if beyond else {}

    def inertia(self) -> dict[str, Any] | None:
        """Return the masses that a device reports for its poses so far; None if it reports none."""
        if not self._tells_inertia:
            return None
        try:
            found: dict[str, Any] | None = self.ask(self.driver, "inertia")
        except CommandError:
            # The driver is restarting; the map will be redrawn soon.
            return None
        return found

    def device_delay(self) -> float | None:
        """Return the device's delay [ticks]; None for a device that is not virtual."""
        if not self.delays:
            return None
        return float(
            self.ask(self.driver, "param.get", READ_TIMEOUT, name="device.delay")
        )

    def _set_delay(self, ticks: float, beyond: bool = False) -> dict[str, Any]:
        before = self.device_delay()
        if before is None:
            raise CommandError(
                f"{self.driver} is not a virtual device in real time, so its delay"
                " cannot be changed"
            )
        receipt = self._put_delay(ticks, force=bool(self._forced(beyond)))
        self._remember(self.driver, {"delay": before}, {"delay": ticks})
        return {"node": self.driver, "values": {"delay": ticks}, "receipt": receipt}

    def _put_delay(self, ticks: float, force: bool) -> Any:
        """Change a virtual device's delay, after the coupling judged its law with it."""
        values = {"device.delay": ticks}
        return set_device(self.coupling, self.driver, values, self.ask, force)

    def _start_again(
        self, stiffness: float, field: str = "stiffness"
    ) -> dict[str, Any]:
        """Rearm a virtual driver that stopped the loop, with a stable wall."""
        if not self.beyond:
            raise CommandError(
                "This launch does not allow a page to start its driver again."
            )
        if self.ask(self.driver, "progress")["safety"] != "stopped":
            raise CommandError("The driver has not stopped the loop.")
        changed = self._set_law(field, stiffness)
        self.ask(self.driver, "rearm")
        return changed

    def _switch(
        self, law: str, ramp: int | None = None, beyond: bool = False
    ) -> dict[str, Any]:
        before = self.ask(self.coupling, "law.list")["active"]
        receipt = self.ask(
            self.coupling,
            "law.switch",
            law=law,
            **({} if ramp is None else {"ramp": ramp}),
            **self._forced(beyond),
        )
        self._remember(self.coupling, {"law": before}, {"law": law})
        return {"node": self.coupling, "values": {"law": law}, "receipt": receipt}

    def _remember(
        self, node: str, before: dict[str, Any], values: dict[str, Any]
    ) -> None:
        now = time.monotonic()
        if self._undo:
            last_node, last_before, last_values, when = self._undo[-1]
            if (
                last_node == node
                and set(last_values) == set(values)
                and now - when < TOGETHER
            ):
                self._undo[-1] = (node, last_before, values, now)
                return
        self._undo = [*self._undo[1 - STEPS :], (node, before, values, now)]

    def _undo_last(self) -> dict[str, Any]:
        if not self._undo:
            raise CommandError("nothing to undo")
        node, before, values, _ = self._undo[-1]
        if set(before) == {"law"}:
            receipt = self.ask(node, "law.switch", law=before["law"])
        elif set(before) == {"delay"}:
            receipt = self._put_delay(before["delay"], force=False)
        else:
            receipt = self.ask(node, "param.set", values=before)
        self._undo.pop()
        return {"node": node, "undone": values, "values": before, "receipt": receipt}

    def stop(self) -> dict[str, Any]:
        """Stop the run. Called on its own thread, so that it waits for no other request."""
        try:
            call(self._context, self._endpoint(self.driver), "stop", TIMEOUT)
        except (HapticError, zmq.ZMQError) as error:
            raise CommandError(str(error)) from error
        return {"stopping": True}

    def _record(self, on: bool) -> dict[str, Any]:
        before = self.recording()
        if on and not before["recording"]:
            self._recordings = self._recordings + 1
            self._failure = ""
            name = f"{self._run.run}-{time.strftime('%H%M%S')}-{self._recordings}"
            self._path = f"recordings/{name}.mcap"
            options = ("--run", self._run.chosen, "--out", self._path, "--json")
            self._recorder = subprocess.Popen(
                [*PYTHON, "-m", "nodes.cli.command", "bag", "record", *options],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
            )
        elif not on:
            self._end_recorder()
        return self.recording()

    @property
    def records(self) -> bool:
        """Whether a recording started by a page is running, as far as known."""
        return self._recorder is not None

    def recording(self) -> dict[str, Any]:
        """Return the state of the recording; if it ended by itself, also the reason."""
        if self._recorder is not None and self._recorder.poll() is not None:
            self._end_recorder()
        return {
            "recording": self._recorder is not None,
            "path": self._path,
            "error": self._failure,
        }

    def _end_recorder(self) -> None:
        recorder = self._recorder
        if recorder is None:
            return
        recorder.send_signal(signal.SIGINT)
        try:
            answered, said = recorder.communicate(timeout=TIMEOUT)
        except subprocess.TimeoutExpired:
            self._failure = (
                f"recording: {self._path} is not complete"
                f" {TIMEOUT:g} s after the request to end"
            )
            return
        self._recorder, self._failure = None, ""
        if recorder.returncode == -signal.SIGINT:
            # Its interpreter was still starting.
            self._failure = "recording: stopped before it began"
        elif recorder.returncode not in (0, 130):
            why = (
                _error_of(answered)
                or " ".join(map(str, read_lines(said.decode(errors="replace"))))[-500:]
            )
            why = why or f"it ended with exit code {recorder.returncode}"
            self._failure = f"recording failed: {why}"

    def end(self) -> None:
        """Cancel all pending requests; returns after `close` on another thread."""
        self._context.term()

    def close(self) -> None:
        """Complete a running recording and close the connections."""
        self._end_recorder()
        for line in self._lines.values():
            line.drop()


def _error_of(answer: bytes) -> str:
    """Return the error of a command's ``--json`` answer; empty if there is none."""
    try:
        return str(msgspec.json.decode(answer, type=dict[str, Any]).get("error", ""))[
            -500:
        ]
    except msgspec.DecodeError:
        return ""
