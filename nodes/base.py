"""The life of a node: sockets, ready, ticks, control requests, a clean stop on any signal.

The main thread owns the loop's sockets and does nothing but ticks: blocking receive, plain floats, send. A second thread
serves control requests on its own socket; what it prepares is handed over by one reference assignment and taken up between
two ticks, and what it wants published goes through an outbox that is emptied after the tick's own message has left.
"""

from __future__ import annotations

import importlib
import os
import resource
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from types import FrameType
from typing import Any, ClassVar, TypeVar

import msgspec

from messages import topics
from messages.codec import Decoder, MessageRefusedError, encode
from messages.sockets import Publisher, Subscription, new_context, remove_ipc
from messages.types import Event, Message, NodeStatus
from nodes import realtime
from nodes.parameters import ParameterError, ParameterStore
from nodes.setup import Setup

M = TypeVar("M", bound=Message)
IDLE_MS = 100
"""How long a blocking receive waits before it looks whether the node should stop [ms]."""


class Change:
    """Something prepared off the hot path, to be applied between two ticks.

    Parameters
    ----------
    apply : callable
        Called on the main thread with the tick number; its return value goes back to whoever asked.
    """

    def __init__(self, apply: Callable[[int], Any]) -> None:
        self._apply = apply
        self._done = threading.Event()
        self._result: Any = None

    def run(self, seq: int) -> None:
        """Apply it (main thread).

        Parameters
        ----------
        seq : int
            Tick number at which it takes effect.
        """
        self._result = self._apply(seq)
        self._done.set()

    def wait(self, timeout: float) -> Any:
        """Wait until it was applied (control thread).

        Parameters
        ----------
        timeout : float
            Longest wait [s].

        Returns
        -------
        object
            What the change returned.

        Raises
        ------
        ParameterError
            When the main thread did not take it up in time.
        """
        if not self._done.wait(timeout):
            raise ParameterError(f"not taken up by the loop within {timeout:g} s; is the node being stopped?")
        return self._result


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
    """

    Parameters: ClassVar[type[msgspec.Struct]] = msgspec.Struct
    publishes: ClassVar[tuple[str, ...]] = ()
    listens_to: ClassVar[tuple[str, ...]] = ()

    def __init__(self, setup: Setup) -> None:
        self.setup = setup
        self.store = ParameterStore(setup.name, self.Parameters, setup.parameters)
        self.state = "configuring"
        self.stop_reason = ""
        self.stopping = False
        self.started = threading.Event()
        self.change: Change | None = None
        self.outbox: deque[tuple[bytes, bytes]] = deque(maxlen=1024)
        self.seq = 0
        self.ticks = self.sent = self.received = self.refused = self.skipped = self.gaps = 0
        self._told: dict[str, int] = {}
        self._change_lock = threading.Lock()

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Check, before anything is started, what the types of the parameters cannot say.

        Parameters
        ----------
        setup : Setup
            The node as it would be started.

        Raises
        ------
        ParameterError
            With path, value, limit and remedy.
        """
        del setup

    # -- what a kind of node defines ---------------------------------------------------------------------------------

    def configure(self) -> None:
        """Build what the loop needs from the parameters, before any socket exists."""

    def connect(self, subscribe: Callable[[Iterable[str], Iterable[str], int], Subscription]) -> None:
        """Connect to the publishers of what the kind listens to.

        Parameters
        ----------
        subscribe : callable
            Makes a subscription from endpoints, topics and queue length.
        """
        if self.listens_to:
            self.inbox = subscribe({self.setup.sources[topic] for topic in self.listens_to}, self.listens_to, 1000)

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
        """Prepare new, valid parameters off the hot path (control thread).

        Parameters
        ----------
        parameters : msgspec.Struct
            The node's parameters after the change.

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
        raise ParameterError(f"{self.setup.name}: parameters of a {self.setup.kind} are fixed while it runs")

    def operations(self) -> dict[str, Callable[..., Any]]:
        """Control operations beside parameters, status and stop.

        Returns
        -------
        dict of str to callable
            Called on the control thread with the request's arguments.
        """
        return {}

    # -- what every node can use -------------------------------------------------------------------------------------

    def now(self) -> float:
        """Time for stamps: the host's monotonic clock, or simulated time in lockstep.

        Returns
        -------
        float
            Seconds.
        """
        return self.seq * self.setup.period if self.setup.pace == "lockstep" else time.monotonic()

    def stop(self, reason: str) -> None:
        """Ask the loop to end after the present tick.

        Parameters
        ----------
        reason : str
            Why; the first one is kept.
        """
        if not self.stopping:
            self.stop_reason = reason
            self.stopping = True
        self.started.set()

    def say(self, text: str) -> None:
        """Write one line to standard error, named.

        Parameters
        ----------
        text : str
            What to say.
        """
        print(f"[{self.setup.name}] {text}", file=sys.stderr, flush=True)

    def tell(self, kind: str, reason: str) -> None:
        """Publish an event and say it; repeats of one kind are said at powers of two only.

        Parameters
        ----------
        kind : str
            Kind of event.
        reason : str
            One sentence with value and limit.
        """
        count = self._told[kind] = self._told.get(kind, 0) + 1
        if count & (count - 1) == 0:
            repeat = f" ({count} times)" if count > 1 else ""
            self.say(f"{kind}: {reason}{repeat}")
            message = Event(seq=self.seq, stamp=self.now(), node=self.setup.name, kind=kind, reason=reason[:4000])
            self.post(topics.event(self.setup.name), message)

    def post(self, topic: str, message: Message) -> None:
        """Queue a message that is not part of the tick; it leaves after the tick's own.

        Parameters
        ----------
        topic : str
            Topic.
        message : Message
            The message.
        """
        self.outbox.append((topic.encode(), encode(message)))

    def flush_outbox(self) -> None:
        """Send what is queued (main thread)."""
        while self.outbox:
            topic, payload = self.outbox.popleft()
            self.publisher.send(topic, payload)
            self.sent += 1

    def take(self, decoder: Decoder[M], frames: tuple[bytes, bytes], topic: bytes) -> M | None:
        """Decode a received message; count and tell what is refused.

        Parameters
        ----------
        decoder : Decoder
            For the type expected.
        frames : tuple of bytes
            Topic and payload.
        topic : bytes
            The topic expected.

        Returns
        -------
        Message or None
            None when it was refused.
        """
        if frames[0] != topic:
            self.refused += 1
            self.tell("refused", f"a message on {frames[0][:64]!r} where {topic.decode()} was expected")
            return None
        try:
            message = decoder.decode(frames[1])
        except MessageRefusedError as error:
            self.refused += 1
            self.tell("refused", str(error)[:1000])
            return None
        self.received += 1
        return message

    def between_ticks(self, seq: int) -> None:
        """Take up what the control thread prepared, and send what is queued (main thread, after the tick).

        Parameters
        ----------
        seq : int
            The tick at which a change takes effect.
        """
        change = self.change
        if change is not None:
            self.change = None
            change.run(seq)
        if self.outbox:
            self.flush_outbox()

    def hand_over(self, apply: Callable[[int], Any], timeout: float = 2.0) -> Any:
        """Hand a prepared change to the loop and wait until it was applied (control thread).

        Parameters
        ----------
        apply : callable
            Called on the main thread with the tick number.
        timeout : float
            Longest wait [s].

        Returns
        -------
        object
            What `apply` returned.
        """
        with self._change_lock:
            change = Change(apply)
            self.change = change
            return change.wait(timeout)

    def change_parameters(self, parameters: Any) -> Any:
        """Check, prepare and apply new parameters, all or nothing (control thread).

        Parameters
        ----------
        parameters : msgspec.Struct
            The node's parameters after the change.

        Returns
        -------
        object
            The receipt of the change.
        """
        receipt = self.hand_over(self.prepare(parameters))
        self.store.accept(parameters)
        return receipt

    def status(self) -> NodeStatus:
        """Describe the node now.

        Returns
        -------
        NodeStatus
            State and counters.
        """
        usage = resource.getrusage(resource.RUSAGE_SELF)
        return NodeStatus(
            seq=self.seq,
            stamp=self.now(),
            node=self.setup.name,
            kind=self.setup.kind,
            state=self.state,
            pid=os.getpid(),
            ticks=self.ticks,
            sent=self.sent,
            received=self.received,
            refused=self.refused,
            skipped=self.skipped,
            gaps=self.gaps,
            reason=self.stop_reason,
            memory=float(realtime.memory_bytes()),
            cpu=usage.ru_utime + usage.ru_stime,
        )

    # -- life --------------------------------------------------------------------------------------------------------

    def _await_listeners(self) -> None:
        deadline = time.monotonic() + 10.0
        self.state = "waiting"
        while self.publisher.listeners() < self.setup.listeners and not self.stopping:
            if time.monotonic() > deadline:
                self.tell(
                    "listeners",
                    f"{self.publisher.listeners()} of {self.setup.listeners} listeners within 10 s; going on without",
                )
                return
            time.sleep(0.002)

    def live(self) -> int:
        """Run the node from start to end.

        Returns
        -------
        int
            Exit code: 0 after a clean stop, 1 after a failure.
        """
        from nodes.control import ControlServer

        signal.signal(signal.SIGINT, self._on_signal)
        signal.signal(signal.SIGTERM, self._on_signal)
        refused = realtime.apply(self.setup.scheduling)
        try:
            self.configure()
        except (ParameterError, ValueError, OSError) as error:
            self.say(f"cannot start: {error}")
            self.stop_reason, self.state = str(error), "failed"
            self._write_report()
            return 1
        context = new_context()
        self.publisher = Publisher(context, self.setup.publish)
        self.inbox: Subscription | None = None
        self.connect(lambda endpoints, topics, queue: Subscription(context, endpoints, topics, queue))
        control = ControlServer(self, context)
        code = 1
        try:
            control.start()
            for text in refused:
                self.tell("realtime", text)
            self._await_listeners()
            self.state = "ready"
            realtime.quiet_interpreter()
            self.loop()
            code = 0
        finally:
            # Whatever ended the loop, an exception included: first the device is made safe, then all is told and closed.
            try:
                self.finish()
            finally:
                self.state = "finished" if code == 0 else "failed"
                control.stop()
                # Emptied first, so that the last status tells exactly what was sent before it.
                self.flush_outbox()
                self.post(topics.status(self.setup.name), self.status())
                self.flush_outbox()
                if self.inbox is not None:
                    self.inbox.close()
                self.publisher.close()
                context.term()
                remove_ipc(self.setup.control)
                self._write_report()
        return code

    def _write_report(self) -> None:
        path = Path(self.setup.run_dir) / f"{self.setup.name}.report.json"
        draft = path.with_suffix(".draft")
        draft.write_bytes(msgspec.json.encode({"status": msgspec.to_builtins(self.status()), **self.report()}))
        draft.replace(path)

    def _on_signal(self, number: int, frame: FrameType | None) -> None:
        del frame
        self.stop(signal.Signals(number).name)


def load(factory: str) -> type[Node]:
    """Import the class of a node kind.

    Parameters
    ----------
    factory : str
        ``module:Class``.

    Returns
    -------
    type of Node
        The class.
    """
    module, _, name = factory.partition(":")
    found: type[Node] = getattr(importlib.import_module(module), name)
    return found


def start(arguments: list[str]) -> int:
    """Run one node as this process: ``python -m nodes.base SETUP_FILE``.

    Parameters
    ----------
    arguments : list of str
        The path of the node's setup file, written by the launcher.

    Returns
    -------
    int
        Exit code.
    """
    realtime.die_with_parent()
    setup = msgspec.json.decode(Path(arguments[0]).read_bytes(), type=Setup)
    try:
        node = load(setup.factory)(setup)
    except ParameterError as error:
        print(f"[{setup.name}] cannot start: {error}", file=sys.stderr, flush=True)
        return 1
    return node.live()


def describe(parameters: Mapping[str, Any]) -> str:
    """Write parameters in one line.

    Parameters
    ----------
    parameters : mapping
        Builtins.

    Returns
    -------
    str
        JSON, which is YAML flow style too.
    """
    return msgspec.json.encode(parameters).decode()
