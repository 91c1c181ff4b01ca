"""The gate: lets in the machines whose keys are allowed, and counts everybody else.

ZeroMQ asks it once per connection (ZAP, RFC 27), never per message, so it costs the loop nothing. It also watches the
process's sockets for handshakes that fail before there is a key to ask about: a plain client, a port scan, a forger bound in
the place of a node, a replayed or altered stream. Keys allowed while it runs are let in from then on.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING

import zmq
from zmq.utils.monitor import parse_monitor_message

from messages.transport.endpoints import DOMAIN
from messages.transport.keys import KeyRefusedError, allowed, identity, key_dir

if TYPE_CHECKING:
    from messages.transport.endpoints import Context, Socket

ZAP = "inproc://zeromq.zap.01"
FAILURES = zmq.EVENT_HANDSHAKE_FAILED_PROTOCOL | zmq.EVENT_HANDSHAKE_FAILED_NO_DETAIL | zmq.EVENT_HANDSHAKE_FAILED_AUTH
_STOP = "inproc://haptic.gate.stop"


class Gate(threading.Thread):
    """Authenticates what connects to the encrypted sockets of one process.

    Parameters
    ----------
    context : zmq.Context
        Context of the process; start the gate before binding, stop it before terminating.
    denied : callable
        Called on the gate's thread with one sentence for every peer that was not let in.

    Raises
    ------
    KeyRefusedError
        When this machine's keys cannot be used.
    """

    def __init__(self, context: Context, denied: Callable[[str], None]) -> None:
        super().__init__(name="gate", daemon=True)
        self._context = context
        self._denied = denied
        self._me = identity().public
        self._folder = key_dir()
        self._seen = -1
        self._known: dict[bytes, str] = {}
        self._monitors: list[tuple[Socket, str, Socket]] = []
        self._zap = context.socket(zmq.REP)
        self._zap.bind(ZAP)
        self._stop_in = context.socket(zmq.PAIR)
        self._stop_in.bind(_STOP)
        self._stop_out = context.socket(zmq.PAIR)
        self._stop_out.connect(_STOP)

    def watch(self, socket: Socket, role: str) -> None:
        """Watch the handshakes of a socket, from the thread that owns it and before the gate is started.

        Parameters
        ----------
        socket : zmq.Socket
            Any socket of the process.
        role : str
            What it is, for the report: ``server`` where peers come to it, ``client`` where it goes to them.
        """
        self._monitors.append((socket.get_monitor_socket(FAILURES), role, socket))

    def run(self) -> None:
        """Answer until stopped."""
        poller = zmq.Poller()
        for watched in (self._zap, self._stop_in, *(monitor for monitor, _, _ in self._monitors)):
            poller.register(watched, zmq.POLLIN)
        while True:
            ready = dict(poller.poll())
            if self._stop_in in ready:
                break
            if self._zap in ready:
                self._answer(self._zap.recv_multipart())
            for monitor, role, _ in self._monitors:
                if monitor in ready:
                    self._tell(role, monitor.recv_multipart())
        self._close()

    def _close(self) -> None:
        for socket in (self._zap, self._stop_in, *(monitor for monitor, _, _ in self._monitors)):
            socket.close(linger=0)

    def _answer(self, frames: list[bytes]) -> None:
        version, request, domain, address, _, mechanism, *credentials = frames
        key = credentials[0] if mechanism == b"CURVE" and credentials else b""
        name = self._who(key) if domain == DOMAIN else ""
        code, text = (b"200", b"OK") if name else (b"400", b"unknown key")
        self._zap.send_multipart([version, request, code, text, name.encode(), b""])
        if not name:
            self._denied(
                f"a connection from {address.decode('ascii', 'replace')} with the unknown key {key.hex()}; to let it in: "
                f"haptic keys allow NAME {key.hex()}"
            )

    def _who(self, key: bytes) -> str:
        with contextlib.suppress(FileNotFoundError):
            changed = (self._folder / "allowed").stat().st_mtime_ns
            if changed != self._seen:
                try:
                    self._known = {bytes.fromhex(public): name for name, public in allowed(self._folder).items()}
                except KeyRefusedError as error:
                    # Nobody is let in by a directory that others can write to.
                    self._known = {}
                    self._denied(str(error))
                self._seen = changed
        return "self" if key.hex() == self._me else self._known.get(key, "")

    def _tell(self, role: str, frames: list[bytes]) -> None:
        told = parse_monitor_message(frames)
        event, where = told["event"], told["endpoint"].decode("ascii", "replace")
        if role == "client":
            if event == zmq.EVENT_HANDSHAKE_FAILED_AUTH:
                self._denied(f"{where} does not let this machine in; there: haptic keys allow NAME {self._me}")
            else:
                self._denied(
                    f"whoever answers at {where} does not have the key that is expected there; nothing is taken from it"
                )
        elif event != zmq.EVENT_HANDSHAKE_FAILED_AUTH:
            # Unknown keys are told where they are refused, with the key.
            self._denied(
                f"a connection to {where} without a valid handshake: a plain client, or an altered or replayed stream"
            )

    def stop(self) -> None:
        """Stop watching and wait for the thread; before the watched sockets are closed."""
        if self.is_alive():
            self._stop_out.send(b"")
            self.join()
        else:
            self._close()
        self._stop_out.close(linger=0)
        for _, _, socket in self._monitors:
            if not socket.closed:
                socket.disable_monitor()
