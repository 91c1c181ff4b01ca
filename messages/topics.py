"""The topics and the message type each one carries."""

from __future__ import annotations

from messages.types import DeviceState, Event, Force, Message, NodeStatus, Proxy, Receipt

__all__ = [
    "DEVICE_STATE",
    "FIXED",
    "FORCE",
    "LOOP",
    "PROXY",
    "RECEIPT",
    "event",
    "message_type",
    "status",
]

DEVICE_STATE = "/device/state"
PROXY = "/environment/proxy"
FORCE = "/coupling/force"
RECEIPT = "/coupling/receipt"

LOOP: dict[str, type[Message]] = {DEVICE_STATE: DeviceState, PROXY: Proxy, FORCE: Force}
"""One message per tick on each of these."""

FIXED: dict[str, type[Message]] = {**LOOP, RECEIPT: Receipt}


def status(node: str) -> str:
    """Topic of a node's status.

    Parameters
    ----------
    node : str
        Name of the node in its launch.

    Returns
    -------
    str
        ``/<node>/status``.
    """
    return f"/{node}/status"


def event(node: str) -> str:
    """Topic of a node's events.

    Parameters
    ----------
    node : str
        Name of the node in its launch.

    Returns
    -------
    str
        ``/<node>/event``.
    """
    return f"/{node}/event"


def message_type(topic: str) -> type[Message] | None:
    """Type of the messages on a topic.

    Parameters
    ----------
    topic : str
        Full topic name.

    Returns
    -------
    type of Message or None
        None for a topic that is not part of the protocol.
    """
    if topic in FIXED:
        return FIXED[topic]
    if topic.count("/") == 2 and topic.startswith("/"):
        kinds: dict[str, type[Message]] = {"status": NodeStatus, "event": Event}
        return kinds.get(topic.rsplit("/", 1)[1])
    return None
