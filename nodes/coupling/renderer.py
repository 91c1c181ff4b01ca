"""Which law renders on all axes now, how another takes over between two ticks, and what takes over when it fails.

Everything here runs on the loop's thread but the making and warming up of a law, which happens before it is handed over.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

from messages.types import Proxy, Vector
from nodes.coupling.law_on_axis import Fade, History, LawOnAxis
from nodes.kernels import deflection, one_sided, push
from nodes.laws import CompiledLaw
from nodes.parameters.store import ParameterError


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
    histories : sequence of History
        The live ones, one per axis.
    """

    def __init__(self, name: str, text: str, compiled: CompiledLaw, histories: Sequence[History]) -> None:
        self.name = name
        self.text = text
        self.compiled = compiled
        self.axes = [LawOnAxis(compiled, history) for history in histories]

    @property
    def watched(self) -> bool:
        """Whether it has code of its own, which may raise or take its time."""
        return self.compiled.evaluate is not None

    def warm_up(self, histories: Sequence[History]) -> None:
        """Bring recursive sections up to date."""
        for axis, history in zip(self.axes, histories, strict=True):
            axis.warm_up(history)

    def catch_up(self) -> None:
        """Let recursive sections see what was pushed since they last did."""
        for axis in self.axes:
            axis.catch_up()

    def attempt(self, histories: Sequence[History]) -> None:
        """Call the law's own code once, before it may render."""
        for axis, history in zip(self.axes, histories, strict=True):
            try:
                force = axis.own(history)
                finite = math.isfinite(force)
            except Exception as error:  # a law of another package may raise anything
                raise ParameterError(f"law {self.name!r}: raised {type(error).__name__}: {error}") from error
            if not finite:
                raise ParameterError(f"law {self.name!r}: returned {force}, which is not a finite force")


