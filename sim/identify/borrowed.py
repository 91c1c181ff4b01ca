"""A running launch whose law and surface are borrowed, and restored whatever happens to the borrower.

The surface is restored first and the law after it: at no time does a stiff law meet a point that
has jumped. Everything is changed under leases, which this process renews several times a second.
When it is killed or held up (Ctrl-Z), the nodes restore surface and law and refuse its later
changes.
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
from nodes.driver.node import LONGEST_PAUSE
from nodes.launcher.runs import RunInfo
from sim.measure.interrupts import deferred, undisturbed

RAMP = 100  # cross-fade from and to the law that was there [ticks]
# So long after the last renewal surface and law are put back; the law later, as it is the stiffer
# one [s].
SURFACE_LEASE, LAW_LEASE = 4.0, 5.0
# leases are so many times longer in lockstep: a loop that takes the whole machine pushes nobody
PATIENT = 6.0
RENEWED = 0.4  # how often leases are renewed [s]
# What holds the device between pushes and knocks: its name, and a trial that is over at once, which
# leaves the spring.
SOFT_LAW, SOFT = "soft", {"kind": "knock", "taps": [0.0], "step": 1e-9, "ticks": 1}
SOFT_RAMP = 250  # cross-fade to it [ticks]
REST = 0.2  # the force of a device at rest is averaged over so long [s]
STILL = 1e-4  # a device that moves less than this is at rest [m]
SETTLING = 3.0  # a device that does not come to rest within so long goes on moving [s]
SILENCE = 30.0  # after so long without a tick a launch is given up [s]
LEASE = "borrowed"  # name of the leases


class PushedLaunch:
    """The nodes of a running launch that are needed to push its device."""

    def __init__(self, run: RunInfo) -> None:
        # Of a launch of several chains the one that was chosen, also where its recorder is asked
        # for it.
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
        self.axes = tuple(AXIS_INDEX[axis] for axis in setup.axes)  # axes that the scene computes
        # The driver's limits, by `read_limits`: force [N], change per tick [N].
        self.peak: float | None = None
        self.slew: float | None = None
        self.holder = ""  # of the leases that this process has taken; empty while it has none
        self.leased: set[str] = set()  # nodes that hold one

    def poses(self) -> tuple[float, float] | None:
        """Ask a device that knows its inertia by how much it is lighter and heavier elsewhere, along its first axis [kg]."""
        if not hasattr(load(self.run.nodes[self.driver].factory), "hardware"):
            return None
        answer = ask(self.run, self.driver, "inertia")
        if answer is None:
            return None
        here = answer["here_kg"][self.axes[0]]
        return max(0.0, here - answer["least_kg"]), max(0.0, answer["greatest_kg"] - here)

    def read_limits(self) -> None:
        """Ask the driver for its limits."""
        safety = ask(self.run, self.driver, "param.get", name="safety")
        self.peak = safety["peak_force"]
        self.slew = None if safety["slew"] is None else safety["slew"] * self.period

    def progress(self) -> Any:
        """Ask the driver how it goes."""
        return ask(self.run, self.driver, "progress")

    def ready(self) -> None:
        """Refuse a driver that gives no force."""
        state = self.progress()["safety"]
        if state == "stopped":
            raise RefusedError(f"{self.driver}: has stopped for good ({self.why_stopped()})")
        if state == "fault":
            raise RefusedError(
                f"{self.driver}: the device is outside its workspace; bring it back first"
            )

    def why_stopped(self) -> str:
        """Ask the driver for the newest change of its safety state."""
        reasons = ask(self.run, self.driver, "report").get("safety", {}).get("reasons", [])
        return str(reasons[-1]) if reasons else "the driver gives no reason"

    def rearm(self, beside: bool) -> None:
        """Let a driver that has stopped take forces again; that of a real device only with somebody `beside` it."""
        self.change(self.driver, "rearm", beside=beside)

    def wait(self, ticks: int, silence: float = SILENCE) -> None:
        """Wait for some ticks; a driver that makes none for so long [s] is an error."""
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
        """Let a loop in lockstep, which takes all processors, stand still in a with block, or while the driver grants it."""
        if self.run.nodes[self.driver].pace != "lockstep":
            yield
            return
        try:
            # A launch that has ended is told of by whoever asks it next.
            with contextlib.suppress(RefusedError):
                self.change(self.driver, "stand", seconds=LONGEST_PAUSE)
            yield
        finally:
            with contextlib.suppress(RefusedError), undisturbed():
                ask(self.run, self.driver, "stand", seconds=0.0)

    def states(self, silence: float = SILENCE) -> Iterator[DeviceState]:
        """Hear every tick of the driver; one that says nothing for so long [s] is an error."""
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
        """Change something at a node, under its lease if it has one; a signal that comes meanwhile waits for the answer.

        Raises RefusedError when the node refuses, or when the lease has run out.
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
        """Let a soft spring hold the device, whatever the surface is."""
        self.change(self.coupling, "param.set", values={f"laws.{SOFT_LAW}": {**SOFT, "load": load}})
        self.change(self.coupling, "law.switch", law=SOFT_LAW, ramp=SOFT_RAMP)
        self.wait(SOFT_RAMP)

    def anchor(self, place: Sequence[float]) -> int:
        """Let the coupling pull the device to a point [m]; from which tick on."""
        surface = {"kind": "anchor", "position": list(place)}
        return int(self.change(self.environment, "param.set", values={"surface": surface})["seq"])


