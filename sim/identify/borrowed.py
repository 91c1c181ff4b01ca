"""Borrow law and surface of a running launch, and restore them in all cases.

The surface is restored first and the law after it, so a stiff law never meets a point that has
jumped. All changes are made under leases, which this process renews several times a second. If it
is killed or suspended (Ctrl-Z), the nodes restore surface and law and refuse its later changes.
"""

import contextlib
import os
import threading
import time
from collections.abc import Iterator, Sequence
from typing import Any

from messages import topics
from messages.errors import RefusedError, UsageError
from messages.types import DeviceState
from nodes.base.node_kinds import load
from nodes.base.setup import AXIS_INDEX
from nodes.client.launches import ask, roles
from nodes.client.listen import listen
from nodes.driver.operations import LONGEST_PAUSE
from nodes.launcher.runs import RunInfo
from sim.measure.interrupts import deferred, undisturbed

RAMP = 100  # cross-fade from and to the previous law [ticks]
# time after the last renewal at which surface and law are restored; the law later, because it is
# the stiffer one [s]
SURFACE_LEASE, LAW_LEASE = 4.0, 5.0
# factor on the leases in lockstep, where the loop may use the whole machine and pushes nobody
PATIENT = 6.0
RENEWED = 0.4  # interval of lease renewals [s]
# The law between pushes and knocks: its name, and a trial that ends at once, which leaves the
# spring.
SOFT_LAW, SOFT = "soft", {"kind": "knock", "taps": [0.0], "step": 1e-9, "ticks": 1}
SOFT_RAMP = 250  # cross-fade to the soft law [ticks]
REST = 0.2  # averaging time of the force of a device at rest [s]
STILL = 1e-4  # a device that moves less than this is at rest [m]
SETTLING = 3.0  # time within which a device must come to rest [s]
SILENCE = 30.0  # time without a tick after which a launch is given up [s]
LEASE = "borrowed"  # name of the leases


