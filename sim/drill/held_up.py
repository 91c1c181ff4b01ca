"""Faults in which a verb that borrowed the device is suspended and resumed too late."""

import os
import signal
import subprocess
from collections.abc import Sequence

from sim.drill.drill import Fault
from sim.drill.people import BACK, borrowed_now, held_at_a_point, leave_a_design
from sim.identify.borrowed import SOFT_LAW
from sim.measure.haptic_commands import MeasurementError, wait_for
from sim.measure.rig import Rig
from sim.tune.live_trial import TRIAL

VERBS: dict[str, tuple[str, ...]] = {
    SOFT_LAW: ("device", "identify", "--load", "0"),
    TRIAL: ("tune", "--steps", "verify"),
}
"""Verbs to suspend, by the law that they have then put into the coupling."""


def _suspend(rig: Rig) -> None:
    """Suspend each verb until the launch has its own law and surface again, then resume it."""
    before = borrowed_now(rig)
    for law, words in VERBS.items():
        leave_a_design(rig)
        with rig.beside(*words) as verb:
            try:
                _await_law(rig, verb, law)
                os.kill(verb.pid, signal.SIGSTOP)
                wait_for(
                    lambda: borrowed_now(rig) == before,
                    "own law and surface after SIGSTOP",
                    BACK,
                )
                os.kill(verb.pid, signal.SIGCONT)
                _await_refusal(rig, verb, words)
            finally:
                verb.kill()
        if borrowed_now(rig) != before:
            raise MeasurementError(
                f"haptic {' '.join(words)}: changed law or surface after SIGCONT"
            )


def _await_law(rig: Rig, verb: subprocess.Popen[bytes], law: str) -> None:
    wait_for(
        lambda: verb.poll() is not None or borrowed_now(rig)[0] == law,
        f"law {law}",
        30.0,
    )


def _await_refusal(
    rig: Rig, verb: subprocess.Popen[bytes], words: Sequence[str]
) -> None:
    try:
        code = verb.wait(BACK)
    except subprocess.TimeoutExpired as error:
        raise MeasurementError(
            f"haptic {' '.join(words)}: does not end after SIGCONT"
        ) from error
    if code != 1:
        said = (rig.folder / "beside.txt").read_text(encoding="utf-8")
        raise MeasurementError(
            f"haptic {' '.join(words)}: exit code {code}: {said[-500:]}"
        )


def faults() -> list[Fault]:
    """Return the faults of this module."""
    what = "identify and tune: SIGSTOP until their leases have run out, then SIGCONT"
    return [Fault("verb suspended", what, _suspend, change=held_at_a_point)]
