"""Completeness of a recording: messages sent, recorded, left out and lost; clock offsets."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import msgspec

from messages.topics import DEVICE_STATE, LOOP, message_type, split, within
from messages.types import DeviceState, NodeStatus
from nodes.recording.reader import EXTRACT, WITHOUT, Recording
from nodes.recording.writer import CHOSEN, MANIFEST, read_ended


class Account(msgspec.Struct):
    """Messages a node sent, compared with those recorded."""

    sent: int  # messages sent, from the last status of each of the node's processes
    recorded: int  # messages of the node recorded before that status
    # Messages sent but not recorded; 0 if everything arrived. For a late logger or an extract,
    # only gaps in ``seq`` after the first recorded status that the driver did not leave out.
    lost: int
    # Messages sent before the logger listened or the extract begins, from the first recorded
    # status; they do not count as lost.
    early: int
    # First recorded ``seq`` of the node's chain; above 0 if the logger started late.
    since: int
    # Whether the last status is a final one; otherwise the node was killed, or the logger stopped
    # first.
    finished: bool

    @property
    def text(self) -> str:
        """Return the account as text."""
        whole = (
            "all there"
            if self.finished
            else "nothing missing so far; its end is not there"
        )
        parts = [f"{self.lost} lost" if self.lost else whole]
        parts += (
            [f"{self.early} before it was listened to"]
            if self.early and not self.since
            else []
        )
        parts += [f"recorded from seq {self.since} on"] if self.since else []
        return f"sent {self.sent}, recorded {self.recorded}: {', '.join(parts)}"


class Completeness(msgspec.Struct):
    """Whether a recording is complete; shown by ``bag info``, plots and summaries."""

    # whether the writer finished the file; False for a cut, recovered file
    complete: bool
    end_s: float  # time of the run at which the recording ends [s]
    # Ticks of the run after the end of a cut recording; None if no launch reported the run's
    # length.
    missing_ticks: int | None
    nodes: dict[str, Account]  # account of each node
    # Ticks that the driver left out: gaps in ``seq`` on every topic, but no losses; None if its
    # states were not recorded.
    left_out: int | None
    # Nodes with a status whose topics are unknown because the manifest is missing, and ``seq``
    # missing on topics of ticks.
    unknown: list[str] = []
    gaps: int = 0

    @property
    def lost(self) -> int | None:
        """Number of messages sent but not recorded; None if no node's count was recorded."""
        return (
            sum(account.lost for account in self.nodes.values()) if self.nodes else None
        )

    @property
    def text(self) -> str:
        """Return the verdict as text."""
        if not self.complete:
            after = (
                "what came after is"
                if self.missing_ticks is None
                else f"{self.missing_ticks} ticks after it are"
            )
            before = f"; {self.lost} messages lost before" if self.lost else ""
            return f"cut at {self.end_s:.3f} s; {after} not there{before}"
        if self.unknown:
            gaps = (
                f"{self.gaps} ticks missing in seq"
                if self.gaps
                else "no tick missing in seq"
            )
            who = ", ".join(self.unknown)
            return f"complete, {gaps}; losses of {who} unknown: the file has lost its manifest"
        if self.lost is None:
            return "complete, losses unknown: no node has its status and all its topics recorded"
        return f"complete, {f'{self.lost} messages' if self.lost else 'nothing'} lost"


def completeness(recording: Recording) -> Completeness:
    """Check whether a recording is complete."""
    ended = read_ended(recording.path) if recording.recovered else None
    last = [
        figures.last_seq
        for topic, figures in recording.topics.items()
        if split(topic)[1] == DEVICE_STATE
    ]
    missing = max(ended.ticks - max(last), 0) if ended and last else None
    nodes, left_out, unknown = _compared(recording)
    return Completeness(
        not recording.recovered,
        recording.duration,
        missing,
        nodes,
        left_out,
        unknown,
        sum(figures.gaps for figures in recording.topics.values()),
    )


class ClockRecord(msgspec.Struct):
    """Clock offset of a node's host to the launcher's; its stamps are already corrected."""

    # Last measured correction from that clock to the time of the run [s]; 0 on the launcher's
    # host.
    offset: float
    # Largest error bound of the correction during the recording [s]; 0 on the launcher's host.
    error: float


def clocks(recording: Recording) -> dict[str, ClockRecord]:
    """Return the clock offset of each node, read from the recorded statuses.

    The manifest is written before the offsets are measured.
    """
    found: dict[str, ClockRecord] = {}
    for entry in recording.entries(
        topic for topic in recording.topics if message_type(topic) is NodeStatus
    ):
        status = entry.message
        if isinstance(status, NodeStatus):
            before = found.get(status.node)
            found[status.node] = ClockRecord(
                status.clock_offset,
                max(status.clock_error, before.error if before else 0.0),
            )
    return found


