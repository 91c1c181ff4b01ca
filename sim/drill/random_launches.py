"""Random launches: sequences of stalls, kills, swaps, moves and faults; judged by logs.

Each launch is drawn from a seed and a number, so that a failed one can be repeated. The receipts
and the device's own log tell what was done when; of the driver's messages only the end of zero
force is used.
"""

from __future__ import annotations

import contextlib
import math
import os
import signal
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from random import Random
from typing import Any, Final

import msgspec

from messages.transport.requests import ControlError
from messages.types import DeviceState
from sim.drill.device_log import Sample, read_log
from sim.drill.drawn_launches import DAMPING, LAWS, LOG, ORDER, RAMP, STIFFNESS, drawn
from sim.drill.drill import HOLD, PEAK, RATE, SLEW, await_another, in_order
from sim.drill.faulty_device import BLOCKS, FAILS, MOVED
from sim.drill.writes import EPSILON, Promise, judge
from sim.measure.haptic_commands import MeasurementError, within
from sim.measure.rig import Rig

# Time without force after which the whole ramp is due: a fifth of it, plus two ticks [ticks].
AWAY: Final = 17
FADE: Final = 80  # longest fade of a swap, plus some ticks [ticks]
# Largest move of a surface, such that no law requests more than the peak [m].
REACH: Final = 0.0015
OUTSIDE: Final = "1.0"  # order of a position far outside the workspace [m]
RECOVERY_TIMEOUT: Final = 20.0  # time limit until a launch has recovered [s]
DONE: Final = (3, 7)  # smallest and largest number of actions per launch


class LaunchOutcome(msgspec.Struct, kw_only=True):
    """Result of one random launch.

    Attributes
    ----------
    number : int
        Number within its seed.
    what : str
        Initial scene and settings.
    done : list of str
        Actions, in order.
    forces : int
        Number of forces that its device received.
    above : int
        Number of them above a limit.
    steepest : float
        Largest ratio of a force to what its ramp allowed.
    reasons : list of str
        Why it failed; empty if it passed.
    """

    number: int
    what: str = ""
    done: list[str] = []
    forces: int = 0
    above: int = 0
    steepest: float = 0.0
    reasons: list[str] = []


class RandomLaunches(msgspec.Struct, kw_only=True):
    """Result of all launches of a seed; fields as in `LaunchOutcome`."""

    seed: str
    launches: int = 0
    forces: int = 0
    above: int = 0
    steepest: float = 0.0
    done: dict[str, int] = {}
    failed: list[LaunchOutcome] = []
    passed: bool = False


