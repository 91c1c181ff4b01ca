"""Read and validate what was recorded with a run: period, axes, publishers, parameters.

A recording may come from another program or be malicious, so every invalid value raises
RecordError. Files that parameters name are opened only in folders where the reader keeps files (see
`refuse_foreign_files`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from messages.event_kinds import MARK
from messages.topics import DEVICE_STATE, message_type
from messages.types import Event
from nodes.base.setup import AXIS_INDEX
from nodes.recording.reader import Recording
from nodes.recording.writer import MANIFEST, PARAMETERS, RecordError

SLOWEST, FASTEST = 1.0, 100_000.0  # limits of a launch's rate [Hz]
DEEPEST = 32  # limit of the nesting depth of parameters


def period_of(recording: Recording) -> float:
    """Return the sampling period [s]: the manifest's, else that of the states' stamps.

    Raises
    ------
    RecordError
        If ``rate_hz`` of the manifest is no rate, or the stamps advance at another; without it, if
        the stamps give none.
    """
    text = recording.manifest.get("rate_hz")
    stamped = stamped_rate(recording)
    if text is None:
        if stamped is None:
            raise RecordError(
                f"{recording.path}: {MANIFEST}.rate_hz is missing, and the stamps of"
                f" {DEVICE_STATE} give no rate; replaying and drawing the scene need it"
            )
        return 1.0 / stamped
    try:
        rate = float(text)
    except ValueError:
        rate = math.nan
    if not SLOWEST <= rate <= FASTEST:
        raise RecordError(
            f"{recording.path}: {MANIFEST}.rate_hz is {text[:40]!r}, expected {SLOWEST:g} to"
            f" {FASTEST:g} Hz; replaying and drawing the scene need it"
        )
    if stamped is not None and not _agree(recording, rate):
        raise RecordError(
            f"{recording.path}: {MANIFEST}.rate_hz is {rate:g}, while the stamps of {DEVICE_STATE}"
            f" advance {stamped:g} times a second; write the rate of the ticks, or leave it out"
        )
    return 1.0 / rate


def stamped_rate(recording: Recording) -> float | None:
    """Return the rate at which the stamps of the states advance [Hz].

    It is rounded to the fewest digits that the stamps, each late by up to a tick, do not
    contradict. None for fewer than two states, for several runs in one file, and for stamps that
    give no rate of a launch.
    """
    figures = recording.topics.get(DEVICE_STATE)
    if figures is None or figures.back:
        return None
    steps = figures.last_seq - figures.first_seq
    span = figures.last_stamp - figures.first_stamp
    if steps < 1 or not span > 0.0:
        return None
    rate = steps / span
    if not SLOWEST <= rate <= FASTEST:
        return None
    candidates = (float(f"{rate:.{digits}g}") for digits in range(1, 10))
    return next(
        (one for one in candidates if abs(one / rate - 1.0) <= _ROUNDED / steps), rate
    )


_ROUNDED = 0.5  # what the first and the last stamp together may be late by [ticks]
_RATE_TOLERANCE, _LATE = (
    0.01,
    2.0,
)  # of a declared rate: share, and ticks that a stamp may be late


def _agree(recording: Recording, rate: float) -> bool:
    """Whether a declared rate fits the stamps."""
    figures = recording.topics[DEVICE_STATE]
    steps = figures.last_seq - figures.first_seq
    span = figures.last_stamp - figures.first_stamp
    return abs(span * rate - steps) <= _RATE_TOLERANCE * steps + _LATE


def axes_of(recording: Recording) -> list[str]:
    """Return the axes that the scene computes: the manifest's, else those that moved."""
    text = recording.manifest.get("axes")
    if text is None:
        return _moved(recording)
    axes = text.split(",")
    if not set(axes) <= set(AXIS_INDEX) or len(set(axes)) != len(axes):
        raise RecordError(
            f"{recording.path}: {MANIFEST}.axes is {text[:40]!r}, expected some of x, y, z"
            " separated by commas"
        )
    return axes


