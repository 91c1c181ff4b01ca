"""A recording for other programs: one CSV file per topic, or one NPZ of arrays."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterable, Iterator
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from typing import Any

import msgspec

from messages.schema import schema
from messages.types import Message
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordError, save

_UNIT = re.compile(r"\[([^\]]+)\]")


def plain_names(topics: Iterable[str]) -> dict[str, str]:
    """Turn topics into names that are safe as file names.

    Parameters
    ----------
    topics : iterable of str
        Topic names, from a file that may be anybody's.

    Returns
    -------
    dict of str to str
        Each topic's name in letters, digits and underscores only, no two alike: ``/device/state`` is ``device_state``.
    """
    found: dict[str, str] = {}
    for topic in topics:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", topic.strip("/"))[:100] or "topic"
        name, number = plain, 1
        while name in found.values():
            number += 1
            name = f"{plain}_{number}"
        found[topic] = name
    return found


def columns(message_type: type[Message]) -> list[str]:
    """Name the columns of a topic's table, units included.

    Parameters
    ----------
    message_type : type of Message
        What the topic carries.

    Returns
    -------
    list of str
        ``log_time [s]`` and one name per field or component, e.g. ``seq``, ``stamp [s]``, ``position_x [m]``; the units
        are those of the field's documentation.
    """
    found = ["log_time [s]"]
    for name, told in schema(message_type)["properties"].items():
        unit = _UNIT.search(told.get("description", ""))
        suffix = f" [{unit[1]}]" if unit else ""
        parts = [f"{name}_{axis}" for axis in "xyz"] if told["type"] == "array" else [name]
        found += [part + suffix for part in parts]
    return found


def _row(log_time: float, message: Message) -> Iterator[Any]:
    yield log_time
    for value in msgspec.structs.astuple(message):
        if isinstance(value, tuple):
            yield from value
        else:
            yield int(value) if isinstance(value, bool) else value


def export_csv(recording: Recording, out: str | Path, *, overwrite: bool = False) -> list[Path]:
    """Write one CSV file per topic.

    Parameters
    ----------
    recording : Recording
        The recording.
    out : str or Path
        Directory for the files; made when it is not there.
    overwrite : bool, optional
        Whether existing files may be replaced.

    Returns
    -------
    list of Path
        The files: comma-separated, first row the names of the columns with their units (`columns`), numbers to the last
        bit, flags as 0 and 1.

    Raises
    ------
    RecordError
        When a message does not fit its type, a file exists already, or the disk is full.
    """
    folder = Path(out)
    files = {topic: folder / f"{name}.csv" for topic, name in plain_names(recording.topics).items()}
    writers: dict[str, Any] = {}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            for entry in recording.entries():
                writer = writers.get(entry.topic)
                if writer is None:
                    stream = stack.enter_context(
                        files[entry.topic].open("w" if overwrite else "x", newline="", encoding="utf-8")
                    )
                    writer = writers[entry.topic] = csv.writer(stream)
                    writer.writerow(columns(type(entry.message)))
                writer.writerow(_row(entry.log_time, entry.message))
    except OSError as error:
        raise RecordError(f"{error.filename or folder}: {error.strerror}") from error
    return list(files.values())


def export_npz(recording: Recording, out: str | Path, *, overwrite: bool = False) -> Path:
    """Write one NPZ file with the arrays of all topics.

    Parameters
    ----------
    recording : Recording
        The recording.
    out : str or Path
        The file.
    overwrite : bool, optional
        Whether an existing file may be replaced.

    Returns
    -------
    Path
        The file; its arrays are named ``topic.field``, e.g. ``device_state.position`` of shape (N, 3), in SI units.

    Raises
    ------
    RecordError
        When a message does not fit its type, the file exists already, or the disk is full.
    """
    import numpy as np

    arrays = {
        f"{name}.{field}": array
        for topic, name in plain_names(recording.topics).items()
        for field, array in recording.arrays(topic).items()
    }
    for name, array in arrays.items():
        if array.dtype.hasobject:
            raise RecordError(f"{recording.path}: {name} holds numbers beyond 64 bits, which NPZ cannot; export CSV")
    buffer = BytesIO()
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]  # the stub takes a keyword of numpy's for any name
    save(Path(out), buffer.getvalue(), overwrite)
    return Path(out)
