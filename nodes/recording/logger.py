"""Loggers: subscribe to all messages and write MCAP without slowing the loop.

A logger is a node of a launch, or ``haptic bag record`` beside it; both use `Recorder`. A publisher
never waits for a logger: if one stalls, messages beyond the publisher's queue are lost, and the
recording shows how many.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, ClassVar, NoReturn

import msgspec

from messages.codec import Decoder, MessageRefusedError
from messages.topics import FIXED, message_type, split, within
from messages.transport.sockets import Subscription
from messages.types import Message
from nodes.base.node import Node
from nodes.base.processor_wait import ProcessorWait
from nodes.base.setup import Setup
from nodes.client.listen import listening
from nodes.launcher.runs import RunInfo
from nodes.parameters.paths import LocalChoice, LocalPath
from nodes.parameters.store import ParameterError
from nodes.recording.parts import next_part
from nodes.recording.writer import CHOSEN, RecordError, RecordWriter

FLUSH_PERIOD = 0.5  # time between flushes: most that a killed logger loses [s]
QUEUE = 200_000  # messages queued in the logger's process while its disk is busy
# time after which `record` starts its duration even without a message [s]
CONNECTING = 5.0
# silence after which a stopping logger assumes that all messages came [ms]
QUIET_MS = 200


class LoggerParameters(
    msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True
):
    """Parameters of a logger node.

    path: The file; ``{run}`` stands for the name of the run, and for the logger's namespace if it
        has one.
    topics: Topics to record; empty for all.
    overwrite: Whether an existing file may be replaced.
    """

    path: LocalPath = "recordings/{run}.mcap"
    topics: list[str] = []
    overwrite: LocalChoice = False


def file_of(path: str, run: str, node: str) -> str:
    """Return the file that a logger writes, from the `path` of the launch file."""
    return path.replace("{run}", "-".join([run, *node.split("/")[:-1]]))


class Recorder:
    """Writes the messages of a subscription: those of the given topics, or all."""

    def __init__(
        self, inbox: Subscription, writer: RecordWriter, topics: Collection[str] = ()
    ) -> None:
        self._inbox = inbox
        self._topics = frozenset(topic.encode() for topic in topics)
        self._writer = writer
        self._decoders: dict[bytes, tuple[str, Decoder[Message]]] = {}
        self._last: dict[bytes, bytes] = {}
        self._next_flush = time.monotonic() + FLUSH_PERIOD
        # Messages written, and messages that do not follow the protocol.
        self.recorded = 0
        self.refused = 0
        self.latest = -math.inf  # stamp of the last written message [s]
        # Correction from this host's monotonic clock to the time of the run, for receipt times [s].
        self.clock_offset = 0.0

    def take(self, timeout_ms: int) -> bool:
        """Wait for one message and record it; flush when due. Return whether one came."""
        frames = self._inbox.receive(timeout_ms)
        now = time.monotonic()
        if frames is not None:
            self._record(frames, now + self.clock_offset)
        if now >= self._next_flush:
            self._writer.flush()
            self._next_flush = now + FLUSH_PERIOD
        return frames is not None

    def _record(self, frames: tuple[bytes, bytes], now: float) -> None:
        topic, payload = frames
        # ZeroMQ subscribes to prefixes; drop topics that only begin like a wanted one.
        if self._topics and topic not in self._topics:
            return
        # A node asked again repeats its answer, and its subscribers may see that. Frames equal to
        # the byte, stamp included, are one message.
        if self._last.get(topic) == payload:
            return
        self._last[topic] = payload
        known = self._decoders.get(topic)
        if known is None:
            name = topic.decode("utf-8", errors="replace")
            kind = message_type(name)
            if kind is None:
                self.refused += 1
                return
            known = self._decoders[topic] = (name, Decoder(kind))
        try:
            message = known[1].decode(payload)
        except MessageRefusedError:
            self.refused += 1
            return
        self._writer.write(known[0], message, now)
        self.latest = message.stamp
        self.recorded += 1

    def drain(self, end: float = math.inf) -> None:
        """Record messages in flight, until none comes or all were sent after `end` [s]."""
        wait = ProcessorWait()
        pid = os.getpid()
        late = 0
        # Publishers are received in turn: a late message of one says nothing about the queue of
        # another.
        while late <= len(self._last):
            if not self.take(0):
                # Silence counts only while this process had a processor; otherwise messages may
                # still be in ZeroMQ's I/O thread.
                began = time.monotonic()
                before = wait.update(pid)
                if not self.take(QUIET_MS):
                    if (
                        time.monotonic() - began - (wait.update(pid) - before)
                        > 0.5e-3 * QUIET_MS
                    ):
                        return
                    continue
            late = late + 1 if self.latest > end else 0


def open_writer(
    path: str, manifest: dict[str, str], overwrite: bool, topics: Collection[str] = ()
) -> RecordWriter:
    """Create a recording of these topics, or of all, and its folder."""
    try:
        Path(path).parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(
            f"{path}: cannot create its folder: {error.strerror}"
        ) from error
    facts = {
        name: text
        for name, text in manifest.items()
        if name not in ("launch_file", "nodes")
    }
    if topics:
        facts[CHOSEN] = msgspec.json.encode(list(topics)).decode()
    nodes = msgspec.json.decode(manifest.get("nodes", "{}"), type=dict[str, Any])
    return RecordWriter(
        path,
        facts,
        launch_file=manifest.get("launch_file", ""),
        parameters={
            name: msgspec.json.encode(values).decode() for name, values in nodes.items()
        },
        overwrite=overwrite,
    )


class Logger(Node):
    """Records a launch from its first message to its last."""

    Parameters: ClassVar[type[msgspec.Struct]] = LoggerParameters
    listens_to: ClassVar[tuple[str, ...]] = ("*",)
    queue: ClassVar[int] = QUEUE

    @classmethod
    def subscribes(cls, parameters: Any) -> tuple[str, ...]:
        """Return the topics that the logger subscribes to."""
        return tuple(dict.fromkeys(parameters.topics)) or ("",)

    @classmethod
    def check(cls, setup: Setup) -> None:
        """Check that the topics to record can exist."""
        nodes = {setup.name, *setup.sources}
        for number, topic in enumerate(setup.parameters.get("topics", [])):
            kind = message_type(topic)
            inside = split(topic)[1]
            if kind is None or (
                inside not in FIXED and topic[1:].rpartition("/")[0] not in nodes
            ):
                known = [
                    *FIXED,
                    *(f"/{node}/{{status,event}}" for node in sorted(nodes)),
                ]
                raise ParameterError(
                    f"nothing publishes {topic!r}; there are {', '.join(known)}",
                    path=f"{setup.name}.topics[{number}]",
                )

    def configure(self) -> None:
        """Create the file, so that a bad path fails at start and not during the run."""
        parameters: LoggerParameters = self.store.current
        self._path = file_of(parameters.path, self.setup.run, self.setup.name)
        diary = Path(self.setup.run_dir) / f"{self.setup.name}.parts"
        path, first = next_part(Path(self._path), diary)
        if not first:
            self.events.emit_each(
                "recording",
                f"continues in {path}; {self._path} stays as the last process left it",
            )
        try:
            self._writer = open_writer(
                str(path), self.setup.manifest, parameters.overwrite, parameters.topics
            )
        except RecordError as error:
            raise OSError(str(error)) from error
        self._recorder: Recorder | None = None

    def report(self) -> dict[str, Any]:
        """Return the file and the numbers of messages recorded and refused."""
        recorder = self._recorder
        return {
            "recording": (
                os.path.abspath(self._path)
                if self.setup.control.startswith("tcp://")
                else self._path
            ),
            "recorded": recorder.recorded if recorder else 0,
            "refused": recorder.refused if recorder else 0,
        }

    def loop(self) -> None:
        """Record until stopped, then drain the messages in flight."""
        self.state = "running"
        assert self.inbox is not None  # noqa: S101  # every kind that listens has one
        recorder = self._recorder = Recorder(
            self.inbox, self._writer, self.store.current.topics
        )
        try:
            while not self.stopping:
                recorder.clock_offset = self.clock.offset
                recorder.take(50)
                self.received = self.counters.ticks = recorder.recorded
                self.events.refused = recorder.refused
                self.between_ticks(0)
            # Later messages are not recorded if only this logger stops. In lockstep stamps are
            # simulated, so they cannot be told by their time.
            end = self.clock.now() if self.setup.pace == "realtime" else math.inf
            recorder.drain(end)
        except RecordError as error:
            self._give_up(error)
        finally:
            self.received = self.counters.ticks = recorder.recorded

    def _give_up(self, error: RecordError) -> NoReturn:
        """Exit with an event and code 1: a full disk is not a bug, so no traceback."""
        self.events.emit("recording", str(error))
        self.stop(str(error))
        raise SystemExit(1) from error

    def finish(self) -> None:
        """Close the file to complete it."""
        try:
            self._writer.close()
        except RecordError as error:
            self._give_up(error)


def record(
    run: RunInfo,
    path: str,
    topics: list[str],
    ended: Callable[[], bool],
    duration: float = math.inf,
    overwrite: bool = False,
) -> int:
    """Record a running launch until it ends or `ended` returns True; return the message count.

    The `duration` [s] starts with the first message, or after CONNECTING if none comes, because
    connecting takes longer on a slow machine.
    """
    # On the wire, topics of a chain begin with its namespace.
    topics = [within(run.namespace, topic) for topic in topics]
    with (
        listening(run, set(run.publishers().values()), topics or [""], QUEUE) as (
            inbox,
            links,
        ),
        open_writer(path, run.manifest, overwrite, topics) as writer,
    ):
        recorder = Recorder(inbox, writer, topics)
        until = time.monotonic() + CONNECTING + duration
        while not ended() and run.lives and time.monotonic() < until:
            heard = recorder.recorded
            recorder.take(100)
            if not heard and recorder.recorded:
                until = time.monotonic() + duration
            links.keep()
        # Messages may still be queued if this process was held up. In lockstep stamps are
        # simulated, so the time of sending is unknown.
        if run.lives and run.manifest.get("pace") == "lockstep":
            # Messages sent just now may still be in ZeroMQ's threads.
            soon = time.monotonic() + 1e-3 * QUIET_MS
            for _ in range(QUEUE):
                if not recorder.take(0) and (
                    time.monotonic() > soon or not recorder.take(QUIET_MS)
                ):
                    break
        else:
            recorder.drain(time.monotonic() if run.lives else math.inf)
        return recorder.recorded
