"""Period, delay and jitter of a recorded run, tick by tick, to design for that loop.

Poles assume a constant delay. A delay that changes from tick to tick can be worse than each of its
values, so a design for a recorded loop is replayed with the recorded delays and the exact device.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from messages.topics import DEVICE_STATE
from nodes.laws import CompiledLaw
from nodes.parameters.yaml_io import parse_yaml
from nodes.recording.facts import period_of
from nodes.recording.reader import Recording
from nodes.recording.summary import quantile
from nodes.stability.plant import Plant
from sim.device.hand import Hand
from sim.device.model import DeviceModel
from sim.play.given import Given
from sim.play.one_axis import run
from sim.play.one_axis_inputs import Scene, SceneSurface


@dataclass(frozen=True)
class Measured:
    """Timing of a recorded loop."""

    period: float  # sampling period T [s]
    # range of the delay, 0.1 % and 99.9 % quantiles over the answered ticks [ticks], shape (2,)
    delay: tuple[float, float]
    median: float  # median delay [ticks]
    jitter: float  # 99.9 % quantile minus 0.1 % quantile of the delay [ticks]
    # delay of each tick, in order [ticks]; infinite for a tick not answered in time
    delays: tuple[float, ...]
    unanswered: int  # number of ticks not answered in time
    # parameters of the virtual device; None for another device [kg], [N s/m]
    mass: float | None
    damping: float | None


def measure(path: Path) -> Measured:
    """Read period, delay and jitter from a recording.

    Raise ValueError if the recording has fewer than 100 ticks or no delays.
    """
    recording = Recording(path)
    states = recording.messages(DEVICE_STATE)
    if len(states) < 100:
        raise ValueError(
            f"{path}: {len(states)} ticks recorded, at least 100 are needed to measure delay and"
            " jitter"
        )
    period = period_of(recording)
    device = node_with(recording, "device").get("device", {})
    own = float(device.get("delay", 0.0))
    # Each state reports the previous tick; the first state, and a loop still without forces,
    # reports none. A tick not answered in time reports the age of the older force that acted; its
    # own force never acts.
    with_answer = [state for state in states[1:] if state.force_seq >= 0]
    delays = tuple(
        state.delay + own if state.age == 0 else math.inf for state in with_answer
    )
    answered = sorted(filter(math.isfinite, delays))
    if len(answered) < 100:
        raise ValueError(
            f"{path}: {len(answered)} ticks were answered by a force in time, at least 100 are"
            " needed"
        )
    if recording.manifest.get("pace") == "realtime" and not any(
        state.delay for state in with_answer
    ):
        raise ValueError(
            f"{path}: a real-time run without any delay: it was recorded before delays were; record"
            " it again"
        )
    low, middle, high = (
        quantile(answered, fraction) for fraction in (0.001, 0.5, 0.999)
    )
    told = (low, high), middle, high - low, delays, len(delays) - len(answered)
    return Measured(period, *told, device.get("mass"), device.get("damping"))


def node_with(recording: Recording, name: str) -> dict[str, Any]:
    """Return the recorded parameters of the node with a group `name`; empty if none."""
    nodes = (
        parse_yaml(text, "parameters")
        for text in recording.metadata.get("parameters", {}).values()
    )
    return next(
        (
            node
            for node in nodes
            if isinstance(node, dict) and isinstance(node.get(name), dict)
        ),
        {},
    )


GIVEN_UP = 1e200  # deflection above which a loop counts as unstable [m]


def replayed_radius(law: CompiledLaw, plant: Plant, delays: Sequence[float]) -> float:
    """Return the growth factor per tick of a released deflection under recorded delays.

    Raise ValueError for a law with filter sections or fewer than 40 delays.
    """
    if law.sections:
        raise ValueError("law: only taps can be replayed")
    if len(delays) < 40:
        raise ValueError(
            f"delays: {len(delays)} ticks, at least 40 are needed for a first and a last quarter"
        )
    hand = (
        Hand(stiffness=plant.stiffness, path=[(0.0, 0.0)]) if plant.stiffness else None
    )
    device = DeviceModel(
        mass=plant.mass, damping=plant.damping, position=1.0, hand=hand
    )
    scene = Scene(
        device=device,
        surface=SceneSurface("anchor"),
        period=plant.period,
        raw=False,
        clamp=False,
    )
    arrivals: list[tuple[float, int]] = []
    for at, seq in sorted((k + delay, k) for k, delay in enumerate(delays)):
        # A force overtaken by a newer one never acts.
        if not arrivals or seq > arrivals[-1][1]:
            arrivals.append((at, seq))
    when = np.array([at for at, _ in arrivals])
    answers = np.array([seq for _, seq in arrivals], dtype=np.int64)
    with np.errstate(all="ignore"):
        trace = run(
            scene,
            law,
            len(delays),
            interpreted=True,
            given=Given(arrivals=(when, answers, np.zeros(len(when)))),
        )
        size = np.abs(trace.position) + np.abs(trace.velocity) * plant.period
    if not np.all(size < GIVEN_UP):
        return math.inf
    quarter = len(size) // 4
    first = float(np.max(size[:quarter]))
    last = float(np.max(size[-quarter:]))
    return (
        math.exp((math.log(last) - math.log(first)) / (len(size) - quarter))
        if last > 0.0
        else 0.0
    )
