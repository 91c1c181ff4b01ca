"""A sound recording in memory, to cut, damage and count."""

from __future__ import annotations

from pathlib import Path

from mcap.reader import make_reader
from mcap.records import Chunk
from mcap.records import Message as RawMessage
from mcap.stream_reader import StreamReader, breakup_chunk

from messages.types import Message
from nodes.recording.writer import RecordWriter
from tests.support.recorded import PUBLISHES, drop


def write(path: Path, sent: list[tuple[str, Message]], flush_every: int = 120) -> None:
    manifest = {"scenario": "drop", "pace": "lockstep", "publishes": PUBLISHES}
    with RecordWriter(path, manifest, overwrite=True) as writer:
        for number, (topic, message) in enumerate(sent, 1):
            writer.write(topic, message, message.stamp + 1e-4)
            if number % flush_every == 0:
                writer.flush()


class Whole:
    """A sound recording in memory, with the places of its chunks from the reference library.

    Attributes
    ----------
    data : bytes
        The file.
    sent : list
        Topics and messages.
    ends : list of tuple of int
        For each chunk where it ends, and how many messages are in it and before.
    starts : list of int
        Where each chunk starts.
    """

    def __init__(self, path: Path) -> None:
        # Five chunks suffice, as short ones as still hold each kind of message.
        self.sent = list(drop(100, switch=50))
        write(path, self.sent, flush_every=60)
        self.data = path.read_bytes()
        with path.open("rb") as stream:
            summary = make_reader(stream, validate_crcs=True).get_summary()
            assert summary is not None
            self.ends = [(0, 0)]
            self.starts = sorted(
                index.chunk_start_offset for index in summary.chunk_indexes
            )
            for index in sorted(
                summary.chunk_indexes, key=lambda index: index.chunk_start_offset
            ):
                stream.seek(index.chunk_start_offset)
                chunk = next(
                    StreamReader(stream, skip_magic=True, emit_chunks=True).records
                )
                assert isinstance(chunk, Chunk)
                count = sum(
                    isinstance(record, RawMessage)
                    for record in breakup_chunk(chunk, validate_crc=True)
                )
                self.ends.append(
                    (
                        index.chunk_start_offset + index.chunk_length,
                        self.ends[-1][1] + count,
                    )
                )
        assert self.ends[-1][1] == len(self.sent)
        assert len(self.ends) > 4

    def within(self, cut: int) -> int:
        """Return the number of messages in chunks that end at or before a place.

        Parameters
        ----------
        cut : int
            Where the file ends [bytes].

        Returns
        -------
        int
            How many.
        """
        return max(count for end, count in self.ends if end <= cut)
