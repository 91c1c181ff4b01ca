"""What the plain and the compiled side of a node share: structs that both read and write, laid out once.

Addresses are whole numbers: a kernel knows nothing of Python's objects. Whoever fills them in keeps
alive what they point to.
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
LONGEST_OUT: Final = 1024  # room for one message sent [bytes]; the longest is under 600
# room for one message received [bytes]; a longer one is refused for its length
LONGEST_IN: Final = 65536 + 64
# room for a first frame [bytes]; of a longer one only the beginning is ever told
LONGEST_TOPIC: Final = 256
# room for a message that is not part of a tick [bytes]; a longer one makes the kernel stop
LONGEST_MAIL: Final = 4096
LONGEST_TEXT: Final = 128  # longest text in a message sent, encoded [bytes]

REALS: Final = 32  # room for the numbers of a message, read or to be written
WHOLES: Final = 16  # the same for its whole numbers
# where among the wholes address and size of a message's text stand; size -1 for one that is absent
TEXTS: Final = 12


Vector3: TypeAlias = Annotated[list[float], 3]
"""Three floats of a struct."""

_NUMBERS: Final[dict[Any, Any]] = {float: c_double, int: c_int64}
S = TypeVar("S")


def struct(declared: type[S]) -> type[S]:
    """Lay out the annotations of a class as a ctypes struct, those of its base first.

    ``float`` and ``int`` are one number of 64 bits; ``Annotated[list[float], n]`` is an array of n.
    A type checker sees the class as it is written, so a misspelt variable is an error; numba sees
    the struct.

    Raises
    ------
    TypeError
        For an annotation that is none of these.
    """
    hints = get_type_hints(declared, include_extras=True)
    # The checker's bases are the struct's own fields here: numpy and numba look at one list of
    # them.
    fields = [
        (name, _laid_out(f"{declared.__name__}.{name}", kind)) for name, kind in hints.items()
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
        if get_origin(items) is list and get_args(items)[0] in _NUMBERS and isinstance(size, int):
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
    inbox: int  # subscription that brings the ticks
    hop: int  # publisher of the next hop
    aside: int  # publisher of the listeners; 0 where they share the hop's

    # Addresses of buffers
    expected: int  # topic that is followed
    frame: int  # first frame taken
    payload: int  # second frame taken
    spare: int  # payload left out for a newer one
    topic: int  # topic that is published
    out_keys: int  # keys of the message published, encoded
    text: int  # its text, encoded
    out: int  # room for it
    sent: int  # the message sent last
    held: int  # messages collected for listeners
    held_sizes: int  # their sizes
    time: int  # two whole numbers for the clock
    events: int  # room for a socket's option
    events_size: int  # room for that option's size
    mail_topic: int  # frames that another thread wants sent
    mail_payload: int

    # What is fixed
    expected_size: int  # [bytes]
    topic_size: int  # [bytes]
    text_size: int  # [bytes]; -1 for no text
    batch: int  # messages collected for listeners at most
    realtime: int  # 1 in real time, 0 in lockstep
    period: float  # sampling period T [s]
    clock_offset: float  # added to this host's clock to get the run's time [s]
    most: int  # ticks at most before the kernel stops
    until: int  # tick before which it stops

    # What goes on from tick to tick
    seq: int  # tick taken last; -1 before the first
    answered: int  # tick answered last; -1 before the first
    gaps: int  # ticks that never came
    skipped: int  # messages left out for newer ones
    skipping: int  # 1 where one was left out just now
    ticks: int  # ticks done
    held_count: int  # messages collected for listeners
    sent_size: int  # [bytes]
    frames: int  # frames taken that must be put back: 0, 1 (topic) or 2
    frame_size: int  # [bytes]
    payload_size: int  # [bytes]
    spare_size: int  # of the message that was left out last [bytes]
    mail: int  # 1 where another thread has a message to send
    mail_topic_size: int  # [bytes]
    mail_size: int  # [bytes]
    mailed: int  # messages of other threads sent so far
    unlooked: int  # ticks since the kernel looked for mail
    upstream: int  # 1 where a listener has sent something that must be taken in

    # Numbers of the message read
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
    """Return a new state: the struct itself, or for the interpreter an ordinary object, with which rules take 5 µs of 13."""
    kind: Any = struct
    made: S = (kind if compiled else _ordinary(kind))(**given)
    return made


def address_of(state: Any) -> int:
    """Return where a state that is a struct stands, for compiled code."""
    return addressof(state)
