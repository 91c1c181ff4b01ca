"""Push the device of a running launch: the excitation takes over as a law, and everything is put back whatever happens.

The law goes first and the surface after it, the other way round at the end: at no time does a stiff law meet a point that
has jumped. Should this process be killed, the excitation ends by itself and leaves a soft spring.
"""

from __future__ import annotations

import contextlib
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from messages import topics
from nodes.base.kinds import load
from nodes.cli.ask import ask
from nodes.cli.main import RefusedError, UsageError
from nodes.launcher.runs import RunInfo
from sim.measure.launches import HAPTIC, within

LAW = "identify"
"""Name that the excitation gets in the coupling; it stays defined afterwards, inactive."""
RAMP = 100
"""Cross-fade from and to the law that was there [ticks]."""
HELD_FAST = 1.5
"""A device that is pushed and has not moved for so long is held fast [s]."""
MOVED = 1e-4
"""Less than this is not a motion [m]."""
ALARM = 1.0
"""A driver that gives no force for so long ends the push; shorter silences are a busy machine's [s]."""
START = 20.0
"""A recorder that has not begun after so long will not [s]."""
_POLL = 0.05


@contextlib.contextmanager
def undisturbed() -> Iterator[None]:
    """Ignore Ctrl-C while a launch is put back: an impatient second one must not leave it half-way."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def interrupted_once() -> Iterator[None]:
    """Take the first Ctrl-C as the order to leave; those after it change nothing."""

    def leave(*_: object) -> None:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        raise KeyboardInterrupt

    before = signal.signal(signal.SIGINT, leave)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


@dataclass
class Pushed:
    """What a push left.

    Attributes
    ----------
    recording : Path
        Its recording.
    place : tuple of float, shape (3,)
        Where the device was centred [m].
    reason : str
        Why it ended: ``done``, or what stopped it.
    """

    recording: Path
    place: tuple[float, float, float]
    reason: str = "done"


@dataclass
class Loop:
    """The nodes of a running launch that a push needs.

    Attributes
    ----------
    run : RunInfo
        The run.
    driver, environment, coupling : str
        Names of its nodes.
    period : float
        Sampling period [s].
    axes : tuple of int
        Axes that the scene computes.
    peak, slew : float or None
        The driver's limits, by `read_limits`: force [N], change per tick [N].
    """

    run: RunInfo
    driver: str = ""
    environment: str = ""
    coupling: str = ""
    period: float = 0.0
    axes: tuple[int, ...] = field(default=())
    peak: float | None = None
    slew: float | None = None

    def __post_init__(self) -> None:
        for name, setup in self.run.nodes.items():
            publishes = load(setup.factory).publishes
            if topics.DEVICE_STATE in publishes:
                self.driver, self.period = name, setup.period
                self.axes = tuple("xyz".index(axis) for axis in setup.axes)
            elif topics.PROXY in publishes:
                self.environment = name
            elif topics.FORCE in publishes:
                self.coupling = name
        if not (self.driver and self.environment and self.coupling):
            raise UsageError(f"{self.run.run}: has no driver, environment and coupling that could push a device")

    def read_limits(self) -> None:
        """Ask the driver for its limits."""
        safety = ask(self.run, self.driver, "param.get", name="safety")
        self.peak = safety["peak_force"]
        self.slew = None if safety["slew"] is None else safety["slew"] * self.period

    def progress(self) -> dict[str, Any]:
        """Ask the driver how it goes."""
        told: dict[str, Any] = ask(self.run, self.driver, "progress")
        return told

    def wait(self, ticks: int) -> None:
        """Wait for some ticks."""
        first = self.progress()["tick"]
        while self.progress()["tick"] < first + ticks:
            time.sleep(0.02)


def push(
    loop: Loop,
    law: dict[str, Any],
    out: Path,
    place: Sequence[float] | None = None,
    say: Callable[[str], None] = lambda _: None,
) -> Pushed:
    """Push the device once, record it, and put everything back."""
    start = loop.progress()
    if start["safety"] == "stopped":
        raise RefusedError(f"{loop.driver}: has stopped for good; launch again")
    if start["safety"] == "fault":
        raise RefusedError(f"{loop.driver}: the device is outside its workspace; bring it back first")
    here = tuple(float(x) for x in start["position_m"])
    centre = tuple(float(x) for x in place) if place is not None else here
    result = Pushed(out, (centre[0], centre[1], centre[2]))
    if len(loop.axes) == 1 and "load" not in law:
        # At rest on a wall the force carries the weight; without a wall it is zero.
        law = {**law, "load": float(start["force_n"][loop.axes[0]])}
    run, duration = loop.run, float(law.get("duration", 8.0))
    surface = ask(run, loop.environment, "param.get", name="surface")
    before = ask(run, loop.coupling, "law.list")["active"]
    command = [*HAPTIC, "bag", "record", topics.DEVICE_STATE, "--run", run.run]
    recorder: subprocess.Popen[bytes] | None = None
    try:
        # It is ended from here; by itself only should nobody do so.
        ask(run, loop.coupling, "param.set", values={f"laws.{LAW}": {**law, "duration": min(duration + START, 600.0)}})
        ask(run, loop.coupling, "law.switch", law=LAW, ramp=RAMP)
        _centre(loop, here, centre)
        recorder = subprocess.Popen([*command, "--out", str(out)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        # What the recorder misses at the start is missing at the end.
        within(lambda: recorder.poll() is not None or out.exists(), START)
        result.reason = _watch(loop, duration, say)
    except KeyboardInterrupt:
        result.reason = "Ctrl-C"
    finally:
        with undisturbed():
            _restore(loop, before, surface, say)
            if recorder is not None:
                recorder.send_signal(signal.SIGINT)
                recorder.wait(timeout=30.0)
    if not out.exists():
        raise RefusedError(f"{loop.run.run}: nothing was recorded: {result.reason}")
    return result


def _centre(loop: Loop, here: Sequence[float], centre: Sequence[float]) -> None:
    """Bring the spring's far end there in steps of a millimetre, which the soft spring turns into a slow pull."""
    steps = max(1, round(max(abs(c - h) for c, h in zip(centre, here, strict=True)) / 1e-3))
    for n in range(1, steps + 1):
        at = [h + (c - h) * n / steps for c, h in zip(centre, here, strict=True)]
        ask(loop.run, loop.environment, "param.set", values={"surface": {"kind": "anchor", "position": at}})


