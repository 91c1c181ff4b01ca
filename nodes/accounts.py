"""Every message accounted for: what the nodes say they sent, what was recorded, and what was left out on purpose."""

from __future__ import annotations

import msgspec

from messages.topics import DEVICE_STATE, FORCE, LOOP, PROXY, RECEIPT, message_type
from messages.types import DeviceState, NodeStatus
from nodes.mcapfile import RawMessage
from nodes.recording import Recording


class Account(msgspec.Struct):
    """What a node says it sent against what was recorded of it.

    Attributes
    ----------
    sent : int
        Messages sent, by the last status of each of its processes.
    recorded : int
        Messages of the node recorded before that status.
    lost : int
        Difference; 0 when everything arrived. For a logger that came late, only what is missing in ``seq`` since then.
    since : int
        ``seq`` of the first recorded message of the node's tick topic: above 0 for a logger that came late.
    finished : bool
        Whether the last status is a final one: otherwise the node was killed, or the logger left before it.
    """

    sent: int
    recorded: int
    lost: int
    since: int
    finished: bool


def _tick_topics(kind: str) -> tuple[str, ...]:
    """Topics outside its own name that a kind of node publishes."""
    if "driver" in kind:
        return (DEVICE_STATE,)
    return {"environment": (PROXY,), "coupling": (FORCE, RECEIPT)}.get(kind, ())


def accounts(recording: Recording) -> dict[str, Account]:
    """Compare, node by node, what it says it sent with what was recorded.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    dict of str to Account
        By node name, for each node whose status was recorded.

    Raises
    ------
    RecordError
        When a status does not fit its type.
    """
    topics = recording.topics
    decoder = msgspec.json.Decoder(NodeStatus)
    counts = dict.fromkeys(topics, 0)
    sent: dict[str, dict[int, int]] = {}
    found: dict[str, Account] = {}
    for topic, raw, offset in recording.raw():
        if message_type(topic) is NodeStatus:
            status = recording.decode(decoder, raw, offset)
            sent.setdefault(status.node, {})[status.pid] = status.sent
            own = [t for t in topics if t in _tick_topics(status.kind) or t.startswith(f"/{status.node}/")]
            since = max((topics[t].first_seq for t in own if t in LOOP), default=0)
            total, recorded = sum(sent[status.node].values()), sum(counts[t] for t in own)
            lost = sum(topics[t].gaps for t in own) if since else max(total - recorded, 0)
            found[status.node] = Account(total, recorded, lost, since, status.state in ("finished", "failed"))
        counts[topic] += 1
    return found


def overruns(recording: Recording) -> int:
    """Count the ticks that the driver left out while it was recorded: gaps in ``seq`` that are no losses.

    Parameters
    ----------
    recording : Recording
        The recording.

    Returns
    -------
    int
        By the driver's own count; 0 without device states.

    Raises
    ------
    RecordError
        When a state does not fit its type.
    """
    ends: list[tuple[RawMessage, int]] = []
    for topic, raw, offset in recording.raw():
        if topic == DEVICE_STATE:
            ends[1:] = [(raw, offset)]
    decoder = msgspec.json.Decoder(DeviceState)
    counts = [recording.decode(decoder, raw, offset).overruns for raw, offset in ends]
    return counts[-1] - counts[0] if counts else 0