def carried(loop: PushedLaunch, amplitude: float, given: float | None) -> float:
    """Find the force that carries the device's weight [N]: the given one, or that at rest, if no hand can be meant by it."""
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
        # Of a device that moves the force tells no weight; with several axes nobody knows which way
        # is down.
        return 0.0 if moves or len(loop.axes) > 1 else means[0]
    raise RefusedError(f"{loop.run.run}: the launch has ended")


class Borrowed:
    """Law and surface of a launch while they are borrowed, and what else is borrowed with them."""

    def __init__(self, loop: PushedLaunch) -> None:
        self._loop = loop
        self.law, self._surface = self._found()  # what comes back at the end
        self.not_put_back = ""  # why law or surface could not be put back; empty when they were
        self._lost = ""  # why what was borrowed is lost
        # by leased node: operation and arguments that revert
        self._reverts: dict[str, tuple[str, dict[str, Any]]] = {}
        loop.holder = f"{os.getpid()}-{time.monotonic_ns()}"
        self._over = threading.Event()
        self._renewing = threading.Thread(target=self._renew, name="leases", daemon=True)

    def _found(self) -> tuple[str, Any]:
        loop = self._loop
        law = str(ask(loop.run, loop.coupling, "law.list")["active"])
        return law, ask(loop.run, loop.environment, "param.get", name="surface")

    def take(self) -> None:
        """Take the leases of law and surface."""
        loop = self._loop
        self.borrow(loop.coupling, LAW_LEASE, "law.switch", law=self.law, ramp=RAMP, force=True)
        self.borrow(loop.environment, SURFACE_LEASE, "param.set", values={"surface": self._surface})
        if self._found() != (self.law, self._surface):
            # Another tuning gave them back after they were looked at here: what was seen may have
            # been its law on trial.
            raise RefusedError(
                f"{loop.run.run}: law or surface were changed just now by somebody else; try again"
            )
        self._renewing.start()

    def borrow(self, node: str, seconds: float, revert: str, **arguments: Any) -> None:
        """Take a lease at a node: it is reverted by an operation at the end, or after so long without a renewal [s]."""
        loop = self._loop
        longer = PATIENT if loop.run.nodes[loop.driver].pace == "lockstep" else 1.0
        # A node that refuses holds another's lease: what is there now may be another tuning's.
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
        """Renew a lease; False where it has run out, and may be another's by now."""
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
        """Raise when the launch has taken back what was borrowed."""
        if self._lost:
            raise RefusedError(self._lost)

    def give_back(self) -> None:
        """Restore what was borrowed, law last; a launch that has ended meanwhile has nothing to restore."""
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
        """Restore one node and end its lease; a node that refuses keeps the lease, and tries again when it runs out."""
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
    """Borrow law and surface for the length of a with block."""
    held = Borrowed(loop)
    try:
        held.take()
        yield held
    finally:
        held.give_back()
