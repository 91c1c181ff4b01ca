"""What the plain and the compiled side of a node share: structs that both read and write, laid out once.

Addresses are whole numbers: a kernel knows nothing of Python's objects. Whoever fills them in keeps alive what they point to.
"""

from __future__ import annotations

from ctypes import Array, Structure, c_double, c_int64
from functools import cache
from typing import Any, Final

NEVER: Final = 2**62  # a tick that does not come
LONGEST_OUT: Final = 1024  # room for one message sent [bytes]; the longest is under 600
LONGEST_IN: Final = 65536 + 64  # room for one message received [bytes]; a longer one is refused for its length
LONGEST_TOPIC: Final = 256  # room for a first frame [bytes]; of a longer one only the beginning is ever told
LONGEST_MAIL: Final = 4096  # room for a message that is not part of a tick [bytes]; a longer one makes the kernel stop
LONGEST_TEXT: Final = 128  # longest text in a message sent, encoded [bytes]

REALS: Final = 32  # room for the numbers of a message, read or to be written
WHOLES: Final = 16  # the same for its whole numbers
TEXTS: Final = 12  # where among the wholes address and size of a message's text stand; size -1 for one that is absent


def named(kind: Any, *names: str) -> list[tuple[str, Any]]:
    """Lay out fields of one type."""
    return [(name, kind) for name in names]


LOOP: Final[list[tuple[str, Any]]] = [  # the part that all nodes have
    # C functions
    *named(c_int64, "zmq_recv", "zmq_send", "zmq_getsockopt", "clock_gettime", "clock_nanosleep", "ppoll", "sched_yield"),
    # sockets; ``aside`` is 0 where listeners have none of their own
    *named(c_int64, "inbox", "hop", "aside"),
    # buffers
    *named(c_int64, "expected", "frame", "payload", "spare", "topic", "out_keys", "text", "out", "sent", "held", "held_sizes"),
    *named(c_int64, "time", "events", "events_size", "mail_topic", "mail_payload"),
    # what is fixed: sizes [bytes], messages collected for listeners, pace
    *named(c_int64, "expected_size", "topic_size", "text_size", "batch", "realtime"),
    *named(c_double, "period", "clock_offset"),
    # how many ticks at most before the kernel stops, and before which tick
    *named(c_int64, "most", "until"),
    # what goes on from tick to tick: the tick taken last, and of who answers ticks the one answered last, -1 before the first
    *named(c_int64, "seq", "answered", "gaps"),
    # messages left out for newer ones; whether one was just now
    *named(c_int64, "skipped", "skipping", "ticks", "held_count", "sent_size"),
    # what was taken off the socket and must be put back: 0, 1 (topic) or 2 frames, and their sizes [bytes]
    *named(c_int64, "frames", "frame_size", "payload_size"),
    # the size of the message that was left out last [bytes]
    *named(c_int64, "spare_size"),
    # a message that another thread wants sent: whether there is one, the sizes of its frames [bytes], how many were sent so far
    *named(c_int64, "mail", "mail_topic_size", "mail_size", "mailed"),
    # ticks since the kernel looked for mail, and whether a listener has sent something that must be taken in
    *named(c_int64, "unlooked", "upstream"),
    # the numbers of the message read, and of the one to be written
    ("reals", c_double * REALS),
    ("wholes", c_int64 * WHOLES),
    ("out_reals", c_double * REALS),
    ("out_wholes", c_int64 * WHOLES),
]


@cache
def _ordinary(struct: type[Structure]) -> type[Any]:
    zeros: dict[str, Any] = {name: kind() for name, kind, *_ in struct._fields_}

    def begin(state: Any, **given: Any) -> None:
        for name, zero in zeros.items():
            setattr(state, name, list(zero) if isinstance(zero, Array) else zero.value)
        for name, value in given.items():
            setattr(state, name, value)

    body = {"__slots__": tuple(zeros), "__init__": begin, "__doc__": struct.__doc__, "_fields_": struct._fields_}
    return type(struct.__name__, (), body)


def state_of(struct: type[Structure], compiled: bool = False, **given: Any) -> Any:
    """Make a state: the struct itself, or for the interpreter alone an ordinary object, with which rules take 5 µs of 13."""
    return (struct if compiled else _ordinary(struct))(**given)
