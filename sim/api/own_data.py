"""Read tables of other programs as recordings; identify the device of arrays."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from messages.errors import HapticError, RefusedError, UsageError
from nodes.recording.bag_table import bag_of
from nodes.recording.facts import FASTEST, SLOWEST
from nodes.recording.foreign_table import ForeignTable, is_export
from nodes.recording.import_table import import_table
from nodes.recording.import_words import HAND_IN_PYTHON, PYTHON, words
from nodes.recording.imported_samples import refuse_unlikely
from nodes.recording.reader import Recording
from nodes.recording.writer import RecordError

if TYPE_CHECKING:
    from sim.studies.identify import IdentifiedRecording

ARRAYS = Path("arrays")  # what a result of arrays names as its recording
IMPORT_OPTIONS = ("columns", "units", "rate", "ignore_times", "decimal_comma")


@contextmanager
def as_recording(
    file: str | Path,
    *,
    columns: Mapping[str, str | Sequence[str]] | None = None,
    units: str | Mapping[str, str | float] | None = None,
    rate: float | None = None,
    axis: str | None = None,
    ignore_times: bool = False,
    decimal_comma: bool = False,
) -> Iterator[Path]:
    """Yield the path of a recording: the file, or a table imported meanwhile.

    Parameters
    ----------
    file : str or Path
        An MCAP file, or a table.
    columns, units, rate, axis, ignore_times, decimal_comma : optional
        Of a table, as of `nodes.recording.import_table.import_table`; one column and the unit of
        positions may be a text.

    Yields
    ------
    Path
        The recording; an imported one exists inside the block only.

    Raises
    ------
    UsageError
        If a recording comes with options of a table.
    nodes.recording.writer.RecordError
        If the file is no such table.
    """
    path = Path(file)
    bag = bag_of(path)
    is_foreign = bag is not None and _is_foreign(bag)
    if bag is not None and is_foreign:
        path = bag  # of which a file may be named
    of_table = {
        "columns": columns,
        "units": units,
        "rate": rate,
        "ignore_times": ignore_times,
        "decimal_comma": decimal_comma,
    }
    is_folder = path.is_dir() and not is_export(path)
    is_recording = is_folder or path.suffix.lower() == ".mcap" or is_mcap(path)
    if not path.exists() or (is_recording and not is_foreign):
        given = [name for name, value in of_table.items() if value]
        if given and path.exists():
            raise UsageError(f"{path}: is no table; {', '.join(given)} are of tables")
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="haptic-import-") as folder:
        out = Path(folder) / f"{path.stem}.mcap"
        before = words.set(PYTHON)
        try:
            import_table(
                path,
                out,
                columns=_columns(columns),
                units=_units(units),
                rate=rate,
                axis=axis,
                ignore_times=ignore_times,
                decimal_comma=decimal_comma,
            )
        finally:
            words.reset(before)
        try:
            yield out
        except HapticError as error:
            # The recording is gone when the error is read.
            error.args = tuple(
                one.replace(str(out), str(path)) if isinstance(one, str) else one
                for one in error.args
            )
            raise


def _is_foreign(bag: Path) -> bool:
    """Whether a ROS bag has no message of ours."""
    try:
        return not Recording(bag).topics
    except RecordError:
        return True  # SQLite, or several files


def is_mcap(path: Path) -> bool:
    """Whether a file begins as an MCAP file does."""
    if not path.is_file():
        return False
    with path.open("rb") as stream:
        return stream.read(5) == b"\x89MCAP"


def _columns(
    columns: Mapping[str, str | Sequence[str]] | None,
) -> dict[str, Sequence[str]]:
    return {
        role: names.split(":") if isinstance(names, str) else names
        for role, names in (columns or {}).items()
    }


def _units(units: str | Mapping[str, str | float] | None) -> dict[str, str]:
    named = {"position": units} if isinstance(units, str) else units or {}
    return {role: str(unit) for role, unit in named.items()}


def identify_arrays(
    position: ArrayLike,
    force: ArrayLike,
    rate: float,
    *,
    delay: float = 0.0,
    axis: str | None = None,
    held: bool | None = None,
    window: int = 100,
) -> IdentifiedRecording:
    """Identify the device whose position answered a force.

    Parameters
    ----------
    position : array_like, shape (N,) or (N, 3)
        Position sampled at each tick [m].
    force : array_like, shape (N,) or (N, 3)
        Force handed over for each tick, held until the next [N].
    rate : float
        Sampling rate [Hz].
    delay : float
        Time from each sample until its force was handed over [ticks].
    axis : str, optional
        Which axis; by default the one that was pushed hardest.
    held : bool, optional
        Whether a hand held the device; by default this is found out.
    window : int
        Length of a window [ticks].

    Returns
    -------
    IdentifiedRecording
        Mass, damping, friction, delay and encoder, each with its 95 % interval.

    Raises
    ------
    UsageError
        If the arrays do not fit each other, hold no numbers, or are in another unit.
    RefusedError
        If they identify nothing.
    """
    from sim.identify.experiment import SHORTEST, lockstep
    from sim.identify.identify import identify
    from sim.studies.identify import IdentifiedRecording

    where, pushed = _checked("position", position), _checked("force", force)
    if where.shape != pushed.shape:
        raise UsageError(
            f"position has the shape {where.shape}, force {pushed.shape}; they need the same: (N,)"
            " or (N, 3)"
        )
    if not SLOWEST <= rate <= FASTEST:
        raise UsageError(f"rate {rate:g} Hz; expected {SLOWEST:g} to {FASTEST:g} Hz")
    if axis not in (None, "x", "y", "z"):
        raise UsageError(f"axis {axis!r}; expected x, y or z")
    if not 0.0 <= delay < SHORTEST:
        raise UsageError(f"delay {delay:g} ticks; expected 0 to {SHORTEST}")
    if len(where) < SHORTEST:
        raise RefusedError(f"{len(where)} samples; at least {SHORTEST} are needed")
    _refuse_unlikely(where, pushed)
    if where.ndim == 2:
        axis = axis or "xyz"[int(np.argmax(np.std(pushed, axis=0)))]
        where, pushed = where[:, "xyz".index(axis)], pushed[:, "xyz".index(axis)]
    try:
        found = identify(
            lockstep(1.0 / rate, where, pushed, delay, axis or "x"), held, window
        )
    except ValueError as error:
        raise RefusedError(str(error)) from error
    return IdentifiedRecording(ARRAYS, found)


def hand_path(
    position: ArrayLike | str | Path,
    *,
    rate: float | None = None,
    time: ArrayLike | None = None,
    columns: Mapping[str, str | Sequence[str]] | None = None,
    units: str | Mapping[str, str | float] | None = None,
) -> dict[str, Any]:
    """Return an array or a file as the path of a virtual device's hand.

    Parameters
    ----------
    position : array_like, shape (N,) or (N, 3), str or Path
        Points to which the hand pulls [m], or a CSV, NPZ, MAT or Parquet file, or a recording,
        with a column of them.
    rate : float, optional
        Points per second [Hz]; of a file, if it has no column of times.
    time : array_like, shape (N,), optional
        In place of `rate`: increasing times [s], counted from the first.
    columns, units : mapping, optional
        Of a file: as of `read`, e.g. ``columns={"position": "x", "time": "t"}``, ``units="mm"``.

    Returns
    -------
    dict
        ``path`` for a driver's ``device.hand.path``: times [s] and positions [m] of its corners. Of
        three columns it is that of x, and ``axes``, for ``device.axes``, has those of y and z.

    Raises
    ------
    UsageError
        If the arrays do not fit each other, hold no numbers, or are in another unit, or the file
        holds no path.

    Examples
    --------
    >>> hand = hand_path([0.0, 0.01, 0.0], rate=2)
    >>> hand
    {'path': [[0.0, 0.0], [0.5, 0.01], [1.0, 0.0]]}

    A launch takes it, or of three columns ``{"hand": {"path": …}, "axes": …}``:

    >>> from sim.api.played import play
    >>> play("wall_press", duration=0.1, params={"driver": {"device": {"hand": hand}}}).axes
    'x'
    """
    from sim.device.hand_path import corners, read_path

    if isinstance(position, str | Path):
        if time is not None:
            raise UsageError(
                "hand_path: times of a file are a column of it; name it in columns"
            )
        try:
            found = read_path(
                str(position),
                _columns(columns),
                _units(units),
                rate or 0.0,
                HAND_IN_PYTHON,
            )
        except ValueError as error:
            raise UsageError(f"hand_path: {error}") from None
        return _as_hand([[list(corner) for corner in path] for path in found.values()])
    if columns or units:
        raise UsageError(
            "hand_path: columns and units are of a file, but an array is given"
        )
    where = _checked("position", position)
    if (rate is None) == (time is None):
        given = "needs rate or time" if rate is None else "takes rate or time, not both"
        raise UsageError(f"hand_path: {given}")
    if time is None:
        if not isinstance(rate, Real):
            raise UsageError(f"rate {rate!r} is no number of points per second")
        if not SLOWEST <= rate <= FASTEST:
            raise UsageError(
                f"rate {rate:g} Hz; expected {SLOWEST:g} to {FASTEST:g} Hz"
            )
        at = np.arange(len(where)) / rate
    else:
        at = _checked("time", time)
        at = at - at[0] if at.size else at
    if at.shape != where.shape[:1]:
        raise UsageError(
            f"{at.size} times and {len(where)} positions; they need the same number"
        )
    if (back := np.flatnonzero(np.diff(at) <= 0.0)).size:
        raise UsageError(f"time[{back[0] + 1}] does not grow")
    _refuse_unlikely(where, None)
    paths = [
        [list(corner) for corner in corners(at, column)]
        for column in (where.T if where.ndim == 2 else [where])
    ]
    return _as_hand(paths)


def _as_hand(paths: Sequence[list[list[float]]]) -> dict[str, Any]:
    """Return paths along x, or along x, y and z, as fields of a device's hand."""
    if len(paths) == 1:
        return {"path": paths[0]}
    own = {
        axis: {"hand": {"path": path}}
        for axis, path in zip("yz", paths[1:], strict=True)
    }
    return {"path": paths[0], "axes": own}


def _refuse_unlikely(
    position: NDArray[np.float64], force: NDArray[np.float64] | None
) -> None:
    """Raise UsageError for arrays of values that no device reaches: they have no units."""
    try:
        refuse_unlikely(ForeignTable(ARRAYS, {}), position, force)
    except RecordError as error:
        raise UsageError(f"{error.fault}; arrays are in metres and newtons") from None


def _checked(name: str, values: ArrayLike) -> NDArray[np.float64]:
    try:
        found = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name}: {error}") from error
    if found.ndim not in (1, 2) or (found.ndim == 2 and found.shape[1] != 3):
        raise UsageError(f"{name} has the shape {found.shape}; expected (N,) or (N, 3)")
    if not np.isfinite(found).all():
        bad = np.argwhere(~np.isfinite(found))[0].tolist()
        raise UsageError(f"{name}{bad} is no finite number; cut the data there")
    return found
