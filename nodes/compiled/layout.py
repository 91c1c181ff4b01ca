"""What the plain and the compiled side of a node share: structs that both read and write, laid out once.

Addresses are whole numbers: a kernel knows nothing of Python's objects. Whoever fills them in keeps alive what they point to.
"""

from __future__ import annotations

from ctypes import Array, Structure, c_double, c_int64
from functools import cache
from typing import Any, Final, NamedTuple

NEVER: Final = 2**62
"""A tick that does not come."""

LONGEST_OUT: Final = 1024
"""Room for one message sent [bytes]; the longest is under 600."""

LONGEST_IN: Final = 65536 + 64
"""Room for one message received [bytes]; a longer one is refused for its length."""

LONGEST_TOPIC: Final = 256
"""Room for a first frame [bytes]; of a longer one only the beginning is ever told."""

LONGEST_MAIL: Final = 4096
"""Room for a message that is not part of a tick [bytes]; a longer one makes the kernel stop."""

LONGEST_TEXT: Final = 128
"""Longest text in a message sent, encoded [bytes]."""

REALS: Final = 32
WHOLES: Final = 16
"""Room for a message's numbers, read or to be written."""

TEXTS: Final = 12
"""Where among the wholes address and size of a message's text stand; size -1 for one that is absent."""


class Counted(NamedTuple):
    """How far a node is: its tick, ticks handled, ticks missing in what it follows, messages left out for newer ones."""

    seq: int
    ticks: int
    gaps: int
    skipped: int


class Counters:
    """The same of a node without compiled ticks, and -1 for the tick before the first."""

    def __init__(self) -> None:
        self.seq = self.answered = -1
        self.ticks = self.gaps = self.skipped = self.mailed = 0


_ADDRESSES: Final = [
    # C functions
    "zmq_recv",
    "zmq_send",
    "zmq_getsockopt",
    "clock_gettime",
    "clock_nanosleep",
    "ppoll",
    "sched_yield",
    # sockets; ``aside`` is 0 where listeners have none of their own
    "inbox",
    "hop",
    "aside",
    # buffers
    "expected",
    "frame",
    "payload",
    "spare",
    "topic",
    "out_keys",
    "text",
    "out",
    "sent",
    "held",
    "held_sizes",
    "time",
    "events",
    "events_size",
    "mail_topic",
    "mail_payload",
]

LOOP: Final[list[tuple[str, Any]]] = [
    *((name, c_int64) for name in _ADDRESSES),
    # what is fixed: sizes [bytes], messages collected for listeners, pace
    ("expected_size", c_int64),
    ("topic_size", c_int64),
    ("text_size", c_int64),
    ("batch", c_int64),
    ("realtime", c_int64),
    ("period", c_double),
    ("clock_offset", c_double),
    # how many ticks at most before the kernel stops, and before which tick
    ("most", c_int64),
    ("until", c_int64),
    # what goes on from tick to tick: the tick taken last, and of who answers ticks the one answered last, -1 before the first
    ("seq", c_int64),
    ("answered", c_int64),
    ("gaps", c_int64),
    # messages left out for newer ones; whether one was just now
    ("skipped", c_int64),
    ("skipping", c_int64),
    ("ticks", c_int64),
    ("held_count", c_int64),
    ("sent_size", c_int64),
    # what was taken off the socket and must be put back: 0, 1 (topic) or 2 frames, and their sizes [bytes]
    ("frames", c_int64),
    ("frame_size", c_int64),
    ("payload_size", c_int64),
    # the message that was left out last, and its size [bytes]
    ("spare_size", c_int64),
    # a message that another thread wants sent: whether there is one, the sizes of its frames [bytes], how many were sent so far
    ("mail", c_int64),
    ("mail_topic_size", c_int64),
    ("mail_size", c_int64),
    ("mailed", c_int64),
    # ticks since the kernel looked for mail, and whether a listener has sent something that must be taken in
    ("unlooked", c_int64),
    ("upstream", c_int64),
    # the numbers of the message read, and of the one to be written
    ("reals", c_double * REALS),
    ("wholes", c_int64 * WHOLES),
    ("out_reals", c_double * REALS),
    ("out_wholes", c_int64 * WHOLES),
]
"""The part that all nodes have."""


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
    """Make a state: the struct itself, or, where the interpreter has it for itself, an ordinary object of the same fields.

    With it a driver's rules take the interpreter less than half of the time that fields of a struct take: 5 µs of 13.
    """
    return (struct if compiled else _ordinary(struct))(**given)
