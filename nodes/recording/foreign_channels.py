"""Channels of other programs in a recording: types that are read, and all others."""

from __future__ import annotations

from pathlib import Path

import msgspec

import messages.types
from messages.topics import FIXED, message_type, split
from messages.types import Message
from nodes.recording.mcap_walk import Channel, Schema
from nodes.recording.writer import RecordError

_PREFIX = "haptic."
_KNOWN: dict[str, type[Message]] = {
    f"{_PREFIX}{kind.__name__}": kind
    for kind in vars(messages.types).values()
    if isinstance(kind, type) and issubclass(kind, Message)
}


class Stamped(msgspec.Struct, gc=False):
    """Tick and time of any message of ours, without its other fields."""

    seq: int  # tick of the message
    stamp: float  # time of the content [s]


class ForeignTopic(msgspec.Struct):
    """Figures of a topic that is not read here.

    Attributes
    ----------
    encoding : str
        Encoding of its messages, e.g. ``cdr`` or ``json``.
    schema : str
        Name of its message type; empty without one.
    messages : int
        Number of messages.
    first_publish : int
        Publish time of the first message, on the file's clock [ns].
    """

    encoding: str
    schema: str
    messages: int = 0
    first_publish: int = 0

    def add(self, publish: int) -> None:
        """Count one more message, published at a time [ns]."""
        self.first_publish = (
            min(publish, self.first_publish) if self.messages else publish
        )
        self.messages += 1

    @property
    def text(self) -> str:
        """Return why the topic is not read, for a person."""
        kind = self.schema or "unknown type"
        if self.encoding == "json":
            return f"{kind} of another program, as JSON"
        return f"{kind} in {self.encoding or 'an unnamed encoding'}; only JSON is read here"


def type_of(channel: Channel, schema: Schema | None) -> type[Message] | None:
    """Return the message type of a channel; None if it is another program's.

    The schema's name decides, then the topic. A status or an event with a schema of another name is
    another program's, because such names are common.
    """
    if channel.encoding != "json":
        return None
    name = schema.name if schema is not None else ""
    if name.startswith(_PREFIX):
        return _KNOWN.get(name)
    if not name or split(channel.topic)[1] in FIXED:
        return message_type(channel.topic)
    return None


def described(foreign: dict[str, ForeignTopic]) -> str:
    """Return the topics that are not read, in one line; empty without one."""
    return ", ".join(f"{topic} ({one.text})" for topic, one in foreign.items())


def file_of(path: Path) -> Path:
    """Return the file of a recording: itself, or the MCAP file in a ROS bag's folder.

    Raises
    ------
    RecordError
        If the folder is no bag of one MCAP file; the text names the way in.
    """
    if not path.is_dir():
        return path
    if not (path / "metadata.yaml").is_file():
        raise RecordError(
            f"{path}: is a folder; name the recording in it, or import the table or ROS bag in it:"
            f" haptic bag import {path}"
        )
    found = sorted(path.glob("*.mcap"))
    if len(found) == 1:
        return found[0]
    what = f"{len(found)} MCAP files" if found else "no MCAP file"
    raise RecordError(
        f"{path}: is the folder of a ROS bag with {what}; read its topics with: haptic bag import"
        f" {path}"
    )
