"""The second thread of a node: serves control requests, writes the status, watches the parameter file.

It is the only thread that may take its time. It never touches the loop's sockets: what must be
published goes through the node's outbox, what must change is handed over between two ticks.
Whatever a request provokes, it goes on serving.
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
    await_given_back,
    bind,
    closed_if_refused,
    remove_ipc,
)
from messages.transport.gate import Gate, Reopening
from messages.transport.links import Links
from messages.transport.requests import Reply, ReplySocket, Request, decode_request
from nodes.base import descriptors, realtime
from nodes.base.leases import Leases
from nodes.base.node import Node
from nodes.base.saved_parameters import keep
from nodes.base.status_report import report_of
from nodes.parameters.store import ParameterError

if TYPE_CHECKING:
    from nodes.parameters.yaml_io import WatchedFile

STATUS_PERIOD = 0.5
# so much memory grown means unbounded requests: who sends requests is disconnected [bytes]
MOST_GROWTH = 256 << 20
# requests served at once, and how many a second then: each takes the interpreter from the loop
BURST, RATE = 50, 100.0
END_TIMEOUT = 10.0  # how long a request that is being served may take at the node's end [s]

WATCH_PERIOD = 0.1
# how many changes of a file are told by name, and how many characters of each value
MOST, SHOWN = 4, 60


class ControlServer(threading.Thread):
    """Serves one node, and looks after its `links`."""

    def __init__(self, node: Node, context: Context, links: Links) -> None:
        super().__init__(name=f"{node.setup.name}-control", daemon=True)
        self._node = node
        self._ending = threading.Event()
        # Each time it wakes up for nothing, it takes the interpreter's lock from the loop for some
        # 100 µs.
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
        self._watched: WatchedFile | None = None
        if node.setup.watch:
            # Few nodes do, and YAML is a tenth of what a node's modules take to load.
            from nodes.parameters.yaml_io import WatchedFile

            self._watched = WatchedFile(node.setup.watch, node.watched)
        self._operations: dict[str, Callable[..., Any]] = {
            "status": lambda: msgspec.to_builtins(node.status()),
            "info": self._info,
            "start": node.started.set,
            "stop": lambda: node.stop("stop requested"),
            "report": self._report,
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
            Path(node.setup.run_dir) / f"{node.setup.name}.leases" if node.setup.run_dir else None
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
        # Requests are carried by the thread that serves listeners, off the loop's processor where
        # there is another.
        self._socket.setsockopt(zmq.AFFINITY, 1 << (int(self._context.get(zmq.IO_THREADS)) - 1))
        self._socket.rcvtimeo = self._patience_ms
        with closed_if_refused(self._socket):
            bind(self._socket, node.setup.control)
        self._wakes += 1
        self._wake = f"inproc://control-wake-{id(self)}-{self._wakes}"
        self._socket.bind(self._wake)
        self._reopening = Reopening(self._socket, [node.setup.control])

    def _info(self) -> dict[str, Any]:
        node, name = self._node, self._node.setup.name
        return {
            "status": msgspec.to_builtins(node.status()),
            "publishes": [
                *map(node.setup.topic, node.publishes),
                topics.status(name),
                topics.event(name),
            ],
            "listens_to": [
                topic if topic == "*" else node.setup.topic(topic) for topic in node.listens_to
            ],
            "operations": sorted(self._operations),
            "endpoint": node.setup.publish,
        }

    def _report(self) -> dict[str, Any]:
        if self._node.state in ("finished", "failed"):
            self._fetched.set()
        return report_of(self._node, self._node.report())

    def watched_by(self, gate: Gate) -> None:
        """Let a gate watch who tries to connect to an encrypted endpoint."""
        if "#" in self._node.setup.control:
            gate.watch(self._socket)

    def evict(self) -> None:
        """End all tcp connections soon; who is still allowed connects again. From any thread."""
        self._reopening.ask()

    def _review_memory(self) -> None:
        """Disconnect all who may send requests when memory grows without bound; ZeroMQ bounds no request."""
        now = realtime.memory_bytes()
        self._usual_memory = self._usual_memory or now
        if now - self._usual_memory > MOST_GROWTH:
            grown = now - self._usual_memory
            self._node.events.deny(
                f"memory grew by {grown >> 20} MiB; all connections for requests are ended",
                {"grown_bytes": grown},
            )
            self._usual_memory = now
            self._socket.close(linger=0)
            await_given_back(self._node.setup.control, time.monotonic() + END_TIMEOUT)
            while self._socket.closed:
                try:
                    self._open()
                except EndpointRefusedError as error:
                    self._node.events.emit("control", str(error))
                    time.sleep(WATCH_PERIOD)

    def await_fetch(self, timeout: float) -> None:
        """Go on answering until the launcher has fetched the last report."""
        if self.is_alive():
            self._fetched.wait(timeout)

    def _watch_lease(self) -> None:
        lease, now = self._node.setup.lease, time.monotonic()
        if lease and now - self._asked > lease and not self._node.stopping:
            reason = f"launcher lost: no request for {lease:g} s"
            self._node.events.log(f"{reason}; stopping")
            self._node.lost_launcher = True
            self._node.stop(reason)

    def _put_back(self) -> None:
        """Revert what was changed under leases that have run out."""
        over = self._leases.run_out()
        for name, op, args in over:
            try:
                self._perform(op, args)
            except Exception as error:  # noqa: BLE001  # as for requests: told, and served on
                self._node.events.emit_each(
                    "lease", f"lease {name!r} has run out, but {op} failed: {error}"
                )
            else:
                self._node.events.emit_each(
                    "lease", f"lease {name!r} expired without a renewal: {op} {args}"[:4000]
                )
        if over:
            # Parameters first: a process that dies in between must not leave those of a borrower
            # without a lease.
            self._keep()
            try:
                self._leases.save()
            except OSError as error:
                self._node.events.emit("kept", f"the leases would outlive this process: {error}")

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
            return Reply(False, error=str(error)[:4000])
        except Exception as error:  # noqa: BLE001  # e.g. what a law of another package raises while it is compiled
            return Reply(
                False, error=f"{name}: {request.op}: {type(error).__name__}: {error}"[:4000]
            )

    def _perform(self, op: str, args: Mapping[str, Any]) -> Any:
        """Perform an operation; raise ParameterError for an unknown one and for arguments that it does not take."""
        name = self._node.setup.name
        operation = self._operations.get(op)
        if operation is None:
            known = ", ".join(sorted(self._operations))
            raise ParameterError(f"{name}: unknown operation {op!r}; known: {known}")
        try:
            inspect.signature(operation).bind(**args)
        except TypeError as error:
            raise ParameterError(f"{name}: {op}: {error}") from error
        return operation(**args)

    def _await_turn(self) -> None:
        """Wait when there were many requests just now; who asks waits too, and nobody is refused."""
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
        # Before the answer: what was granted outlives this process.
        self._keep()
        try:
            encoded = msgspec.msgpack.encode(reply)
        except (TypeError, OverflowError, RecursionError) as error:
            encoded = msgspec.msgpack.encode(
                Reply(False, error=f"{node.setup.name}: unsendable result: {error}")
            )
        self._requests.answer(encoded)

    def _keep(self) -> None:
        try:
            keep(self._node)
        except OSError as error:
            self._node.events.emit(
                "kept", f"the parameters would not outlive this process: {error}"
            )

    def run(self) -> None:
        """Serve until stopped."""
        realtime.step_aside(self._node.setup.scheduling)
        while not self._ending.is_set():
            try:
                self._serve()
            except zmq.ZMQError as error:
                self._node.events.emit("control", f"a request could not be served: {error}")
            for duty in (
                self._node.check_health,
                self._keep,
                self._watch_lease,
                self._put_back,
                self._look_around,
            ):
                try:
                    duty()
                except OSError as error:
                    # Descriptors or memory ran out: what the lease and the next request are for
                    # goes on.
                    self._node.events.emit("control", f"{error}")
                except Exception as error:  # noqa: BLE001  # e.g. code of a device: the node ends softly, and is reachable
                    self._end_softly(error)
        self._links.close()
        self._socket.close(linger=100)
        remove_ipc(self._node.setup.control)

    def _end_softly(self, error: Exception) -> None:
        """End the node as a request to stop does, because something that it calls beside its loop failed."""
        node = self._node
        if not node.failing:
            reason = f"{node.setup.name}: {type(error).__name__} beside the loop: {error}"
            node.events.emit("control", f"{reason}; the node ends")
            node.failing = True
            node.stop(reason)

    def _look_around(self) -> None:
        node, now = self._node, time.monotonic()
        if self._watched is not None and now >= self._next_watch:
            self._next_watch = now + WATCH_PERIOD
            self._poll_file(self._watched)
        if now >= self._next_status:
            self._next_status = now + STATUS_PERIOD
            self._watch_descriptors()
            node.events.publish(topics.status(node.setup.name), node.status())
            self._reopening.maintain()
            self._review_memory()
            # Who answers each tick should hear one all the time, from the first one on.
            self._links.poll(
                node.counted().ticks or None if node.answers and node.state == "running" else None
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

    def _poll_file(self, watched: WatchedFile) -> None:
        node, where = self._node, ""  # what the file itself does not allow names it already
        try:
            values = watched.poll()
            where = f"{watched.path}: "
            if values is not None and node.store.merged(values) != node.store.current:
                receipt = self._change(lambda: node.store.merged(values))
                node.events.log(f"applied {watched.path}: {_told(receipt)}")
        except Exception as error:  # noqa: BLE001  # as for requests: refused, told, and served on
            known = isinstance(error, ParameterError)
            reason = (
                f"{where}{error}" if known else f"{watched.path}: {type(error).__name__}: {error}"
            )
            node.events.emit_each("refused", f"{reason}; the running parameters are untouched")
        finally:
            node.watched = watched.applied

    def stop(self) -> bool:
        """Stop serving and wait for the thread, but not for ever."""
        self._ending.set()
        if self.is_alive():
            # The thread may end this very moment by itself, and nobody takes it; without a
            # descriptor left to wake it by, it looks by itself before long.
            with contextlib.suppress(zmq.ZMQError), self._context.socket(zmq.REQ) as waker:
                waker.linger = 0
                waker.connect(self._wake)
                waker.send(msgspec.msgpack.encode(Request("clock")), zmq.NOBLOCK)
            self.join(END_TIMEOUT)
            return not self.is_alive()
        if not self._socket.closed:
            self._links.close()
            self._socket.close(linger=0)
        return True


def _told(receipt: dict[str, Any]) -> str:
    """Tell what a changed file has changed, in one line; the receipt itself is published and recorded."""
    changed = [
        f"{path} {str(old)[:SHOWN]} → {str(new)[:SHOWN]}"
        for path, (old, new) in receipt["changed"].items()
    ]
    more = f", {len(changed) - MOST} more" if len(changed) > MOST else ""
    return f"{', '.join(changed[:MOST])}{more} from tick {receipt['seq']} on"
