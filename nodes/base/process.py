"""The life of a node's process: sockets, ready, ticks, and a safe end.

Whatever ends the loop, an exception included: first the device is made safe, then the end is
reported, then everything is closed.
"""

import signal
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import msgspec

from messages import topics
from messages.transport.context import move_aside, new_context
from messages.transport.endpoints import Context
from messages.transport.gate import Gate
from messages.transport.links import Links
from messages.transport.sockets import Publisher, Subscription
from messages.transport.waker import Waker
from nodes.base import descriptors, realtime
from nodes.base.control_thread import ControlServer
from nodes.base.log_line import AS_JSON, LogLine
from nodes.base.node import Node
from nodes.base.node_kinds import load
from nodes.base.saved_parameters import resume
from nodes.base.setup import Setup
from nodes.base.status_report import write_report
from nodes.base.stderr_queue import instead_of_stderr
from nodes.parameters.store import ParameterError

# longest time to collect messages for listeners in real time, at least one period [s]
LISTENERS_WAIT = 0.002
# messages collected in lockstep: waking an idle core for each costs the loop some µs
LOCKSTEP_BATCH = 32
# fraction of the lease that a manual node waits for its report to be fetched
REPORT_SHARE = 0.5


def _await_listeners(node: Node) -> None:
    deadline = time.monotonic() + node.setup.patience
    node.state = "waiting"
    while node.publisher.listeners() < node.setup.listeners and not node.stopping:
        if time.monotonic() > deadline:
            there = node.publisher.listeners()
            expected = node.setup.listeners
            patience = node.setup.patience
            node.events.emit(
                "listeners",
                f"{there} of {expected} listeners within {patience:g} s; continuing without them",
                {"listeners": there, "expected": expected, "limit_s": patience},
            )
            return
        node.maintain()
        time.sleep(0.002)


def _heed_signals(node: Node) -> None:
    """Wait for signals in a thread; a handler could interrupt one that holds a lock."""
    asking = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP}
    # inherited by threads created from here on; nodes/__main__.py did the same for those of imports
    signal.pthread_sigmask(signal.SIG_BLOCK, asking)

    def wait() -> None:
        while True:
            node.stop(signal.Signals(signal.sigwait(asking)).name)

    threading.Thread(
        target=wait, name=f"{node.setup.name}-signals", daemon=True
    ).start()
    # sent when a process opens a watched file that is read under a lease; the default ends the
    # process
    signal.signal(signal.SIGIO, signal.SIG_IGN)


def _make_sockets(node: Node, context: Context) -> tuple[ControlServer, Gate | None]:
    """Create all sockets, and the gate before them if some are encrypted."""
    setup = node.setup
    bound = (setup.publish, setup.control, setup.reach, setup.listen_reach)
    events = node.events
    links = node.links = Links(
        context, lambda reason: events.emit("link", reason), events.deny, events.notify
    )

    def evict() -> None:
        node.publisher.evict()
        control.evict()
        events.notify()

    is_encrypted = any("#" in place for place in bound)
    gate = (
        Gate(
            context, events.deny, evict, partial(realtime.step_aside, setup.scheduling)
        )
        if is_encrypted
        else None
    )
    try:
        hops = filter(None, [setup.reach])
        listeners = filter(None, [setup.listen, setup.listen_reach])
        batch = (
            LOCKSTEP_BATCH
            if setup.pace == "lockstep"
            else max(1, int(LISTENERS_WAIT / setup.period))
        )
        node.publisher = Publisher(context, setup.publish, hops, listeners, batch)
        node.connect(
            lambda endpoints, wanted, queue: Subscription(
                context, endpoints, wanted, queue, links
            )
        )
        if node.answers and node.inbox is not None:
            node.waker = Waker(context, node.setup.topic(node.listens_to[0]).encode())
            node.events.interrupt = node.waker.wake
            node.inbox.woken_by(node.waker)
        control = ControlServer(node, context, links)
        if gate is not None:
            node.publisher.watched_by(gate)
            control.watched_by(gate)
    except ValueError:
        if gate is not None:
            gate.stop()
        raise
    return control, gate


def _fail_to_start(node: Node, error: Exception) -> int:
    node.events.log(f"cannot start: {error}")
    node.stop_reason = str(error)
    node.state = "failed"
    write_report(node, {})
    return 1


def live(node: Node, load_kernel: Callable[[Node], None]) -> int:
    """Run a node from start to end; `load_kernel` loads its compiled ticks, if any."""
    _heed_signals(node)
    descriptors.take()
    refused = realtime.apply(node.setup.scheduling)
    instead_of_stderr(
        partial(realtime.step_aside, node.setup.scheduling), stdout_too=True
    )
    load_kernel(node)
    resume(node)
    try:
        node.configure()
    except (ParameterError, ValueError, OSError) as error:
        return _fail_to_start(node, error)
    context = new_context(aside=True)
    try:
        control, gate = _make_sockets(node, context)
    except ValueError as error:
        context.destroy(linger=0)
        return _fail_to_start(node, error)
    move_aside(node.setup.scheduling.aside)
    code = 1
    try:
        try:
            if gate is not None:
                gate.start()
            control.start()
            for text in refused:
                node.events.emit("realtime", text)
            _await_listeners(node)
            node.state = "ready"
            realtime.quiet_interpreter()
            node.loop()
        finally:
            node.finish()
        code = int(node.failing)
    except (ParameterError, OSError) as error:
        # an error of a device or a disk is no fault of the program: one line, no traceback
        node.stop_reason = node.stop_reason or str(error)
        node.events.log(f"ended: {error}")
    finally:
        code = _close(node, context, control, gate, code)
    return code


def _close(
    node: Node, context: Context, control: ControlServer, gate: Gate | None, code: int
) -> int:
    node.state = "finished" if code == 0 else "failed"
    if node.setup.lease and not node.lost_launcher:
        control.await_fetch(REPORT_SHARE * node.setup.lease)
    if gate is not None:
        gate.stop()
    is_ended = control.stop()
    # emptied first, so that the last status counts exactly what was sent before it
    node.flush_outbox()
    node.events.publish(topics.status(node.setup.name), node.status())
    node.flush_outbox()
    if node.inbox is not None:
        node.inbox.close()
    node.publisher.close()
    if is_ended:
        context.term()
    if node.setup.by_hand:
        # its launcher has fetched the report, and may be removing the directory
        return code
    try:
        write_report(node)
    except OSError as error:
        # a full disk: the launcher must not conclude that all is well
        node.events.log(f"its report could not be written: {error}")
        return 1
    return code


def start(arguments: list[str], load_kernel: Callable[[Node], None]) -> int:
    """Run one node as this process: ``python -m nodes SETUP_FILE [LAUNCHER]``."""
    realtime.die_with_parent(*map(int, arguments[1:]))
    setup = msgspec.json.decode(Path(arguments[0]).read_bytes(), type=Setup)
    try:
        node = load(setup.factory)(setup)
    except ParameterError as error:
        line = LogLine(f"cannot start: {error}", setup.name)
        # in one piece: other nodes write there, too
        sys.stderr.write(f"{line.as_json() if AS_JSON else line}\n")
        sys.stderr.flush()
        return 1
    return live(node, load_kernel)