def _moved(recording: Recording) -> list[str]:
    """Return the axes along which position or force changed, of a file that names none."""
    low = [math.inf] * 6
    high = [-math.inf] * 6
    for state in recording.messages(DEVICE_STATE):
        for place, value in enumerate((*state.position, *state.force)):
            low[place], high[place] = min(low[place], value), max(high[place], value)
    found = [
        axis
        for axis, place in AXIS_INDEX.items()
        if low[place] < high[place] or low[place + 3] < high[place + 3]
    ]
    return found or ["z"]


def marks_of(recording: Recording) -> list[Event]:
    """Return the events with which somebody marked a moment, in the order of their stamps."""
    topics = [topic for topic in recording.topics if message_type(topic) is Event]
    found = (entry.message for entry in recording.entries(topics)) if topics else ()
    marks = [
        event for event in found if isinstance(event, Event) and event.kind == MARK
    ]
    return sorted(marks, key=lambda event: event.stamp)


def publishers_of(recording: Recording) -> dict[str, list[str]]:
    """Return the topics that each node publishes outside its own name, from the manifest."""
    return recording.facts(MANIFEST, "publishes", dict[str, list[str]])


def parameters_of(recording: Recording) -> dict[str, dict[str, Any]]:
    """Return the parameters of each node."""
    found = {}
    for node in recording.metadata.get(PARAMETERS, {}):
        values = recording.facts(PARAMETERS, node, dict[str, Any])
        if depth(values) > DEEPEST:
            raise RecordError(
                f"{recording.path}: {PARAMETERS}.{node}: nested deeper than {DEEPEST}"
            )
        found[node] = values
    return found


def depth(value: Any, limit: int = DEEPEST + 1) -> int:
    """Return the nesting depth of a value, at most `limit`."""
    if limit == 0 or not isinstance(value, (dict, list)):
        return 0
    inside = value.values() if isinstance(value, dict) else value
    return 1 + max((depth(one, limit - 1) for one in inside), default=0)


def group(values: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a group of a node's parameters; empty if absent."""
    found = values.get(name)
    return found if isinstance(found, dict) else {}


def refuse_foreign_files(
    recording: Recording, parameters: Mapping[str, Any], node: str
) -> None:
    """Raise RecordError if parameters name a file outside the folders allowed here.

    A recording from elsewhere may name any file of this machine, a device or a pipe. Allowed are
    regular files below the recording's folder, the working directory and the folders of installed
    scenarios.
    """
    for text in _names(parameters):
        try:
            file = Path(text).expanduser().resolve()
            allowed = file.is_file() and any(
                file.is_relative_to(folder) for folder in _folders(recording.path)
            )
        except (OSError, ValueError, RuntimeError):
            allowed = False
        if not allowed:
            raise RecordError(
                f"{recording.path}: {PARAMETERS}.{node} names the file {text[:200]!r}, which is no"
                f" file below {recording.path.absolute().parent} or the working directory, and is"
                " not opened; copy it there, or work in a folder above it"
            )


def _names(value: Any) -> Iterator[str]:
    """Yield every text that may name a file: with a separator, a suffix or a leading ``~``."""
    if isinstance(value, str):
        if (
            "/" in value
            or "\\" in value
            or value.startswith("~")
            or Path(value[:4096]).suffix
        ):
            yield value
    elif isinstance(value, Mapping):
        for one in value.values():
            yield from _names(one)
    elif isinstance(value, list):
        for one in value:
            yield from _names(one)


def _folders(recording: Path) -> Iterator[Path]:
    """Yield the folders below which a file may be opened; never the root."""
    for folder in (recording.absolute().parent, Path.cwd(), *_collections()):
        if (resolved := folder.resolve()).parent != resolved:
            yield resolved


def _collections() -> Iterator[Path]:
    """Yield the folders of installed launch files."""
    from nodes.launcher.scenario_files import scenarios

    yield from {path.parent for path in scenarios().values()}
