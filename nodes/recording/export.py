"""Export a recording: a table of ticks, a table per topic, and the parameters of the run.

Formats: CSV for any program, NPZ for numpy, MAT for MATLAB and Octave, Parquet for pandas, polars
and databases.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack
from io import BytesIO
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from messages.schema import schema, unit_of
from messages.topics import DEVICE_STATE, split
from messages.types import Message
from nodes.recording.facts import DEEPEST, depth
from nodes.recording.reader import Recording, column_value
from nodes.recording.table import COLUMNS, VECTORS, Row, read, rows
from nodes.recording.writer import (
    LAUNCH_FILE,
    MANIFEST,
    PARAMETERS,
    VERSIONS,
    RecordError,
    discard,
    save,
)

if TYPE_CHECKING:
    import numpy as np

    Arrays = dict[str, np.ndarray[Any, Any]]

TICKS = "ticks"  # name of the table with one row per tick
_ROWS = 65536


def plain_names(topics: Iterable[str]) -> dict[str, str]:
    """Return names for topics that are valid file and variable names."""
    found: dict[str, str] = {}
    for topic in topics:
        plain = re.sub(r"[^A-Za-z0-9_]", "_", topic.strip("/"))[:55] or "topic"
        plain = plain if plain[0].isalpha() else f"t{plain}"
        name = plain
        number = 1
        while name in (TICKS, "parameters", *found.values()):
            number += 1
            name = f"{plain}_{number}"
        found[topic] = name
    return found


def columns(message_type: type[Message]) -> list[str]:
    """Return the column names of a topic's table, with units."""
    found = ["time [s]", "log_time [s]"]
    for name, field in schema(message_type)["properties"].items():
        unit = unit_of(field.get("description", ""))
        suffix = f" [{unit}]" if unit else ""
        # A vector is x, y and z; a handle's orientation has a w.
        parts = (
            [f"{name}_{part}" for part in "xyzw"[: field["maxItems"]]]
            if field["type"] == "array"
            else [name]
        )
        found += [part + suffix for part in parts]
    return found


def parameters(recording: Recording) -> dict[str, Any]:
    """Return run, parameters, launch file, versions and the meaning of the columns."""

    def parsed(text: str) -> Any:
        try:
            found = json.loads(text)
        except (ValueError, RecursionError):
            return text
        return found if depth(found) <= DEEPEST else text

    metadata = recording.metadata
    return {
        "recording": recording.path.name,
        "manifest": metadata.get(MANIFEST, {}),
        "parameters": {
            node: parsed(text) for node, text in metadata.get(PARAMETERS, {}).items()
        },
        "launch_file": metadata.get(LAUNCH_FILE, {}).get("yaml", ""),
        "versions": metadata.get(VERSIONS, {}),
        "columns": {
            name: {"unit": unit, "meaning": meaning}
            for name, (unit, meaning, _) in COLUMNS.items()
        },
    }


def _flat(values: Iterable[Any]) -> Iterator[Any]:
    for value in values:
        if isinstance(value, tuple):
            yield from value
        else:
            yield int(value) if isinstance(value, bool) else column_value(value)


def begin_of(recording: Recording) -> float:
    """Return the stamp of the first tick of any chain, or else of the first message [s]."""
    ticks = [
        figures
        for topic, figures in recording.topics.items()
        if split(topic)[1] == DEVICE_STATE
    ]
    if not recording.topics:
        # Only topics of other programs: their first message.
        first = min(
            (one.first_publish for one in recording.foreign.values()), default=0
        )
        return (first - recording.publish_offset) / 1e9
    return min(figures.first_stamp for figures in ticks or recording.topics.values())


def _tick_names() -> list[str]:
    """Return the column names of the table of ticks, one per number."""
    return [
        f"{part}{f' [{unit}]' if unit else ''}"
        for name, (unit, _, _) in COLUMNS.items()
        for part in (
            [f"{name}_{axis}" for axis in "xyz"] if name in VECTORS else [name]
        )
    ]


