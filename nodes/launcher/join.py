"""Start one node by hand, for a launch on this machine or on another one.

For another machine's launch it waits at the node's control endpoint until that launcher, whose key
must be allowed here, sends the setup. This machine decides the kind of node, the code it runs and
the files it opens, by what is installed and by the command line; a setup that goes beyond that is
refused or adjusted.
"""

import fcntl
import os
import shutil
import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import zmq

from messages.codec import MessageRefusedError
from messages.transport.context import new_context
from messages.transport.endpoints import bind, split
from messages.transport.gate import Gate
from messages.transport.keys import identity
from messages.transport.requests import Reply, ReplySocket, decode_request
from nodes.base import realtime
from nodes.base.node import Node
from nodes.base.node_kinds import is_hop, load, node_kinds
from nodes.base.process import live
from nodes.base.setup import Scheduling, Setup
from nodes.compiled.load import load_kernel
from nodes.launcher import runs
from nodes.parameters.paths import check_paths
from nodes.parameters.store import ParameterError, convert


def start_here(run: runs.RunInfo, name: str) -> int:
    """Start a node that a launch on this machine waits for."""
    setup = run.nodes[name]
    if not setup.by_hand or not split(setup.control)[0].startswith("ipc://"):
        raise ParameterError(
            "the launch does not wait for it here; set by_hand: true in its launch file",
            path=name,
        )
    _claim(setup)
    return live(load(setup.factory)(setup), load_kernel)


def _claim(setup: Setup) -> None:
    """Lock the node's name for this process: a second one would take over its sockets."""
    held = os.open(
        Path(setup.run_dir) / f"{setup.name}.lock", os.O_RDWR | os.O_CREAT, 0o600
    )
    try:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        other = os.read(held, 32).decode("ascii", errors="replace")
        os.close(held)
        raise ParameterError(
            f"process {other} is already this node; end it first: kill {other}; kill -CONT {other}",
            path=setup.name,
        ) from error
    os.ftruncate(held, 0)
    os.write(held, str(os.getpid()).encode("ascii"))


