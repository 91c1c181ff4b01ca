"""Step tests on the device of a running launch; everything is restored whatever happens.

The law on trial gives up after its ticks, or as soon as the device swings far (`nodes.laws.knock`).
The loop itself counts the ticks, so this works in lockstep too. The driver's passivity guard gets
an energy allowance: a knock that decays never reaches it, and a loop that emits more is limited
within a tick. If the driver stops the loop, the verdict is "does not rest". The driver is rearmed
once the soft spring holds the device; for a real device only if the user has asked for it.
"""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from messages.errors import RefusedError
from nodes.client.launches import ask
from sim.arrays import Array
from sim.identify.borrowed import (
    SOFT_LAW,
    SOFT_RAMP,
    SURFACE_LEASE,
    Borrowed,
    PushedLaunch,
)
from sim.tune.knocking import (
    LONGEST_WINDOW,
    WINDOW,
    KnockedEdge,
    KnockVerdict,
    Plan,
    climb,
    factor_of,
    judge,
    law_of,
)

MAX_ATTEMPTS = 10  # attempts at one stiffness when the machine stalls
# times the soft spring is anchored at the position of the device, which still creeps
HOLDS = 3
TRIAL = "trial"  # name of the law on trial in the coupling
# Position change after which a knock has moved the device, and below which it has not [share of the
# knock].
MOVES, STANDS = 0.5, 0.1
UNMOVED = (
    "the position did not follow a knock: the encoder is stuck, or the device is held fast; nothing"
    " was verified by it"
)
STOPPED, TAKEN = "the driver stopped the loop", "the driver removed the force"


class Cut(NamedTuple):
    """What ended a trial early."""

    by: str = ""  # see `KnockVerdict.ended_by`
    why: str = ""


class StalledError(RefusedError):
    """The machine repeatedly answered late, so the loop could not be judged."""