def _tick(row: Row, begin: float) -> list[Any]:
    values = list(_flat(value(row) for _, _, value in COLUMNS.values()))
    values[0] -= begin
    return values


def export_csv(
    recording: Recording, out: str | Path, *, overwrite: bool = False
) -> list[Path]:
    """Write a CSV file with a row per tick, one per topic, and the parameters as JSON.

    An `out` that ends in ``.csv`` is the file of the ticks alone, with the parameters beside it.
    """
    folder = Path(out)
    if folder.suffix.lower() == ".csv":
        return _export_ticks(recording, folder, overwrite=overwrite)
    files = {
        topic: folder / f"{name}.csv"
        for topic, name in plain_names(recording.topics).items()
    }
    made = list(files.values())
    mode = "w" if overwrite else "x"
    begin = begin_of(recording)
    writers: dict[str, Any] = {}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ExitStack() as stack:
            for entry in recording.entries():
                writer = writers.get(entry.topic)
                if writer is None:
                    stream = stack.enter_context(
                        files[entry.topic].open(mode, newline="", encoding="utf-8")
                    )
                    writer = writers[entry.topic] = csv.writer(stream)
                    writer.writerow(columns(type(entry.message)))
                values = _flat(msgspec.structs.astuple(entry.message))
                writer.writerow((entry.message.stamp - begin, entry.log_time, *values))
        if DEVICE_STATE in recording.topics:
            made.insert(0, folder / f"{TICKS}.csv")
            with made[0].open(mode, newline="", encoding="utf-8") as stream:
                writer = csv.writer(stream)
                writer.writerow(_tick_names())
                writer.writerows(_tick(row, begin) for row in rows(recording))
    except OSError as error:
        raise RecordError(f"{error.filename or folder}: {error.strerror}") from error
    return [*made, _save_parameters(recording, folder / "parameters.json", overwrite)]


def _export_ticks(recording: Recording, out: Path, *, overwrite: bool) -> list[Path]:
    """Write the table of ticks into one file."""
    if not overwrite:
        _refuse_existing(recording, out)
    recording.require_ticks()
    begin = begin_of(recording)
    try:
        with out.open(
            "w" if overwrite else "x", newline="", encoding="utf-8"
        ) as stream:
            writer = csv.writer(stream)
            writer.writerow(_tick_names())
            writer.writerows(_tick(row, begin) for row in rows(recording))
    except OSError as error:
        raise RecordError(f"{out}: {error.strerror}") from error
    except RecordError:
        discard(out)
        raise
    return [out, _save_parameters(recording, _beside(out), overwrite)]


def _save_parameters(recording: Recording, path: Path, overwrite: bool) -> Path:
    if not _stand(recording, path):
        save(path, _text(recording), overwrite)
    return path


def _text(recording: Recording) -> bytes:
    return (
        json.dumps(parameters(recording), indent=2, ensure_ascii=False).encode() + b"\n"
    )


def _stand(recording: Recording, path: Path) -> bool:
    """Whether the parameter file is already this recording's; formats share the file."""
    try:
        return path.read_bytes() == _text(recording)
    except OSError:
        return False


def _beside(out: Path) -> Path:
    return out.with_name(f"{out.stem}.parameters.json")


def _refuse_existing(recording: Recording, out: Path) -> None:
    for path in (out, _beside(out)):
        if path.exists() and (path == out or not _stand(recording, path)):
            raise RecordError(
                f"{path}: already exists; choose another name or ask to overwrite it"
            )


def _tables(recording: Recording) -> dict[str, Arrays]:
    """Return all tables as arrays, by name; times start at the first tick."""
    found: dict[str, Arrays] = (
        {TICKS: read(recording.path)} if DEVICE_STATE in recording.topics else {}
    )
    for topic, name in plain_names(recording.topics).items():
        arrays = recording.arrays(topic)
        found[name] = {"time": arrays["stamp"] - begin_of(recording), **arrays}
    for table, arrays in found.items():
        for field, array in arrays.items():
            if array.dtype.hasobject:
                what = (
                    f"{table}.{field} holds numbers beyond 64 bits,"
                    " which arrays cannot; export CSV"
                )
                raise RecordError(f"{recording.path}: {what}")
    return found