def _tick_topics(recording: Recording, status: NodeStatus) -> Sequence[str]:
    """Return the topics outside its own name that a node publishes, from the manifest."""
    found = recording.facts(MANIFEST, "publishes", dict[str, list[str]])
    own = found.get(status.node) or found.get(
        status.node.removeprefix(f"{recording.namespace}/"), []
    )
    return [split(topic)[1] if recording.namespace else topic for topic in own]


def _all_taken(recording: Recording, topics: Collection[str]) -> bool:
    """Whether all of a node's `topics` were to be recorded, so that counts are comparable."""
    full = {within(recording.namespace, topic) for topic in topics}
    chosen = recording.facts(MANIFEST, CHOSEN, set[str])
    without = recording.facts(EXTRACT, WITHOUT, set[str])
    return not full & without and (not chosen or full <= chosen)


class _Told(msgspec.Struct):
    """Counts collected for one node; see `Account`."""

    own: list[str]  # its topics that were recorded
    chain: str  # its namespace
    since: int
    early: int
    comparable: bool  # whether all its topics were to be recorded
    known: bool  # whether its topics are known
    sent: dict[int, int] = {}  # by process
    recorded: int = 0
    finished: bool = False


def _first_told(
    recording: Recording,
    topic: str,
    status: NodeStatus,
    counts: dict[str, int],
    begins: dict[str, int],
) -> _Told:
    """Create the counts of a node from its first status."""
    ticking = _tick_topics(recording, status)
    place = topic.rpartition("/")[0]
    own = [t for t in counts if t in ticking or t.startswith(f"{place}/")]
    chain = split(topic)[0]
    since = begins.get(chain, max(begins.values(), default=0))
    # Messages counted but not received were sent before the logger listened, or before the extract
    # begins, provided that no tick was sent yet.
    ahead = since or not any(counts.get(t, 0) for t in ticking)
    early = max(status.sent - sum(counts[t] for t in own), 0) if ahead else 0
    comparable = (not ticking or ticking[0] in counts) and _all_taken(
        recording, {*ticking, topic, f"{place}/event"}
    )
    # Without a manifest, only topics inside its own name are known to be a node's.
    known = bool(recording.manifest) or any(split(t)[1] in LOOP for t in own)
    return _Told(own, chain, since, early, comparable and known, known)


def _compared(recording: Recording) -> tuple[dict[str, Account], int | None, list[str]]:
    """Return each node's account, the ticks left out, and the nodes of unknown topics."""
    topics = recording.topics
    places = {topic: split(topic) for topic in topics}
    begins: dict[str, int] = {}
    for topic, (chain, inside) in places.items():
        if inside in LOOP:
            begins[chain] = max(topics[topic].first_seq, begins.get(chain, 0))
    decoder = msgspec.json.Decoder(NodeStatus)
    statuses = {topic for topic in topics if message_type(topic) is NodeStatus}
    counts = dict.fromkeys(topics, 0)
    told: dict[str, _Told] = {}
    states = msgspec.json.Decoder(DeviceState)
    before = dict[str, DeviceState]()
    left_out = dict[str, int]()
    for topic, raw, offset in recording.raw():
        chain, inside = places[topic]
        if inside == DEVICE_STATE:
            state = recording.decode(states, raw, offset)
            last = before.get(chain, state)
            # A restarted driver counts from zero; in real time its seq continues the old one's.
            more = state.overruns - last.overruns if state.seq > last.seq else 0
            left_out[chain] = left_out.get(chain, 0) + max(more, 0)
            before[chain] = state
        elif topic in statuses:
            status = recording.decode(decoder, raw, offset)
            node = told.get(status.node)
            if node is None:
                node = told[status.node] = _first_told(
                    recording, topic, status, counts, begins
                )
            node.sent[status.pid] = status.sent
            node.recorded = sum(counts[t] for t in node.own)
            node.finished = status.state in ("finished", "failed")
        counts[topic] += 1
    found: dict[str, Account] = {}
    for name, node in told.items():
        sent = sum(node.sent.values())
        lost = max(sent - node.recorded - node.early, 0)
        if node.since:
            # Ticks that a node skipped are gaps in seq too, but were never sent.
            lost = min(
                lost,
                max(
                    sum(topics[t].gaps for t in node.own) - left_out.get(node.chain, 0),
                    0,
                ),
            )
        if node.comparable:
            found[name] = Account(
                sent, node.recorded, lost, node.early, node.since, node.finished
            )
    unknown = [name for name, node in told.items() if not node.known]
    return found, sum(left_out.values()) if left_out else None, unknown


def accounts(recording: Recording) -> dict[str, Account]:
    """Compare what each node says it sent with what was recorded."""
    return _compared(recording)[0]


def overruns(recording: Recording) -> int | None:
    """Count the ticks that drivers left out: gaps in ``seq``, no losses. None without states."""
    return _compared(recording)[1]