class Starter:
    """Waits for a remote launcher and accepts its setup, within `kind` and `allow_paths`."""

    def __init__(
        self,
        name: str,
        host: str,
        port: int,
        kind: str = "",
        allow_paths: Sequence[Path] = (),
    ) -> None:
        self._name = name
        self._kind = kind or name.rpartition("/")[2]
        kinds = node_kinds()
        if self._kind not in kinds:
            raise ParameterError(
                f"no kind of node is named {self._kind!r}; choose one with --kind:"
                f" {', '.join(sorted(kinds))}",
                path=name,
            )
        self._factory = kinds[self._kind]
        self._allow_paths = [folder.resolve() for folder in allow_paths]
        place = f"tcp://{f'[{host}]' if ':' in host else host}"
        key = f"#{identity().public}"
        self.publish = f"{place}:{port}{key}"
        self.control = f"{place}:{port + 1}{key}"
        self._stopping = False

    def wait(self) -> Setup | None:
        """Wait for the setup; None if interrupted."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, self._on_signal)
        context = new_context()
        gate = Gate(
            context,
            lambda reason: print(
                f"[{self._name}] denied: {reason}", file=sys.stderr, flush=True
            ),
        )
        inbox = ReplySocket(context)
        try:
            bind(inbox.socket, self.control)
            gate.watch(inbox.socket)
            gate.start()
            inbox.socket.rcvtimeo = 200
            return self._serve(inbox)
        finally:
            gate.stop()
            # Time for the last answer to leave.
            inbox.socket.close(linger=1000)
            context.term()

    def _on_signal(self, *_: object) -> None:
        self._stopping = True

    def _serve(self, inbox: ReplySocket) -> Setup | None:
        while not self._stopping:
            try:
                frames = inbox.receive()
            except zmq.Again:
                continue
            setup = None
            try:
                request = decode_request(frames)
                if request.op == "configure":
                    setup = self.accept(request.args.get("setup"))
                reply = self._reply(request.op)
            except (MessageRefusedError, ParameterError, runs.RunError) as error:
                reply = Reply(False, error=f"{self._name}: {error}"[:4000])
            inbox.answer(msgspec.msgpack.encode(reply))
            if setup is not None:
                return setup
        return None

    def _reply(self, op: str) -> Reply:
        status = {"state": "unconfigured", "node": self._name, "pid": os.getpid()}
        answers = {
            "status": status,
            "clock": {"monotonic_s": time.monotonic()},
            "configure": None,
            "stop": None,
        }
        self._stopping = self._stopping or op == "stop"
        if op not in answers:
            return Reply(
                False, error=f"{self._name}: unconfigured; known: {', '.join(answers)}"
            )
        return Reply(True, answers[op])

    def accept(self, data: Any) -> Setup:
        """Check a setup from another machine and adapt it to this one."""
        setup: Setup = convert(data, Setup, "setup")
        if setup.name != self._name:
            raise ParameterError(
                f"{setup.name!r}, but {self._name!r} was started here",
                path="setup.name",
            )
        for field, own in (("publish", self.publish), ("control", self.control)):
            if getattr(setup, field) != own:
                raise ParameterError(
                    f"{getattr(setup, field)}, but this node binds {own}",
                    path=f"setup.{field}",
                )
        beyond = (setup.reach, setup.listen, setup.listen_reach, setup.watch)
        if any(beyond) or setup.lease <= 0.0:
            raise ParameterError(
                "reach, listen, listen_reach and watch must be empty and lease positive on"
                " another machine",
                path="setup",
            )
        for topic, source in setup.sources.items():
            if not split(source)[0].startswith("tcp://"):
                raise ParameterError(
                    f"{source} is not on the network", path=f"setup.sources.{topic}"
                )
        if setup.kind != self._kind:
            raise ParameterError(
                f"{setup.kind!r}, but a {self._kind} was started here; use: haptic"
                f" node start {self._name} --kind {setup.kind}",
                path="setup.kind",
            )
        allowed = [str(folder) for folder in self._allow_paths]
        made = msgspec.structs.replace(
            setup, factory=self._factory, run_dir="", allow_paths=allowed
        )
        kind = load(made.factory)
        made = msgspec.structs.replace(made, scheduling=here(setup.scheduling, kind))
        # Check paths before the kind's own code reads them.
        check_paths(
            convert(setup.parameters, kind.Parameters, self._name),
            self._allow_paths,
            self._name,
        )
        kind.check(made)
        kind(made)
        folder = runs.new_node_dir(
            f"{_plain(setup.run)}-{setup.name.replace('/', '-')}"
        )
        (folder / setup.namespace).mkdir(mode=0o700, parents=True, exist_ok=True)
        return msgspec.structs.replace(made, run_dir=str(folder))


def here(asked: Scheduling, kind: type[Node]) -> Scheduling:
    """Choose processors here: the quietest for a node of the loop, others for a listener."""
    quietest = realtime.quietest_processor()
    others = sorted(os.sched_getaffinity(0) - {quietest})
    if not asked.cpus or not others:
        return Scheduling(fifo=asked.fifo)
    return (
        Scheduling(cpus=[quietest], aside=others, fifo=asked.fifo)
        if is_hop(kind)
        else Scheduling(cpus=others)
    )


def _plain(run: str) -> str:
    """Return the run's name if it is valid as a directory name; it came over the network."""
    if (
        not run
        or "/" in run
        or run.startswith(".")
        or not run.isprintable()
        or len(run) > 100
    ):
        raise ParameterError(f"{run!r} is not the name of a run", path="setup.run")
    return run


def start_for(
    name: str, host: str, port: int, kind: str = "", allow_paths: Sequence[Path] = ()
) -> int:
    """Start a node for a launch on another machine."""
    starter = Starter(name, host, port, kind, allow_paths)
    print(
        f"[{name}] waiting for its launcher at {starter.control}",
        file=sys.stderr,
        flush=True,
    )
    setup = starter.wait()
    if setup is None:
        return 130
    # Remove what killed predecessors left.
    runs.sweep()
    try:
        node = load(setup.factory)(setup)
        node.set_clock(setup.clock_offset, setup.clock_error)
        return live(node, load_kernel)
    finally:
        shutil.rmtree(setup.run_dir, ignore_errors=True)
