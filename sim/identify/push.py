"""Push the device of a running launch by an excitation law, and restore everything.

The law changes first and the surface after it, in reverse order at the end. If this process is
killed, the launch restores law and surface by itself (sim/identify/borrowed.py).
"""

import signal
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from messages import topics
from messages.errors import RefusedError
from sim.identify.borrowed import RAMP, Borrowed, PushedLaunch, borrowed, carried
from sim.measure.cancelling import check
from sim.measure.haptic_commands import start_command, within
from sim.measure.interrupts import undisturbed

# name of the excitation in the coupling; it remains defined afterwards, inactive
LAW = "identify"
# time without motion after which a pushed device counts as held, counted in ticks [s]
HELD_FAST = 1.5
STUCK = (
    f"the device has not moved for {HELD_FAST:g} s though it was pushed: it is held fast, or"
    " friction holds it"
)
MOVED = 1e-4  # smallest motion [m]
# Time without force, counted in ticks, after which the push ends; shorter gaps are a busy machine's
# [s].
ALARM = 1.0
LONGER = 2.0  # how much longer than recorded the excitation runs if it is not ended [s]
MAX_DURATION = 600.0  # longest duration of an excitation [s]
START = 20.0  # time within which a recorder must begin [s]


@dataclass
class Pushed:
    """Result of a push."""

    recording: Path  # its recording
    place: tuple[float, float, float]  # where the device was centred [m], shape (3,)
    # first tick of the push and the one after its last, shape (2,)
    ticks: tuple[int, int] = (0, 2**53)
    reason: str = "done"  # why it ended: ``done``, or what stopped it


def push(
    loop: PushedLaunch,
    law: dict[str, Any],
    out: Path,
    place: Sequence[float] | None = None,
    say: Callable[[str], None] = lambda _: None,
    load: float | None = None,
) -> Pushed:
    """Push the device once, record it, and restore everything.

    `load` is the force that carries its weight [N]. Raise RefusedError if nothing was recorded.
    """
    loop.ready()
    loop.read_limits()
    here = tuple(float(x) for x in loop.progress()["position_m"])
    centre = tuple(float(x) for x in place) if place is not None else here
    result, duration = (
        Pushed(out, (centre[0], centre[1], centre[2])),
        float(law.get("duration", 8.0)),
    )
    law = {**law, "load": carried(loop, float(law["amplitude"]), load)}
    record = (
        "bag",
        "record",
        topics.DEVICE_STATE,
        "--run",
        loop.chosen,
        "--out",
        str(out),
    )
    recorder: subprocess.Popen[bytes] | None = None
    try:
        with borrowed(loop) as held:
            loop.soften(law["load"])
            _centre(loop, here, centre)
            # This process ends it; the longer duration is a fallback.
            longer = {
                f"laws.{LAW}": {**law, "duration": min(duration + LONGER, MAX_DURATION)}
            }
            loop.change(loop.coupling, "param.set", values=longer)
            # In lockstep a push would end before a process has started.
            with loop.standing():
                recorder = start_command(
                    *record, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
                )
                within(lambda: recorder.poll() is not None or out.exists(), START)
            _watch(loop, duration, held, say, result)
    except KeyboardInterrupt:
        result.reason = "Ctrl-C"
    finally:
        if recorder is not None:
            with undisturbed():
                recorder.send_signal(signal.SIGINT)
                recorder.wait(timeout=30.0)
    if not out.exists():
        raise RefusedError(f"{loop.run.run}: nothing was recorded: {result.reason}")
    return result


def _centre(loop: PushedLaunch, here: Sequence[float], centre: Sequence[float]) -> None:
    """Move the anchor to `centre` in steps of 1 mm, so that the soft spring pulls slowly."""
    steps = max(
        1, round(max(abs(c - h) for c, h in zip(centre, here, strict=True)) / 1e-3)
    )
    for n in range(1, steps + 1):
        loop.anchor(
            [h + (c - h) * n / steps for c, h in zip(centre, here, strict=True)]
        )


def _watch(
    loop: PushedLaunch,
    duration: float,
    held: Borrowed,
    say: Callable[[str], None],
    result: Pushed,
) -> None:
    """Activate the excitation and watch every tick until the push ends.

    All times are counted in ticks.
    """
    ticks, first = round(duration / loop.period), -1
    still_at: Sequence[float] = ()
    still_since = alarmed_since = 0
    for state in loop.states():
        if first < 0:
            first = int(
                loop.change(loop.coupling, "law.switch", law=LAW, ramp=RAMP)["seq"]
            )
            result.reason = "the launch ended"
            still_since, still_at, alarmed_since = first, state.position, first
            continue
        done = state.seq - first
        if done < 0:
            continue
        result.ticks = (first, state.seq)
        if done % 50 == 0:
            say(f"pushing: {min(100, 100 * done // ticks)} %")
            held.check()
            check()
        if done >= ticks:
            result.reason = "done"
            return
        if state.safety not in ("fault", "zero", "stopped"):
            alarmed_since = state.seq
        elif (state.seq - alarmed_since) * loop.period >= ALARM:
            result.reason = (
                f"the driver removed the force ({state.safety}): {loop.why_stopped()}"
            )
            return
        if max(abs(state.position[i] - still_at[i]) for i in loop.axes) > MOVED:
            still_since, still_at = state.seq, state.position
        elif (state.seq - still_since) * loop.period > HELD_FAST:
            result.reason = STUCK
            return