class _Course:
    """The actions on one launch."""

    def __init__(self, random: Random, rig: Rig, surface: Mapping[str, Any]) -> None:
        self._random, self._rig = random, rig
        self.done: list[str] = []
        self.moved_at: list[int] = []  # ticks at which a surface moved
        self.swapped_at: list[int] = []  # ticks at which the law changed
        self.kinds: Counter[str] = Counter()
        # position of a sphere [m]
        self._at: Sequence[float] = surface.get("position", ())

    def do(self) -> None:
        """Perform a random action at a random time."""
        kinds = (
            self.stop,
            self.stop,
            self.kill,
            self.swap,
            self.move,
            self.move,
            self.change,
            self.recentre,
            self.fault,
        )
        kind = self._random.choice(kinds)
        self._rig.let_pass(self._random.uniform(0.0, 0.3))
        self.kinds[kind.__name__] += 1
        try:
            done = kind()
        except ControlError as refusal:
            # After a stall the loop is late and stable for softer laws only.
            if "unstable" not in str(refusal):
                raise
            done = "refused"
        self.done.append(f"{kind.__name__} {done}")

    def stop(self) -> str:
        """Stop a node for a while."""
        node = self._random.choice(("driver", "coupling", "environment"))
        seconds = self._random.choice(
            (0.005, 0.03, 0.055, 0.1, 0.3, 0.9)
        ) * self._random.uniform(0.8, 1.2)
        pid = self._rig.kill(node, signal.SIGSTOP)
        try:
            self._rig.let_pass(seconds)
        finally:
            os.kill(pid, signal.SIGCONT)
        return f"{node} for {seconds:.3g} s"

    def kill(self) -> str:
        """Kill a node and wait for its successor."""
        node = self._random.choice(("driver", "coupling", "environment"))
        await_another(self._rig, node, self._rig.kill(node))
        return node

    def swap(self) -> str:
        """Switch to another law."""
        law = self._random.choice(list(LAWS))
        ramp = self._random.choice((5, 20, 75))
        receipt = self._rig.call("coupling", "law.switch", law=law, ramp=ramp)
        self.swapped_at.append(int(receipt["seq"]))
        if not math.isfinite(receipt["force_step_n"]):
            raise MeasurementError(
                f"law.switch: no force step in its receipt: {receipt}"
            )
        return f"to {law} within {ramp} ticks"

    def move(self) -> str:
        """Move the surface."""
        by = self._random.uniform(-REACH, REACH)
        position = [self._at[0], self._at[1], self._at[2] + by] if self._at else by
        receipt = self._rig.call(
            "environment", "param.set", values={"surface.position": position}
        )
        self.moved_at.append(int(receipt["seq"]))
        return f"surface to {1e3 * by:.3g} mm at tick {receipt['seq']}"

    def change(self) -> str:
        """Change a law's stiffness."""
        stiffness = self._random.uniform(600.0, STIFFNESS)
        receipt = self._rig.call(
            "coupling", "param.set", values={"laws.pd.stiffness": stiffness, "ramp": 20}
        )
        self.swapped_at.append(int(receipt["seq"]))
        return f"K of pd to {stiffness:.4g} N/m"

    def recentre(self) -> str:
        """Offset the device's position without motion, and back."""
        by = self._random.uniform(-REACH, REACH)
        self._order(f"{MOVED}{by!r}", self._random.uniform(0.05, 0.4))
        return f"by {1e3 * by:.3g} mm and back"

    def fault(self) -> str:
        """Make the device fail for a while."""
        what = self._random.choice(
            (OUTSIDE, f"{BLOCKS}0.06", f"{FAILS}read_position", f"{FAILS}condition")
        )
        before = self._rig.pid("driver")
        self._order(what, self._random.uniform(0.01, 0.2))
        # Wait: the driver may only be starting to end.
        self._rig.let_pass(0.1)
        if what.startswith(FAILS) and "driver: ended with" in self._rig.errors:
            within(lambda: self._is_back(before), RECOVERY_TIMEOUT)
        return what

    def _is_back(self, before: int) -> bool:
        with contextlib.suppress(ControlError):
            return int(self._rig.call("driver", "status", timeout=0.3)["pid"]) != before
        return False

    def _order(self, what: str, seconds: float) -> None:
        order = self._rig.folder / ORDER
        fresh = self._rig.folder / "order.new"
        fresh.write_text(what, encoding="ascii")
        fresh.rename(order)  # a device never reads half an order
        self._rig.let_pass(seconds)
        order.unlink()


def begins_in(log: Sequence[Sample], states: Sequence[DeviceState]) -> list[float]:
    """Return the times at which the driver's whole ramp was due [s].

    It is due after each jump, each fault and each interval without force.

    Parameters
    ----------
    log : sequence of Sample
        Log of the device.
    states : sequence of DeviceState
        States that the driver published.
    """
    begins = []
    # A jump in free air needs no ramp, nor does a later contact by motion.
    for before, sample in pairwise(log):
        if sample.jumps > before.jumps and any(
            (*before.write.force, *sample.write.force)
        ):
            begins.append(sample.write.at)
    was_fault = False
    since = -1
    for state, following in pairwise(states):
        was_fault = state.safety == "fault" or (was_fault and state.safety == "zero")
        if state.safety != "zero":
            since = -1
            continue
        since = state.seq if since < 0 else since
        # If the device released the force by itself, the gap costs only a part of the ramp.
        if following.safety == "zero" or not (was_fault or state.seq - since >= AWAY):
            continue
        # A state reports the tick before it: the first force is that of the last tick without one.
        begins += [sample.write.at for sample in log if sample.seq >= state.seq][:1]
    return begins


def pushed(
    log: Sequence[Sample], moved_at: Sequence[int], swapped_at: Sequence[int] = ()
) -> tuple[list[str], float]:
    """Return forces that rose faster than their ramp after a move, and the largest ratio.

    A move near one of `swapped_at` is skipped, because the force also follows that swap's fade. A
    hand that moves meanwhile adds at most the stiffness times its distance and the damping times
    its speed.
    """
    wrong: list[str] = []
    steepest = 0.0
    for seq in moved_at:
        if any(abs(seq - swap) <= FADE for swap in swapped_at):
            continue
        first = next((n for n, sample in enumerate(log) if sample.seq >= seq), len(log))
        if (
            first in (0, len(log))
            or log[first].seq > seq + 1
            or log[first].write.at - log[first - 1].write.at >= HOLD
        ):
            continue  # no force at that time, so the driver's own ramp applies
        began = log[first]
        # Forces ramped down just then return by the driver's own ramp.
        felt = [
            max(abs(s.write.force[i]) for s in log[first - min(first, 50) : first])
            for i in range(3)
        ]
        way = [0.0] * 3
        speed = [0.0] * 3
        for before, sample in zip(log[first - 1 :], log[first:], strict=False):
            since = max(
                sample.write.at - began.write.at, sample.write.due - began.write.due
            )
            if since >= RAMP or sample.jumps != began.jumps:
                break
            took = max(sample.seq - before.seq, 1) / RATE
            share = min((since + 2.0 / RATE) / RAMP, 1.0)
            for i in range(3):
                way[i] = max(way[i], abs(sample.position[i] - began.position[i]))
                speed[i] = max(
                    speed[i], abs(sample.position[i] - before.position[i]) / took
                )
                allowed = share * PEAK + (1.0 - share) * felt[i]
                moved = STIFFNESS * max(way) + DAMPING * max(speed)
                steepest = max(steepest, (abs(sample.write.force[i]) - moved) / allowed)
                if abs(sample.write.force[i]) > allowed + moved + EPSILON:
                    force = f"{sample.write.force[i]:.3g} N along {'xyz'[i]} at tick {sample.seq}"
                    wrong.append(
                        f"{force}, moved at tick {seq}: {allowed:.3g} N by its ramp, {moved:.3g} N"
                        " by motion"
                    )
    return wrong[:3], steepest


