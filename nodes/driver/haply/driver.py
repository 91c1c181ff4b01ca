"""Haply Inverse3 as a driver node, through the WebSocket of Haply's Inverse Service.

A thread exchanges forces for states, as fast as the service answers and at most at `servo_rate`.
Driver and thread share a mailbox, as with every other device, so the driver's tick never waits for
the service. Written from the vendor's guide and checked against a stand-in service (sim/emulators),
not yet on hardware.
"""

from __future__ import annotations

import ctypes
import math
import threading
import time
from contextlib import AbstractContextManager, ExitStack, suppress
from typing import Any, ClassVar, Final

import msgspec
from websockets.exceptions import ConnectionClosed, InvalidHandshake
from websockets.sync.client import ClientConnection, connect

from messages.types import ZERO, Vector
from nodes.driver.haply.parameters import Inverse3DriverParameters
from nodes.driver.haply.service import (
    ENDS,
    EVENTS,
    MAX_BUTTONS,
    REMEDY,
    Inverse3,
    Inverse3State,
    ServiceMessage,
    ask,
    buttons,
    command,
    read,
)
from nodes.driver.haply.service_faults import (
    BROKEN,
    CLOSED,
    ERRORS,
    FORCELESS,
    NO_STATE,
    SLOW,
    SURPLUS,
    UNPLUGGED,
    UNREADABLE,
)
from nodes.driver.haply.surplus import SurplusAnswers, SurplusError
from nodes.driver.hardware.driver import HardwareDriver
from nodes.driver.hardware.libraries import Search
from nodes.driver.hardware.mailbox import SAMPLE, MailboxDevice

COLD_START: Final = 25.0  # start time of the service, by the vendor's guide [s]
# force from which its effect is checked, and that other sessions may add [N]
ASKED: Final = 0.1
# time without an effect after which forces count as refused [s]
FORCELESS_AFTER: Final = 0.3


