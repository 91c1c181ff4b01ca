"""What was recorded with a run, read as what it should be: a recording may be another program's, or made to deceive.

Rate, axes and publishers of the manifest, and the nodes' parameters. What is not what it should be
is a RecordError. Files that parameters name are opened only where their reader keeps files anyway.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from nodes.base.setup import AXIS_INDEX
from nodes.recording.reader import Recording
from nodes.recording.writer import MANIFEST, PARAMETERS, RecordError

SLOWEST, FASTEST = 1.0, 100_000.0  # rates that a launch may have [Hz]
DEEPEST = 32  # how deep parameters are nested at most


def period_of(recording: Recording) -> float:
    """Return the sampling period by the manifest's ``rate_hz`` [s]."""
    text = recording.manifest.get("rate_hz", "")
    try:
        rate = float(text)
    except ValueError:
        rate = math.nan
    if not SLOWEST <= rate <= FASTEST:
        raise RecordError(
            f"{recording.path}: {MANIFEST}.rate_hz is {text[:40]!r}, expected {SLOWEST:g} to"
            f" {FASTEST:g} Hz; without it nothing can be replayed or drawn as a scene"
        )
    return 1.0 / rate


def axes_of(recording: Recording) -> list[str]:
    """Return the axes that its scene computes, by the manifest."""
    text = recording.manifest.get("axes", "")
    axes = text.split(",")
    if not set(axes) <= set(AXIS_INDEX) or len(set(axes)) != len(axes):
        raise RecordError(
            f"{recording.path}: {MANIFEST}.axes is {text[:40]!r}, expected some of x, y, z with"
            " commas between"
        )
    return axes


def publishers_of(recording: Recording) -> dict[str, list[str]]:
    """Return the topics that each node publishes outside its own name, by the manifest."""
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


def depth(value: Any, most: int = DEEPEST + 1) -> int:
    """Return how deep something is nested, at most `most`."""
    if most == 0 or not isinstance(value, (dict, list)):
        return 0
    inside = value.values() if isinstance(value, dict) else value
    return 1 + max((depth(one, most - 1) for one in inside), default=0)


def group(values: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Return a group of a node's parameters, empty where there is none."""
    found = values.get(name)
    return found if isinstance(found, dict) else {}


def refuse_foreign_files(recording: Recording, parameters: Mapping[str, Any], node: str) -> None:
    """Raise RecordError where an environment's parameters name a file that its reader did not put where it is.

    A recording of somebody else may name any file of this machine, a device or a pipe. Opened are
    regular files below the recording's folder, the working directory, and the folders of installed
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
    """Find what may name a file: every text with a separator, or that begins in somebody's home."""
    if isinstance(value, str):
        if "/" in value or "\\" in value or value.startswith("~") or Path(value[:4096]).suffix:
            yield value
    elif isinstance(value, Mapping):
        for one in value.values():
            yield from _names(one)
    elif isinstance(value, list):
        for one in value:
            yield from _names(one)


def _folders(recording: Path) -> Iterator[Path]:
    """List the folders below which a file may be opened; the root of all is none of them."""
    for folder in (recording.absolute().parent, Path.cwd(), *_collections()):
        if (resolved := folder.resolve()).parent != resolved:
            yield resolved


def _collections() -> Iterator[Path]:
    """List the folders of installed launch files."""
    from nodes.launcher.launch_file import scenarios

    yield from {path.parent for path in scenarios().values()}