class PushedLaunch:
    """The nodes of a running launch needed to push its device."""

    def __init__(self, run: RunInfo) -> None:
        # Of a launch with several chains the chosen one, also for its recorder.
        self.run = run = run.only_chain()
        self.chosen = run.chosen
        found = roles(run)
        if len(found) < 3:
            raise UsageError(
                f"{run.run}: has no driver, environment and coupling that could push a device"
            )
        self.driver, self.environment, self.coupling = (
            found["driver"],
            found["environment"],
            found["coupling"],
        )
        setup = run.nodes[self.driver]
        self.period = setup.period  # sampling period [s]
        # axes that the scene computes
        self.axes = tuple(AXIS_INDEX[axis] for axis in setup.axes)
        # driver limits, set by `read_limits`: force [N], change per tick [N]
        self.peak: float | None = None
        self.slew: float | None = None
        self.holder = ""  # holder of this process's leases; empty if there are none
        self.leased: set[str] = set()  # nodes with a lease of this process

    def poses(self) -> tuple[float, float] | None:
        """Return how much lighter and heavier the device is in other poses [kg], or None.

        Only for a device that knows its inertia, along its first axis.
        """
        if not hasattr(load(self.run.nodes[self.driver].factory), "hardware"):
            return None
        answer = ask(self.run, self.driver, "inertia")
        if answer is None:
            return None
        here = answer["here_kg"][self.axes[0]]
        return max(0.0, here - answer["least_kg"]), max(
            0.0, answer["greatest_kg"] - here
        )

    def read_limits(self) -> None:
        """Read the driver's limits."""
        safety = ask(self.run, self.driver, "param.get", name="safety")
        self.peak = safety["peak_force"]
        self.slew = None if safety["slew"] is None else safety["slew"] * self.period

    def progress(self) -> Any:
        """Return the driver's progress."""
        return ask(self.run, self.driver, "progress")

    def ready(self) -> None:
        """Raise RefusedError for a driver that renders no force."""
        state = self.progress()["safety"]
        if state == "stopped":
            raise RefusedError(
                f"{self.driver}: has stopped for good ({self.why_stopped()})"
            )
        if state == "fault":
            raise RefusedError(
                f"{self.driver}: the device is outside its workspace; bring it back first"
            )

    def why_stopped(self) -> str:
        """Return the latest change of the driver's safety state."""
        reasons = (
            ask(self.run, self.driver, "report").get("safety", {}).get("reasons", [])
        )
        return str(reasons[-1]) if reasons else "the driver gives no reason"

    def rearm(self, beside: bool) -> None:
        """Rearm a stopped driver; a real device only if somebody is `beside` it."""
        self.change(self.driver, "rearm", beside=beside)

    def wait(self, ticks: int, silence: float = SILENCE) -> None:
        """Wait for some ticks; raise RefusedError after `silence` [s] without one."""
        first = tick = self.progress()["tick"]
        last = time.monotonic()
        while tick < first + ticks:
            time.sleep(0.02)
            before, tick = tick, self.progress()["tick"]
            if tick != before:
                last = time.monotonic()
            elif time.monotonic() - last > silence:
                raise RefusedError(
                    f"{self.driver}: no tick within {silence:g} s; does the launch tick?"
                )

    @contextlib.contextmanager
    def standing(self) -> Iterator[None]:
        """Pause a lockstep loop, which uses all processors, within a with block.

        The driver limits the length of the pause.
        """
        if self.run.nodes[self.driver].pace != "lockstep":
            yield
            return
        try:
            # A launch that has ended is reported by the next request.
            with contextlib.suppress(RefusedError):
                self.change(self.driver, "stand", seconds=LONGEST_PAUSE)
            yield
        finally:
            with contextlib.suppress(RefusedError), undisturbed():
                ask(self.run, self.driver, "stand", seconds=0.0)

    def states(self, silence: float = SILENCE) -> Iterator[DeviceState]:
        """Yield every state of the driver; raise RefusedError after `silence` [s] without one."""
        heard = listen(self.run, [topics.DEVICE_STATE])
        last = time.monotonic()
        try:
            for message in heard:
                if message is not None and isinstance(message.message, DeviceState):
                    last = time.monotonic()
                    yield message.message
                elif time.monotonic() - last > silence:
                    raise RefusedError(
                        f"{self.driver}: nothing was heard within {silence:g} s; does the launch"
                        " tick?"
                    )
            raise RefusedError(f"{self.run.run}: the launch has ended")
        finally:
            heard.close()  # type: ignore[attr-defined]

    def change(self, node: str, operation: str, **arguments: Any) -> Any:
        """Request a change at a node, under its lease if it has one.

        Signals are deferred until the answer. Raise RefusedError if the node refuses or the lease
        has expired.
        """
        with deferred():
            if node not in self.leased:
                return ask(self.run, node, operation, **arguments)
            return ask(
                self.run,
                node,
                "lease.change",
                name=LEASE,
                holder=self.holder,
                operation=operation,
                args=arguments,
            )

    def soften(self, load: float) -> None:
        """Switch to a soft spring that holds the device, whatever the surface is."""
        self.change(
            self.coupling,
            "param.set",
            values={f"laws.{SOFT_LAW}": {**SOFT, "load": load}},
        )
        self.change(self.coupling, "law.switch", law=SOFT_LAW, ramp=SOFT_RAMP)
        self.wait(SOFT_RAMP)

    def anchor(self, place: Sequence[float]) -> int:
        """Anchor the surface at a point [m]; return the tick from which it applies."""
        surface = {"kind": "anchor", "position": list(place)}
        return int(
            self.change(self.environment, "param.set", values={"surface": surface})[
                "seq"
            ]
        )


def carried(loop: PushedLaunch, amplitude: float, given: float | None) -> float:
    """Return the force that carries the device's weight [N].

    The given force, or that at rest unless a hand may cause it. Raise RefusedError if the push
    would exceed the driver's limit.
    """
    strongest = loop.peak if loop.peak is not None else 20.0
    weight = _at_rest(loop, amplitude) if given is None else given
    if abs(weight) + amplitude > strongest:
        raise RefusedError(
            f"{loop.driver}: a load of {weight:.3g} N and a push of {amplitude:g} N are more than"
            f" {strongest:g} N, the largest force of the driver; lower --amplitude"
        )
    return weight


def _at_rest(loop: PushedLaunch, amplitude: float) -> float:
    ticks = max(10, round(REST / loop.period))
    states: list[DeviceState] = []
    for state in loop.states():
        states.append(state)
        if len(states) % ticks:
            continue
        last = states[-ticks:]
        means = [sum(one.force[i] for one in last) / ticks for i in loop.axes]
        spans = [
            max(one.position[i] for one in last) - min(one.position[i] for one in last)
            for i in loop.axes
        ]
        moves = max(spans) > STILL
        if moves and len(states) * loop.period < SETTLING:
            continue
        pressed = max(means, key=abs)
        if abs(pressed) > amplitude:
            raise RefusedError(
                f"{loop.driver}: a force of {pressed:.3g} N acts on the device, more than the push"
                f" of {amplitude:g} N: let go first. If it carries the device's weight, say so:"
                f" --load {pressed:.3g}"
            )
        # The force on a moving device is not its weight; with several axes the vertical is unknown.
        return 0.0 if moves or len(loop.axes) > 1 else means[0]
    raise RefusedError(f"{loop.run.run}: the launch has ended")


