"""Every message accounted for: what nodes say they sent, what was recorded, what was left out on purpose, and their clocks."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from messages.topics import DEVICE_STATE, LOOP, message_type, split
from messages.types import DeviceState, NodeStatus
from nodes.recording.mcap_walk import RawMessage
from nodes.recording.reader import Recording
from nodes.recording.writer import read_ended


class Account(msgspec.Struct):
    """What a node says it sent against what was recorded of it."""

    sent: int  # messages sent, by the last status of each of its processes
    recorded: int  # messages of the node recorded before that status
    # Difference; 0 when everything arrived. For a logger that came late, only what is missing in ``seq`` since then and was not
    # left out by the driver.
    lost: int
    # Messages sent before the logger listened, as the first recorded status tells: not lost, nobody was there.
    early: int
    since: int  # ``seq`` at which the recording begins: above 0 for a logger that came late
    # Whether the last status is a final one: otherwise the node was killed, or the logger left before it.
    finished: bool

    @property
    def text(self) -> str:
        """The account in words."""
        whole = "all there" if self.finished else "nothing missing so far; its end is not there"
        parts = [f"{self.lost} lost" if self.lost else whole]
        parts += [f"{self.early} before it was listened to"] if self.early else []
        parts += [f"recorded from seq {self.since} on"] if self.since else []
        return f"sent {self.sent}, recorded {self.recorded}: {', '.join(parts)}"


class Completeness(msgspec.Struct):
    """Whether a recording holds everything: the one verdict that ``bag info``, plots and summaries tell."""

    complete: bool  # whether its writer finished the file; not so for a cut one that was recovered
    end_s: float  # time of the run at which the recording ends [s]
    # Ticks of the run that came after the end of a cut recording; None where no launch told how many the run had.
    missing_ticks: int | None
    nodes: dict[str, Account]  # what each node sent against what was recorded
    left_out: int  # ticks that the driver left out: gaps in ``seq`` everywhere, but no losses

    @property
    def lost(self) -> int | None:
        """Messages that were sent and not recorded; None when no node's count was recorded, so that nobody can tell."""
        return sum(account.lost for account in self.nodes.values()) if self.nodes else None

    @property
    def text(self) -> str:
        """The verdict in words."""
        if not self.complete:
            after = "what came after is" if self.missing_ticks is None else f"{self.missing_ticks} ticks after it are"
            before = f"; {self.lost} messages lost before" if self.lost else ""
            return f"cut at {self.end_s:.3f} s; {after} not there{before}"
        if self.lost is None:
            return "complete, losses unknown: no status recorded"
        return f"complete, {f'{self.lost} messages' if self.lost else 'nothing'} lost"


def completeness(recording: Recording) -> Completeness:
    """Judge whether a recording holds everything."""
    ended = read_ended(recording.path) if recording.recovered else None
    ticks = recording.topics.get(DEVICE_STATE)
    missing = None if ended is None else max(ended.ticks - (ticks.last_seq if ticks else 0), 0)
    return Completeness(not recording.recovered, recording.duration, missing, accounts(recording), overruns(recording))


class ClockRecord(msgspec.Struct):
    """How far the clock of a node's host was from the launcher's; its stamps are corrected by that already."""

    # What was added to that clock to get the time of the run, as measured last [s]; 0 on the launcher's host.
    offset: float
    error: float  # how far off that was at most, the largest bound of the whole recording [s]; 0 on the launcher's host


def clocks(recording: Recording) -> dict[str, ClockRecord]:
    """Tell how far the nodes' clocks were from the launcher's, by the recorded statuses: a manifest is written too early."""
    found: dict[str, ClockRecord] = {}
    for entry in recording.entries(topic for topic in recording.topics if message_type(topic) is NodeStatus):
        status = entry.message
        if isinstance(status, NodeStatus):
            before = found.get(status.node)
            found[status.node] = ClockRecord(status.clock_offset, max(status.clock_error, before.error if before else 0.0))
    return found


def _tick_topics(recording: Recording, status: NodeStatus) -> Sequence[str]:
    """Topics outside its own name that a node publishes, by the manifest."""
    found: dict[str, list[str]] = msgspec.json.decode(recording.manifest.get("publishes", "{}"))
    own = found.get(status.node) or found.get(status.node.removeprefix(f"{recording.namespace}/"), [])
    return [split(topic)[1] if recording.namespace else topic for topic in own]


def accounts(recording: Recording) -> dict[str, Account]:
    """Compare, node by node, what it says it sent with what was recorded."""
    topics = recording.topics
    since = max((figures.first_seq for topic, figures in topics.items() if topic in LOOP), default=0)
    left_out = overruns(recording) if since else 0
    decoder = msgspec.json.Decoder(NodeStatus)
    counts = dict.fromkeys(topics, 0)
    sent: dict[str, dict[int, int]] = {}
    early: dict[str, int] = {}
    found: dict[str, Account] = {}
    for topic, raw, offset in recording.raw():
        if message_type(topic) is NodeStatus:
            status = recording.decode(decoder, raw, offset)
            sent.setdefault(status.node, {})[status.pid] = status.sent
            ticking = _tick_topics(recording, status)
            inside = status.node.removeprefix(f"{recording.namespace}/")
            own = [t for t in topics if t in ticking or t.startswith(f"/{inside}/")]
            total, recorded = sum(sent[status.node].values()), sum(counts[t] for t in own)
            # What the first status counts and nobody received was sent before the logger listened, if no tick was sent yet.
            ahead = not since and not any(counts.get(t, 0) for t in ticking)
            before = early.setdefault(status.node, max(total - recorded, 0) if ahead else 0)
            lost = max(total - recorded - before, 0)
            if since:
                # What a node skipped for something newer is missing in seq too, but was never sent.
                lost = min(lost, max(sum(topics[t].gaps for t in own) - left_out, 0))
            # Where only some topics were recorded, there is nothing to compare.
            if not ticking or ticking[0] in topics:
                ended = status.state in ("finished", "failed")
                found[status.node] = Account(total, recorded, lost, before, since, ended)
        counts[topic] += 1
    return found


def overruns(recording: Recording) -> int:
    """Count the ticks that the driver left out while it was recorded: gaps in ``seq`` that are no losses."""
    ends: list[tuple[RawMessage, int]] = []
    for topic, raw, offset in recording.raw():
        if topic == DEVICE_STATE:
            ends[1:] = [(raw, offset)]
    decoder = msgspec.json.Decoder(DeviceState)
    counts = [recording.decode(decoder, raw, offset).overruns for raw, offset in ends]
    return counts[-1] - counts[0] if counts else 0
