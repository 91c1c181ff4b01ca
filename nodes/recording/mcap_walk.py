"""Walk the records of an MCAP file; distinguish a cut file from a damaged one.

A cut file ends early because its writer was killed. The mcap library's stream reader does not
report where a file is cut or damaged, returns short data silently, does not limit what a chunk
unpacks to, and verifies no checksum of the summary: of 201 recordings with one flipped bit it read
52 without an error. This reader checks every length and checksum, names the offset in errors, and
takes a third of the time per message (6 µs instead of 20 µs).
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple, TypeVar

import zstandard

from nodes.recording.writer import RecordError

MAGIC = b"\x89MCAP0\r\n"
# Suffixes of the tables that ``haptic bag import`` reads.
TEXT_TABLES = (".csv", ".tsv", ".txt", ".dat", ".lvm")
TABLES = (*TEXT_TABLES, ".npz", ".npy", ".mat", ".parquet")
BAGS = (".db3", ".bag")  # files of ROS bags that it reads beside MCAP
FOOTER = 0x02
SCHEMA = 0x03
CHANNEL = 0x04
MESSAGE = 0x05
CHUNK = 0x06
METADATA = 0x0C
DATA_END = 0x0F
"""Opcodes of the MCAP specification that are read here; others are skipped."""

MAX_RECORD = 1 << 28  # largest record that is read [bytes]
MAX_CHUNK = 8 << 20
MAX_RATIO = 1000
"""Limits of an unpacked chunk: size [bytes], and size relative to its size in the file.

