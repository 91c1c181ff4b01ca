"""A hand's path from a file, a table or a recording, in one axis or three."""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from messages.topics import DEVICE_STATE
from nodes.recording.foreign_table import is_export, read_foreign
from nodes.recording.import_words import LAUNCH_FILE, ImportWords, words
from nodes.recording.imported_samples import motion_of
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordError

if TYPE_CHECKING:
    import numpy as np

    Array = np.ndarray[Any, np.dtype[np.float64]]

OF_A_RECORDING = ("position", "target")
"""What of a recording's states may be a path."""


def read_path(
    file: str,
    columns: Mapping[str, str | Sequence[str]],
    units: Mapping[str, str],
    rate: float,
    in_words: ImportWords = LAUNCH_FILE,
) -> dict[str, list[tuple[float, float]]]:
    """Return the paths in a file, by axis.

    Parameters
    ----------
    file : str
        CSV, NPZ, MAT or Parquet file, or a recording.
    columns : mapping of str to str or sequence of str
        Columns of ``position`` (one or three) and ``time``; of a recording ``position: target``
        reads where its hand pulled to. Empty: those of the usual names.
    units : mapping of str to str
        Units of ``position`` and ``time``.
    rate : float
        Rows per second without a column of times [Hz]; 0: there is one.
    in_words : ImportWords
        How errors write these options.

    Returns
    -------
    dict of str to list of tuple of float
        Times [s], counted from the first row, and positions [m] of each axis; rows at rest between
        two equal ones are left out.

    Raises
    ------
    ValueError
        If the file is no such table, or its values make no sense; the text says what was probably
        meant.
    """
    path = Path(file).expanduser()
    try:
        stat = path.stat()
    except (OSError, ValueError) as error:
        raise ValueError(
            f"file {file!r}: {getattr(error, 'strerror', None) or error}"
        ) from error
    if not path.is_file() and not path.is_dir():
        raise ValueError(f"file {file!r}: is no regular file")
    key = tuple(
        (role, names if isinstance(names, str) else tuple(names))
        for role, names in columns.items()
    )
    before = words.set(in_words)
    try:
        return _read(
            path, stat.st_mtime_ns, stat.st_size, key, tuple(units.items()), rate
        )
    except RecordError as error:
        raise ValueError(str(error)) from error
    finally:
        words.reset(before)


@functools.lru_cache(maxsize=8)
def _read(
    path: Path,
    _changed: int,
    _size: int,
    columns: tuple[tuple[str, str | tuple[str, ...]], ...],
    units: tuple[tuple[str, str], ...],
    rate: float,
) -> dict[str, list[tuple[float, float]]]:
    """Read a file once for all that ask; a changed file is read again."""
    chosen = {
        role: [names] if isinstance(names, str) else names for role, names in columns
    }
    if path.suffix.lower() == ".mcap" or (path.is_dir() and not is_export(path)):
        time, position, axes = _of_recording(path, chosen, dict(units), rate)
    else:
        time, position, axes = motion_of(
            read_foreign(path), columns=chosen, units=dict(units), rate=rate or None
        )
    return {axis: corners(time, position[:, "xyz".index(axis)]) for axis in axes}


def _of_recording(
    path: Path,
    columns: Mapping[str, Sequence[str]],
    units: Mapping[str, str],
    rate: float,
) -> tuple[Array, Array, str]:
    import numpy as np

    field = columns.get("position", ["position"])[0]
    if units or rate or set(columns) - {"position"} or field not in OF_A_RECORDING:
        raise RecordError(
            f"{path}: of a recording only columns: {{position: NAME}} is chosen, one of"
            f" {', '.join(OF_A_RECORDING)}; it is in metres and seconds"
        )
    recording = Recording(path)
    recording.require_ticks()
    states = recording.messages(DEVICE_STATE)
    time = np.array([state.stamp for state in states])
    if len(time) < 2 or (np.diff(time) <= 0.0).any():
        raise RecordError(
            f"{path}: its stamps do not grow; cut one run of it with haptic bag cut"
        )
    position = np.array([getattr(state, field) for state in states])
    axes = "".join(axis for i, axis in enumerate("xyz") if np.ptp(position[:, i]) > 0.0)
    return time - time[0], position, axes or "x"


def corners(time: Array, position: Array) -> list[tuple[float, float]]:
    """Return the corners of a sampled path.

    Parameters
    ----------
    time : numpy.ndarray
        Increasing times [s], shape (N,).
    position : numpy.ndarray
        Positions [m], shape (N,).

    Returns
    -------
    list of tuple of float
        Every sample but those at rest between two equal ones, which change nothing.
    """
    import numpy as np

    same = np.diff(position) == 0.0
    kept = np.ones(len(position), dtype=bool)
    kept[1:-1] = ~(same[:-1] & same[1:])
    return list(zip(time[kept].tolist(), position[kept].tolist(), strict=True))