def launch_once(
    seed: str, number: int, ticks: Sequence[str] = ("plain", "compiled")
) -> tuple[LaunchOutcome, Counter[str]]:
    """Run and judge one random launch."""
    random = Random(f"{seed}:{number}")  # noqa: S311  # reproducible, no secret
    content, what = drawn(random, ticks)
    outcome = LaunchOutcome(number=number, what=what)
    kinds: Counter[str] = Counter()
    log: list[Sample] = []
    moved_at: list[int] = []
    swapped_at: list[int] = []
    try:
        with Rig(content) as rig:
            course = _Course(
                random, rig, content["nodes"]["environment"]["parameters"]["surface"]
            )
            outcome.done, kinds, moved_at = course.done, course.kinds, course.moved_at
            swapped_at = course.swapped_at
            for _ in range(random.randint(*DONE)):
                course.do()
            if not within(lambda: in_order(rig.states), RECOVERY_TIMEOUT):
                outcome.reasons.append(
                    f"not in order again within {RECOVERY_TIMEOUT:g} s: {rig.errors[-500:]}"
                )
            rig.end()
            log = read_log(rig.folder / LOG, 1.0 / RATE)
            states = rig.states
    except (MeasurementError, ControlError) as error:
        outcome.reasons.append(str(error))
        return outcome, kinds
    bounds = Promise(1.0 / RATE, PEAK, SLEW / RATE, HOLD, RAMP)
    judged = judge([sample.write for sample in log], bounds, begins_in(log, states))
    wrong, steepest = pushed(log, moved_at, swapped_at)
    outcome.forces = len(log)
    outcome.above = judged.above
    outcome.steepest = max(judged.steepest, steepest)
    outcome.reasons += [f"the device: {text}" for text in (*judged.broken[:3], *wrong)]
    outcome.reasons += [] if log else ["the device received no force"]
    if rig.exit_code != 0:
        outcome.reasons.append(
            f"the launch ended with exit code {rig.exit_code}: {rig.said[-500:]}"
        )
    outcome.reasons += [f"left behind: {left}" for left in rig.left]
    return outcome, kinds


def launch_many(
    launches: int,
    seed: str,
    ticks: Sequence[str] = ("plain", "compiled"),
    shown: Callable[[LaunchOutcome], object] = lambda _: None,
) -> RandomLaunches:
    """Run random launches, one after another.

    Parameters
    ----------
    launches : int
        Number of launches.
    seed : str
        Seed from which they are drawn, with their number.
    ticks : sequence of str
        Kinds of tick to draw from.
    shown : callable
        Called with each outcome.
    """
    found = RandomLaunches(seed=seed)
    kinds: Counter[str] = Counter()
    for number in range(launches):
        outcome, done = launch_once(seed, number, ticks)
        shown(outcome)
        kinds += done
        found.launches += 1
        found.forces += outcome.forces
        found.above += outcome.above
        found.steepest = max(found.steepest, outcome.steepest)
        if outcome.reasons:
            found.failed.append(outcome)
    found.done = dict(sorted(kinds.items()))
    found.passed = not found.failed and found.launches > 0
    return found


def text(found: RandomLaunches) -> str:
    """Return the results as text."""
    done = ", ".join(f"{count} {name}" for name, count in found.done.items())
    lines = [
        f"{found.launches} launches of seed {found.seed}: {done}",
        (
            f"{found.forces} forces checked, {found.above} above a limit; the steepest rise took"
            f" {found.steepest:.3f} of its ramp"
        ),
    ]
    for one in found.failed:
        lines.append(f"launch {one.number} FAILED ({one.what}): {'; '.join(one.done)}")
        lines += [f"  {reason}" for reason in one.reasons]
    lines.append("passed" if found.passed else "FAILED")
    return "\n".join(lines)
