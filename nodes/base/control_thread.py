"""The second thread of a node: control requests, status, watched parameter file.

Only this thread may take its time. It never uses the loop's sockets: messages go through the node's
outbox, and changes are handed over between two ticks. It keeps serving, whatever a request causes.
"""

from __future__ import annotations

import contextlib
import inspect
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import zmq

from messages import topics
from messages.codec import MessageRefusedError
from messages.transport.endpoints import (
    Context,
    EndpointRefusedError,
    bind,
    closed_if_refused,
    remove_ipc,
)
from messages.transport.gate import Gate, Reopening, close_bound
from messages.transport.links import Links
from messages.transport.requests import Reply, ReplySocket, Request, decode_request
from nodes.base import descriptors, realtime
from nodes.base.leases import Leases
from nodes.base.node import Node
from nodes.base.saved_parameters import save_parameters
from nodes.base.status_report import report_of
from nodes.parameters.store import ParameterError

if TYPE_CHECKING:
    from nodes.base.watched_parameters import WatchedParameters

STATUS_PERIOD = 0.5
# memory growth taken as unbounded requests, after which all requesting peers are disconnected
# [bytes]
MAX_GROWTH = 256 << 20
# growth while a node loads files of its launch: a mesh of the largest file, 256 MB, takes 13 times
# its size (nodes/environment/shapes/mesh_file.py) [bytes]
MAX_LOADED = 4 << 30
# requests served at once, and then per second: each takes the GIL from the loop
BURST, RATE = 50, 100.0
END_TIMEOUT = 10.0  # longest duration of a request at the node's end [s]
# longest wait for ZeroMQ to be done with the closed endpoint: nobody is served meanwhile [s]
GIVEN_BACK = 1.0

WATCH_PERIOD = 0.1


