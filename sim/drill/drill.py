"""The drill: one fault at a time in a real launch with a hand pressing into a wall.

Safety is judged from the driver's own messages: a force may act only while forces are fresh. The
time to safe is the longest time for which an old force, or the damping after it, acted on the
device: from the last fresh force to zero force or to the next fresh one.
"""

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import msgspec

from messages.transport.requests import ControlError
from messages.types import ZERO, DeviceState
from sim.measure.haptic_commands import MeasurementError, wait_for, within
from sim.measure.rig import Rig

RATE = 500.0
WATCHDOG, DAMPING_TICKS = 10, 10
PEAK, SLEW = 5.0, 1000.0
DAMPING = 0.5
HOLD = 0.05  # deadline of the virtual device, like that of a servo thread [s]
# Limit of the time to safe [ticks]: watchdog, damping and ramp, or the device's own deadline; plus
# two for the tick of the fault and for the message that reports it. If a driver loses its
# processor while damping or ramping, the device's deadline ends that force: such ticks are
# subtracted (`driven_to_safe`).
LIMIT = (
    max(
        WATCHDOG + DAMPING_TICKS + math.ceil(PEAK * RATE / SLEW), math.ceil(HOLD * RATE)
    )
    + 2
)
CALM = 25  # consecutive good ticks that count as a recovery


class DrillOutcome(msgspec.Struct, kw_only=True):
    """Result of one fault."""

    # Name and description.
    fault: str
    what: str
    safe_ticks: int = 0  # longest time for which an old force or damping acted [ticks]
    # Ticks without a timely answer, and all ticks, since the strike.
    lost_ticks: int = 0
    window_ticks: int = 0
    energy_j: float = 0.0  # largest energy given out since the strike [J]
    recovered: bool = False  # whether fresh forces arrive again at the end
    left: list[str] = []  # orphans and stale files after the end
    passed: bool = False  # safe in time, recovered, and nothing left behind
    reasons: list[str] = []  # why it failed; else the reasons of the driver's safety
    skipped: str = ""  # why the drill could not be run here; empty if it was


class FaultSkippedError(MeasurementError):
    """The machine does not allow this fault; the text says what is missing."""


@dataclass(frozen=True)
class Fault:
    """A fault to inject."""

    # Name and description.
    name: str
    what: str
    # Injects the fault into a running rig, and reverts it if that is part of it.
    strike: Callable[[Rig], None]
    # changes the launch file beforehand
    change: Callable[[dict[str, Any]], object] = dict
    # Prepares what it needs before the launch and returns environment variables; raises
    # FaultSkippedError if that is not possible here.
    prepare: Callable[[], Mapping[str, str]] = dict
    tidy: Callable[[], None] = lambda: None  # removes what `prepare` made
    unread: bool = False  # whether nobody reads what the launch prints
    # expected exit code of the launch; not 0 if a node does not return
    exit_code: int = 0
    # Returns further violations in the driver's states since the strike.
    judge: Callable[[Sequence[DeviceState]], list[str]] = lambda _: []


def fault_of(
    made: Any,
    name: str,
    what: str,
    strike: Callable[[Rig], None] | None = None,
    **more: Any,
) -> Fault:
    """Create a fault from the methods of an object."""
    parts = {
        part: getattr(made, part)
        for part in ("change", "prepare", "tidy", "judge")
        if hasattr(made, part)
    }
    return Fault(name, what, strike or made.strike, **parts, **more)


def scene() -> dict[str, Any]:
    """Return the launch file of the drill."""
    hand = {"stiffness": 500.0, "damping": 5.0, "path": [[0.0, -0.005]]}
    safety: dict[str, Any] = {
        "watchdog": WATCHDOG,
        "damping_ticks": DAMPING_TICKS,
        "damping": DAMPING,
    }
    safety |= {
        "peak_force": PEAK,
        "slew": SLEW,
        "ramp": 0.02,
        "workspace": [[-0.05, 0.05]] * 3,
    }
    parameters = {
        "driver": {
            "device": {"mass": 0.1, "damping": 1.0, "hand": hand},
            "hold": HOLD,
            "safety": safety,
        },
        "environment": {"surface": {"kind": "plane", "axis": "z"}},
        "coupling": {
            "law": "pd",
            "laws": {"pd": {"kind": "pd", "stiffness": 1000.0, "damping": 3.0}},
        },
        "logger": {"overwrite": True, "path": "run.mcap"},
    }
    again = {"respawn": True, "respawn_delay": 0.1, "respawn_max": -1}
    nodes: dict[str, dict[str, Any]] = {
        name: {
            "kind": "sim_driver" if name == "driver" else name,
            **again,
            "parameters": given,
        }
        for name, given in parameters.items()
    }
    nodes["logger"]["required"] = False
    run = {"rate": RATE, "duration": 0.0}
    return {
        "summary": "A hand pressing into a wall, for drills",
        "run": run,
        "nodes": nodes,
    }


def with_link(content: dict[str, Any]) -> None:
    """Insert a faulty link between coupling and driver."""
    content["nodes"]["link"] = {"kind": "link"}


