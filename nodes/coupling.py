"""The coupling node: renders a force for each proxy with the law that is active now, and swaps laws while the wall is felt.

All laws read one deflection history per axis (nodes/rendering.py). A law is prepared on the control thread (validated,
compiled, judged for stability, brought up to date) and taken up between two ticks; what is refused leaves the running law
untouched. A law that raises, returns a force that is not finite or overruns its budget is replaced within the same tick.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, ClassVar

import msgspec

from messages import topics
from messages.codec import Decoder, encode
from messages.types import Force, Proxy, Receipt, Vector
from nodes.base import IDLE_MS, Node, describe
from nodes.coupling_parameters import CouplingParameters
from nodes.follower import Follower
from nodes.kernels import deflection, one_sided
from nodes.laws import CompiledLaw
from nodes.lawbook import LawBook
from nodes.rendering import Fade, History, LawOnAxis
from nodes.parameters import convert
from nodes.setup import AXIS_INDEX, Setup
from nodes.watch import Budget


class ActiveLaw:
    """A law ready to render on all axes.

    Parameters
    ----------
    name : str
        Its name in the parameters.
    text : str
        Name and parameters, for receipts.
    compiled : CompiledLaw
        What it renders.
    histories : list of History
        One per axis.
    """

    def __init__(self, name: str, text: str, compiled: CompiledLaw, histories: list[History]) -> None:
        self.name = name
        self.text = text
        self.compiled = compiled
        self.axes = [LawOnAxis(compiled, history) for history in histories]

    def warm_up(self, histories: list[History]) -> None:
        """Bring recursive sections up to date.

        Parameters
        ----------
        histories : list of History
            The live ones, or snapshots.
        """
        for axis, history in zip(self.axes, histories, strict=True):
            axis.warm_up(history)


class Coupling(Node):
    """Answers proxies with forces."""

    Parameters: ClassVar[type[msgspec.Struct]] = CouplingParameters
    publishes: ClassVar[tuple[str, ...]] = (topics.FORCE, topics.RECEIPT)
    listens_to: ClassVar[tuple[str, ...]] = (topics.PROXY,)

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Compile the laws that will render before anything is started, and read the others.

        A law that only waits to be switched to may be one that this rate does not allow; it is refused when it is asked for.

        Parameters
        ----------
        setup : Setup
            The node as it would be started.

        Raises
        ------
        ParameterError
            With path, value, limit and remedy.
        """
        parameters: CouplingParameters = convert(setup.parameters, CouplingParameters, setup.name)
        book = LawBook(setup.name, setup.period)
        for name in parameters.laws:
            book.description(parameters, name)
        for name in (parameters.law, *(swap.law for swap in parameters.schedule)):
            book.compile(parameters, name, 0.0, judge=False)

    # -- off the hot path --------------------------------------------------------------------------------------------

    def configure(self) -> None:
        """Compile the laws and the schedule."""
        parameters: CouplingParameters = self.store.current
        self._axes = [AXIS_INDEX[axis] for axis in self.setup.axes]
        self._histories = [History(parameters.memory) for _ in self._axes]
        self._delay = 0.0
        self._revision = 0
        self._fades: list[Fade] = []
        self._book = LawBook(self.setup.name, self.setup.period)
        self._settle(parameters)
        self._fallback = self._make("fallback", parameters.fallback.compile(self.setup.period))
        self._law = self._prepare_law(parameters, parameters.law)
        self._schedule = [
            (round(swap.at / self.setup.period), self._prepare_law(parameters, swap.law), swap.ramp)
            for swap in sorted(parameters.schedule, key=lambda swap: swap.at)
        ]
        self._budget = Budget(parameters.budget * self.setup.period if self.setup.pace == "realtime" else math.inf)

    def _settle(self, parameters: CouplingParameters) -> None:
        self._raw = parameters.history == "position"
        self._clamp = parameters.clamp

    def _make(self, name: str, compiled: CompiledLaw) -> ActiveLaw:
        return ActiveLaw(name, name, compiled, self._histories)

    def _prepare_law(self, parameters: CouplingParameters, name: str) -> ActiveLaw:
        compiled, told = self._book.compile(parameters, name, self._delay)
        if told:
            self.tell("stability", told)
        text = describe({"law": name, **self._book.description(parameters, name)})
        return ActiveLaw(name, text[:4000], compiled, self._histories)

    def prepare(self, parameters: Any) -> Callable[[int], Any]:
        """Prepare changed parameters: compile the active law anew, refuse what must not change while it runs.

        Parameters
        ----------
        parameters : CouplingParameters
            The parameters after the change.

        Returns
        -------
        callable
            Swaps the law between two ticks and returns the receipt.
        """
        now: CouplingParameters = self.store.current
        self._book.refuse_fixed(now, parameters)
        for name in parameters.laws:
            self._book.description(parameters, name)
        law = self._ready(self._prepare_law(parameters, parameters.law))
        fallback = self._make("fallback", parameters.fallback.compile(self.setup.period))
        action = "set" if parameters.law == now.law else "switch"

        def apply(seq: int) -> dict[str, Any]:
            self._settle(parameters)
            self._fallback = fallback
            return self._swap(seq, law, parameters.ramp, action, "asked")

        return apply

    def _ready(self, law: ActiveLaw) -> ActiveLaw:
        law.warm_up([history.snapshot() for history in self._histories])
        return law

    def operations(self) -> dict[str, Callable[..., Any]]:
        """Law operations beside the parameters.

        Returns
        -------
        dict of str to callable
            ``law.list``, ``law.show`` and ``law.switch``.
        """
        return {"law.list": self._list_laws, "law.show": self._show_law, "law.switch": self._switch_law}

    def _list_laws(self) -> dict[str, Any]:
        parameters: CouplingParameters = self.store.current
        laws = {name: self._book.description(parameters, name) for name in self._book.names(parameters)}
        return {"active": self._law.name, "laws": laws}

    def _show_law(self, law: str = "") -> dict[str, Any]:
        parameters: CouplingParameters = self.store.current
        name = law or self._law.name
        return {"law": name, **self._book.figures(parameters, name, self._delay)}

    def _switch_law(self, law: str, ramp: int | None = None) -> dict[str, Any]:
        parameters: CouplingParameters = self.store.current
        before = self._book.figures(parameters, self._law.name, self._delay) if parameters.figures else {}
        values: dict[str, Any] = {"law": law}
        if ramp is not None:
            values["ramp"] = ramp
        changed = self.store.changed(values)
        ready = self._ready(self._prepare_law(changed, law))
        receipt: dict[str, Any] = self.hand_over(lambda seq: self._swap(seq, ready, changed.ramp, "switch", "asked"))
        self.store.accept(changed if ramp is None else msgspec.structs.replace(changed, ramp=parameters.ramp))
        if parameters.figures:
            receipt = {**receipt, "was": before, "is": self._book.figures(changed, law, self._delay)}
        return receipt

    # -- between two ticks -------------------------------------------------------------------------------------------

    def _swap(self, seq: int, law: ActiveLaw, ramp: int, action: str, reason: str) -> dict[str, Any]:
        old = self._law
        steps = []
        for before, after in zip(old.axes, law.axes, strict=True):
            after.catch_up()
            steps.append(after.present() - before.present())
        force_step = math.hypot(*steps)
        self._law = law
        self._fades = [Fade(axis, ramp) for axis in old.axes] if ramp > 0 else []
        self._revision += 1
        receipt = Receipt(
            seq=seq,
            stamp=self.now(),
            action=action,
            before=old.text,
            after=law.text,
            force_step=force_step if math.isfinite(force_step) else 0.0,
            ramp=ramp,
            reason=reason,
            revision=self._revision,
        )
        self.post(topics.RECEIPT, receipt)
        return {"seq": seq, "from": old.name, "to": law.name, "force_step_n": receipt.force_step, "ramp": ramp}

    def _follow_schedule(self, seq: int) -> None:
        while self._schedule and self._schedule[0][0] <= seq:
            _, law, ramp = self._schedule.pop(0)
            law.warm_up(self._histories)
            self._swap(seq, law, ramp, "switch", "schedule")
            self.store.accept(msgspec.structs.replace(self.store.current, law=law.name))

    # -- the tick ----------------------------------------------------------------------------------------------------

    def _render(self, proxy: Proxy) -> Vector:
        force = [0.0, 0.0, 0.0]
        contact, distance, law = proxy.contact, proxy.distance, self._law
        for n, i in enumerate(self._axes):
            normal = proxy.normal[i]
            self._histories[n].push(deflection(proxy.position[i], proxy.proxy[i], distance, normal, contact, self._raw))
            value = law.axes[n].force()
            if self._fades:
                value = self._fades[n].mix(value)
            force[i] = one_sided(value, normal, contact, self._raw, self._clamp)
        if self._fades and self._fades[0].over:
            self._fades = []
        return force[0], force[1], force[2]

    def _fall_back(self, proxy: Proxy, reason: str) -> Vector:
        seq = proxy.seq
        failed = self._law
        self._fades = []
        self._law = self._fallback
        self._revision += 1
        force = [0.0, 0.0, 0.0]
        for n, i in enumerate(self._axes):
            value = self._fallback.axes[n].force()
            force[i] = one_sided(value, proxy.normal[i], proxy.contact, self._raw, self._clamp)
        self.tell("fallback", f"law {failed.name!r} at tick {seq}: {reason}; the fallback renders now")
        receipt = Receipt(
            seq=seq,
            stamp=self.now(),
            action="fallback",
            before=failed.text,
            after=self._fallback.text,
            reason=reason[:4000],
            revision=self._revision,
        )
        self.post(topics.RECEIPT, receipt)
        return force[0], force[1], force[2]

    def _guarded(self, proxy: Proxy) -> Vector:
        """Render with a law that has code of its own, which may raise or take its time."""
        pushes = [history.pushes for history in self._histories]
        self._budget.start()
        try:
            force = self._render(proxy)
        except Exception as error:  # noqa: BLE001  # a law from another package may raise anything
            for n, i in enumerate(self._axes):
                if self._histories[n].pushes == pushes[n]:
                    value = deflection(
                        proxy.position[i], proxy.proxy[i], proxy.distance, proxy.normal[i], proxy.contact, self._raw
                    )
                    self._histories[n].push(value)
            return self._fall_back(proxy, f"raised {type(error).__name__}: {error}")
        over = self._budget.overrun()
        return self._fall_back(proxy, over) if over else force

    def _bridge(self, proxy: Proxy, missing: int) -> None:
        for n, i in enumerate(self._axes):
            value = deflection(
                proxy.position[i], proxy.proxy[i], proxy.distance, proxy.normal[i], proxy.contact, self._raw
            )
            self._histories[n].bridge(value, missing)

    def loop(self) -> None:
        """Answer until stopped."""
        self.state = "running"
        assert self.inbox is not None  # noqa: S101  # every kind that listens has one
        follower = Follower(self, self.inbox, Decoder(Proxy), topics.PROXY)
        topic = topics.FORCE.encode()
        send, take = self.publisher.send, follower.take
        last = -1
        payload = b""
        while not self.stopping:
            proxy = take(IDLE_MS)
            if proxy is not None:
                seq = proxy.seq
                # A repeated tick (lockstep, after a lost answer) gets the same answer; the history must not see it twice.
                if seq != last:
                    if self._schedule:
                        self._follow_schedule(seq)
                    if 0 <= last < seq - 1:
                        self._bridge(proxy, seq - last - 1)
                    last = seq
                    self._delay = max(proxy.delay, self._delay * 0.999)
                    force = self._render(proxy) if self._law.compiled.evaluate is None else self._guarded(proxy)
                    if not math.isfinite(force[0] + force[1] + force[2]):
                        force = self._fall_back(proxy, f"returned a force that is not finite: {force}")
                    payload = encode(
                        Force(seq=seq, stamp=self.now(), force=force, law=self._law.name, revision=self._revision)
                    )
                send(topic, payload)
                self.sent += 1
                self.ticks += 1
            self.between_ticks(self.seq + 1)