class ControlServer(threading.Thread):
    """Serves one node, and monitors its `links`."""

    def __init__(self, node: Node, context: Context, links: Links) -> None:
        super().__init__(name=f"{node.setup.name}-control", daemon=True)
        self._node = node
        self._ending = threading.Event()
        # each idle wake-up takes the GIL from the loop for some 100 µs
        often = node.setup.watch or node.setup.lease
        self._patience_ms = int((WATCH_PERIOD if often else STATUS_PERIOD) * 1000)
        self._context = context
        self._wakes = 0
        self._open()
        self._usual_memory = 0
        self._asked = self._counted = time.monotonic()
        self._tokens = float(BURST)
        self._fetched = threading.Event()
        self._next_status = self._next_watch = 0.0
        self._links = links
        self._watched: WatchedParameters | None = None
        if node.setup.watch:
            # few nodes need it, and YAML is a tenth of a node's import time
            from nodes.base.watched_parameters import WatchedParameters

            self._watched = WatchedParameters(node, self._change)
        self._operations: dict[str, Callable[..., Any]] = {
            "status": lambda: msgspec.to_builtins(node.status()),
            "info": self._info,
            "start": node.started.set,
            "stop": lambda: node.stop("stop requested"),
            "report": self._report,
            "mark": node.events.mark,
            "clock": lambda: {"monotonic_s": time.monotonic()},
            "clock.set": node.set_clock,
            "param.list": node.store.flat,
            "param.get": lambda name: node.store.get(name),
            "param.set": lambda values, force=False: self._change(
                lambda: node.store.changed(values), force
            ),
            "param.dump": node.store.dump,
            "param.load": lambda values, force=False: self._change(
                lambda: node.store.merged(values), force
            ),
            **node.operations(),
        }
        kept = (
            Path(node.setup.run_dir) / f"{node.setup.name}.leases"
            if node.setup.run_dir
            else None
        )
        self._leases = Leases(node.setup.name, self._perform, kept)
        self._operations |= self._leases.operations()

    def _change(self, make: Callable[[], Any], force: bool = False) -> dict[str, Any]:
        return self._node.changes.change(
            make, self._node.prepare_forced if force else self._node.prepare
        )

    def _open(self) -> None:
        node = self._node
        self._requests = ReplySocket(self._context)
        self._socket = self._requests.socket
        # The thread that serves listeners carries requests, off the loop's processor if possible.
        self._socket.setsockopt(
            zmq.AFFINITY, 1 << (int(self._context.get(zmq.IO_THREADS)) - 1)
        )
        self._socket.rcvtimeo = self._patience_ms
        with closed_if_refused(self._socket):
            bind(self._socket, node.setup.control)
        self._wakes += 1
        self._wake = f"inproc://control-wake-{id(self)}-{self._wakes}"
        self._socket.bind(self._wake)
        self._reopening = Reopening(self._socket, [node.setup.control])

    def _info(self) -> dict[str, Any]:
        node = self._node
        name = self._node.setup.name
        return {
            "status": msgspec.to_builtins(node.status()),
            "publishes": [
                *map(node.setup.topic, node.publishes),
                topics.status(name),
                topics.event(name),
            ],
            "listens_to": [
                topic if topic == "*" else node.setup.topic(topic)
                for topic in node.listens_to
            ],
            "operations": sorted(self._operations),
            "endpoint": node.setup.publish,
        }

    def _report(self) -> dict[str, Any]:
        if self._node.state in ("finished", "failed"):
            self._fetched.set()
        return report_of(self._node, self._node.report())

    def watched_by(self, gate: Gate) -> None:
        """Make a gate monitor connections to an encrypted endpoint."""
        if "#" in self._node.setup.control:
            gate.watch(self._socket)

    def evict(self) -> None:
        """Request the end of all tcp connections; allowed peers reconnect. From any thread."""
        self._reopening.ask()

    def _review_memory(self) -> None:
        """Disconnect all requesting peers if memory keeps growing; ZeroMQ limits no request."""
        now = realtime.memory_bytes()
        self._usual_memory = self._usual_memory or now
        grown = now - self._usual_memory
        loading = self._node.loading
        if loading.is_on or loading.has_been:
            if grown <= MAX_LOADED:
                # what the node itself took; requests count from here on
                loading.has_been = False
                self._usual_memory = now
                return
            loading.has_been = False
        if grown > MAX_GROWTH:
            self._node.events.deny(
                f"memory grew by {grown >> 20} MiB; all requesting peers are disconnected",
                {"grown_bytes": grown},
            )
            self._usual_memory = now
            close_bound(
                self._socket, self._node.setup.control, time.monotonic() + GIVEN_BACK
            )
            while self._socket.closed:
                try:
                    self._open()
                except EndpointRefusedError as error:
                    self._node.events.emit("control", str(error))
                    time.sleep(WATCH_PERIOD)

    def await_fetch(self, timeout: float) -> None:
        """Serve until the launcher has fetched the last report."""
        if self.is_alive():
            self._fetched.wait(timeout)

    def _watch_lease(self) -> None:
        lease = self._node.setup.lease
        now = time.monotonic()
        if lease and now - self._asked > lease and not self._node.stopping:
            reason = f"launcher lost: no request for {lease:g} s"
            self._node.events.log(f"{reason}; stopping")
            self._node.lost_launcher = True
            self._node.stop(reason)

    def _revert_expired(self) -> None:
        """Revert the changes of expired leases."""
        over = self._leases.run_out()
        for name, op, args in over:
            try:
                self._perform(op, args)
            # as for requests: report it, and keep serving
            except Exception as error:  # noqa: BLE001
                self._node.events.emit_each(
                    "lease", f"lease {name!r} has run out, but {op} failed: {error}"
                )
            else:
                self._node.events.emit_each(
                    "lease",
                    f"lease {name!r} expired without a renewal: {op} {args}"[:4000],
                )
        if over:
            # Parameters first: if the process dies in between, a borrower's must not remain without
            # a lease.
            self._save_parameters()
            try:
                self._leases.save()
            except OSError as error:
                self._node.events.emit("kept", f"the leases cannot be saved: {error}")

    def _answer(self, frames: list[bytes]) -> Reply:
        name = self._node.setup.name
        try:
            request = decode_request(frames)
        except MessageRefusedError as error:
            self._node.events.refused += 1
            return Reply(False, error=f"{name}: {error}")
        try:
            return Reply(True, self._perform(request.op, request.args))
        except ParameterError as error:
            return Reply(False, error=error.fault[:4000], remedies=error.remedies)
        # e.g. an exception of another package's law while it is compiled
        except Exception as error:  # noqa: BLE001
            return Reply(
                False,
                error=f"{name}: {request.op}: {type(error).__name__}: {error}"[:4000],
            )

    def _perform(self, op: str, args: Mapping[str, Any]) -> Any:
        """Perform an operation; ParameterError if it or its arguments are unknown."""
        name = self._node.setup.name
        operation = self._operations.get(op)
        if operation is None:
            known = ", ".join(sorted(self._operations))
            raise ParameterError(f"unknown operation {op!r}; known: {known}", path=name)
        try:
            inspect.signature(operation).bind(**args)
        except TypeError as error:
            raise ParameterError(f"{op}: {error}", path=name) from error
        return operation(**args)

    def _await_turn(self) -> None:
        """Rate-limit requests with a token bucket; the caller waits, none is refused."""
        now = time.monotonic()
        self._tokens = min(float(BURST), self._tokens + (now - self._counted) * RATE)
        self._counted = now
        if self._tokens < 1.0:
            self._ending.wait((1.0 - self._tokens) / RATE)
        self._tokens -= 1.0

    def _serve(self) -> None:
        node = self._node
        node.changes.serving.stop()
        try:
            frames = self._requests.receive()
            self._await_turn()
        except zmq.Again:
            return
        finally:
            node.changes.serving.start()
        self._asked = time.monotonic()
        reply = self._answer(frames)
        # before the answer: accepted changes survive a restart
        self._save_parameters()
        try:
            encoded = msgspec.msgpack.encode(reply)
        except (TypeError, OverflowError, RecursionError) as error:
            encoded = msgspec.msgpack.encode(
                Reply(False, error=f"{node.setup.name}: unsendable result: {error}")
            )
        self._requests.answer(encoded)

    def _save_parameters(self) -> None:
        try:
            save_parameters(self._node)
        except OSError as error:
            self._node.events.emit(
                "kept", f"the parameters cannot be saved for a restart: {error}"
            )

    def run(self) -> None:
        """Serve until stopped."""
        realtime.step_aside(self._node.setup.scheduling)
        while not self._ending.is_set():
            try:
                self._serve()
            except zmq.ZMQError as error:
                self._node.events.emit(
                    "control", f"a request could not be served: {error}"
                )
            for duty in (
                self._node.check_health,
                self._save_parameters,
                self._watch_lease,
                self._revert_expired,
                self._publish_status,
            ):
                try:
                    duty()
                except OSError as error:
                    # Descriptors or memory ran out: leases and requests must still be served.
                    self._node.events.emit("control", f"{error}")
                # e.g. a device's code: the node ends softly, and stays reachable
                except Exception as error:  # noqa: BLE001
                    self._end_softly(error)
        self._links.close()
        self._socket.close(linger=100)
        remove_ipc(self._node.setup.control)

    def _end_softly(self, error: Exception) -> None:
        """Stop the node, because code outside its loop failed."""
        node = self._node
        if not node.failing:
            reason = (
                f"{node.setup.name}: {type(error).__name__} outside the loop: {error}"
            )
            node.events.emit("control", f"{reason}; the node ends")
            node.failing = True
            node.stop(reason)

    def _publish_status(self) -> None:
        node = self._node
        now = time.monotonic()
        if self._watched is not None and now >= self._next_watch:
            self._next_watch = now + WATCH_PERIOD
            self._watched.poll()
        if now >= self._next_status:
            self._next_status = now + STATUS_PERIOD
            self._watch_descriptors()
            node.events.publish(topics.status(node.setup.name), node.status())
            self._reopening.maintain()
            self._review_memory()
            # A node that answers every tick should hear one all the time, from the first one on.
            self._links.poll(
                node.counted().ticks or None
                if node.answers and node.state == "running"
                else None
            )

    def _watch_descriptors(self) -> None:
        node = self._node
        # Over tcp ZeroMQ bears it.
        if (
            node.setup.control.startswith("ipc://")
            and not node.stopping
            and (reason := descriptors.shortage())
        ):
            node.events.emit("descriptors", f"{reason}; stopping")
            node.failing = True
            node.stop(reason)

    def stop(self) -> bool:
        """Stop serving and wait for the thread, but not for ever."""
        self._ending.set()
        if self.is_alive():
            # The thread may be ending by itself, so that nobody receives this. Without a free
            # descriptor for the wake-up, it notices by itself soon.
            with (
                contextlib.suppress(zmq.ZMQError),
                self._context.socket(zmq.REQ) as waker,
            ):
                waker.linger = 0
                waker.connect(self._wake)
                waker.send(msgspec.msgpack.encode(Request("clock")), zmq.NOBLOCK)
            self.join(END_TIMEOUT)
            return not self.is_alive()
        if not self._socket.closed:
            self._links.close()
            self._socket.close(linger=0)
        return True
