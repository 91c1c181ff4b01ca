"""The base of all nodes: what a kind defines, and what every node can use.

The main thread owns the loop's sockets and does nothing but ticks: blocking receive, plain floats,
send. A second thread serves control requests on its own socket; what it prepares is handed over by
one reference assignment and taken up between two ticks, and what it wants published goes through an
outbox that is emptied after the tick's own message has left.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar, TypeVar

import msgspec

from messages.transport.links import Links
from messages.transport.sockets import Publisher, Subscription
from messages.transport.waker import Waker
from messages.types import Message, NodeStatus
from nodes.base.events import Clock, Events
from nodes.base.handover import Changes
from nodes.base.intake import Intake, TickTaker
from nodes.base.setup import Axis, Setup
from nodes.base.status_report import Counted, Counters, status_of
from nodes.parameters.store import ParameterError, ParameterStore

__all__ = ["IDLE_MS", "M", "Node"]

M = TypeVar("M", bound=Message)
IDLE_MS = 100
"""How long a blocking receive waits before it looks whether the node should stop [ms]."""


class Node:
    """Base of all nodes.

    Parameters
    ----------
    setup : Setup
        Who the node is and how it is wired and paced.

    Attributes
    ----------
    Parameters : type
        The struct of the node's parameters.
    publishes, listens_to : tuple of str
        The loop topics that the kind binds and takes; ``"*"`` listens to everything.
    queue : int
        Messages that may wait to be taken in.
    answers : bool
        Whether each tick is one message taken and one sent; ``sent`` and ``received`` count only
        what comes on top.
    answer : bytes
        What was sent for the tick answered last.
    kernel_module : str
        Module of the compiled ticks of the kind (nodes/compiled); empty when it has none. Not
        inherited.
    kernel : callable or None
        They, where the launch asks for them and they could be had.
    ticks_compiled : int
        How many of the ticks they did.
    counters : Counters
        How far it is; of a node with compiled ticks its whole state, which they change where it
        stands.
    clock, events, changes : Clock, Events, Changes
        The run's time; what it has to say beside its ticks; how its parameters change.
    compiled : TickTaker or None
        Its compiled ticks, when the sockets exist.
    intake : Intake
        What it takes in.
    waker : Waker or None
        What ends the loop's wait; None for a loop that does not wait without end.
    saved_parameters : msgspec.Struct
        The parameters that a successor of this process would go on with.
    failing : bool
        Whether its end is a failure, although it goes there in order.
    resumed_at : int
        Tick from which this process goes on with what a predecessor had; -1 for the first one.
    watched : tuple of int, or None
        Which save of the watched file has been taken up: one that was is older than what has been
        set since.
    """

    Parameters: ClassVar[type[msgspec.Struct]] = msgspec.Struct
    publishes: ClassVar[tuple[str, ...]] = ()
    listens_to: ClassVar[tuple[str, ...]] = ()
    relays: ClassVar[tuple[str, ...]] = ()
    queue: ClassVar[int] = 1000
    answers: ClassVar[bool] = False
    kernel_module: ClassVar[str] = ""

    publisher: Publisher

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        # Who changes a kind may change what its compiled ticks do: it names its own, or has none.
        if "kernel_module" not in vars(cls):
            cls.kernel_module = ""

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
            setup, self.store, self.events.notify, lambda: self.state not in ("finished", "failed")
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
        self.ticks_compiled = 0

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Check a node's `setup`, before anything is started, for what the types of its parameters cannot say.

        Raises
        ------
        ParameterError
            With path, value, limit and remedy.
        """
        del setup

    @classmethod
    def kernel_of(cls, parameters: Mapping[str, Any]) -> str:
        """Name the module of the compiled ticks of a node with these `parameters`, as written.

        Returns
        -------
        str
            Its name; empty where there is none.
        """
        del parameters
        return cls.kernel_module

    @classmethod
    def modules(cls, parameters: Mapping[str, Any]) -> set[str]:
        """Tell what is compiled for a node with these `parameters`, as written.

        Returns
        -------
        set of str
            Modules of nodes/compiled.
        """
        return {cls.kernel_of(parameters)} - {""}

    @classmethod
    def axes(cls, parameters: Mapping[str, Any], name: str) -> tuple[Axis, ...]:
        """Tell which axes the scene must compute for what a node of this `name` does with these `parameters`, as written.

        Returns
        -------
        tuple of str
            Axes; none for a node that does not care.
        """
        del parameters, name
        return ()

    @classmethod
    def substitute_device(
        cls, parameters: Mapping[str, Any], name: str, device: str
    ) -> tuple[dict[str, Any], dict[str, Any]] | None:
        """Put a real `device` (``device:=NAME``) in the place of a virtual one, in the node `name` with these `parameters`.

        Returns
        -------
        tuple of dict and dict, or None
            The node's parameters with that device, and the plant that it is to a coupling; None for
            a node without a virtual device.

        Raises
        ------
        ParameterError
            When no such device is known.
        """
        del parameters, name, device
        return None

    @classmethod
    def plant(
        cls, parameters: Mapping[str, Any], name: str, axes: Sequence[Axis]
    ) -> dict[str, float]:
        """Return what the node `name` with these `parameters`, as written, knows of the plant along the `axes` of the scene.

        The launcher fills it into the ``plant`` of the chain's coupling, which judges its laws on
        it.

        Returns
        -------
        dict of str to float
            Fields of `nodes.coupling.parameters.PlantParameters` in their units; none for a node
            that knows nothing.

        Raises
        ------
        ParameterError
            When the parameters describe no device.
        """
        del parameters, name, axes
        return {}

    @classmethod
    def largest_force(cls, parameters: Mapping[str, Any], name: str, period: float) -> float | None:
        """Return the largest force that the node `name` with these `parameters` hands over, at a `period` [s].

        Returns
        -------
        float or None
            Largest magnitude along an axis [N]; None where the parameters set no limit.
        """
        del parameters, name, period
        return None

    @classmethod
    def unjudged(cls, setup: Setup) -> str:
        """Return why nobody judges the stability of what the node of this `setup` renders.

        Returns
        -------
        str
            One sentence; empty where it is judged, or renders nothing.
        """
        del setup
        return ""

    @classmethod
    def subscribes(cls, parameters: Any) -> tuple[str, ...]:
        """Tell which subscriptions a node with these `parameters` makes at each publisher, which waits for all of them.

        Returns
        -------
        tuple of str
            Topics.
        """
        del parameters
        return ("",) if cls.listens_to == ("*",) else cls.listens_to

    @classmethod
    def hears(cls, parameters: Any, nodes: Iterable[str]) -> frozenset[str]:
        """Tell which of the other `nodes` of a launch one with these `parameters` connects to, when it listens to everything.

        Returns
        -------
        frozenset of str
            Some of them, or all.
        """
        del parameters
        return frozenset(nodes)

    # -- what a kind of node defines
    # ---------------------------------------------------------------------------------

    def configure(self) -> None:
        """Build what the loop needs from the parameters, before any socket exists."""

    def compiled_ticks(self, kernel: Callable[[int], int]) -> TickTaker:
        """Make the compiled ticks of the kind, which this `kernel` does, when the sockets exist.

        Returns
        -------
        TickTaker
            Of this node.
        """
        del kernel
        raise TypeError(f"node kind {self.setup.kind!r} does not define compiled_ticks()")

    def connect(
        self, subscribe: Callable[[Iterable[str], Iterable[str], int], Subscription]
    ) -> None:
        """Connect to the publishers of what the kind listens to; `subscribe` takes endpoints, topics and queue length."""
        if self.listens_to == ("*",):
            self.inbox = subscribe(
                set(self.setup.sources.values()), self.subscribes(self.store.current), self.queue
            )
        elif self.listens_to:
            wanted = [self.setup.topic(topic) for topic in self.listens_to]
            self.inbox = subscribe(
                {self.setup.sources[topic] for topic in self.listens_to}, wanted, self.queue
            )

    def loop(self) -> None:
        """Tick until `stopping` (main thread)."""
        raise TypeError(f"node kind {self.setup.kind!r} does not define loop()")

    def finish(self) -> None:
        """Leave everything safe; called on every way out of the loop."""

    def report(self) -> dict[str, Any]:
        """Tell the launcher at the end what the status does not.

        Returns
        -------
        dict
            JSON-able figures.
        """
        return {}

    def prepare(self, parameters: Any) -> Callable[[int], Any]:
        """Prepare new, valid `parameters` off the hot path (control thread).

        Returns
        -------
        callable
            Applied on the main thread between two ticks, with the tick number.

        Raises
        ------
        ParameterError
            When the node cannot change while it runs.
        """
        del parameters
        raise ParameterError(
            f"{self.setup.name}: parameters of a {self.setup.kind} are fixed while it runs"
        )

    def prepare_forced(self, parameters: Any) -> Callable[[int], Any]:
        """Prepare new, valid `parameters` that the user insists on although the node advises against them (control thread).

        Returns
        -------
        callable
            As from `prepare`, which it is for a node that refuses nothing of the kind.
        """
        return self.prepare(parameters)

    def check_health(self) -> None:
        """Look whether all is well, about twice a second (control thread)."""

    def operations(self) -> dict[str, Callable[..., Any]]:
        """Control operations beside parameters, status and stop.

        Returns
        -------
        dict of str to callable
            Called on the control thread with the request's arguments.
        """
        return {}

    # -- what every node can use
    # -------------------------------------------------------------------------------------

    def make_counters(self) -> Any:
        """Make what counts the node's ticks.

        Returns
        -------
        Counters
            Or a struct with the same fields, in which compiled ticks go on.
        """
        return Counters()

    def counted(self) -> Counted:
        """Tell how far the node is, compiled ticks that still go on included; from any thread.

        Returns
        -------
        Counted
            Its tick, how many there were, and what was missed.
        """
        counters = self.counters
        return Counted(max(counters.seq, 0), counters.ticks, counters.gaps, counters.skipped)

    def set_clock(self, offset: float, error: float) -> None:
        """Take over the `offset` from this host's clock to the launcher's [s], and how far off that may be: its `error` [s]."""
        self.clock.set(offset, error)
        # Compiled ticks go on with the one that they were given.
        self.events.notify()

    def make_compiled(self) -> TickTaker | None:
        """Make the compiled ticks, where there are any.

        Returns
        -------
        TickTaker or None
            Of this node, when its sockets exist.
        """
        if self.kernel is not None:
            self.compiled = self.compiled_ticks(self.kernel)
            self.events.mail = self.compiled.mail
        return self.compiled

    def stop(self, reason: str) -> None:
        """Ask the loop to end after the present tick, for a `reason`; the first one is kept."""
        if not self.stopping:
            self.stop_reason = reason
            self.stopping = True
        self.started.set()
        self.events.interrupt()

    def flush_outbox(self) -> None:
        """Send what is queued (main thread)."""
        if self.compiled is not None:
            self.compiled.take_mail()
        while self.events.outbox:
            topic, payload = self.events.outbox.popleft()
            self.publisher.send_aside(topic, payload)
            self.sent += 1
        self.publisher.flush()

    def between_ticks(self, seq: int) -> None:
        """Take up what the control thread prepared, from tick `seq` on, and send what is queued (main thread)."""
        # Before looking: what comes in between calls again.
        self.events.waiting = False
        if self.changes:
            self.changes.apply_next(seq)
        if self.events.outbox:
            self.flush_outbox()
        if self.maintain() or self.changes:
            self.events.waiting = True

    def maintain(self) -> bool:
        """Take in what listeners have sent, and connect anew what the control thread found deaf (main thread).

        Returns
        -------
        bool
            Whether there is more to take in.
        """
        if self.links is None:
            # There are no sockets.
            return False
        self.links.maintain()
        return self.publisher.maintain()

    def status(self) -> NodeStatus:
        """Describe the node now.

        Returns
        -------
        NodeStatus
            State and counters.
        """
        return status_of(self)
