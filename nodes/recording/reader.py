"""Read a recording: messages, figures per topic, gaps in ``seq``, and metadata.

Opening reads the file once, checks every length and checksum, and stores figures only, so an hour
of recording needs no more memory than a minute. A file whose writer was killed opens too;
`Recording.cut` says where it ends. Channels of other programs are counted in `Recording.foreign`
and skipped. A file without its clock record is judged by the stamps inside its messages.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import msgspec

from messages.topics import DEVICE_STATE, LOOP, split
from messages.types import Message
from nodes.recording import mcap_walk
from nodes.recording.foreign_channels import ForeignTopic, described, file_of, type_of
from nodes.recording.mcap_walk import Channel, CutError, RawMessage, Record, Schema
from nodes.recording.part_clocks import PartClocks
from nodes.recording.parts import parts_of
from nodes.recording.topic_figures import TopicFigures
from nodes.recording.wall_clock import CLOCK
from nodes.recording.writer import MANIFEST, RecordError

if TYPE_CHECKING:
    import numpy as np

__all__ = ["EXTRACT", "RECOVERY", "WITHOUT", "Entry", "M", "Recording"]

RECOVERY = "recovery"  # metadata record added by `nodes.recording.recover.recover`
# metadata record of an extract: its source, times and omitted topics
EXTRACT = "extract"
WITHOUT = "without"  # entry of EXTRACT: full names of the omitted topics
_NANO = 1e9

# Offset between the channel numbers of a recording's parts; MCAP's numbers are below it.
_OWN_NUMBERS = 1 << 16
M = TypeVar("M", bound=Message)
T = TypeVar("T")


class Entry(NamedTuple):
    """One recorded message.

    Attributes
    ----------
    topic : str
        Topic of the message.
    log_time : float
        Time of receipt by the logger, on the host's monotonic clock [s].
    message : Message
        The message.
    """

    topic: str
    log_time: float
    message: Message


def column_value(value: Any) -> Any:
    """Return a field as a column of a table holds it.

    Parameters
    ----------
    value : object
        Field of a message.

    Returns
    -------
    object
        A mapping's JSON text, anything else as it is.
    """
    return msgspec.json.encode(value).decode() if isinstance(value, dict) else value


class Recording:
    """A recording on disk.

    Parameters
    ----------
    path : str or Path
        An MCAP file written by `nodes.recording.writer.RecordWriter` or by another program
        (messages/PROTOCOL.md), or the folder of a ROS bag with one.

    Attributes
    ----------
    path : Path
        The file.
    namespace : str
        Namespace of the only chain, which is removed from topic names; empty for none or several.
    parts : list of Path
        The file, and those in which a restarted logger continued (nodes/recording/parts.py).
    topics : dict of str to TopicFigures
        Figures per topic, in the order of their first message.
    foreign : dict of str to ForeignTopic
        Figures of the topics that are not read here, by their full names.
    metadata : dict of str to dict of str to str
        All metadata records.
    complete : bool
        Whether the writer finished the file; False if the logger was killed.
    cut : str
        Description of where the file is cut; empty for a complete file.
    first_log : float
        Time of the first receipt, on the clock of the recording host [s].
    wall_duration : float
        Time from the first to the last receipt [s].
    channels, schemas : dict of int to Channel, dict of int to Schema
        Channels by the numbers that `raw` yields, those of other programs included, and schemas by
        the numbers in the channels.

    Raises
    ------
    RecordError
        If it is not an MCAP file, or is damaged.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = file_of(Path(path))
        self.parts = parts_of(self.path)
        self.topics: dict[str, TopicFigures] = {}
        self.foreign: dict[str, ForeignTopic] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.complete = False
        self.cut = ""
        self.first_log = 0.0
        self.wall_duration = 0.0
        self.namespace = ""
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self._types: dict[int, type[Message] | None] = {}
        self._clocks = PartClocks()
        self._scan()

    @property
    def manifest(self) -> dict[str, str]:
        """Return the record that identifies the run; empty if there is none."""
        return self.metadata.get(MANIFEST, {})

    @property
    def recovered(self) -> bool:
        """Whether the file was cut, even if `nodes.recording.recover.recover` completed it."""
        return not self.complete or RECOVERY in self.metadata

    def _of_ticks(self) -> list[TopicFigures]:
        """Return the figures of the topics of ticks, or else of all topics."""
        return [self.topics[topic] for topic in LOOP if topic in self.topics] or list(
            self.topics.values()
        )

    @property
    def first_stamp(self) -> float:
        """Return the first stamp [s], of ticks or else of all messages."""
        return min((figures.first_stamp for figures in self._of_ticks()), default=0.0)

    @property
    def duration(self) -> float:
        """Return the time from first to last stamp [s], of ticks or else of all messages."""
        last = max((figures.last_stamp for figures in self._of_ticks()), default=0.0)
        return last - self.first_stamp

    def _channel(self, channel: Channel, offset: int) -> None:
        """Enter a channel; a number belongs to one topic."""
        if self.channels.setdefault(channel.number, channel) != channel:
            raise RecordError(
                f"{self.path}: damaged at byte {offset}: channel {channel.number} changes its topic"
            )

    def _records(self) -> Iterator[tuple[int, Record]]:
        """Yield all records, chunks unpacked, without the summaries.

        With each comes the offset to add to its part's channel and schema numbers.
        """
        for n, path in enumerate(self.parts):
            try:
                for record in mcap_walk.walk(path):
                    if record.opcode == mcap_walk.CHUNK:
                        for inner in mcap_walk.unpack_chunk(path, record):
                            yield n * _OWN_NUMBERS, inner
                    elif record.opcode != mcap_walk.DATA_END:
                        # The summary after the end of the data repeats schemas and channels, but
                        # the walk must still see the footer.
                        yield n * _OWN_NUMBERS, record
            except CutError as error:
                self.cut = self.cut or str(error)

    def _scan(self) -> None:
        first_log = 1 << 64
        last_log = 0
        finished = 0
        for shift, record in self._records():
            if record.opcode == mcap_walk.MESSAGE:
                raw = self._message(shift, record)
                if self._count(raw, record.offset):
                    first_log = min(first_log, raw.log_time)
                    last_log = max(last_log, raw.log_time)
            elif record.opcode == mcap_walk.SCHEMA:
                schema = mcap_walk.parse_schema(self.path, record)
                self.schemas[schema.number + shift] = schema
            elif record.opcode == mcap_walk.CHANNEL:
                channel = mcap_walk.parse_channel(self.path, record)
                if shift:
                    # 0 stands for no schema.
                    schema_number = channel.schema + shift if channel.schema else 0
                    channel = channel._replace(
                        number=channel.number + shift, schema=schema_number
                    )
                self._channel(channel, record.offset)
            elif record.opcode == mcap_walk.METADATA:
                name, values = mcap_walk.parse_metadata(self.path, record)
                if name != CLOCK or name not in self.metadata:
                    # A copy of all parts has the first part's clock.
                    self.metadata[name] = values
                if name == CLOCK:
                    self._set_clock(shift // _OWN_NUMBERS, values, record.offset)
            elif record.opcode == mcap_walk.FOOTER:
                finished += 1
        self.complete = finished == len(self.parts)
        self._enter_chain()
        if self.topics:
            self.first_log = (first_log - self._clocks.first.log) / _NANO
            self.wall_duration = (last_log - first_log) / _NANO

    def _enter_chain(self) -> None:
        """Remove the namespace from topics if there is only one chain."""
        spaces = {split(topic)[0] for topic in self.topics}
        if len(spaces) == 1 and (namespace := spaces.pop()):
            self.namespace = namespace
            self.topics = {
                split(topic)[1]: figures for topic, figures in self.topics.items()
            }
            self.channels = {
                number: channel._replace(topic=split(channel.topic)[1])
                if self._type(number) is not None
                else channel
                for number, channel in self.channels.items()
            }

    def facts(self, record: str, name: str, kind: type[T]) -> T:
        """Decode a JSON value of a metadata record.

        Parameters
        ----------
        record : str
            Name of the record.
        name : str
            Name of the value in the record.
        kind : type
            Type of the value.

        Returns
        -------
        object
            Value of type `kind`; empty if absent.

        Raises
        ------
        RecordError
            If the value does not decode as `kind`.
        """
        text = self.metadata.get(record, {}).get(name)
        try:
            return kind() if text is None else msgspec.json.decode(text, type=kind)
        except (msgspec.DecodeError, RecursionError, UnicodeError) as error:
            raise RecordError(
                f"{self.path}: damaged metadata {record}.{name}: {error}"
            ) from error

    def require_ticks(self) -> None:
        """Raise RecordError without ticks of one chain; of several, name how to extract one."""
        if DEVICE_STATE in self.topics:
            return
        chains = sorted(
            space for space, topic in map(split, self.topics) if topic == DEVICE_STATE
        )
        text = f"{self.path}: no message on {DEVICE_STATE}, so there are no ticks"
        if chains:
            take = f"haptic bag filter {shlex.quote(str(self.path))} -e ^/{chains[0]}/"
            text += f"; to extract one of its chains ({', '.join(chains)}): {take}"
        if self.foreign:
            text += f"; not read: {described(self.foreign)}"
            if any(one.encoding == "cdr" for one in self.foreign.values()):
                in_bag = (self.path.parent / "metadata.yaml").is_file()
                bag = shlex.quote(str(self.path.parent if in_bag else self.path))
                text += f"; topics of a ROS bag are imported: haptic bag import {bag}"
        raise RecordError(text)

    def _message(self, shift: int, record: Record) -> RawMessage:
        raw = mcap_walk.parse_message(self.path, record)
        return raw._replace(channel=raw.channel + shift) if shift else raw

    def _set_clock(self, part: int, values: dict[str, str], offset: int) -> None:
        try:
            self._clocks.set(part, values)
        except ValueError as error:
            raise RecordError(
                f"{self.path}: damaged at byte {offset}: {error}"
            ) from error

    def _type(self, number: int) -> type[Message] | None:
        """Return the message type of a channel by its number; None if it is not read here."""
        if number not in self._types:
            channel = self.channels[number]
            self._types[number] = type_of(channel, self.schemas.get(channel.schema))
        return self._types[number]

    def _count(self, raw: RawMessage, offset: int) -> bool:
        """Count a message; return whether it is read here."""
        channel = self.channels.get(raw.channel)
        if channel is None:
            raise RecordError(
                f"{self.path}: damaged at byte {offset}: a message on channel {raw.channel}, which"
                " is unknown"
            )
        if self._type(raw.channel) is None:
            schema = self.schemas.get(channel.schema)
            self.foreign.setdefault(
                channel.topic,
                ForeignTopic(channel.encoding, schema.name if schema else ""),
            ).add(raw.publish_time)
            return False
        sequence, stamp = self._clocks.count(raw.channel // _OWN_NUMBERS, raw)
        figures = self.topics.setdefault(channel.topic, TopicFigures())
        figures.add(sequence, stamp, split(channel.topic)[1] in LOOP)
        return True

    def stamp_ns(self, raw: RawMessage) -> int:
        """Return the stamp of a message of `raw` [ns].

        Parameters
        ----------
        raw : RawMessage
            Encoded message; of another program's, its publish time counts.

        Returns
        -------
        int
            Time of the run [ns].
        """
        part = raw.channel // _OWN_NUMBERS
        return self._clocks.stamp_ns(part, raw, self._type(raw.channel) is not None)

    @property
    def publish_offset(self) -> int:
        """Return what the first part's publish times exceed its stamps by [ns]."""
        return self._clocks.first.publish

    def _refuse_mixed(self) -> None:
        """Raise RecordError for a topic with messages of two types."""
        kinds: dict[str, type[Message]] = {}
        for number, channel in self.channels.items():
            kind = self._type(number)
            if kind is not None and kinds.setdefault(channel.topic, kind) is not kind:
                raise RecordError(
                    f"{self.path}: {channel.topic} carries two message types"
                )

    def raw(self, *, foreign: bool = False) -> Iterator[tuple[str, RawMessage, int]]:
        """Yield the encoded messages in the order of receipt.

        Parameters
        ----------
        foreign : bool
            Whether those of other programs are included.

        Yields
        ------
        tuple of str, RawMessage and int
            Topic, message and byte offset of its chunk.

        Raises
        ------
        RecordError
            If the file has changed since it was opened.
        """
        for shift, record in self._records():
            if record.opcode == mcap_walk.MESSAGE:
                raw = self._message(shift, record)
                channel = self.channels.get(raw.channel)
                if channel is None:
                    raise RecordError(f"{self.path}: has changed while it was read")
                if foreign or self._type(raw.channel) is not None:
                    yield channel.topic, raw, record.offset

    def decode(
        self, decoder: msgspec.json.Decoder[M], raw: RawMessage, offset: int
    ) -> M:
        """Decode a message of `raw`.

        Parameters
        ----------
        decoder : msgspec.json.Decoder
            Decoder of the message's type.
        raw : RawMessage
            Encoded message.
        offset : int
            Byte offset of its chunk, for the error text.

        Returns
        -------
        Message
            Decoded message.

        Raises
        ------
        RecordError
            If the message does not fit its type.
        """
        try:
            return decoder.decode(raw.data)
        except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
            topic = self.channels[raw.channel].topic
            raise RecordError(
                f"{self.path}: {topic} seq {raw.sequence} (chunk at byte {offset}): {error}"
            ) from error

    def entries(self, topics: Iterable[str] | None = None) -> Iterator[Entry]:
        """Yield the decoded messages in the order of receipt.

        Parameters
        ----------
        topics : iterable of str, optional
            Topics to read; all by default.

        Yields
        ------
        Entry
            Topic, receipt time and typed message.

        Raises
        ------
        RecordError
            If a topic is not in the recording or is another program's, or a message does not fit
            its type.
        """
        wanted = set(self.topics if topics is None else topics)
        for topic in wanted - set(self.topics):
            if topic in self.foreign:
                raise RecordError(f"{self.path}: {topic} is {self.foreign[topic].text}")
            raise RecordError(
                f"{self.path}: no topic {topic!r}; there are {', '.join(self.topics) or 'none'}"
            )
        self._refuse_mixed()
        decoders: dict[int, msgspec.json.Decoder[Message]] = {}
        for number, channel in self.channels.items():
            kind = self._type(number)
            if channel.topic in wanted and kind is not None:
                decoders[number] = msgspec.json.Decoder(kind)
        for topic, raw, offset in self.raw():
            if raw.channel in decoders:
                log_time = self._clocks.log_time(raw.channel // _OWN_NUMBERS, raw)
                yield Entry(
                    topic, log_time, self.decode(decoders[raw.channel], raw, offset)
                )

    def messages(self, topic: str) -> list[Any]:
        """Read all messages of one topic.

        Parameters
        ----------
        topic : str
            Topic name.

        Returns
        -------
        list of Message
            In the order of receipt; empty if the topic is not in the recording.

        Raises
        ------
        RecordError
            If a message does not fit its type.
        """
        return (
            [entry.message for entry in self.entries([topic])]
            if topic in self.topics
            else []
        )

    def arrays(self, topic: str) -> dict[str, np.ndarray[Any, Any]]:
        """Read one topic as arrays.

        Parameters
        ----------
        topic : str
            Topic name.

        Returns
        -------
        dict of str to numpy.ndarray
            One array per field, shape (N,) or (N, 3) for vectors, and ``log_time`` [s], in the
            order of receipt. A mapping (an event's ``data``) is one JSON text per message.

        Raises
        ------
        RecordError
            If the topic is not in the recording or a message does not fit its type.
        """
        import numpy as np

        entries = list(self.entries([topic]))
        found = {
            "log_time": np.array(
                [entry.log_time for entry in entries], dtype=np.float64
            )
        }
        for field in msgspec.structs.fields(type(entries[0].message)):
            found[field.name] = np.array(
                [column_value(getattr(entry.message, field.name)) for entry in entries]
            )
        return found
