"""Copy a recording: recover the file of a killed logger, or extract a part.

Messages are copied byte for byte. Chunks whose checksum does not match are left out and reported;
every sound chunk is found, whatever is damaged around it.
"""

from __future__ import annotations

import contextlib
import math
import mmap
import struct
import zlib
from collections import deque
from collections.abc import Callable, Collection, Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from messages.topics import within
from nodes.recording import mcap_walk
from nodes.recording.export import begin_of
from nodes.recording.foreign_channels import file_of
from nodes.recording.mcap_walk import FRAME, Channel, RawMessage, Record, Schema
from nodes.recording.parts import parts_of
from nodes.recording.reader import EXTRACT, RECOVERY, WITHOUT, Recording
from nodes.recording.wall_clock import CLOCK, LATEST_NS, read_offsets
from nodes.recording.writer import RecordError, mcap_writer, written

T = TypeVar("T")

_U64 = struct.Struct("<Q")
REJECTED = 1 << 16  # work charged for a false chunk [bytes]


class Recovered(msgspec.Struct):
    """Result of `recover`."""

    messages: dict[str, int]  # messages copied per topic
    # What was wrong with the source, with offsets; empty if it was complete and sound.
    problems: list[str]


def _summary(data: mmap.mmap) -> Iterator[Record]:
    """Yield the records of the summary if the footer at the end of the file is sound."""
    footer = len(data) - len(mcap_walk.MAGIC) - 20
    end = footer - FRAME.size
    if end < 0 or data[end:footer] != FRAME.pack(mcap_walk.FOOTER, 20):
        return
    (offset,) = struct.unpack_from("<Q", data, footer)
    if offset > end or not mcap_walk.footer_sound(
        data[footer : footer + 20], zlib.crc32(data[offset:end])
    ):
        return
    while offset + FRAME.size <= end:
        opcode, length = FRAME.unpack_from(data, offset)
        start = offset + FRAME.size
        yield Record(offset, opcode, data[start : start + length])
        offset = start + length


class _Budget:
    """Limits the work spent on false chunks, so that a small file cannot cost minutes."""

    def __init__(self, size: int) -> None:
        # Twice what any recording unpacks to [bytes].
        self._left = 32 * size + 16 * mcap_walk.MAX_CHUNK

    def spend(self, work: int) -> bool:
        """Subtract `work` from the budget [bytes]; return False once it is exhausted."""
        self._left -= work
        return self._left >= 0


def _search(path: Path) -> Iterator[Record]:
    """Yield the sound records of a damaged file: its summary, and chunks with valid checksum."""
    mark = b"\x04\x00\x00\x00zstd"
    lead = FRAME.size + mcap_walk.CHUNK_HEAD.size
    with (
        path.open("rb") as stream,
        mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data,
        memoryview(data) as view,
    ):
        yield from _summary(data)
        budget = _Budget(len(data))
        at = data.find(mark, lead)
        while at >= 0:
            # The opcode may be damaged too; the content has a checksum.
            start = at - lead
            following = at + 1
            content = _chunk_at(view, start, budget)
            if content is None:
                return
            with contextlib.suppress(RecordError):
                yield from mcap_walk.unpack_chunk(
                    path, Record(start, mcap_walk.CHUNK, content)
                )
                following = start + FRAME.size + len(content)
            at = data.find(mark, following)


