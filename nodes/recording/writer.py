"""Write a recording: MCAP with one JSON channel per topic, readable up to the last flush whatever ends the writer.

Every finished chunk goes straight to the operating system in one piece, so a killed writer leaves
whole chunks and at most one cut record at the end, and a full disk leaves whole chunks only. No
numpy here: a logger has to stay small.
"""

from __future__ import annotations

import contextlib
import fcntl
import os
import platform
import stat
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import TracebackType
from typing import IO, Any, cast

import msgspec

from messages.errors import HapticError
from messages.schema import schema_json
from messages.types import Message
from nodes.parameters.installed import version
from nodes.recording import wall_clock

CHUNK_SIZE = 65536  # uncompressed size at which a chunk is finished [bytes]
MANIFEST, LAUNCH_FILE, PARAMETERS, VERSIONS = "manifest", "launch_file", "parameters", "versions"
"""Names of the metadata records."""

CHOSEN = "topics"  # what of the manifest lists the topics, where only some were to be recorded

_PACKAGES = ("haptic-nodes", "mcap", "msgspec", "pyzmq", "zstandard")


class RecordError(HapticError):
    """A recording cannot be written or read; the text names the file, the place in it and what to do."""


def versions() -> dict[str, str]:
    """Tell what wrote a recording."""
    found = {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()}",
    }
    for package in _PACKAGES:
        found[package] = version(package) or "not installed as a package"
    return found