def _acting(
    states: Sequence[DeviceState], hold_ticks: float
) -> Iterator[tuple[int, int]]:
    """Yield per tick how long an old force or damping has acted, and for how long unattended.

    Unattended: without processor time for the driver.
    """
    since = written = states[0].seq if states else 0
    away = 0
    for before, state in pairwise(states):
        gap = state.seq - before.seq
        if before.force != ZERO and gap > 1:
            # While the driver was away nobody renewed the force; the device releases it after
            # `hold_ticks`.
            ended = math.ceil(min(state.seq, max(written + hold_ticks, before.seq)))
            away += ended - before.seq - 1 if written > since else 0
            yield ended - since, away
        if state.force != before.force or state.safety not in ("active", "ramp"):
            written = state.seq
        if (
            state.force_seq > before.force_seq
            or state.force == ZERO
            or gap >= hold_ticks
        ):
            since = state.seq
            written = state.seq
            away = 0
        else:
            yield state.seq - since, away


def time_to_safe(states: Sequence[DeviceState], hold_ticks: float) -> int:
    """Return the longest time for which an old force, or damping, acted [ticks]."""
    return max((ticks for ticks, _ in _acting(states, hold_ticks)), default=0)


def driven_to_safe(states: Sequence[DeviceState], hold_ticks: float) -> int:
    """Return the time to safe without ticks in which the driver had no processor.

    Then only the device can end the force.
    """
    return max((ticks - away for ticks, away in _acting(states, hold_ticks)), default=0)


def energy_given_out(states: Sequence[DeviceState]) -> float:
    """Return the largest energy given out since the first of some states [J]."""
    largest, total = 0.0, 0.0
    for before, state in pairwise(states):
        fresh = state.force_seq < before.force_seq
        total += state.energy - (0.0 if fresh else before.energy)
        largest = max(largest, total)
    return largest


def overdamped(states: Sequence[DeviceState]) -> float:
    """Return the largest excess of the damping force over that of a damper [N]."""
    most = 0.0
    for first, second, third in zip(states, states[1:], states[2:], strict=False):
        ticks = second.seq - first.seq
        # A respawned driver counts from zero.
        if (
            third.safety != "damping"
            or second.safety == "fault"
            or third.force_seq < first.force_seq
            or ticks <= 0
        ):
            continue
        for i in range(3):
            velocity = (second.position[i] - first.position[i]) * RATE / ticks
            allowed = max(abs(second.force[i]), DAMPING * abs(velocity))
            # Tolerance: rounding of a difference and two products.
            most = max(most, abs(third.force[i]) - allowed * (1.0 + 1e-9) - 1e-12)
    return most


def in_order(states: Sequence[DeviceState]) -> bool:
    """Whether the last ticks were all answered and active."""
    last = states[-CALM:]
    fresh = sum(
        later.force_seq > earlier.force_seq for earlier, later in pairwise(last)
    )
    return (
        len(last) == CALM and last[-1].safety == "active" and fresh >= 0.8 * (CALM - 1)
    )


def await_strike(shows: Callable[[], Any], what: str, timeout: float = 5.0) -> None:
    """Wait until a fault shows; raise MeasurementError if it does not."""

    def is_there() -> Any:
        # A node under fault may not answer.
        with contextlib.suppress(ControlError):
            return shows()
        return None

    if not within(is_there, timeout):
        raise MeasurementError(f"not struck: {what} not within {timeout:g} s")


def kill(node: str) -> Callable[[Rig], None]:
    """Return a strike that kills a node and waits for its successor."""

    def strike(rig: Rig) -> None:
        await_another(rig, node, rig.kill(node))

    return strike


def await_another(rig: Rig, node: str, before: int) -> None:
    """Wait until another process answers in a node's place."""
    wait_for(lambda: another(rig, node, before), f"another {node}", 30.0)


def another(rig: Rig, node: str, before: int) -> bool:
    """Whether another process answers in a node's place."""
    with contextlib.suppress(ControlError):
        return int(rig.call(node, "status", timeout=0.3)["pid"]) != before
    return False


def drill(fault: Fault, timeout: float = 15.0) -> DrillOutcome:
    """Run one drill."""
    outcome = DrillOutcome(fault=fault.name, what=fault.what)
    content = scene()
    try:
        environment = fault.prepare()
        fault.change(content)
        with Rig(content, environment, fault.unread) as rig:
            within(lambda: in_order(rig.states), 10.0)
            struck = len(rig.states) - 1
            fault.strike(rig)
            after = len(rig.states)
            outcome.recovered = within(
                lambda: len(rig.states) > after + CALM and in_order(rig.states), timeout
            )
            window = rig.states[struck:]
            errors = rig.errors
    except FaultSkippedError as reason:
        outcome.skipped = str(reason)
        return outcome
    except MeasurementError as error:
        outcome.reasons = [str(error)]
        return outcome
    finally:
        fault.tidy()
    outcome.safe_ticks = time_to_safe(window, HOLD * RATE)
    outcome.window_ticks = window[-1].seq - window[0].seq
    outcome.lost_ticks = outcome.window_ticks - sum(
        state.response > 0.0 for state in window[1:]
    )
    outcome.energy_j = energy_given_out(window)
    outcome.left = rig.left
    wrong = []
    if driven_to_safe(window, HOLD * RATE) > LIMIT:
        wrong.append(f"safe after {outcome.safe_ticks} ticks, limit {LIMIT}")
    if not outcome.recovered:
        wrong.append(f"not recovered: {errors[-1000:]}")
    if (excess := overdamped(window)) > 0.0:
        wrong.append(f"damped with {excess:.3g} N more than damping times velocity")
    if rig.exit_code != fault.exit_code:
        wrong.append(
            f"the launch ended with exit code {rig.exit_code}: {rig.said[-1000:]}"
        )
    wrong += fault.judge(window)
    wrong += [f"left behind: {what}" for what in rig.left]
    outcome.passed = not wrong
    outcome.reasons = wrong or list(rig.summary.get("safety", {}).get("reasons", []))
    return outcome