This project writes chunks of 64 KiB, MCAP's own tools of up to 4 MiB. Data packed tighter than any
measurement is an attempt to exhaust memory.
"""

RUN_LENGTH, RESERVED = 1, 3  # kinds of blocks of a zstd frame
BLOCK_LIMIT = 4096  # blocks of a frame; MAX_CHUNK has 64 of the usual size

FRAME = struct.Struct("<BQ")  # opcode and length before each record
# A chunk's first and last log time, uncompressed size and checksum.
CHUNK_HEAD = struct.Struct("<QQQI")
_MESSAGE = struct.Struct("<HIQQ")
_U16 = struct.Struct("<H")
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")

SMALL_RECORDS = 64  # records that a chunk may have beyond one per packed byte

T = TypeVar("T")


class CutError(RecordError):
    """The file ends early: its writer was killed, or the disk was full.

    The records before the cut are sound.
    """


class Record(NamedTuple):
    """One record of the file."""

    offset: int  # start [bytes]; for a record inside a chunk, start of the chunk
    opcode: int  # kind of record, from the MCAP specification
    content: bytes  # bytes after the length


class Channel(NamedTuple):
    """A channel: one topic with its encoding."""

    number: int
    schema: int  # number of its schema; 0 for none
    topic: str
    encoding: str  # encoding of its messages


class Schema(NamedTuple):
    """A message schema."""

    number: int
    name: str  # name of the message type
    encoding: str  # encoding of the schema
    data: bytes  # the schema itself


class RawMessage(NamedTuple):
    """A message, still encoded."""

    channel: int  # number of its channel
    sequence: int  # seq modulo 2³²
    log_time: int  # time of receipt [ns]
    publish_time: int  # source stamp [ns]
    data: bytes


def _string(content: bytes, at: int) -> tuple[str, int]:
    (length,) = _U32.unpack_from(content, at)
    end = at + 4 + length
    if end > len(content):
        raise ValueError(f"a text of {length} bytes does not fit")
    return content[at + 4 : end].decode(), end


def _parsed(path: Path, record: Record, what: str, parse: Callable[[bytes], T]) -> T:
    try:
        return parse(record.content)
    except (struct.error, ValueError) as error:
        raise RecordError(
            f"{path}: damaged {what} at byte {record.offset}: {error}"
        ) from error


def parse_channel(path: Path, record: Record) -> Channel:
    """Parse a channel record."""

    def parse(content: bytes) -> Channel:
        topic, at = _string(content, 4)
        encoding, _ = _string(content, at)
        return Channel(
            _U16.unpack_from(content, 0)[0],
            _U16.unpack_from(content, 2)[0],
            topic,
            encoding,
        )

    return _parsed(path, record, "channel", parse)


def parse_schema(path: Path, record: Record) -> Schema:
    """Parse a schema record."""

    def parse(content: bytes) -> Schema:
        name, at = _string(content, 2)
        encoding, at = _string(content, at)
        (length,) = _U32.unpack_from(content, at)
        if at + 4 + length > len(content):
            raise ValueError(f"a schema of {length} bytes does not fit")
        return Schema(
            _U16.unpack_from(content, 0)[0],
            name,
            encoding,
            content[at + 4 : at + 4 + length],
        )

    return _parsed(path, record, "schema", parse)


def parse_metadata(path: Path, record: Record) -> tuple[str, dict[str, str]]:
    """Parse a metadata record."""

    def parse(content: bytes) -> tuple[str, dict[str, str]]:
        name, at = _string(content, 0)
        (length,) = _U32.unpack_from(content, at)
        at += 4
        end = at + length
        values: dict[str, str] = {}
        while at < end:
            key, at = _string(content, at)
            values[key], at = _string(content, at)
        return name, values

    return _parsed(path, record, "metadata", parse)


def parse_message(path: Path, record: Record) -> RawMessage:
    """Parse a message record."""
    if len(record.content) < _MESSAGE.size:
        raise RecordError(
            f"{path}: damaged message at byte {record.offset}: {len(record.content)} bytes"
        )
    channel, sequence, log_time, publish_time = _MESSAGE.unpack_from(record.content)
    return RawMessage(
        channel, sequence, log_time, publish_time, record.content[_MESSAGE.size :]
    )


def frame_length(data: bytes | memoryview) -> int:
    """Return the length of the zstd frame at the start of `data` [bytes] (RFC 8878, 3.1.1).

    Raises ValueError if it is not a frame, or incomplete.
    """
    try:
        at = zstandard.frame_header_size(data)
        has_checksum = zstandard.get_frame_parameters(data).has_checksum
    except zstandard.ZstdError as error:
        raise ValueError(str(error)) from error
    is_last, blocks = False, 0
    while not is_last:
        blocks += 1
        if at + 3 > len(data) or blocks > BLOCK_LIMIT:
            raise ValueError("the compressed frame does not end")
        header = data[at] | data[at + 1] << 8 | data[at + 2] << 16
        is_last = bool(header & 1)
        kind = header >> 1 & 3
        size = header >> 3
        if kind == RESERVED:
            raise ValueError("a block of the compressed frame is of no known kind")
        at += 3 + (1 if kind == RUN_LENGTH else size)
    at += 4 * has_checksum
    if at > len(data):
        raise ValueError("the compressed frame does not end")
    return at


def unpack_chunk(path: Path, record: Record) -> Iterator[Record]:
    """Decompress a chunk, check its size and checksum, and yield its records."""

    def parse(content: bytes) -> bytes:
        _, _, size, checksum = CHUNK_HEAD.unpack_from(content)
        compression, at = _string(content, CHUNK_HEAD.size)
        (length,) = _U64.unpack_from(content, at)
        data = content[at + 8 : at + 8 + length]
        limit = min(MAX_CHUNK, MAX_RATIO * length)
        if len(data) != length or size > limit:
            raise ValueError(f"{length} bytes that unpack to {size}, limit {limit}")
        if compression == "zstd":
            if (frame := frame_length(data)) != length:
                raise ValueError(
                    f"its compressed frame ends after {frame} of {length} bytes"
                )
            # zstd allocates the size that its frame declares: check that first.
            if zstandard.frame_content_size(data) not in (size, -1):
                raise ValueError(
                    "the compressed frame has another size than the chunk says"
                )
            data = zstandard.ZstdDecompressor().decompress(data, max_output_size=size)
        elif compression == "lz4":
            # Imported here: a logger, which must stay small, does not need it. Never more than
            # `size` bytes are made, whatever the frame declares.
            import lz4.frame

            data = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size)
        elif compression:
            raise ValueError(
                f"compressed with {compression!r}; zstd and lz4 are read here"
            )
        if len(data) != size or (checksum and zlib.crc32(data) != checksum):
            raise ValueError(
                f"checksum or size does not match ({len(data)} of {size} bytes)"
            )
        return data

    try:
        data = _parsed(path, record, "chunk", parse)
    except (zstandard.ZstdError, RuntimeError) as error:  # the latter of lz4
        raise RecordError(
            f"{path}: damaged chunk at byte {record.offset}: {error}"
        ) from error
    return _split(path, record.offset, data, len(record.content) + SMALL_RECORDS)


def _split(path: Path, offset: int, data: bytes, limit: int) -> Iterator[Record]:
    """Yield the records of an unpacked chunk; refuse more than `limit`, which only cost time."""
    at = count = 0
    while at < len(data):
        count += 1
        if count > limit:
            raise RecordError(
                f"{path}: damaged chunk at byte {offset}: more than {limit} records, the limit"
                " for its size"
            )
        if at + FRAME.size > len(data):
            raise RecordError(
                f"{path}: damaged chunk at byte {offset}: it ends within a record's length"
            )
        opcode, length = FRAME.unpack_from(data, at)
        at += FRAME.size
        if at + length > len(data):
            raise RecordError(
                f"{path}: damaged chunk at byte {offset}: a record of {length} bytes does not fit"
                " into the chunk"
            )
        yield Record(offset, opcode, data[at : at + length])
        at += length


def footer_sound(content: bytes, checksum: int) -> bool:
    """Whether the footer's checksum matches the summary."""
    (stored,) = _U32.unpack_from(content, 16)
    return stored in (0, zlib.crc32(FRAME.pack(FOOTER, 20) + content[:16], checksum))


