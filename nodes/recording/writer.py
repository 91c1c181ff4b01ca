"""Write a recording: MCAP, one JSON channel per topic, readable up to the last flush.

Every finished chunk goes to the operating system in one piece, so a killed writer leaves whole
chunks and at most one cut record at the end, and a full disk leaves whole chunks only. No numpy
here, to keep a logger small.
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
MANIFEST = "manifest"
# Of the manifest of a table: sources by role, as JSON.
IMPORTED_COLUMNS = "imported_columns"
LAUNCH_FILE = "launch_file"
PARAMETERS = "parameters"
VERSIONS = "versions"
"""Names of the metadata records."""

CHOSEN = "topics"  # manifest entry with the recorded topics, if not all

_PACKAGES = ("haptic-nodes", "mcap", "msgspec", "pyzmq", "zstandard")


class RecordError(HapticError):
    """A recording cannot be written or read; the text names file, place and remedy."""


def versions() -> dict[str, str]:
    """Return the versions of Python, system and packages that write a recording."""
    found = {
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.release()}",
    }
    for package in _PACKAGES:
        found[package] = version(package) or "not installed as a package"
    return found


class Output:
    """The file under the MCAP writer; each write is complete or leaves no trace."""

    def __init__(self, path: Path, overwrite: bool) -> None:
        self.path = path
        self.size = 0  # bytes written so far
        flags = (
            os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | (0 if overwrite else os.O_EXCL)
        )
        try:
            # file descriptor; -1 once closed
            self.descriptor = os.open(path, flags, 0o644)
            self._claim()
        except FileExistsError as error:
            raise RecordError(
                f"{path}: already exists; choose another name or ask to overwrite it"
            ) from error
        except OSError as error:
            raise RecordError(f"{path}: cannot be created: {error.strerror}") from error

    def _claim(self) -> None:
        """Lock and empty the file; raise RecordError while another process writes it."""
        if not stat.S_ISREG(os.fstat(self.descriptor).st_mode):
            return
        try:
            fcntl.flock(self.descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self.close()
            raise RecordError(
                f"{self.path}: another process is writing it; choose another name, or stop that"
                " process first"
            ) from error
        except OSError:
            pass  # a file system without locks
        os.ftruncate(self.descriptor, 0)

    def write(self, data: bytes) -> int:
        """Write all of `data`, or nothing."""
        view = memoryview(data)
        try:
            while view:
                view = view[os.write(self.descriptor, view) :]
        except OSError as error:
            left = len(view)
            # A device or a pipe cannot be truncated, and needs not.
            with contextlib.suppress(OSError):
                os.ftruncate(self.descriptor, self.size)
            raise RecordError(
                f"{self.path}: {error.strerror} after {self.size} bytes ({left} of the next"
                f" {len(data)} not written)"
            ) from error
        self.size += len(data)
        return len(data)

    def tell(self) -> int:
        """Return the position, as the MCAP writer requires."""
        return self.size

    def flush(self) -> None:
        """Do nothing: there is no buffer."""

    def close(self) -> None:
        """Close the file; repeating it is harmless."""
        descriptor = self.descriptor
        self.descriptor = -1
        if descriptor >= 0:
            try:
                os.close(descriptor)
            except OSError as error:
                raise RecordError(
                    f"{self.path}: {error.strerror} on closing, after {self.size} bytes"
                ) from error


def discard(path: Path) -> None:
    """Remove an unfinished file; devices, pipes and links stay."""
    if path.is_file() and not path.is_symlink():
        path.unlink()


@contextlib.contextmanager
def written(path: Path, overwrite: bool) -> Iterator[Output]:
    """Open a file for writing and remove it on failure, so that no partial file remains."""
    output = Output(path, overwrite)
    try:
        yield output
    except RecordError:
        discard(path)
        raise
    finally:
        output.close()


def save(path: Path, data: bytes, overwrite: bool) -> None:
    """Write a complete file, or none."""
    with written(path, overwrite) as output:
        output.write(data)


def mcap_writer(output: Output, library: str = "") -> Any:
    """Start an MCAP writer with this project's settings: zstd, 64 KiB chunks, checksums."""
    # Imported here: a launcher only checks a logger's parameters and does not need it.
    from mcap.writer import CompressionType, Writer

    writer: Any = Writer(
        cast("IO[Any]", output),
        chunk_size=CHUNK_SIZE,
        compression=CompressionType.ZSTD,
        enable_data_crcs=True,
    )
    writer.start(
        profile="haptic-nodes",
        library=library or f"haptic-nodes {versions()['haptic-nodes']}",
    )
    return writer


class Ended(msgspec.Struct, frozen=True):
    """A launch's facts about an unfinished recording, stored beside it."""

    ticks: int  # ticks of the whole run
    why: str  # how the logger ended


def ended_beside(path: Path) -> Path:
    """Return the path of the `Ended` file of a recording."""
    return path.with_name(f"{path.name}.ended.json")


def write_ended(path: Path, ended: Ended) -> None:
    """Write the `Ended` file; ignore errors, for example of a full disk."""
    with contextlib.suppress(OSError):
        ended_beside(path).write_bytes(msgspec.json.encode(ended))


def read_ended(path: Path) -> Ended | None:
    """Read the `Ended` file; None without one."""
    try:
        return msgspec.json.decode(ended_beside(path).read_bytes(), type=Ended)
    except (OSError, msgspec.DecodeError):
        return None


class RecordWriter:
    """Writes messages to one MCAP file.

    `manifest` identifies the run; `parameters` holds each node's parameters as JSON.
    """

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
                wall_clock.CLOCK,
                wall_clock.record(self._log_offset, self._publish_offset),
            )
            if launch_file is not None:
                self.add_metadata(LAUNCH_FILE, {"yaml": launch_file})
            if parameters is not None:
                self.add_metadata(PARAMETERS, parameters)
            self.add_metadata(VERSIONS, versions())
        except RecordError:
            self._output.close()
            raise

    def _open(
        self, topic: str, message_type: type[Message]
    ) -> tuple[int, type[Message]]:
        """Register the channel of a topic for its first message."""
        if message_type not in self._schemas:
            self._schemas[message_type] = self._writer.register_schema(
                f"haptic.{message_type.__name__}",
                "jsonschema",
                schema_json(message_type),
            )
        channel = self._writer.register_channel(
            topic, "json", self._schemas[message_type]
        )
        self._channels[topic] = (channel, message_type)
        self.counts[topic] = 0
        return self._channels[topic]

    def _failure(self, error: RecordError) -> RecordError:
        self._failed = True
        return RecordError(
            f"{error}; earlier messages are kept; complete the file with: haptic bag recover"
            f" {self.path}"
        )

    def _usable(self) -> None:
        if self._failed:
            raise RecordError(
                f"{self.path}: writing failed before; nothing more can be recorded in this file"
            )
        if self._output.descriptor < 0:
            raise RecordError(f"{self.path}: already closed")

    def write(self, topic: str, message: Message, log_time_s: float) -> None:
        """Add one message; takes about 8 µs."""
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
        """Pass the chunk to the operating system: a kill then loses nothing, a power cut may."""
        self._usable()
        try:
            self._writer.flush()
        except RecordError as error:
            raise self._failure(error) from error

    def close(self) -> None:
        """Write the summary and close the file; after a failed write, only close.

        Repeating it is harmless.
        """
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
