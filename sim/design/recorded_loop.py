"""What a recorded run tells about its loop: period, delay and jitter, tick by tick, for a design made for that loop."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from messages.topics import DEVICE_STATE
from nodes.parameters.yaml_io import parse_yaml
from nodes.recording.reader import Recording
from nodes.recording.summary import quantile


@dataclass(frozen=True)
class Measured:
    """What a recorded run tells about its loop."""

    period: float  # sampling period T [s]
    # Delay that all but one answered tick in a thousand stayed within, at either end [ticks], shape (2,).
    delay: tuple[float, float]
    median: float  # median delay [ticks]
    jitter: float  # its spread, 99.9 % quantile minus 0.1 % quantile [ticks]
    delays: tuple[float, ...]  # delay of each tick, in order [ticks]; infinite for a tick that was not answered in time
    unanswered: int  # how many were not
    # What the virtual device was given, None for another device [kg], [N s/m].
    mass: float | None
    damping: float | None


def measure(path: Path) -> Measured:
    """Read period, delay and jitter from a recording."""
    recording = Recording(path)
    states = recording.messages(DEVICE_STATE)
    if len(states) < 100:
        raise ValueError(f"{path}: {len(states)} ticks recorded, at least 100 are needed to tell delay and jitter")
    rate = float(recording.manifest.get("rate_hz", 0.0))
    if not rate > 0.0:
        raise ValueError(f"{path}: its manifest tells no rate_hz")
    device = _virtual_device(recording)
    own = float(device.get("delay", 0.0))
    # Each state tells of the tick before it; the first one, and a loop without forces yet, have none. A tick that was not
    # answered in time has an older force instead, whose age it tells; its own force never acts.
    with_answer = [state for state in states[1:] if state.force_seq >= 0]
    delays = tuple(state.delay + own if state.age == 0 else math.inf for state in with_answer)
    answered = sorted(filter(math.isfinite, delays))
    if len(answered) < 100:
        raise ValueError(f"{path}: {len(answered)} ticks were answered by a force in time, at least 100 are needed")
    if recording.manifest.get("pace") == "realtime" and not any(state.delay for state in with_answer):
        raise ValueError(
            f"{path}: a real-time run without any delay: it was recorded before delays were; record it again"
        )
    low, middle, high = (quantile(answered, fraction) for fraction in (0.001, 0.5, 0.999))
    return Measured(
        period=1.0 / rate,
        delay=(low, high),
        median=middle,
        jitter=high - low,
        delays=delays,
        unanswered=len(delays) - len(answered),
        mass=device.get("mass"),
        damping=device.get("damping"),
    )


def _virtual_device(recording: Recording) -> dict[str, Any]:
    for text in recording.metadata.get("parameters", {}).values():
        node = parse_yaml(text, "parameters")
        if isinstance(node, dict) and isinstance(node.get("device"), dict):
            return dict(node["device"])
    return {}