class Borrowed:
    """Borrowed law, surface and further parameters of a launch."""

    def __init__(self, loop: PushedLaunch) -> None:
        self._loop = loop
        self.law, self._surface = self._found()  # restored at the end
        self.not_put_back = ""  # why law or surface could not be restored; else empty
        self._lost = ""  # why the leases are lost
        # by leased node: operation and arguments that restore it
        self._reverts: dict[str, tuple[str, dict[str, Any]]] = {}
        loop.holder = f"{os.getpid()}-{time.monotonic_ns()}"
        self._over = threading.Event()
        self._renewing = threading.Thread(
            target=self._renew, name="leases", daemon=True
        )

    def _found(self) -> tuple[str, Any]:
        loop = self._loop
        law = str(ask(loop.run, loop.coupling, "law.list")["active"])
        return law, ask(loop.run, loop.environment, "param.get", name="surface")

    def take(self) -> None:
        """Acquire the leases of law and surface."""
        loop = self._loop
        self.borrow(
            loop.coupling, LAW_LEASE, "law.switch", law=self.law, ramp=RAMP, force=True
        )
        self.borrow(
            loop.environment,
            SURFACE_LEASE,
            "param.set",
            values={"surface": self._surface},
        )
        if self._found() != (self.law, self._surface):
            # Another tuning restored them after they were read here: the law read may have been its
            # trial.
            raise RefusedError(
                f"{loop.run.run}: law or surface were changed just now by somebody else; try again"
            )
        self._renewing.start()

    def borrow(self, node: str, seconds: float, revert: str, **arguments: Any) -> None:
        """Acquire a lease at a node, with the operation that restores it.

        The operation runs at the end, or after `seconds` without a renewal.
        """
        loop = self._loop
        longer = PATIENT if loop.run.nodes[loop.driver].pace == "lockstep" else 1.0
        # A refusal means that another process holds a lease: the present values may be its own.
        with deferred():
            agreed: dict[str, Any] = {
                "seconds": longer * seconds,
                "then": revert,
                "args": arguments,
            }
            ask(loop.run, node, "lease.take", name=LEASE, holder=loop.holder, **agreed)
            self._reverts[node] = revert, arguments
            loop.leased.add(node)

    def _holds(self, node: str) -> bool:
        """Renew a lease; return False if it has expired."""
        return not ask(
            self._loop.run, node, "lease.renew", names=[LEASE], holder=self._loop.holder
        )["run_out"]

    def _renew(self) -> None:
        while not self._over.wait(RENEWED):
            try:
                for node in list(self._reverts):
                    if not self._holds(node):
                        self._lost = (
                            f"{node}: this process was held up for too long, and the launch took"
                            " law and surface back"
                        )
            except RefusedError as error:
                self._lost = self._lost or str(error)

    def check(self) -> None:
        """Raise RefusedError if the launch has restored what was borrowed."""
        if self._lost:
            raise RefusedError(self._lost)

    def give_back(self) -> None:
        """Restore everything borrowed, law last; a launch that has ended needs nothing."""
        self._over.set()
        with undisturbed():
            begun, loop = self._renewing.ident is not None, self._loop
            if begun:
                self._renewing.join()
            try:
                for node in reversed(self._reverts):
                    self._revert(node, begun)
            finally:
                loop.leased.clear()
                loop.holder = ""

    def _revert(self, node: str, begun: bool) -> None:
        """Restore one node and end its lease.

        If the node refuses, the lease remains, and the node restores itself when it expires.
        """
        loop = self._loop
        try:
            if not self._holds(node):
                return
            if begun:
                operation, arguments = self._reverts[node]
                loop.change(node, operation, **arguments)
            ask(loop.run, node, "lease.end", names=[LEASE], holder=loop.holder)
        except RefusedError as error:
            self.not_put_back = self.not_put_back or str(error)


@contextlib.contextmanager
def borrowed(loop: PushedLaunch) -> Iterator[Borrowed]:
    """Borrow law and surface within a with block."""
    held = Borrowed(loop)
    try:
        held.take()
        yield held
    finally:
        held.give_back()