class Inverse3Device(MailboxDevice):
    """One device; only `open` needs the service, because its cold start takes long."""

    TITLE: ClassVar[str] = "Inverse3"
    SECTION: ClassVar[str] = "inverse3"
    AXES: ClassVar[tuple[str, ...]] = ("+y", "-x", "+z")

    def __init__(self, parameters: Inverse3DriverParameters) -> None:
        super().__init__(parameters)
        self._socket: ClientConnection | None = None
        self._open = ExitStack()
        self._threads: list[threading.Thread] = []
        self._ending = threading.Event()
        self._id = ""
        self._remark = ""
        self._others: Vector = ZERO
        self._withheld = self._many_buttons = self._unreadable = False
        self._surplus = SurplusAnswers(self._note_surplus)
        self._broken = ""  # exception that ended the exchange

    @classmethod
    def find(cls, parameters: Any) -> Search:
        """Return whether the service answers."""
        wants = parameters.inverse3
        address = f"ws://{wants.host}:{wants.port}"
        version = ask(wants.host, wants.port, "/version")
        return Search(
            None if version is None else f"the Inverse Service {version}", (address,)
        )

    def connect(self) -> None:
        """Prepare the mailbox; the service is not needed yet."""
        wants = self._wants
        continuous = min(wants.peak_force, wants.continuous_force)
        self.prepare(
            wants.peak_force,
            continuous,
            wants.workspace,
            opening=wants.start_time + 10.0,
        )
        code = self._code
        doubles = ctypes.POINTER(ctypes.c_double)
        code.mailbox_force.argtypes = [ctypes.c_void_p, doubles, ctypes.c_int]
        code.mailbox_sampled.argtypes = [ctypes.c_void_p, doubles]
        code.mailbox_ticked.argtypes = [ctypes.c_void_p]
        code.mailbox_failed.argtypes = [ctypes.c_void_p, ctypes.c_int, ctypes.c_int]

    def identify(self) -> None:
        """Wait for the service and the device, and read its properties; no force."""
        if self._socket is not None:
            return
        wants = self._wants
        address = f"ws://{wants.host}:{wants.port}"
        begun = time.monotonic()
        why = ""
        while self._socket is None:
            try:
                self._socket = self._dial(address)
            except (
                OSError,
                ConnectionClosed,
                InvalidHandshake,
                ValueError,
                TimeoutError,
            ) as error:
                why = str(error)
                if time.monotonic() > begun + wants.start_time:
                    raise OSError(
                        f"Inverse3: not ready at {address} within {wants.start_time:g} s: {why};"
                        f" {REMEDY}. On Linux ModemManager may hold its serial port"
                    ) from error
                self.wait_for(
                    f"waits up to {wants.start_time:g} s for the Inverse Service at {address}:"
                    f" {why}; a cold start takes up to {COLD_START:g} s"
                )
                time.sleep(0.1)
        if why:
            self.wait_for(f"is there after {time.monotonic() - begun:.1f} s")

    def _dial(self, address: str) -> ClientConnection:
        wants = self._wants
        with ExitStack() as dialled:
            socket = dialled.enter_context(_connection(address))
            found = read(socket.recv(timeout=2.0)).inverse3
            names = [device.device_id for device in found]
            chosen = [
                device for device in found if wants.serial in ("", device.device_id)
            ]
            if not chosen:
                asked = (
                    f"no Inverse3 {wants.serial}; available: {', '.join(names)}"
                    if names
                    else "no Inverse3 is connected"
                )
                raise ValueError(asked)
            self._describe(chosen[0])
            self._open = dialled.pop_all()
            return socket

    def _describe(self, device: Inverse3) -> None:
        wants = self._wants
        self._id = device.device_id
        sessions = ask(wants.host, wants.port, "/sessions")
        self.facts = {
            "model": "Haply Inverse3",
            "serial": device.device_id,
            "service": ask(wants.host, wants.port, "/version") or "unknown",
            # Settings of the service that change positions and forces.
            "basis": (
                ask(wants.host, wants.port, "/inverse3/0/config/basis")
                or device.config.get("basis", "unknown")
            ),
            "config": device.config,
            "status": device.status,
            "other_sessions": sessions if isinstance(sessions, list) else [],
        }

    def open(self) -> None:
        """Wait for the service, start the exchange, and enable forces, at zero."""
        self.identify()
        self._ending.clear()
        for work in (
            self._exchange,
            *([self._listen] if self._wants.events_port else []),
        ):
            thread = threading.Thread(
                target=work, name=f"inverse3 {work.__name__}", daemon=True
            )
            thread.start()
            self._threads.append(thread)
        self.await_samples()

    def _failed(self, error: int, fatal: bool = False) -> None:
        self._code.mailbox_failed(self._at, error, int(fatal))

    def _note_surplus(self, count: int) -> None:
        self.facts["surplus_answers"] = count

    def _exchange(self) -> None:
        """Exchange until the end (own thread); any error also ends the forces."""
        try:
            self._go_on_exchanging()
        except SurplusError:
            self._failed(SURPLUS, fatal=True)
        except (ConnectionClosed, OSError):
            self._failed(CLOSED, fatal=not self._ending.is_set())
        # a dead thread would renew no force and report nothing
        except Exception as error:  # noqa: BLE001
            self._broken = f"{type(error).__name__}: {error}"
            self._failed(BROKEN, fatal=True)

    def _go_on_exchanging(self) -> None:
        """Send forces and receive states."""
        socket, code, at = self._socket, self._code, self._at
        assert socket is not None  # noqa: S101  # it is connected
        force = (ctypes.c_double * 3)()
        period = 1.0 / self._wants.servo_rate
        first = True
        due = begun = time.monotonic()
        self._surplus.begin()
        owed = blind = proven = False
        refused_since = math.inf
        while not self._ending.is_set():
            # without a position, a force might act anywhere
            acts = code.mailbox_force(at, force, int(blind))
            wanted = (force[0], force[1], force[2]) if acts else ZERO
            begun = begun if owed else time.monotonic()
            try:
                # A second request, or an unrequested answer, would delay every later answer by one.
                if not owed:
                    self._surplus.newest(socket, "")
                    socket.send(command(self._id, wanted if acts else None, first))
                answered = read(self._surplus.newest(socket, socket.recv(timeout=1.0)))
            except TimeoutError:
                self._failed(SLOW)
                owed = True
                continue
            except ValueError:
                self._failed(UNREADABLE)
                owed, blind, self._unreadable = False, True, True
                continue
            first = owed = self._unreadable = False
            state = next(
                (
                    device.state
                    for device in answered.inverse3
                    if device.device_id == self._id
                ),
                None,
            )
            blind = state is None
            if state is None:
                # Zero fields may be missing in a state, but a missing state is not a state of
                # zeros.
                self._failed(NO_STATE)
            else:
                self._publish_sample(state, answered)
                given = state.current_cursor_force.numbers()
                self._others = (
                    tuple(a - b for a, b in zip(given, wanted, strict=True))
                    if acts
                    else given  # type: ignore[assignment]
                )
                acting = max(map(abs, given)) > 0.0
                taken = max(map(abs, wanted)) < ASKED or acting
                refused_since = math.inf if taken else min(refused_since, begun)
                self._withheld = begun - refused_since > FORCELESS_AFTER
                proven = proven or acting
                # A service that has applied forces has the right version: something else, e.g. its
                # brake, prevents them now.
                if self._withheld and not proven and not self._remark:
                    self._failed(FORCELESS, fatal=True)
                    return
            due = max(due + period, time.monotonic())
            if (left := due - time.monotonic()) > 0.0:
                time.sleep(left)

    def _publish_sample(self, state: Inverse3State, answered: ServiceMessage) -> None:
        turn = state.body_orientation
        pressed, self._many_buttons = buttons(answered)
        seen = (
            *state.cursor_position.numbers(),
            *state.cursor_velocity.numbers(),
            turn.x,
            turn.y,
            turn.z,
            turn.w,
        )
        self._code.mailbox_sampled(
            self._at, (ctypes.c_double * SAMPLE)(*seen, 0.0, float(pressed))
        )
        self._code.mailbox_ticked(self._at)

    def _listen(self) -> None:
        """Receive the service's events until the end (own thread), if it has any."""
        address = f"ws://{self._wants.host}:{self._wants.events_port}"
        try:
            with _connection(address) as events:
                while not self._ending.is_set():
                    try:
                        text = str(events.recv(timeout=0.1))
                    except TimeoutError:
                        continue
                    if any(word in text for word in ENDS):
                        self._remark = ""
                    for word, meaning in EVENTS.items():
                        if word in text:
                            self._remark = meaning
                    if "device-disconnected" in text:
                        self._failed(UNPLUGGED, fatal=True)
        except (OSError, ConnectionClosed, InvalidHandshake, TimeoutError):
            return

    def error_text(self, code: int) -> str:
        """Return an error as text."""
        why = f": {self._broken}" if code == BROKEN else ""
        return ERRORS.get(code, f"error {code}") + why

    def condition(self) -> str:
        """Return why the service applies another force than the wanted one, or ""."""
        if self._box.fault:
            return (
                f"{self.error_text(self._box.fault)}: forces are off until the node is started"
                " again"
            )
        if self._remark:
            return self._remark
        if self._withheld:
            return (
                "the Inverse Service lets no force act (0 N while a force is asked for), and does"
                " not say why"
            )
        if self._unreadable:
            return f"{ERRORS[UNREADABLE]}: no position, so no force"
        if max(map(abs, self._others)) > ASKED:
            x, y, z = self._others
            return (
                f"another session of the Inverse Service adds {x:+.2f}, {y:+.2f}, {z:+.2f} N along"
                " the device's axes"
            )
        if self._many_buttons:
            return (
                f"the grip has more than {MAX_BUTTONS} buttons: the first {MAX_BUTTONS} by name"
                " are read"
            )
        return ""

    def close(self) -> None:
        """Send zero, end the exchange and disconnect; also after a partial failure."""
        self._ending.set()
        for thread in self._threads:
            thread.join(timeout=1.5)
        self._threads.clear()
        socket = self._socket
        self._socket = None
        if socket is not None:
            # a closed connection has already cleared every force
            with self._open, suppress(ConnectionClosed, OSError):
                socket.send(command(self._id, ZERO))


def _connection(address: str) -> AbstractContextManager[ClientConnection]:
    """Return a connection without compression and without any proxy of the environment."""
    return connect(
        address, open_timeout=2.0, close_timeout=0.5, compression=None, proxy=None
    )


class Inverse3Driver(HardwareDriver):
    """A driver node with a Haply Inverse3."""

    Parameters: ClassVar[type[msgspec.Struct]] = Inverse3DriverParameters
    hardware: ClassVar[type[MailboxDevice]] = Inverse3Device
    checked: ClassVar[str] = "a stand-in service; not on hardware"
