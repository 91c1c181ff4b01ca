"""Push the device of a running launch: the excitation takes over as a law, and everything is put back whatever happens.

The law goes first and the surface after it, the other way round at the end. Should this process be
killed, the launch takes law and surface back by itself (sim/identify/borrowed.py).
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
from sim.measure.haptic_commands import start_command, within
from sim.measure.interrupts import undisturbed

# name that the excitation gets in the coupling; it stays defined afterwards, inactive
LAW = "identify"
# a device that is pushed and has not moved for so many seconds' worth of ticks is held fast [s]
HELD_FAST = 1.5
STUCK = (
    f"the device has not moved for {HELD_FAST:g} s though it was pushed: it is held fast, or"
    " friction holds it"
)
MOVED = 1e-4  # less than this is not a motion [m]
# A driver that gives no force for so many seconds' worth of ticks ends the push; shorter silences
# are a busy machine's [s].
ALARM = 1.0
LONGER = 2.0  # so much longer than it is recorded the excitation pushes, should nobody end it [s]
LONGEST = 600.0  # the excitation takes no longer duration [s]
START = 20.0  # a recorder that has not begun after so long will not [s]


@dataclass
class Pushed:
    """What a push left."""

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
    """Push the device once, record it, and put everything back; `load` is the force that carries its weight [N]."""
    loop.ready()
    loop.read_limits()
    here = tuple(float(x) for x in loop.progress()["position_m"])
    centre = tuple(float(x) for x in place) if place is not None else here
    result, duration = (
        Pushed(out, (centre[0], centre[1], centre[2])),
        float(law.get("duration", 8.0)),
    )
    law = {**law, "load": carried(loop, float(law["amplitude"]), load)}
    record = ("bag", "record", topics.DEVICE_STATE, "--run", loop.chosen, "--out", str(out))
    recorder: subprocess.Popen[bytes] | None = None
    try:
        with borrowed(loop) as held:
            loop.soften(law["load"])
            _centre(loop, here, centre)
            # It is ended from here; by itself only should nobody do so.
            longer = {f"laws.{LAW}": {**law, "duration": min(duration + LONGER, LONGEST)}}
            loop.change(loop.coupling, "param.set", values=longer)
            # In lockstep a push is over in less time than a process takes to start.
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
    """Bring the spring's far end there in steps of a millimetre, which the soft spring turns into a slow pull."""
    steps = max(1, round(max(abs(c - h) for c, h in zip(centre, here, strict=True)) / 1e-3))
    for n in range(1, steps + 1):
        loop.anchor([h + (c - h) * n / steps for c, h in zip(centre, here, strict=True)])


def _watch(
    loop: PushedLaunch, duration: float, held: Borrowed, say: Callable[[str], None], result: Pushed
) -> None:
    """Let the excitation take over, and hear every tick until the push is over, or must be; all times are counted in ticks."""
    ticks, first = round(duration / loop.period), -1
    still_at: Sequence[float] = ()
    still_since = alarmed_since = 0
    for state in loop.states():
        if first < 0:
            first = int(loop.change(loop.coupling, "law.switch", law=LAW, ramp=RAMP)["seq"])
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
        if done >= ticks:
            result.reason = "done"
            return
        if state.safety not in ("fault", "zero", "stopped"):
            alarmed_since = state.seq
        elif (state.seq - alarmed_since) * loop.period >= ALARM:
            result.reason = f"the driver removed the force ({state.safety}): {loop.why_stopped()}"
            return
        if max(abs(state.position[i] - still_at[i]) for i in loop.axes) > MOVED:
            still_since, still_at = state.seq, state.position
        elif (state.seq - still_since) * loop.period > HELD_FAST:
            result.reason = STUCK
            return