def _chunk_at(view: memoryview, start: int, budget: _Budget) -> bytes | None:
    """Return what may be a chunk; empty if it is none, None once the budget is spent.

    The lengths are computed from the packed data, because the stored ones may be damaged and skip
    the next chunk.
    """
    head = start + FRAME.size
    body = head + mcap_walk.CHUNK_HEAD.size + 8 + _U64.size
    (size,) = _U64.unpack_from(view, head + 2 * _U64.size)
    if size > mcap_walk.MAX_CHUNK:
        return b""
    # Incompressible data is stored as is, plus some bytes for each block.
    with view[body : body + size + size // 64 + 64] as packed:
        try:
            length = mcap_walk.frame_length(packed)
        except ValueError:
            return b"" if budget.spend(REJECTED) else None
    if not budget.spend(length + size):
        return None
    return (
        bytes(view[head : body - _U64.size])
        + _U64.pack(length)
        + bytes(view[body : body + length])
    )


def _problems(path: Path) -> list[str]:
    """Return everything wrong with a file; empty if it is complete and sound."""
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
    """Yield all trustworthy records of a file, chunks unpacked."""
    # Records outside chunks have no checksum. Of a damaged file, only metadata before the damage
    # is used.
    with contextlib.nullcontext() if sound else contextlib.suppress(RecordError):
        for record in mcap_walk.walk(path):
            if record.opcode == mcap_walk.CHUNK and sound:
                yield from mcap_walk.unpack_chunk(path, record)
            elif sound or record.opcode == mcap_walk.METADATA:
                yield record
    if not sound:
        yield from _search(path)


def _sound(
    parse: Callable[[Path, Record], T], path: Path, record: Record, problems: list[str]
) -> T | None:
    """Parse a record; on damage, append the error to `problems` and return None."""
    try:
        return parse(path, record)
    except RecordError as error:
        problems.append(str(error))
        return None


class Copy:
    """The output file; registers each schema and channel with its first message."""

    def __init__(
        self, writer: Any, schemas: dict[int, Schema], channels: dict[int, Channel]
    ) -> None:
        self.writer = writer
        self.counts: dict[str, int] = {}
        self.orphans = 0
        # Metadata names written so far, and the first part's clock offsets (log, publish) [ns].
        self._told: set[str] = set()
        self._clock: tuple[int, int] | None = None
        self.enter(schemas, channels)

    def enter(self, schemas: dict[int, Schema], channels: dict[int, Channel]) -> None:
        """Start a part, which has its own channel and schema numbers."""
        self.schemas, self.channels = schemas, channels
        self._new_schemas: dict[int, int] = {}
        self._new_channels: dict[int, int] = {}
        self._earlier = frozenset(self._told)
        self._shift = (0, 0)

    def _register(self, channel: Channel) -> int:
        schema = self.schemas.get(channel.schema)
        if schema is not None and channel.schema not in self._new_schemas:
            self._new_schemas[channel.schema] = self.writer.register_schema(
                schema.name, schema.encoding, schema.data
            )
        number: int = self.writer.register_channel(
            channel.topic, channel.encoding, self._new_schemas.get(channel.schema, 0)
        )
        return number

    def message(self, raw: RawMessage) -> None:
        """Copy a message."""
        channel = self.channels.get(raw.channel)
        if channel is None:
            self.orphans += 1
            return
        if raw.channel not in self._new_channels:
            self._new_channels[raw.channel] = self._register(channel)
        log, publish = (
            min(max(time + shift, 0), LATEST_NS)
            for time, shift in zip(
                (raw.log_time, raw.publish_time), self._shift, strict=True
            )
        )
        self.writer.add_message(
            self._new_channels[raw.channel], log, raw.data, publish, raw.sequence
        )
        self.counts[channel.topic] = self.counts.get(channel.topic, 0) + 1

    def metadata(self, name: str, values: dict[str, str], problems: list[str]) -> None:
        """Copy a sound metadata record; of several parts only the first part's."""
        if name == CLOCK:
            try:
                log, publish = read_offsets(values)
            except ValueError as error:
                problems.append(f"{error}; times now are wall-clock times")
                return
            self._clock = self._clock or (log, publish)
            if name in self._earlier:
                self._shift = self._clock[0] - log, self._clock[1] - publish
        if name not in self._earlier:
            self.writer.add_metadata(name, values)
            self._told.add(name)


def _refuse_source(out: Path, sources: Iterable[Path]) -> None:
    if out.exists() and any(out.samefile(source) for source in sources):
        raise RecordError(f"{out}: is the recording itself; choose another name")


def _layout(
    path: Path, sound: bool, problems: list[str]
) -> tuple[dict[int, Schema], dict[int, Channel], int]:
    """Return schemas, channels and message count; the summary may name lost channels."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, Channel] = {}
    messages = 0
    for record in _salvage(path, sound):
        if record.opcode == mcap_walk.SCHEMA and (
            schema := _sound(mcap_walk.parse_schema, path, record, problems)
        ):
            schemas.setdefault(schema.number, schema)
        elif record.opcode == mcap_walk.CHANNEL and (
            channel := _sound(mcap_walk.parse_channel, path, record, problems)
        ):
            channels.setdefault(channel.number, channel)
        messages += record.opcode == mcap_walk.MESSAGE
    return schemas, channels, messages


def recover(path: str | Path, out: str | Path, *, overwrite: bool = False) -> Recovered:
    """Copy everything sound in a recording, with all its parts, into a new complete file."""
    path = file_of(Path(path))
    out = Path(out)
    parts = parts_of(path)
    wrong = {part: _problems(part) for part in parts}
    problems = [text for texts in wrong.values() for text in texts]
    if not path.is_file() or not path.stat().st_size:
        raise RecordError(problems[0])
    sound = {part: not texts for part, texts in wrong.items()}
    layouts = {part: _layout(part, sound[part], problems) for part in parts}
    if not any(messages for _, _, messages in layouts.values()):
        raise RecordError(
            "; ".join([f"{path}: no message could be recovered", *problems])
        )
    _refuse_source(out, parts)
    with written(out, overwrite) as output:
        copy = Copy(mcap_writer(output), {}, {})
        for part, (schemas, channels, _) in layouts.items():
            copy.enter(schemas, channels)
            for record in _salvage(part, sound[part]):
                if record.opcode == mcap_walk.MESSAGE and (
                    raw := _sound(mcap_walk.parse_message, part, record, problems)
                ):
                    copy.message(raw)
                elif record.opcode == mcap_walk.METADATA and (
                    metadata := _sound(mcap_walk.parse_metadata, part, record, problems)
                ):
                    copy.metadata(*metadata, problems)
        if copy.orphans:
            problems.append(
                f"{path}: {copy.orphans} messages on channels whose topic is lost"
            )
        if problems:
            copy.writer.add_metadata(
                RECOVERY, {"source": str(path), "problems": "\n".join(problems)}
            )
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
    """Copy the messages of `topics` between two times; return the count per topic.

    `start` and `stop` count from the first tick [s]; with `start` 0, earlier messages are included.
    """
    _refuse_source(out, recording.parts)
    zero = round(begin_of(recording) * 1e9)
    low = zero + round(start * 1e9) if start > 0.0 else -math.inf
    high = math.inf if math.isinf(stop) else zero + round(stop * 1e9)
    # Statuses contain full node names, so topics keep their namespace.
    full = {
        n: channel
        if channel.topic in recording.foreign
        else channel._replace(topic=within(recording.namespace, channel.topic))
        for n, channel in recording.channels.items()
    }
    without = recording.facts(EXTRACT, WITHOUT, list[str])
    without += [
        within(recording.namespace, topic)
        for topic in recording.topics
        if topic not in topics
    ]
    without += [topic for topic in recording.foreign if topic not in topics]
    with written(out, overwrite) as output:
        copy = Copy(mcap_writer(output), recording.schemas, full)
        part = {
            "source": str(recording.path),
            "from_s": repr(start),
            "to_s": repr(stop),
        }
        part[WITHOUT] = msgspec.json.encode(without).decode()
        for name, values in [*recording.metadata.items(), (EXTRACT, part)]:
            copy.writer.add_metadata(name, values)
        for topic, raw, _ in recording.raw(foreign=True):
            if topic in topics and low <= (stamp := recording.stamp_ns(raw)) <= high:
                # Only the first part's clock record is copied, so later parts follow it.
                publish = min(max(stamp + recording.publish_offset, 0), LATEST_NS)
                copy.message(raw._replace(publish_time=publish))
        if not copy.counts:
            raise RecordError(
                f"{recording.path}: no message of these topics from {start:g} s to {stop:g} s"
            )
        copy.writer.finish()
    return copy.counts