def export_npz(
    recording: Recording, out: str | Path, *, overwrite: bool = False
) -> list[Path]:
    """Write an NPZ file with the arrays of ticks and topics, and the parameters as JSON."""
    import numpy as np

    arrays = {
        f"{name}.{field}": array
        for name, table in _tables(recording).items()
        for field, array in table.items()
    }
    buffer = BytesIO()
    # The stub reads every array's name as a keyword of numpy's own.
    np.savez_compressed(buffer, **arrays)  # type: ignore[arg-type]
    return _save_with_parameters(recording, Path(out), buffer.getvalue(), overwrite)


def _save_with_parameters(
    recording: Recording, out: Path, data: bytes, overwrite: bool
) -> list[Path]:
    if not overwrite:
        _refuse_existing(recording, out)
    save(out, data, overwrite)
    return [out, _save_parameters(recording, _beside(out), overwrite)]


def export_mat(
    recording: Recording, out: str | Path, *, overwrite: bool = False
) -> list[Path]:
    """Write a MAT file (version 5) for MATLAB and Octave.

    Arrays such as ``run.ticks.time`` and ``run.ticks.position`` are columns.
    """
    from scipy.io import savemat
    from scipy.io.matlab import MatWriteError

    tables: dict[str, Any] = {
        name: {
            field: array.astype(object) if array.dtype.kind == "U" else array
            for field, array in table.items()
        }
        for name, table in _tables(recording).items()
    }
    tables["parameters"] = json.dumps(parameters(recording), ensure_ascii=False)
    # Any: the stub accepts paths only.
    buffer: Any = BytesIO()
    try:
        savemat(
            buffer, tables, oned_as="column", long_field_names=True, do_compression=True
        )
    except (MatWriteError, ValueError) as error:
        raise RecordError(f"{out}: cannot be written as MAT: {error}") from error
    return _save_with_parameters(recording, Path(out), buffer.getvalue(), overwrite)


def export_parquet(
    recording: Recording, out: str | Path, *, overwrite: bool = False
) -> list[Path]:
    """Write the table of ticks as Parquet, in blocks of bounded memory.

    Needs pyarrow: ``pip install 'haptic-nodes[parquet]'``.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError as error:
        raise RecordError(
            "Parquet needs pyarrow: pip install 'haptic-nodes[parquet]', or export CSV"
        ) from error
    out = Path(out)
    if not overwrite:
        _refuse_existing(recording, out)
    begin = begin_of(recording)
    types = {"law": pa.string(), "safety": pa.string(), "contact": pa.int8()}
    types |= dict.fromkeys(
        ("seq", "force_seq", "revision", "age", "missed", "overruns"), pa.int64()
    )
    fields = []
    for column in _tick_names():
        name, _, unit = column.partition(" ")
        fields.append(
            pa.field(
                name, types.get(name, pa.float64()), metadata={"unit": unit.strip("[]")}
            )
        )
    layout = pa.schema(
        fields, metadata={"parameters": json.dumps(parameters(recording))}
    )
    ticks = (_tick(row, begin) for row in rows(recording))
    try:
        with parquet.ParquetWriter(out, layout, compression="zstd") as writer:
            while block := list(islice(ticks, _ROWS)):
                arrays = [
                    pa.array(values, field.type)
                    for values, field in zip(
                        zip(*block, strict=True), layout, strict=True
                    )
                ]
                writer.write_table(pa.table(arrays, schema=layout))
    except OSError as error:
        discard(out)
        raise RecordError(f"{out}: {error}") from error
    except RecordError:
        discard(out)
        raise
    return [out, _save_parameters(recording, _beside(out), overwrite)]


FORMATS: dict[str, Callable[..., list[Path]]] = {  # export function of each format
    "csv": export_csv,
    "npz": export_npz,
    "mat": export_mat,
    "parquet": export_parquet,
}
