"""The second thread of a node: serves control requests, writes the status, watches the parameter file.

It is the only thread that may take its time. It never touches the loop's sockets: what must be published goes through the
node's outbox, what must change is handed over between two ticks.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import msgspec
import zmq

from messages import topics
from messages.codec import MessageRefusedError
from messages.control import Reply, decode_request
from messages.sockets import remove_ipc
from nodes.parameters import ParameterError, WatchedFile

if TYPE_CHECKING:
    from messages.sockets import Context
    from nodes.base import Node

STATUS_PERIOD = 0.5
WATCH_PERIOD = 0.1


class ControlServer(threading.Thread):
    """Serves one node.

    Parameters
    ----------
    node : Node
        The node to serve.
    context : zmq.Context
        Context of the process.
    """

    def __init__(self, node: Node, context: Context) -> None:
        super().__init__(name=f"{node.setup.name}-control", daemon=True)
        self._node = node
        self._ending = threading.Event()
        self._socket = context.socket(zmq.REP)
        remove_ipc(node.setup.control)
        self._socket.bind(node.setup.control)
        self._socket.rcvtimeo = int(WATCH_PERIOD * 1000)
        self._watched = WatchedFile(node.setup.watch) if node.setup.watch else None
        store = node.store
        self._operations: dict[str, Callable[..., Any]] = {
            "status": lambda: msgspec.to_builtins(node.status()),
            "info": self._info,
            "start": self._start,
            "stop": lambda: node.stop("stop requested"),
            "param.list": store.flat,
            "param.get": store.get,
            "param.set": lambda values: node.change_parameters(store.changed(values)),
            "param.dump": store.dump,
            "param.load": lambda values: node.change_parameters(store.replaced(values)),
            **node.operations(),
        }

    def _info(self) -> dict[str, Any]:
        node = self._node
        return {
            "status": msgspec.to_builtins(node.status()),
            "publishes": [*node.publishes, topics.status(node.setup.name), topics.event(node.setup.name)],
            "listens_to": list(node.listens_to),
            "operations": sorted(self._operations),
            "endpoint": node.setup.publish,
        }

    def _start(self) -> None:
        self._node.started.set()

    def _answer(self, payload: bytes) -> Reply:
        try:
            request = decode_request(payload)
        except MessageRefusedError as error:
            self._node.refused += 1
            return Reply(False, error=f"{self._node.setup.name}: {error}")
        operation = self._operations.get(request.op)
        if operation is None:
            known = ", ".join(sorted(self._operations))
            return Reply(False, error=f"{self._node.setup.name}: unknown operation {request.op!r}; known: {known}")
        try:
            return Reply(True, operation(**request.args))
        except (ParameterError, ValueError, TypeError) as error:
            return Reply(False, error=f"{error}"[:4000])

    def run(self) -> None:
        """Serve until stopped."""
        next_status = 0.0
        while not self._ending.is_set():
            try:
                payload = self._socket.recv()
            except zmq.Again:
                payload = None
            if payload is not None:
                reply = self._answer(payload)
                try:
                    self._socket.send(msgspec.msgpack.encode(reply))
                except (TypeError, msgspec.ValidationError) as error:
                    self._socket.send(msgspec.msgpack.encode(Reply(False, error=f"unsendable result: {error}")))
            if self._watched is not None:
                self._poll_file(self._watched)
            if time.monotonic() >= next_status:
                next_status = time.monotonic() + STATUS_PERIOD
                self._node.post(topics.status(self._node.setup.name), self._node.status())
        self._socket.close(linger=100)

    def _poll_file(self, watched: WatchedFile) -> None:
        node = self._node
        try:
            values = watched.poll()
            if values is not None:
                receipt = node.change_parameters(node.store.replaced(values))
                node.say(f"applied {watched.path}: {receipt}")
        except (ParameterError, ValueError) as error:
            node.tell("refused", f"{watched.path}: {error}; the running parameters are untouched")

    def stop(self) -> None:
        """Stop serving and wait for the thread."""
        self._ending.set()
        if self.is_alive():
            self.join()
        else:
            self._socket.close(linger=0)
