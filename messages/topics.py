"""The topics and the message type each one carries."""

from messages.types import DeviceState, Event, Force, Handle, Message, NodeStatus, Proxy, Receipt

__all__ = [
    "DEVICE_STATE",
    "FIXED",
    "FORCE",
    "HANDLE",
    "LOOP",
    "PARTNER",
    "PROXY",
    "RECEIPT",
    "event",
    "message_type",
    "split",
    "status",
    "within",
]

DEVICE_STATE = "/device/state"
PROXY = "/environment/proxy"
FORCE = "/coupling/force"
HANDLE = "/device/handle"
RECEIPT = "/coupling/receipt"
PARTNER = "/partner/state"

LOOP: dict[str, type[Message]] = {DEVICE_STATE: DeviceState, PROXY: Proxy, FORCE: Force}
"""One message per tick on each of these."""

FIXED: dict[str, type[Message]] = {**LOOP, RECEIPT: Receipt, HANDLE: Handle, PARTNER: DeviceState}


def status(node: str) -> str:
    """Topic of the status of a `node`, by its name in its launch.

    Returns
    -------
    str
        ``/<node>/status``.
    """
    return f"/{node}/status"


def event(node: str) -> str:
    """Topic of the events of a `node`, by its name in its launch.

    Returns
    -------
    str
        ``/<node>/event``.
    """
    return f"/{node}/event"


def within(namespace: str, topic: str) -> str:
    """Put a `topic` of a chain (``/device/state``) into the `namespace` of the chain (``left``; empty for none), as in ROS.

    Returns
    -------
    str
        Full name, e.g. ``/left/device/state``.
    """
    return f"/{namespace}{topic}" if namespace else topic


def split(topic: str) -> tuple[str, str]:
    """Take the full name of a `topic` apart: the inverse of `within`.

    Returns
    -------
    tuple of str and str
        Namespace (empty for none) and topic inside the chain.
    """
    namespace, _, rest = topic.removeprefix("/").rpartition("/")
    namespace, _, middle = namespace.rpartition("/")
    return (namespace, f"/{middle}/{rest}") if namespace else ("", topic)


def message_type(topic: str) -> type[Message] | None:
    """Type of the messages on a `topic`: its full name, with or without a namespace.

    Returns
    -------
    type of Message or None
        None for a topic that is not part of the protocol.
    """
    topic = split(topic)[1]
    if topic in FIXED:
        return FIXED[topic]
    kinds: dict[str, type[Message]] = {"status": NodeStatus, "event": Event}
    return (
        kinds.get(topic.rsplit("/", 1)[1])
        if topic.count("/") == 2 and topic.startswith("/")
        else None
    )
