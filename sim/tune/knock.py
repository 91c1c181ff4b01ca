"""Knock on a held device and see whether it comes to rest: how the edge of stability is approached, in a model and for real.

The coupling holds the device to a point; the point jumps by a knock, which the law sees as a deflection from nothing. What
is left of the motion in the last third of the window decides. Both edges, the predicted and the measured one, are found by the
same steps of stiffness and the same verdict, friction, encoder and limits of the driver included.

For real the driver's passivity guard watches meanwhile, with an allowance: a knock that dies down never meets it, and a loop
that gives out more than that is held within a tick, whoever else has stopped looking.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from messages.topics import DEVICE_STATE
from messages.types import DeviceState
from nodes.cli.ask import ask
from nodes.cli.listen import listen
from nodes.cli.main import RefusedError
from nodes.laws import CompiledLaw
from sim.device.model import DeviceModel
from sim.identify.push import Loop, undisturbed
from sim.scene.loop import Scene, Surface, run

Array = NDArray[np.float64]

WINDOW = 400
"""Ticks that a knock is watched."""
STEP = 1.02
"""Factor between two stiffnesses that are tried."""
LEFT = 0.5
"""Part of the knock that may be left, peak to peak, in the last third of the window."""
FAR = 4.0
"""A motion of so many knocks ends the window at once."""
AGAIN = 10
"""How often one stiffness is tried when the machine stalls."""
LAW = "tuned"
"""Name of the law that is tried."""


@dataclass(frozen=True)
class Verdict:
    """What came of one knock.

    Attributes
    ----------
    factor : float
        All taps were multiplied by it.
    left : float
        Motion in the last third of the window, as a part of the knock, peak to peak.
    rests : bool
        Whether that is little enough.
    """

    factor: float
    left: float
    rests: bool


@dataclass
class Edge:
    """The steps towards the edge.

    Attributes
    ----------
    steps : list of Verdict
        In the order of the stiffness.
    ended : str
        Why no more were tried.
    """

    steps: list[Verdict] = field(default_factory=list)
    ended: str = ""

    @property
    def factor(self) -> float | None:
        """Smallest factor that does not come to rest; None when all did."""
        return next((step.factor for step in self.steps if not step.rests), None)


def judge(position: Array, knock: float, factor: float) -> Verdict:
    """Judge one window."""
    last = position[-max(2, len(position) // 3) :]
    with np.errstate(invalid="ignore", over="ignore"):
        left = float(np.ptp(last)) / knock
        far = float(np.max(np.abs(position - position[0]))) / knock
    return Verdict(factor, left, bool(left < LEFT and far < FAR))


def factors(low: float, high: float) -> list[float]:
    """List the steps of stiffness."""
    count = max(1, int(np.ceil(np.log(high / low) / np.log(STEP))) + 1)
    return [low * STEP**n for n in range(count)]


def predicted_edge(
    law: CompiledLaw,
    model: DeviceModel,
    period: float,
    knock: float,
    tried: Sequence[float],
    peak: float | None,
    slew: float | None,
) -> Edge:
    """Knock on a model at rising stiffness until it does not come to rest."""
    import msgspec

    device = msgspec.structs.replace(model, position=-knock, velocity=0.0, gravity=None)
    scene = Scene(device=device, surface=Surface("anchor"), period=period, raw=False, clamp=False, peak=peak, slew=slew)
    edge = Edge(ended="every factor came to rest")
    for factor in tried:
        scaled = CompiledLaw(tuple(factor * tap for tap in law.taps))
        edge.steps.append(judge(run(scene, scaled, WINDOW).measured, knock, factor))
        if not edge.steps[-1].rests:
            edge.ended = f"the model does not come to rest at {factor:.3f} times the law"
            break
    return edge


def measured_edge(
    loop: Loop,
    taps: Sequence[float],
    place: Sequence[float],
    knock: float,
    tried: Sequence[float],
    say: Callable[[str], None],
    steps: list[Verdict],
) -> str:
    """Knock on the device of a running launch at rising stiffness; stop at the first sign."""
    axis = loop.axes[0]
    centre = list(place)
    knocks = 0
    # A launch that has a guard of its own keeps it.
    own = ask(loop.run, loop.driver, "param.get", name="passivity")
    guard = None if own and own["guard"] == "on" else {"allowance": _allowed(loop, knock)}

    def render(factor: float) -> None:
        # Beyond the law that was designed stability is what is looked for, not what is taken for granted.
        law = {"kind": "fir", "taps": [factor * tap for tap in taps], "period": loop.period}
        ask(loop.run, loop.coupling, "param.set", values={f"laws.{LAW}": law}, force=True)

    try:
        for factor in tried:
            doubted = False
            for _ in range(AGAIN):
                render(factor)
                knocks += 1
                centre[axis] = place[axis] + (knock if knocks % 2 else 0.0)
                if guard is not None:
                    # Afresh: every knock has the whole allowance.
                    ask(loop.run, loop.driver, "param.set", values={"passivity": guard})
                position, reason, disturbed = _window(loop, centre, knock)
                verdict = judge(position, knock, factor)
                if not verdict.rests or reason:
                    # The first sign: back at once to the law that was designed.
                    render(1.0)
                    loop.wait(WINDOW // 2)
                if not disturbed and (verdict.rests or doubted):
                    break
                # A machine that stalls shakes the device once, unseen perhaps; a loop that is unstable does it each time.
                doubted = doubted or not disturbed
                say(f"{factor:.3f} times the law: again, {disturbed or 'to be sure'}")
            else:
                reason = reason or f"the machine stalled {AGAIN} times in a row: {disturbed}"
            steps.append(verdict)
            say(f"{factor:.3f} times the law: {100 * verdict.left:.0f} % of the knock left")
            if not verdict.rests:
                return f"the device does not come to rest at {factor:.3f} times the law" + (
                    f": {reason}" if reason else ""
                )
            if reason:
                return reason
    finally:
        with undisturbed():
            render(1.0)
            if guard is not None:
                ask(loop.run, loop.driver, "param.set", values={"passivity": own})
    return "every factor came to rest"


def _window(loop: Loop, centre: Sequence[float], knock: float) -> tuple[Array, str, str]:
    """Jump, and collect positions for a window; break off when the device goes far, energy runs out or forces end."""
    axis = loop.axes[0]
    positions: list[float] = []
    jumped = -1
    energy, late, overruns = 0.0, 0, 0

    def told(late: int) -> str:
        return f"{late} ticks were answered late" if late else ""

    heard = listen(loop.run, [DEVICE_STATE], 30.0)
    try:
        for message in heard:
            if message is None or not isinstance(message.message, DeviceState):
                continue
            state = message.message
            if jumped < 0:
                receipt = ask(
                    loop.run,
                    loop.environment,
                    "param.set",
                    values={"surface": {"kind": "anchor", "position": list(centre)}},
                )
                jumped, energy, overruns = int(receipt["seq"]), state.energy, state.overruns
                continue
            if state.seq < jumped:
                continue
            positions.append(state.position[axis])
            if state.safety == "fault":
                return np.array(positions), "the driver took the force away: the device left its workspace", ""
            if state.age > 0 or state.safety != "active" or state.overruns > overruns:
                late += 1
            if abs(positions[-1] - positions[0]) > FAR * knock:
                return np.array(positions), f"the device went {FAR:g} knocks far", told(late)
            # A spring that was stretched by the knock holds ½ F x; far more than that was made by the loop.
            if state.energy - energy > _allowed(loop, knock):
                return (
                    np.array(positions),
                    f"the loop gave out {state.energy - energy:.2g} J after one knock",
                    told(late),
                )
            if state.seq >= jumped + WINDOW:
                return np.array(positions), "", told(late)
    finally:
        heard.close()  # type: ignore[attr-defined]
    if len(positions) < WINDOW // 2:
        raise RefusedError(f"{loop.driver}: {len(positions)} ticks were heard within 30 s; does the launch tick?")
    return np.array(positions), "", told(late)


def _allowed(loop: Loop, knock: float) -> float:
    """Energy that one knock may set free [J]: four times what the strongest force of the driver does over it."""
    peak = loop.peak if loop.peak is not None else 20.0
    return 4.0 * peak * knock
