"""Copy recordings: the file of a killed logger into a complete one, telling what was saved and lost; or a part of one.

Messages are copied as they stand, byte for byte. Chunks whose checksum does not match are left out and told; whatever is
damaged around them, all chunks that are sound are found.
"""

from __future__ import annotations

import contextlib
import math
import mmap
import struct
import zlib
from collections import deque
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from nodes.recording import mcap_walk
from nodes.recording.export import begin_of
from nodes.recording.mcap_walk import FRAME, Channel, RawMessage, Record, Schema
from nodes.recording.reader import RECOVERY, Recording
from nodes.recording.wall_clock import CLOCK, read_offsets
from nodes.recording.writer import RecordError, mcap_writer, written

T = TypeVar("T")

EXTRACT = "extract"  # name of the metadata record that tells which part of which file a part is
_U64 = struct.Struct("<Q")


class Recovered(msgspec.Struct):
    """What `recover` saved."""

    messages: dict[str, int]  # messages copied per topic
    # What was wrong with the source, with offsets; empty when it was complete and sound, so that nothing was lost.
    problems: list[str]


def _summary(data: mmap.mmap) -> Iterator[Record]:
    """Find the records of the summary from the footer at the end of the file; none when that is not sound either."""
    footer = len(data) - len(mcap_walk.MAGIC) - 20
    end = footer - FRAME.size
    if end < 0 or data[end:footer] != FRAME.pack(mcap_walk.FOOTER, 20):
        return
    (offset,) = struct.unpack_from("<Q", data, footer)
    if offset > end or not mcap_walk.footer_sound(data[footer : footer + 20], zlib.crc32(data[offset:end])):
        return
    while offset + FRAME.size <= end:
        opcode, length = FRAME.unpack_from(data, offset)
        start = offset + FRAME.size
        yield Record(offset, opcode, data[start : start + length])
        offset = start + length


def _search(path: Path) -> Iterator[Record]:
    """Find what is sound wherever it stands: the summary, then every chunk, by its header's pattern and its checksum."""
    mark = b"\x04\x00\x00\x00zstd"
    lead = FRAME.size + mcap_walk.CHUNK_HEAD.size
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        yield from _summary(data)
        at = data.find(mark, lead)
        while at >= 0:
            start, following = at - lead, at + 1
            body = at + len(mark) + _U64.size
            if data[start] == mcap_walk.CHUNK and body <= len(data):
                # Up to where its data end: the record's own length may be what is damaged, and stride over the next chunk.
                end = body + _U64.unpack_from(data, body - _U64.size)[0]
                if end <= len(data):
                    with contextlib.suppress(RecordError):
                        content = data[start + FRAME.size : end]
                        yield from mcap_walk.unpack_chunk(path, Record(start, mcap_walk.CHUNK, content))
                        following = end
            at = data.find(mark, following)


def _problems(path: Path) -> list[str]:
    """Tell all that is wrong with a file; nothing when it is complete and sound."""
    found = []
    try:
        for record in mcap_walk.walk(path):
            if record.opcode == mcap_walk.CHUNK:
                try:
                    deque(mcap_walk.unpack_chunk(path, record), maxlen=0)
                except RecordError as error:
                    found.append(str(error))
    except RecordError as error:
        found.append(str(error))
    return found


def _salvage(path: Path, sound: bool) -> Iterator[Record]:
    """Go through all that can be believed, chunks unpacked."""
    # In a file that is not sound, records outside chunks have no checksum; metadata are taken while the walk goes well.
    with contextlib.nullcontext() if sound else contextlib.suppress(RecordError):
        for record in mcap_walk.walk(path):
            if record.opcode == mcap_walk.CHUNK and sound:
                yield from mcap_walk.unpack_chunk(path, record)
            elif sound or record.opcode == mcap_walk.METADATA:
                yield record
    if not sound:
        yield from _search(path)


def _sound(parse: Callable[[Path, Record], T], path: Path, record: Record, problems: list[str]) -> T | None:
    """Parse a record; note a damaged one."""
    try:
        return parse(path, record)
    except RecordError as error:
        problems.append(str(error))
        return None