class Trials:
    """Step tests on one device under its load [N].

    `rearm`: rearm the driver of a real device after a stop.
    """

    def __init__(
        self,
        loop: PushedLaunch,
        held: Borrowed,
        taps: Sequence[float],
        knock: float,
        load: float,
        say: Callable[[str], None],
        rearm: bool = False,
    ) -> None:
        self._loop, self._held, self._say = loop, held, say
        self._taps = list(taps)
        self._knock = knock
        self._load = load
        self._near = 0
        self._sign = -1.0
        self._rearm = rearm
        self._stirs = math.inf
        # A guard set by the launch is left unchanged.
        self._own = ask(loop.run, loop.driver, "param.get", name="passivity")
        self._guarded = not (self._own and self._own["guard"] == "on")
        self._allowance = {
            "allowance": 4.0 * (loop.peak if loop.peak is not None else 20.0) * knock
        }

    def climb(self, plan: Plan, steps: KnockedEdge) -> KnockedEdge:
        """Try the law from far below up to its edge; `steps` collects the verdicts."""
        loop = self._loop
        self._near = plan.near
        # The driver is leased too: after a stall this process must neither rearm it nor change its
        # guard.
        if self._guarded:
            self._held.borrow(
                loop.driver, SURFACE_LEASE, "param.set", values={"passivity": self._own}
            )
        else:
            self._held.borrow(loop.driver, SURFACE_LEASE, "status")
        self.hold_softly()
        found = climb(plan, self._verdict, steps)
        if not math.isfinite(self._stirs):
            raise RefusedError(f"{loop.driver}: {UNMOVED}")
        return found

    def hold_softly(self) -> None:
        """Anchor a soft spring at the position of the device."""
        loop = self._loop
        loop.soften(self._load)
        for _ in range(HOLDS):
            loop.anchor([float(x) for x in loop.progress()["position_m"]])
            loop.wait(SOFT_RAMP)

    def _verdict(self, step: int) -> KnockVerdict:
        """Knock until one verdict was undisturbed; repeat to confirm one that does not rest."""
        factor = factor_of(step)
        doubted = False
        disturbed = ""
        rested = 0
        for _ in range(MAX_ATTEMPTS):
            verdict, disturbed = self._try(factor)
            if verdict.ended_by in ("stop", "fault"):
                return verdict
            rested += verdict.rests and not disturbed
            if verdict.rests and not disturbed and rested < 2 and step >= self._near:
                # Near the edge the start within an encoder step decides: knock once more in the
                # other direction.
                continue
            if not disturbed and (verdict.rests or doubted):
                self._say(
                    f"{factor:.3f} times the law: {100 * verdict.left:.0f} % of the knock left"
                )
                return verdict
            # A stall shakes the device once, perhaps unseen; an unstable loop shakes it every time.
            doubted = doubted or not disturbed
            self._say(
                f"{factor:.3f} times the law: repeated, {disturbed or 'to confirm'}"
            )
        raise StalledError(
            f"at {factor:.3f} times the law the machine stalled {MAX_ATTEMPTS} times in a row:"
            f" {disturbed}"
        )

    def _try(self, factor: float) -> tuple[KnockVerdict, str]:
        """Knock once; return the verdict and what disturbed it."""
        loop = self._loop
        self._held.check()
        # A driver that accepts no force judges no law.
        loop.ready()
        self._sign = -self._sign
        law = law_of(self._taps, factor, self._sign * self._knock, self._load)
        loop.change(loop.coupling, "param.set", values={f"laws.{TRIAL}": law})
        if self._guarded:
            # Reset, so that every knock has the whole allowance.
            loop.change(loop.driver, "param.set", values={"passivity": self._allowance})
        position, cut, disturbed = self._window(factor)
        self._expect_motion(position, factor, bool(cut.why or disturbed))
        verdict = judge(position, self._sign * self._knock, factor)
        if disturbed and verdict is None:
            verdict = KnockVerdict(factor, 0.0, False, disturbed)
        if cut.why or verdict is None:
            left = (
                float(np.ptp(position[-len(position) // 3 :])) / self._knock
                if len(position)
                else 0.0
            )
            verdict = KnockVerdict(factor, left, False, cut.why, cut.by)
        left = loop.change(loop.coupling, "law.switch", law=SOFT_LAW, ramp=0)["from"]
        if cut.by == "stop":
            self._start_again(cut.why)
        elif left != TRIAL:
            disturbed = disturbed or f"the law overran its time budget: {left} rendered"
        loop.wait(WINDOW // 2)
        if cut.by != "stop" and loop.progress()["safety"] == "stopped":
            # After the window, but caused by this knock: the next one would be blamed for it.
            why = f"{STOPPED}: {loop.why_stopped()}"
            disturbed = ""
            verdict = KnockVerdict(factor, verdict.left, False, why, "stop")
            self._start_again(why)
        return verdict, disturbed

    def _expect_motion(self, position: Array, factor: float, ended: bool) -> None:
        """Refuse a position that stays constant after a knock.

        A law at least as stiff as one that moved the device must move it.
        """
        moved = float(np.ptp(position)) / self._knock if len(position) else 0.0
        if moved >= MOVES:
            self._stirs = min(self._stirs, factor)
        elif moved < STANDS and factor >= self._stirs and not ended:
            raise RefusedError(
                f"{self._loop.driver}: at {factor:.3f} times the law {UNMOVED}"
            )

    def _start_again(self, why: str) -> None:
        """Rearm the driver when the soft spring holds the device where it came to rest."""
        loop = self._loop
        self._say(why)
        self.hold_softly()
        try:
            loop.rearm(self._rearm)
        except RefusedError as error:
            self._say(f"{error}; or tune with --rearm")
            return
        loop.wait(SOFT_RAMP)

    def _window(self, factor: float) -> tuple[Array, Cut, str]:
        """Activate the law on trial and collect positions until they are decisive.

        Return the positions, what ended the trial early and what disturbed it.
        """
        loop = self._loop
        axis = loop.axes[0]
        positions: list[float] = []
        began = -1
        late = 0
        energy = 0.0
        overruns = 0
        for state in loop.states():
            if state.safety == "stopped":
                return (
                    np.array(positions),
                    Cut("stop", f"{STOPPED}: {loop.why_stopped()}"),
                    "",
                )
            if began < 0:
                receipt = loop.change(loop.coupling, "law.switch", law=TRIAL, ramp=0)
                began = int(receipt["seq"])
                energy = state.energy
                overruns = state.overruns
                continue
            if state.seq < began:
                continue
            if state.seq != began + len(positions):
                return np.array(positions), Cut(), "states were missed"
            positions.append(state.position[axis])
            if state.safety == "fault":
                return (
                    np.array(positions),
                    Cut("fault", f"{TAKEN}: the device left its workspace"),
                    "",
                )
            if state.age > 1 or state.safety != "active" or state.overruns > overruns:
                late += 1
            if state.energy - energy > self._allowance["allowance"]:
                # A spring stretched by the knock holds ½ F x; far more than that was generated by
                # the loop.
                cut = Cut(
                    "energy",
                    f"the loop generated {state.energy - energy:.2g} J after one knock",
                )
                return np.array(positions), cut, ""
            # Judged when a window is full, or on each tick once the device is far; the longest
            # window always decides.
            if (
                len(positions) % WINDOW == 0
                or abs(positions[-1] - positions[0]) > 2.0 * self._knock
            ):
                verdict = judge(np.array(positions), self._sign * self._knock, factor)
                if verdict is not None:
                    break
            if state.seq >= began + LONGEST_WINDOW:
                break
        return (
            np.array(positions),
            Cut(),
            f"{late} ticks were answered late" if late else "",
        )
