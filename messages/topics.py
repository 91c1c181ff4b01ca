"""Topics and the message type of each."""

from messages.types import (
    DeviceState,
    Event,
    Force,
    Handle,
    Message,
    NodeStatus,
    Proxy,
    Receipt,
)

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
"""Topics with one message per tick."""

FIXED: dict[str, type[Message]] = {
    **LOOP,
    RECEIPT: Receipt,
    HANDLE: Handle,
    PARTNER: DeviceState,
}


def status(node: str) -> str:
    """Return the status topic of a `node`, by its name in its launch.

    Returns
    -------
    str
        ``/<node>/status``.
    """
    return f"/{node}/status"


def event(node: str) -> str:
    """Return the event topic of a `node`, by its name in its launch.

    Returns
    -------
    str
        ``/<node>/event``.
    """
    return f"/{node}/event"


def within(namespace: str, topic: str) -> str:
    """Return the full name of a chain's `topic` in a `namespace`, as in ROS.

    `topic` is, for example, ``/device/state``, and `namespace` ``left``, or empty for none.

    Returns
    -------
    str
        Full name, e.g. ``/left/device/state``.
    """
    return f"/{namespace}{topic}" if namespace else topic


def split(topic: str) -> tuple[str, str]:
    """Split the full name of a `topic`, the inverse of `within`.

    Returns
    -------
    tuple of str and str
        Namespace (empty for none) and topic inside the chain.
    """
    namespace, _, rest = topic.removeprefix("/").rpartition("/")
    namespace, _, middle = namespace.rpartition("/")
    return (namespace, f"/{middle}/{rest}") if namespace else ("", topic)


def message_type(topic: str) -> type[Message] | None:
    """Return the message type of a `topic`, given with or without namespace.

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
