"""Faults caused by people: a hand that keeps pushing, and verbs that end unexpectedly."""

import signal
import subprocess
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from messages.transport.requests import ControlError
from messages.types import DeviceState
from nodes.driver.limits import SafetyParameters
from nodes.driver.safety import RETURN_SPEED
from sim.drill.drill import RATE, Fault, kill
from sim.drill.given_design import given_design, given_prediction, given_record
from sim.measure.haptic_commands import MeasurementError, wait_for
from sim.measure.rig import Rig
from sim.tune.knocking import Plan
from sim.tune.live_trial import TRIAL

PEAK = 40.0  # force limit for a hand that has sunk in [N]
# Stiffness [N/m] and target [m] of a pushing hand: 9 N at the surface.
STIFFNESS = 150.0
PATH = -0.06
# Its mass, equal to the device's [kg], and damping [N s/m].
MASS, DAMPING = 0.1, 2.0
SUNK = 0.01  # smallest penetration while nobody answers [m]
# Signals that end a tuning: termination, closed terminal, kill.
SIGNALS = (signal.SIGTERM, signal.SIGHUP, signal.SIGKILL)
# Taps of a law on trial [N/m], and the steps of 2 % above it that are tried; all come to rest.
TAPS = [500.0, -400.0]
FIRST, LAST = 3, 40

SETTLED = 150  # time after a gap until the hand is back at its place [ticks]
BACK = 20.0  # time limit until law and surface are restored: four leases [s]


def _pushed(content: dict[str, Any]) -> None:
    """Make a hand push with constant strength, however deep it penetrates."""
    parameters = content["nodes"]["driver"]["parameters"]
    parameters["device"]["hand"] = {
        "mass": MASS,
        "damping": DAMPING,
        "stiffness": STIFFNESS,
        "path": [[0.0, PATH]],
    }
    parameters["safety"] |= {
        "peak_force": PEAK,
        "slew": PEAK * RATE,
        "workspace": [[-0.2, 0.2]] * 3,
    }
    for node in ("environment", "coupling"):
        content["nodes"][node]["respawn_delay"] = 0.2


def _let_sink(rig: Rig) -> None:
    """Kill coupling, then environment, while a hand presses."""
    for node in ("coupling", "environment"):
        kill(node)(rig)
        wait_for(lambda: rig.states[-1].safety == "active", "forces to come back", 15.0)


def thrown(states: Sequence[DeviceState]) -> list[str]:
    """Return violations: forces that returned faster than their ramp, or too much energy."""
    recovery = round(SafetyParameters().recovery * RATE)
    silent = [
        n
        for n, (a, b) in enumerate(pairwise(states))
        if (a.safety, b.safety) == ("zero", "ramp")
    ]
    wrong = (
        []
        if len(silent) >= 2
        else [f"the force came back {len(silent)} times, not twice"]
    )
    for n in silent:
        last = states[n].seq
        after = [state for state in states[n:] if state.seq <= last + 6 * recovery]
        depth = -min(state.position[2] for state in after)
        if depth < SUNK:
            wrong.append(f"the hand sank in by {1e3 * depth:.1f} mm only")
        for state in after:
            allowed = PEAK * min(state.seq - last, recovery) / recovery
            # Tolerance: two roundings.
            if (force := abs(state.force[2])) > allowed * (1.0 + 1e-15):
                wrong.append(
                    f"{force:.3g} N, {state.seq - last} ticks after none; the ramp allows"
                    f" {allowed:.3g} N"
                )
                break
        # The return needs the work against the hand, and its speed: 1.5 times the limit, for ticks
        # of acceleration.
        speed = 1.5 * RETURN_SPEED
        allowed = (STIFFNESS * -PATH + (1.0 + DAMPING) * speed) * depth + 0.5 * (
            0.1 + MASS
        ) * speed**2
        given = max(state.energy for state in after) - after[0].energy
        if given > allowed:
            wrong.append(
                f"{1e3 * given:.0f} mJ given out from a depth of {1e3 * depth:.0f} mm; the return"
                f" needs {1e3 * allowed:.0f} mJ"
            )
    return wrong


def held_at_a_point(content: dict[str, Any]) -> None:
    """Replace the hand by an anchor, as for tuning a law."""
    del content["nodes"]["driver"]["parameters"]["device"]["hand"]
    content["nodes"]["environment"]["parameters"]["surface"] = {
        "kind": "anchor",
        "position": [0.0, 0.0, 0.0],
    }


