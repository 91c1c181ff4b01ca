"""Import a table of another program as a recording: a state per row, and its origin.

A row holds the force handed over at its tick, held until the next, as in our own exports; a state
reports the tick before it. Of our own exports every column of a tick returns.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from messages.topics import DEVICE_STATE, FORCE, PROXY
from messages.types import DeviceState, Force, Message, Proxy
from nodes.recording.bag_table import bag_of, read_bag
from nodes.recording.foreign_table import ForeignTable, read_foreign
from nodes.recording.imported_columns import is_own
from nodes.recording.imported_samples import ImportedSamples, samples_of
from nodes.recording.writer import IMPORTED_COLUMNS, RecordError, RecordWriter, discard

_NOW = ("lateness", "energy", "guard")  # numbers of a tick that its own state reports
_LATER = ("changed_at", "response", "delay")  # numbers that the next state reports


@dataclass(frozen=True)
class Imported:
    """What was imported.

    Attributes
    ----------
    path : Path
        The recording.
    samples : ImportedSamples
        What it holds.
    """

    path: Path
    samples: ImportedSamples

    @property
    def text(self) -> str:
        """Return what was read from which column, for a person."""
        found = self.samples
        gaps = int(found.seq[-1] - found.seq[0]) + 1 - len(found.seq)
        lines = [
            f"{self.path}: {len(found.seq)} ticks at {1.0 / found.period:.6g} Hz, axes"
            f" {', '.join(found.axes)}"
            + (f", {gaps} ticks missing in gaps" if gaps else "")
        ]
        lines += [f"  {role:8} {source}" for role, source in found.sources.items()]
        if found.force is None:
            lines.append("  force    none: no column of forces; zero in the recording")
        return "\n".join(lines)


def import_table(
    file: str | Path,
    out: str | Path,
    *,
    columns: Mapping[str, Sequence[str]] | None = None,
    units: Mapping[str, str] | None = None,
    rate: float | None = None,
    axis: str | None = None,
    ignore_times: bool = False,
    decimal_comma: bool = False,
    overwrite: bool = False,
) -> Imported:
    """Write a table as a recording.

    Parameters
    ----------
    file : str or Path
        CSV, NPZ, MAT or Parquet file, the directory of a CSV export, or a ROS bag.
    out : str or Path
        The recording to write.
    columns : mapping of str to sequence of str, optional
        Columns of ``position``, ``force`` and ``time``; by default those of the usual names.
    units : mapping of str to str, optional
        Units of ``position``, ``force`` and ``time``; by default those in the names, else SI.
    rate : float, optional
        Sampling rate [Hz]; needed without a column of times.
    axis : str, optional
        Axis of a single column of positions.
    ignore_times : bool
        Whether each row is a tick at `rate`, whatever a column of times says.
    decimal_comma : bool
        Whether a text file writes 0,5 for 0.5.
    overwrite : bool
        Whether an existing recording is replaced.

    Returns
    -------
    Imported
        The recording and what it holds.

    Raises
    ------
    RecordError
        If the file is no such table or its values make no sense; the text names place and remedy.
    """
    out = Path(out)
    bag = bag_of(Path(file))
    source = bag or Path(file)
    of_source = source.iterdir() if source.is_dir() else [source]
    if out.exists() and any(out.samefile(one) for one in of_source if one.exists()):
        raise RecordError(f"{out}: is what is imported; write elsewhere with --out")
    if bag is not None:
        table, columns = read_bag(bag, columns or {})
    else:
        table = read_foreign(Path(file), decimal_comma=decimal_comma)
    samples = samples_of(
        table,
        columns=columns,
        units=units,
        rate=rate,
        axis=axis,
        ignore_times=ignore_times,
    )
    with RecordWriter(out, _manifest(table, samples), overwrite=overwrite) as writer:
        try:
            for topic, message in _messages(table, samples):
                writer.write(topic, message, message.stamp)
        except BaseException:
            discard(out)
            raise
    return Imported(out, samples)


def _manifest(table: ForeignTable, samples: ImportedSamples) -> dict[str, str]:
    path = table.path
    return {
        "scenario": path.stem,
        "run": path.stem,
        "pace": "imported",
        "rate_hz": repr(round(1.0 / samples.period, 9)),
        "axes": ",".join(samples.axes),
        "imported": str(path),
        "imported_sha256": _digest(path),
        IMPORTED_COLUMNS: json.dumps(samples.sources, ensure_ascii=False),
    }


def _digest(path: Path) -> str:
    """Return the SHA-256 of a file, or of all files of a folder one after the other."""
    digest = hashlib.sha256()
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        digest.update(file.read_bytes() if file.is_file() else b"")
    return digest.hexdigest()


def _messages(
    table: ForeignTable, samples: ImportedSamples
) -> Iterator[tuple[str, Message]]:
    if is_own(table):
        yield from _own_messages(table, samples)
        return
    energy = 0.0
    before = (0.0, 0.0, 0.0)
    seqs = samples.seq.tolist()
    stamps = samples.stamp.tolist()
    positions = samples.position.tolist()
    forces = None if samples.force is None else samples.force.tolist()
    for row, position in enumerate(positions):
        if row:
            moved = zip(before, position, positions[row - 1], strict=True)
            energy += math.fsum(f * (x - was) for f, x, was in moved)
        yield (
            DEVICE_STATE,
            DeviceState(
                seq=seqs[row],
                stamp=stamps[row],
                position=tuple(position),
                force=before,
                mean_force=before,
                force_seq=seqs[row - 1] if row and forces else -1,
                energy=energy,
            ),
        )
        before = before if forces is None else tuple(forces[row])


def _own_messages(
    table: ForeignTable, samples: ImportedSamples
) -> Iterator[tuple[str, Message]]:
    """Yield the messages of an export; columns that it lacks have their defaults."""
    rows = _Rows(table)
    safety = table.columns.get("safety")
    law = table.columns.get("law")
    seqs = samples.seq.tolist()
    held: dict[str, Any] = {}
    for row, (seq, stamp, position) in enumerate(
        zip(seqs, samples.stamp.tolist(), samples.position.tolist(), strict=True)
    ):
        common: dict[str, Any] = {
            "seq": seq,
            "stamp": stamp,
            "position": tuple(position),
        }
        now: dict[str, Any] = {name: rows.number(name, row) for name in _NOW}
        counts: dict[str, Any] = {
            name: int(rows.number(name, row)) for name in ("missed", "overruns")
        }
        yield (
            DEVICE_STATE,
            DeviceState(
                **common,
                **held,
                **now,
                **counts,
                target=rows.vector("target", row) or (0.0, 0.0, 0.0),
                safety=str(safety[row]) if safety is not None else "active",
            ),
        )
        if (proxy := rows.vector("proxy", row)) is not None:
            yield (
                PROXY,
                Proxy(
                    **common,
                    proxy=proxy,
                    normal=rows.vector("normal", row) or (0.0, 0.0, 0.0),
                    distance=rows.number("distance", row),
                    contact=bool(rows.number("contact", row)),
                ),
            )
        if (asked := rows.vector("force_asked", row)) is not None:
            yield (
                FORCE,
                Force(
                    seq=seq,
                    stamp=stamp,
                    force=asked,
                    law=str(law[row]) if law is not None else "",
                    revision=max(int(rows.number("revision", row)), 0),
                ),
            )
        # Where the next state was not recorded, the table says nothing: what was held remains.
        if (force := rows.vector("force", row)) is not None:
            held = {
                "force": force,
                "mean_force": rows.vector("mean_force", row) or force,
                "force_seq": int(rows.number("force_seq", row)),
                "age": max(int(rows.number("age", row)), 0),
                **{name: rows.number(name, row) for name in _LATER},
            }


class _Rows:
    """Numbers and vectors of a table by row."""

    def __init__(self, table: ForeignTable) -> None:
        self._table = table
        self._read: dict[str, list[float]] = {}

    def number(self, name: str, row: int) -> float:
        """Return a number; 0 where the table has none."""
        if name not in self._read:
            self._read[name] = (
                self._table.numbers(name).tolist()
                if name in self._table.columns
                else []
            )
        value = self._read[name][row] if self._read[name] else 0.0
        return value if math.isfinite(value) else 0.0

    def vector(self, name: str, row: int) -> tuple[float, float, float] | None:
        """Return a vector; None where the table has none."""
        parts = []
        for axis in "xyz":
            column = f"{name}_{axis}"
            self.number(column, row)
            if not self._read[column] or not math.isfinite(self._read[column][row]):
                return None
            parts.append(float(self._read[column][row]))
        return parts[0], parts[1], parts[2]
