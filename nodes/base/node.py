"""The base of all nodes: what a kind defines, and what every node can use.

Topics, parameters and class methods that a launch asks before any node exists stand in
nodes/base/declaration.py.

The main thread owns the loop's sockets and does nothing but ticks: blocking receive, plain floats,
send. A second thread serves control requests on its own socket; prepared changes are handed over by
one reference assignment and applied between two ticks, and its messages go through an outbox that
is emptied after the tick's own message has left.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

from messages.transport.links import Links
from messages.transport.sockets import Publisher, Subscription
from messages.transport.waker import Waker
from messages.types import Message, NodeStatus
from nodes.base.declaration import NodeDeclaration
from nodes.base.events import Clock, Events
from nodes.base.handover import Changes
from nodes.base.intake import Intake, TickTaker
from nodes.base.loading import Loading
from nodes.base.setup import Setup
from nodes.base.status_report import Counted, Counters, status_of
from nodes.parameters.store import ParameterError, ParameterStore

__all__ = ["IDLE_MS", "M", "Node"]

M = TypeVar("M", bound=Message)
IDLE_MS = 100
"""Longest blocking receive before the loop checks whether to stop [ms]."""


class Node(NodeDeclaration):
    """Base of all nodes.

    Parameters
    ----------
    setup : Setup
        Identity, wiring and pace of the node.

    Attributes
    ----------
    answer : bytes
        Message sent for the last answered tick.
    kernel : callable or None
        Compiled tick, or None if not requested or not available.
    ticks_compiled : int
        Number of compiled ticks.
    counters : Counters
        Tick counters; with a compiled tick, the struct it updates in place.
    clock, events, changes : Clock, Events, Changes
        The run's time; output besides the ticks; changes of parameters.
    compiled : TickTaker or None
        Its compiled ticks, once the sockets exist.
    intake : Intake
        Decoder of received messages.
    waker : Waker or None
        Ends the loop's wait; None for a loop that does not wait for ever.
    loading : Loading
        Context in which it loads files of its launch while it runs.
    saved_parameters : msgspec.Struct
        The parameters that a successor of this process would continue with.
    failing : bool
        Whether its end is a failure, although orderly.
    resumed_at : int
        Tick from which this process continues a predecessor; -1 for the first one.
    watched : tuple of int, or None
        Save of the watched file that was last applied; later changes take precedence over it.
    """

    publisher: Publisher

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.store = ParameterStore(setup.name, self.Parameters, setup.parameters)
        self.state = "configuring"
        self.stop_reason = ""
        # whether it ends because its launcher sent no request for a whole lease
        self.lost_launcher = False
        self.stopping = self.failing = False
        self.started = threading.Event()
        self.counters = self.make_counters()
        self.clock = Clock(setup, lambda: self.counted().seq)
        self.events = Events(setup.name, self.clock, lambda: self.counted().seq)
        self.changes = Changes(
            setup,
            self.store,
            self.events.notify,
            lambda: self.state not in ("finished", "failed"),
        )
        self.inbox: Subscription | None = None
        self.links: Links | None = None
        self.sent = self.received = 0
        self.intake = Intake(self)
        self.answer = b""
        self.saved_parameters = self.store.current
        self.resumed_at = -1
        self.watched: tuple[int, int, int] | None = None
        self.kernel: Callable[[int], int] | None = None
        self.compiled: TickTaker | None = None
        self.waker: Waker | None = None
        self.loading = Loading()
        self.ticks_compiled = 0

    # -- what a kind of node defines --

    def configure(self) -> None:
        """Build what the loop needs from the parameters, before any socket exists."""

    def compiled_ticks(self, kernel: Callable[[int], int]) -> TickTaker:
        """Return the compiled ticks of the kind for a `kernel`, once the sockets exist.

        Returns
        -------
        TickTaker
            Of this node.
        """
        del kernel
        raise TypeError(
            f"node kind {self.setup.kind!r} does not define compiled_ticks()"
        )

    def connect(
        self, subscribe: Callable[[Iterable[str], Iterable[str], int], Subscription]
    ) -> None:
        """Connect to the publishers of the kind's topics.

        `subscribe` takes endpoints, topics and queue length.
        """
        if self.listens_to == ("*",):
            self.inbox = subscribe(
                set(self.setup.sources.values()),
                self.subscribes(self.store.current),
                self.queue,
            )
        elif self.listens_to:
            wanted = [self.setup.topic(topic) for topic in self.listens_to]
            self.inbox = subscribe(
                {self.setup.sources[topic] for topic in self.listens_to},
                wanted,
                self.queue,
            )

    def respond(self, message: Any) -> bytes | None:
        """Answer one `message` of the loop topic that the kind follows.

        A process calls it for each message that arrives (nodes/base/follow.py), the player of one
        process for each tick (sim/play).

        Returns
        -------
        bytes or None
            The encoded answer; None where the message has none.
        """
        del message
        raise TypeError(f"node kind {self.setup.kind!r} does not define respond()")

    def loop(self) -> None:
        """Tick until `stopping` (main thread)."""
        raise TypeError(f"node kind {self.setup.kind!r} does not define loop()")

    def finish(self) -> None:
        """Leave everything safe; called on every way out of the loop."""

    def report(self) -> dict[str, Any]:
        """Return figures for the launcher at the end, in addition to the status.

        Returns
        -------
        dict
            JSON-able figures.
        """
        return {}

    def prepare(self, parameters: Any) -> Callable[[int], Any]:
        """Prepare new, valid `parameters` outside the loop (control thread).

        Returns
        -------
        callable
            Applied on the main thread between two ticks, with the tick number.

        Raises
        ------
        ParameterError
            If the node cannot change while it runs.
        """
        del parameters
        raise ParameterError(
            f"parameters of a {self.setup.kind} are fixed while it runs",
            path=self.setup.name,
        )

    def prepare_forced(self, parameters: Any) -> Callable[[int], Any]:
        """Prepare valid `parameters` that the node advises against (control thread).

        Returns
        -------
        callable
            As from `prepare`, to which it is equal by default.
        """
        return self.prepare(parameters)

    def check_health(self) -> None:
        """Check the node's health, about twice a second (control thread)."""

    def operations(self) -> dict[str, Callable[..., Any]]:
        """Return control operations besides parameters, status and stop.

        Returns
        -------
        dict of str to callable
            Called on the control thread with the request's arguments.
        """
        return {}

    # -- what every node can use --

    def make_counters(self) -> Any:
        """Return the tick counters.

        Returns
        -------
        Counters
            Or a struct with the same fields, for compiled ticks.
        """
        return Counters()

    def counted(self) -> Counted:
        """Return the tick counts, including compiled ticks under way; from any thread.

        Returns
        -------
        Counted
            Tick, number of ticks, and missing ones.
        """
        counters = self.counters
        return Counted(
            max(counters.seq, 0), counters.ticks, counters.gaps, counters.skipped
        )

    def set_clock(self, offset: float, error: float) -> None:
        """Set the `offset` of this host's clock to the launcher's, and its `error` [s]."""
        self.clock.set(offset, error)
        # Compiled ticks use the offset that they were given.
        self.events.notify()

    def make_compiled(self) -> TickTaker | None:
        """Create the compiled ticks, if available.

        Returns
        -------
        TickTaker or None
            Of this node.
        """
        if self.kernel is not None:
            self.compiled = self.compiled_ticks(self.kernel)
            self.events.post = self.compiled.post
        return self.compiled

    def stop(self, reason: str) -> None:
        """Stop the loop after the present tick, for a `reason`; the first reason counts."""
        if not self.stopping:
            self.stop_reason = reason
            self.stopping = True
        self.started.set()
        self.events.interrupt()

    def flush_outbox(self) -> None:
        """Send queued messages (main thread)."""
        if self.compiled is not None:
            self.compiled.return_outgoing()
        while self.events.outbox:
            topic, payload = self.events.outbox.popleft()
            self.publisher.send_aside(topic, payload)
            self.sent += 1
        self.publisher.flush()

    def between_ticks(self, seq: int) -> None:
        """Apply a change of the control thread from tick `seq` on, and send queued messages.

        Runs on the main thread.
        """
        # before checking, so that a later request is not lost
        self.events.waiting = False
        if self.changes:
            self.changes.apply_next(seq)
        if self.events.outbox:
            self.flush_outbox()
        if self.maintain() or self.changes:
            self.events.waiting = True

    def maintain(self) -> bool:
        """Process subscriptions, and reconnect links that failed (main thread).

        Returns
        -------
        bool
            Whether more subscriptions wait.
        """
        if self.links is None:
            # there are no sockets
            return False
        self.links.maintain()
        return self.publisher.maintain()

    def status(self) -> NodeStatus:
        """Return the status of the node.

        Returns
        -------
        NodeStatus
            State and counters.
        """
        return status_of(self)