def leave_a_design(rig: Rig) -> None:
    """Write the files of a design and a prediction: a law to be tried from above."""
    law = given_design(TAPS, 1.0 / RATE, MASS)
    record = given_record(
        law, given_prediction(sum(TAPS), 10.0), Plan(FIRST, FIRST, LAST)
    )
    folder = rig.folder / "tuning"
    folder.mkdir(exist_ok=True)
    record.write(folder / "tune.json")


def borrowed_now(rig: Rig) -> tuple[Any, Any]:
    """Return what a verb borrows: the active law, and the surface."""
    try:
        return rig.call("coupling", "law.list")["active"], rig.call(
            "environment", "param.get", name="surface"
        )
    except ControlError as error:
        raise MeasurementError(str(error)) from error


def _end_tuning(rig: Rig) -> None:
    """End a tuning by each signal during a trial; law and surface must be restored."""
    before = borrowed_now(rig)
    for number in SIGNALS:
        leave_a_design(rig)
        with rig.beside("tune", "--steps", "verify") as tuning:
            try:
                _end_on_trial(rig, tuning, number)
            finally:
                tuning.kill()
        # A killed verb restores nothing; the nodes' leases do.
        timeout = BACK if number == signal.SIGKILL else 1.0
        wait_for(
            lambda: borrowed_now(rig) == before,
            f"the launch's own law and surface after {number.name}",
            timeout,
        )


def _end_on_trial(
    rig: Rig, tuning: subprocess.Popen[bytes], number: signal.Signals
) -> None:
    wait_for(
        lambda: tuning.poll() is not None or borrowed_now(rig)[0] == TRIAL,
        "a law on trial",
        30.0,
    )
    tuning.send_signal(number)
    try:
        code = tuning.wait(BACK)
    except subprocess.TimeoutExpired as error:
        raise MeasurementError(f"haptic tune does not end on {number.name}") from error
    if code != (-number if number == signal.SIGKILL else 128 + number):
        said = (rig.folder / "beside.txt").read_text(encoding="utf-8")
        raise MeasurementError(
            f"haptic tune ended with exit code {code}, not by {number.name}: {said[-500:]}"
        )


def _press(rig: Rig) -> None:
    """Run identification and tuning while a hand presses: both must refuse and change nothing."""
    before = borrowed_now(rig)
    leave_a_design(rig)
    for words in (("device", "identify"), ("tune", "--steps", "verify")):
        done = rig.haptic(*words, code=None)
        said = done.stdout + done.stderr
        verb = f"haptic {' '.join(words)}"
        if done.returncode != 1 or "let go first" not in said:
            raise MeasurementError(
                f"{verb}: exit code {done.returncode} while a hand presses: {said[-500:]}"
            )
        if borrowed_now(rig) != before:
            raise MeasurementError(
                f"{verb}: refused, and has changed law or surface all the same"
            )


def unasked(states: Sequence[DeviceState]) -> list[str]:
    """Return a violation if the device was pushed: the pressing force changed without a gap."""
    calm = 0
    pressed = states[0].force[2]
    for state in states:
        calm = calm + 1 if state.safety == "active" else 0
        # After a gap the hand first returns. A push would begin with tenths of a newton.
        if (calm == state.seq - states[0].seq + 1 or calm > SETTLED) and abs(
            state.force[2] - pressed
        ) > 0.1 * abs(pressed):
            return [
                f"{state.force[2]:.3g} N at tick {state.seq}, where a hand presses with"
                f" {pressed:.3g} N"
            ]
    return []


def faults() -> list[Fault]:
    """Return the faults of this module."""
    sinks = f"coupling, then environment killed while a hand pushes with {-STIFFNESS * PATH:g} N"
    signals = ", ".join(number.name for number in SIGNALS)
    return [
        Fault("hand sinks in", sinks, _let_sink, change=_pushed, judge=thrown),
        Fault(
            "tune ended",
            f"{signals} with a law on trial",
            _end_tuning,
            change=held_at_a_point,
        ),
        Fault(
            "pressed device",
            "identify and tune while a hand presses",
            _press,
            judge=unasked,
        ),
    ]