class Renderer:
    """One deflection history per axis, the law that renders them, those that fade out, and the fallback.

    Parameters
    ----------
    axes : sequence of int
        The axes that the scene computes: 0, 1, 2.
    memory : int
        Ticks of deflection that are kept.
    make : callable, optional
        Makes the history of an axis from `memory` and its number among those of the scene.

    Attributes
    ----------
    axes : list of int
        The same.
    histories : list of History
        One per axis.
    law : ActiveLaw
        What renders now; set before the first tick.
    name : str
        Its name.
    watched : bool
        Whether a tick runs a law's own code.
    fallback : ActiveLaw
        What renders when that fails; set before the first tick.
    standby : list of ActiveLaw
        Laws that will take over later and whose sections run along until then.
    raw, clamp : bool
        Contact conventions: see nodes/kernels.py.
    """

    fallback: ActiveLaw

    def __init__(
        self, axes: Sequence[int], memory: int, make: Callable[[int, int], History] = lambda memory, _: History(memory)
    ) -> None:
        self.axes = list(axes)
        self.histories = [make(memory, n) for n in range(len(self.axes))]
        self.standby: list[ActiveLaw] = []
        self._fades: list[Fade] = []
        self.watched = False
        self.name = ""
        self.raw = False
        self.clamp = True

    @property
    def fades(self) -> list[Fade]:
        """The cross-fade under way, axis by axis; empty without one."""
        return self._fades

    def went_on(self, faded: int) -> None:
        """Note what compiled ticks did: histories and sections are theirs too, and the fades have come so far [ticks]."""
        for n, axis in enumerate(self._law.axes):
            axis.seen()
            if self._fades:
                self._fades[n].done = faded
                for leaving, _ in self._fades[n].leaving:
                    leaving.seen()
        if self._fades and self._fades[0].over:
            self._end_fades()
        for waiting in self.standby:
            waiting.catch_up()

    @property
    def law(self) -> ActiveLaw:
        """What renders now."""
        return self._law

    @law.setter
    def law(self, law: ActiveLaw) -> None:
        self._law = law
        self.name = law.name
        self.watched = law.watched
        # Together, as a tick needs them.
        self._lines = list(zip(range(len(self.axes)), self.axes, self.histories, law.axes, strict=True))

    def _deflection(self, proxy: Proxy, i: int) -> float:
        return deflection(proxy.position[i], proxy.proxy[i], proxy.distance, proxy.normal[i], proxy.contact, self.raw)

    def render(self, proxy: Proxy) -> Vector:
        """Take one tick's deflection and render the force that answers it."""
        force = [0.0, 0.0, 0.0]
        position, surface, normals, contact = proxy.position, proxy.proxy, proxy.normal, proxy.contact
        distance, raw, fades, along = proxy.distance, self.raw, self._fades, 0.0
        for n, i, history, law in self._lines:
            normal = normals[i]
            value = deflection(position[i], surface[i], distance, normal, contact, raw)
            head = history.head = push(history.values, history.head, history.length, value)
            history.pushes += 1
            value = law.sum_of_taps(head) if law.plain else law.force()
            if fades:
                value = fades[n].mix(value)
            force[i] = value
            along += value * normal
        self._keep_one_sided(force, proxy, along)
        if fades and fades[0].over:
            self._end_fades()
        for waiting in self.standby:
            waiting.catch_up()
        return force[0], force[1], force[2]

    def _keep_one_sided(self, force: list[float], proxy: Proxy, along: float) -> None:
        normal, contact, raw, clamp = proxy.normal, proxy.contact, self.raw, self.clamp
        for i in self.axes:
            force[i] = one_sided(force[i], normal[i], along, contact, raw, clamp)

    def _end_fades(self) -> None:
        self._fades = []
        self.watched = self._law.watched

    def begin(self, proxy: Proxy) -> None:
        """Take it that the device was at rest before the first tick that is seen, when the run is under way already.

        Nobody knows better in place of a node that was killed; from a history of zeros the first tick would be a jump.
        """
        for n, i in enumerate(self.axes):
            self.histories[n].fill(self._deflection(proxy, i))
        for law in (self.law, *self.standby):
            law.warm_up(self.histories)

    def bridge(self, proxy: Proxy, missing: int) -> None:
        """Fill lost ticks by a straight line up to the present one, which is not yet rendered."""
        for n, i in enumerate(self.axes):
            self.histories[n].bridge(self._deflection(proxy, i), missing)
            self.law.axes[n].catch_up()
            for leaving, _ in self._fades[n].leaving if self._fades else ():
                leaving.catch_up()

    def swap(self, law: ActiveLaw, ramp: int) -> float:
        """Let another law take over from the next tick on; all or nothing."""
        law.catch_up()
        if law.watched:
            law.attempt(self.histories)
        steps = []
        leaving = []
        for n, (before, after) in enumerate(zip(self.law.axes, law.axes, strict=True)):
            shares = self._fades[n].shares(before) if self._fades else [(before, 1.0)]
            steps.append(after.present() - sum(share * part.present() for part, share in shares))
            leaving.append(shares)
        step = math.hypot(*steps)
        if not math.isfinite(step):
            raise ParameterError(
                f"law {law.name!r}: a force step of {step} N; its taps are too large for the present deflection"
            )
        watched = self.watched
        self._fades = [Fade(shares, ramp) for shares in leaving] if ramp > 0 else []
        self.law = law
        if self._fades:
            # As long as the laws that leave run their own code.
            self.watched = self.watched or watched
        return step

    def fall_back(self, proxy: Proxy, pushes: Sequence[int] | None = None) -> Vector:
        """Replace a failed law by the fallback within the same tick."""
        self._end_fades()
        self.law = self.fallback
        force, along = [0.0, 0.0, 0.0], 0.0
        for n, i in enumerate(self.axes):
            history = self.histories[n]
            if pushes is not None and history.pushes == pushes[n]:
                history.push(self._deflection(proxy, i))
            value = self.law.axes[n].force()
            force[i] = value if math.isfinite(value) else 0.0
            along += force[i] * proxy.normal[i]
        self._keep_one_sided(force, proxy, along)
        for law in self.standby:
            law.catch_up()
        return force[0], force[1], force[2]

    def pushes(self) -> list[int]:
        """Tell how many deflections each axis has taken."""
        return [history.pushes for history in self.histories]

    def snapshots(self) -> list[History]:
        """Copy the histories from another thread."""
        return [history.snapshot() for history in self.histories]