def _watch(loop: Loop, duration: float, say: Callable[[str], None]) -> str:
    """Wait until the push is over, or must be."""
    first = loop.progress()
    ticks = round(duration / loop.period)
    still_since = time.monotonic()
    still_at, alarmed = first["position_m"], 0
    while True:
        time.sleep(_POLL)
        now = loop.progress()
        done = now["tick"] - first["tick"]
        say(f"pushing: {min(100, 100 * done // ticks)} %")
        alarmed = alarmed + 1 if now["safety"] in ("fault", "zero", "stopped") else 0
        if alarmed * _POLL >= ALARM:
            why = "the device left its workspace, the loop swung, or forces stopped"
            return f"the driver took the force away ({now['safety']}): {why}"
        if done >= ticks:
            return "done"
        moved = max(abs(now["position_m"][i] - still_at[i]) for i in loop.axes)
        if moved > MOVED:
            still_since, still_at = time.monotonic(), now["position_m"]
        elif time.monotonic() - still_since > HELD_FAST:
            return f"the device has not moved for {HELD_FAST:g} s though it was pushed: it is held fast, or friction holds it"


def _restore(loop: Loop, law: str, surface: Any, say: Callable[[str], None]) -> None:
    """Put surface and law back; a launch that has ended meanwhile has nothing to put back."""
    try:
        ask(loop.run, loop.environment, "param.set", values={"surface": surface})
        if law != LAW:
            ask(loop.run, loop.coupling, "law.switch", law=law, ramp=RAMP, force=True)
    except RefusedError as error:
        say(f"not put back: {error}")