class Copy:
    """The file being written: registers schemas and channels anew, each when its first message comes."""

    def __init__(self, writer: Any, schemas: dict[int, Schema], channels: dict[int, Channel]) -> None:
        self.schemas = schemas
        self.channels = channels
        self.writer = writer
        self.counts: dict[str, int] = {}
        self.orphans = 0
        self._new_schemas: dict[int, int] = {}
        self._new_channels: dict[int, int] = {}

    def _register(self, channel: Channel) -> int:
        schema = self.schemas.get(channel.schema)
        if schema is not None and channel.schema not in self._new_schemas:
            self._new_schemas[channel.schema] = self.writer.register_schema(schema.name, schema.encoding, schema.data)
        number: int = self.writer.register_channel(channel.topic, channel.encoding, self._new_schemas.get(channel.schema, 0))
        return number

    def message(self, raw: RawMessage) -> None:
        """Copy a message."""
        channel = self.channels.get(raw.channel)
        if channel is None:
            self.orphans += 1
            return
        if raw.channel not in self._new_channels:
            self._new_channels[raw.channel] = self._register(channel)
        self.writer.add_message(self._new_channels[raw.channel], raw.log_time, raw.data, raw.publish_time, raw.sequence)
        self.counts[channel.topic] = self.counts.get(channel.topic, 0) + 1

    def metadata(self, name: str, values: dict[str, str], problems: list[str]) -> None:
        """Copy a metadata record, if it is sound."""
        if name == CLOCK:
            try:
                read_offsets(values)
            except ValueError as error:
                problems.append(f"{error}; times are those of the wall clock now")
                return
        self.writer.add_metadata(name, values)


def recover(path: str | Path, out: str | Path, *, overwrite: bool = False) -> Recovered:
    """Copy everything sound in a recording into a new, complete file."""
    path, out = Path(path), Path(out)
    problems = _problems(path)
    sound = not problems
    if not path.is_file() or not path.stat().st_size:
        raise RecordError(problems[0])
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    messages = 0
    # A first pass for the channels: where the chunk that registers one is lost, the summary may still name it.
    for record in _salvage(path, sound):
        if record.opcode == mcap_walk.SCHEMA and (schema := _sound(mcap_walk.parse_schema, path, record, problems)):
            schemas.setdefault(schema.number, schema)
        elif record.opcode == mcap_walk.CHANNEL and (channel := _sound(mcap_walk.parse_channel, path, record, problems)):
            channels.setdefault(channel.number, channel)
        messages += record.opcode == mcap_walk.MESSAGE
    if not messages:
        raise RecordError("; ".join([f"{path}: holds no message that could be saved", *problems]))
    if out.exists() and out.samefile(path):
        raise RecordError(f"{out}: is the recording itself; give another name")
    with written(out, overwrite) as output:
        copy = Copy(mcap_writer(output), schemas, channels)
        for record in _salvage(path, sound):
            if record.opcode == mcap_walk.MESSAGE and (raw := _sound(mcap_walk.parse_message, path, record, problems)):
                copy.message(raw)
            elif record.opcode == mcap_walk.METADATA and (metadata := _sound(mcap_walk.parse_metadata, path, record, problems)):
                copy.metadata(*metadata, problems)
        if copy.orphans:
            problems.append(f"{path}: {copy.orphans} messages on channels whose topic is not known any more")
        if problems:
            copy.writer.add_metadata(RECOVERY, {"source": str(path), "problems": "\n".join(problems)})
        copy.writer.finish()
    return Recovered(copy.counts, problems)


def extract(
    recording: Recording,
    out: Path,
    topics: Collection[str],
    start: float = 0.0,
    stop: float = math.inf,
    *,
    overwrite: bool = False,
) -> dict[str, int]:
    """Copy the messages of some topics whose stamps lie in a while, in seconds from the first tick on; how many of each."""
    if out.exists() and out.samefile(recording.path):
        raise RecordError(f"{out}: is the recording itself; give another name")
    zero = round(begin_of(recording) * 1e9)
    low, high = zero + round(start * 1e9), math.inf if math.isinf(stop) else zero + round(stop * 1e9)
    with written(out, overwrite) as output:
        copy = Copy(mcap_writer(output), recording.schemas, recording.channels)
        part = {"source": str(recording.path), "from_s": repr(start), "to_s": repr(stop)}
        for name, values in [*recording.metadata.items(), (EXTRACT, part)]:
            copy.writer.add_metadata(name, values)
        for topic, raw, _ in recording.raw():
            if topic in topics and low <= raw.publish_time - recording.publish_offset <= high:
                copy.message(raw)
        if not copy.counts:
            raise RecordError(f"{recording.path}: no message of these topics from {start:g} s to {stop:g} s")
        copy.writer.finish()
    return copy.counts