class Output:
    """The file under the MCAP writer: each write goes whole to the operating system, or leaves no trace."""

    def __init__(self, path: Path, overwrite: bool) -> None:
        self.path = path
        self.size = 0  # bytes handed over so far
        flags = os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | (0 if overwrite else os.O_EXCL)
        try:
            self.descriptor = os.open(path, flags, 0o644)  # file descriptor; -1 once closed
            self._claim()
        except FileExistsError as error:
            raise RecordError(
                f"{path}: exists already; give another name or ask for it to be overwritten"
            ) from error
        except OSError as error:
            raise RecordError(f"{path}: cannot be created: {error.strerror}") from error

    def _claim(self) -> None:
        """Be its only writer until it is closed, and empty it; RecordError while another process writes to it."""
        if not stat.S_ISREG(os.fstat(self.descriptor).st_mode):
            return
        try:
            fcntl.flock(self.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self.close()
            raise RecordError(
                f"{self.path}: another process is writing it, and both would be lost; give another"
                " name, or end that one first"
            ) from error
        except OSError:
            pass  # a file system without locks
        os.ftruncate(self.descriptor, 0)

    def write(self, data: bytes) -> int:
        """Hand over some bytes, all of them or none."""
        view = memoryview(data)
        try:
            while view:
                view = view[os.write(self.descriptor, view) :]
        except OSError as error:
            left = len(view)
            # A device or a pipe cannot be cut back, and has nothing to keep either.
            with contextlib.suppress(OSError):
                os.ftruncate(self.descriptor, self.size)
            raise RecordError(
                f"{self.path}: {error.strerror} after {self.size} bytes ({left} of the next"
                f" {len(data)} not written)"
            ) from error
        self.size += len(data)
        return len(data)

    def tell(self) -> int:
        """Tell the position, as the MCAP writer asks for it."""
        return self.size

    def flush(self) -> None:
        """Do nothing: nothing is held back."""

    def close(self) -> None:
        """Close the file; harmless when repeated."""
        descriptor, self.descriptor = self.descriptor, -1
        if descriptor >= 0:
            try:
                os.close(descriptor)
            except OSError as error:
                raise RecordError(
                    f"{self.path}: {error.strerror} on closing, after {self.size} bytes"
                ) from error


def discard(path: Path) -> None:
    """Remove a file that could not be finished; devices, pipes and links to them stay."""
    if path.is_file() and not path.is_symlink():
        path.unlink()


@contextlib.contextmanager
def written(path: Path, overwrite: bool) -> Iterator[Output]:
    """Open a file that is written whole, or not left there: what does not hold everything must not be taken for it."""
    output = Output(path, overwrite)
    try:
        yield output
    except RecordError:
        discard(path)
        raise
    finally:
        output.close()


def save(path: Path, data: bytes, overwrite: bool) -> None:
    """Write a file whole, or leave none."""
    with written(path, overwrite) as output:
        output.write(data)


def mcap_writer(output: Output, library: str = "") -> Any:
    """Start an MCAP writer the way this project writes: zstd, 64 KiB chunks, checksums over everything."""
    # A launcher, which only checks a logger's parameters, does without it.
    from mcap.writer import CompressionType, Writer

    writer: Any = Writer(
        cast("IO[Any]", output),
        chunk_size=CHUNK_SIZE,
        compression=CompressionType.ZSTD,
        enable_data_crcs=True,
    )
    writer.start(
        profile="haptic-nodes", library=library or f"haptic-nodes {versions()['haptic-nodes']}"
    )
    return writer


class Ended(msgspec.Struct, frozen=True):
    """What a launch knows of a recording that its logger did not finish, beside the file: a part is not taken for the whole."""

    ticks: int  # ticks of the whole run
    why: str  # how the logger ended


def ended_beside(path: Path) -> Path:
    """Name the file that tells it."""
    return path.with_name(f"{path.name}.ended.json")


def write_ended(path: Path, ended: Ended) -> None:
    """Write it beside the recording; on a disk that is full too, nothing is lost but this."""
    with contextlib.suppress(OSError):
        ended_beside(path).write_bytes(msgspec.json.encode(ended))


def read_ended(path: Path) -> Ended | None:
    """Read it; None without such a file."""
    try:
        return msgspec.json.decode(ended_beside(path).read_bytes(), type=Ended)
    except (OSError, msgspec.DecodeError):
        return None


class RecordWriter:
    """Write messages to one MCAP file; `manifest` identifies the run, `parameters` are those of each node, as text."""

    def __init__(
        self,
        path: str | Path,
        manifest: Mapping[str, str],
        *,
        launch_file: str | None = None,
        parameters: Mapping[str, str] | None = None,
        overwrite: bool = False,
    ) -> None:
        self.path = Path(path)  # the file
        self.counts: dict[str, int] = {}  # messages written so far per topic
        self._encode = msgspec.json.Encoder().encode
        self._channels: dict[str, tuple[int, type[Message]]] = {}
        self._schemas: dict[type[Message], int] = {}
        self._failed = False
        self._log_offset, self._publish_offset = wall_clock.offsets_of(manifest)
        self._output = Output(self.path, overwrite)
        try:
            self._writer = mcap_writer(self._output)
            self.add_metadata(MANIFEST, manifest)
            self.add_metadata(
                wall_clock.CLOCK, wall_clock.record(self._log_offset, self._publish_offset)
            )
            if launch_file is not None:
                self.add_metadata(LAUNCH_FILE, {"yaml": launch_file})
            if parameters is not None:
                self.add_metadata(PARAMETERS, parameters)
            self.add_metadata(VERSIONS, versions())
        except RecordError:
            self._output.close()
            raise

    def _open(self, topic: str, message_type: type[Message]) -> tuple[int, type[Message]]:
        """Register the channel of a topic at its first message."""
        if message_type not in self._schemas:
            self._schemas[message_type] = self._writer.register_schema(
                f"haptic.{message_type.__name__}", "jsonschema", schema_json(message_type)
            )
        channel = self._writer.register_channel(topic, "json", self._schemas[message_type])
        self._channels[topic] = (channel, message_type)
        self.counts[topic] = 0
        return self._channels[topic]

    def _failure(self, error: RecordError) -> RecordError:
        self._failed = True
        return RecordError(
            f"{error}; what was recorded before is kept, and completed by: haptic bag recover"
            f" {self.path}"
        )

    def _usable(self) -> None:
        if self._failed:
            raise RecordError(
                f"{self.path}: writing failed before; nothing more can be recorded in this file"
            )
        if self._output.descriptor < 0:
            raise RecordError(f"{self.path}: closed already")

    def write(self, topic: str, message: Message, log_time_s: float) -> None:
        """Add one message. Takes about 8 µs."""
        self._usable()
        message_type = type(message)
        channel, expected = self._channels.get(topic) or self._open(topic, message_type)
        if message_type is not expected:
            raise RecordError(
                f"{self.path}: {topic} carries {expected.__name__}, not {message_type.__name__}"
            )
        try:
            self._writer.add_message(
                channel,
                wall_clock.nanoseconds(log_time_s, self._log_offset),
                self._encode(message),
                wall_clock.nanoseconds(message.stamp, self._publish_offset),
                message.seq & 0xFFFFFFFF,
            )
        except RecordError as error:
            raise self._failure(error) from error
        self.counts[topic] += 1

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Add one metadata record."""
        self._usable()
        try:
            self._writer.add_metadata(name, dict(values))
        except RecordError as error:
            raise self._failure(error) from error

    def flush(self) -> None:
        """Hand the chunk to the operating system, every half second: then a kill loses nothing, though a power cut may."""
        self._usable()
        try:
            self._writer.flush()
        except RecordError as error:
            raise self._failure(error) from error

    def close(self) -> None:
        """Write the summary and close the file. Harmless when repeated; after a failed write it only closes."""
        if self._output.descriptor < 0:
            return
        try:
            if not self._failed:
                self._writer.finish()
        except RecordError as error:
            raise self._failure(error) from error
        finally:
            self._output.close()

    def __enter__(self) -> RecordWriter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
