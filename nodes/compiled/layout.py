"""Structs shared by the plain and the compiled side of a node.

Addresses are integers, because a kernel has no Python objects. The side that sets an address keeps
its target alive.
"""

from __future__ import annotations

from ctypes import Array, Structure, addressof, c_double, c_int64
from functools import cache
from typing import (
    Annotated,
    Any,
    Final,
    TypeAlias,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

NEVER: Final = 2**62  # a tick that does not come
# buffer for one message sent [bytes]; the longest is below 600
LONGEST_OUT: Final = 1024
# buffer for one received message [bytes]; a longer one is refused
LONGEST_IN: Final = 65536 + 64
# buffer for a first frame [bytes]; only the beginning of a longer one is reported
LONGEST_TOPIC: Final = 256
# buffer for a message outside the ticks [bytes]; a longer one makes the kernel stop
LONGEST_OUTGOING: Final = 4096
LONGEST_TEXT: Final = 128  # longest encoded text in a message sent [bytes]

REALS: Final = 32  # floats of a message, decoded or to encode
WHOLES: Final = 16  # the same for its integers
# index in the integers of address and size of a message's text; size -1 if absent
TEXTS: Final = 12


Vector3: TypeAlias = Annotated[list[float], 3]
"""Three floats of a struct."""

_NUMBERS: Final[dict[Any, Any]] = {float: c_double, int: c_int64}
S = TypeVar("S")


def struct(declared: type[S]) -> type[S]:
    """Return the annotations of a class as a ctypes struct, base class first.

    ``float`` and ``int`` are one number of 64 bits; ``Annotated[list[float], n]`` is an array of n.
    A type checker sees the class as it is written, so a misspelt variable is an error; numba sees
    the struct.

    Raises
    ------
    TypeError
        For any other annotation.
    """
    hints = get_type_hints(declared, include_extras=True)
    # All fields go into one list, because numpy and numba do not look at base classes.
    fields = [
        (name, _laid_out(f"{declared.__name__}.{name}", kind))
        for name, kind in hints.items()
    ]
    body = {
        "_fields_": fields,
        "__annotations__": hints,
        "__doc__": declared.__doc__,
        "__module__": declared.__module__,
    }
    return cast("type[S]", type(declared.__name__, (Structure,), body))


def _laid_out(where: str, kind: Any) -> Any:
    if kind in _NUMBERS:
        return _NUMBERS[kind]
    if get_origin(kind) is Annotated:
        items, size = get_args(kind)
        if (
            get_origin(items) is list
            and get_args(items)[0] in _NUMBERS
            and isinstance(size, int)
        ):
            return _NUMBERS[get_args(items)[0]] * size
    raise TypeError(
        f"{where}: {kind!r} has no place in a struct; use float, int or Annotated[list[float], n]"
    )


@struct
class LoopState:
    """The part of a state that all nodes have."""

    here: int  # address of this state, for what is written straight out of it

    # Addresses of C functions
    zmq_recv: int
    zmq_send: int
    zmq_getsockopt: int
    clock_gettime: int
    clock_nanosleep: int
    ppoll: int
    sched_yield: int

    # Addresses of sockets
    inbox: int  # subscription to the followed topic
    hop: int  # publisher of the next hop
    aside: int  # publisher of the listeners; 0 if they share the hop's

    # Addresses of buffers
    expected: int  # topic that is followed
    frame: int  # first frame received
    payload: int  # second frame received
    spare: int  # payload skipped for a newer one
    topic: int  # topic that is published
    out_keys: int  # encoded keys of the message published
    text: int  # its encoded text
    out: int  # buffer of the message published
    sent: int  # last message sent
    held: int  # messages collected for listeners
    held_sizes: int  # their sizes
    time: int  # two integers for the clock
    events: int  # value of a socket option
    events_size: int  # size of that option
    outgoing_topic: int  # frames posted by another thread
    outgoing_payload: int

    # Constants
    expected_size: int  # [bytes]
    topic_size: int  # [bytes]
    text_size: int  # [bytes]; -1 for no text
    batch: int  # batch of messages for listeners
    realtime: int  # 1 in real time, 0 in lockstep
    period: float  # sampling period T [s]
    clock_offset: float  # added to this host's clock to get the run's time [s]
    most: int  # most ticks before the kernel stops
    until: int  # tick before which it stops

    # What changes from tick to tick
    seq: int  # last tick received; -1 before the first
    answered: int  # last tick answered; -1 before the first
    gaps: int  # missing ticks
    skipped: int  # messages skipped for newer ones
    skipping: int  # 1 if one was just skipped
    ticks: int  # ticks done
    held_count: int  # messages in the batch for listeners
    sent_size: int  # [bytes]
    frames: int  # received frames that must be put back: 0, 1 (topic) or 2
    frame_size: int  # [bytes]
    payload_size: int  # [bytes]
    spare_size: int  # of the last skipped message [bytes]
    outgoing: int  # 1 if another thread has posted a message
    outgoing_topic_size: int  # [bytes]
    outgoing_size: int  # [bytes]
    outgoing_sent: int  # posted messages sent so far
    unlooked: int  # ticks since the kernel checked for posted messages
    upstream: int  # 1 if a listener has sent something

    # Numbers of the decoded message
    reals: Annotated[list[float], REALS]
    wholes: Annotated[list[int], WHOLES]


@cache
def _ordinary(struct: Any) -> type[Any]:
    zeros: dict[str, Any] = {name: kind() for name, kind, *_ in struct._fields_}

    def begin(state: Any, **given: Any) -> None:
        for name, zero in zeros.items():
            setattr(state, name, list(zero) if isinstance(zero, Array) else zero.value)
        for name, value in given.items():
            setattr(state, name, value)

    body = {
        "__slots__": tuple(zeros),
        "__init__": begin,
        "__doc__": struct.__doc__,
        "_fields_": struct._fields_,
    }
    return type(struct.__name__, (), body)


def state_of(struct: type[S], compiled: bool = False, **given: Any) -> S:
    """Return a new state: the struct, or for the interpreter an object with the same fields.

    With the object, interpreted rules take 5 µs instead of 13.
    """
    kind: Any = struct
    made: S = (kind if compiled else _ordinary(kind))(**given)
    return made


def address_of(state: Any) -> int:
    """Return the address of a state that is a struct."""
    return addressof(state)