def walk(path: Path) -> Iterator[Record]:
    """Yield the records of a file from beginning to end."""
    try:
        size = path.stat().st_size
        stream = path.open("rb")
    except OSError as error:
        raise RecordError(f"{path}: cannot be opened: {error.strerror}") from error
    with stream:
        start = stream.read(len(MAGIC))
        if start != MAGIC:
            what = "is empty" if not start else f"starts with {start!r}"
            suffix = path.suffix.lower()
            hint = (
                f"; make one of it with: haptic bag import {path}"
                if suffix in (*TABLES, *BAGS)
                else ""
            )
            raise RecordError(
                f"{path}: {what}, so it is no MCAP recording ({size} bytes){hint}"
            )
        # If the end magic is there, the writer finished the file: an error is damage, not a cut.
        stream.seek(max(size - len(MAGIC), len(MAGIC)))
        ended = stream.read() == MAGIC
        stream.seek(len(MAGIC))
        checksum = zlib.crc32(MAGIC)
        offset = len(MAGIC)
        while True:
            frame = stream.read(FRAME.size)
            opcode, length = FRAME.unpack(frame) if len(frame) == FRAME.size else (0, 0)
            rest = size - offset - FRAME.size
            if opcode == 0 or length > rest:
                if ended:
                    raise RecordError(
                        f"{path}: damaged at byte {offset}: opcode {opcode}, {length} of {rest}"
                        " bytes"
                    )
                raise CutError(
                    f"{path}: cut at byte {offset}: {size - offset} bytes after it are no whole"
                    " record"
                )
            if length > MAX_RECORD:
                raise RecordError(
                    f"{path}: a record of {length} bytes at byte {offset}, limit {MAX_RECORD}"
                )
            content = stream.read(length)
            if len(content) != length:
                raise CutError(f"{path}: cut at byte {offset} while it was being read")
            if opcode == DATA_END:
                if length < 4 or _U32.unpack_from(content)[0] not in (0, checksum):
                    raise RecordError(
                        f"{path}: damaged: the checksum of the data up to byte {offset} does not"
                        " match"
                    )
                checksum = 0
            elif opcode == FOOTER:
                tail = stream.read()
                if tail != MAGIC and MAGIC.startswith(tail):
                    raise CutError(f"{path}: cut at byte {offset}, in its last bytes")
                if length != 20 or not footer_sound(content, checksum) or tail != MAGIC:
                    raise RecordError(
                        f"{path}: damaged: the summary before byte {offset} or the end does not"
                        " match"
                    )
                yield Record(offset, opcode, content)
                return
            else:
                checksum = zlib.crc32(content, zlib.crc32(frame, checksum))
            yield Record(offset, opcode, content)
            offset += FRAME.size + length
