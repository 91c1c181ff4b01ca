"""State of a driver: one struct that interpreted and compiled ticks update in place.

A new variable is one line here, and one where it is used. Absent limits are infinite. Rules are
plain functions on the struct, each in the module of its subject; they report a code with numbers
(`note`), which nodes/driver/force_words.py turns into text after the tick.
"""

from __future__ import annotations

from typing import Annotated, Final

from messages.types import DeviceState
from nodes.compiled.layout import LoopState, Vector3, struct
from nodes.compiled.published import published
from nodes.compiled.rules import rule

BETWEEN: Final = 0
# phase: sample published, awaiting its force (BETWEEN: before the sample)
WAITING: Final = 1
IDLE, RAMP, ACTIVE, DAMPING, NOTHING, FAULT, STOPPED = range(7)
SAFETY: Final = ("waiting", "ramp", "active", "damping", "zero", "fault", "stopped")
"""States of the safety, and their names in messages."""

REFUSED: Final = ("future", "replayed", "stale", "not_finite")
LIMITED: Final = ("peak", "slew", "continuous")

BINS: Final = 50_000
RECENT: Final = 512  # newest response times, kept for the status line
PEAKS: Final = 64  # most moments at which the force reached its limit

NOTES: Final = 32
# numbers of a note: code, tick, change of state, and five more
NOTE: Final = 8


@struct
class DriverState(LoopState):
    """State that a driver keeps between ticks."""

    # The device
    device_read: int  # address of its compiled read; 0 for a device in Python
    device_write: int  # address of its compiled write
    device_context: int  # their first argument
    device_room: int  # address of six floats: position and target, or a force
    virtual: int  # 1 for a simulated device
    axes: int  # computed axes
    axis: Annotated[list[int], 3]  # index of each
    attention: int  # 1 if another thread wants compiled ticks to return
    fd: int  # descriptor of the inbox
    poll: int  # address of its struct pollfd

    # The tick
    # WAITING: sample published, awaiting its force; BETWEEN: before the sample
    phase: int
    next_tick: int  # 1 if a force takes effect at the next deadline
    epoch: float  # time of tick 0 [s]
    sampled: float  # time at which this tick's sample was published [s]
    arrival: float  # time of reception of the message [s]
    late_answer_at: float  # the same of a message kept for the next tick [s]
    lateness: float  # delay of the sample after its deadline [s]
    response: float  # time from publishing the sample to its answer [s]
    delay: float  # from the last tick's sample to its force taking effect [ticks]
    position_ready: int  # 1 if the driver has already read the position
    # outcome of a message that the driver has already processed, plus 1
    pending_result: int
    failed: int  # 1 after a failed call of the device
    waits_until: float  # time until which this tick waits for its answer [s]
    late_answer: int  # 1 if a message is kept for the next tick
    heard: int  # 1 if a message came in this tick
    unanswered: int  # successive ticks without their answer
    patient: int  # 1 if one came in the last tick: wait for a late answer
    has_following: int  # 1 if `following` is handed over at the next deadline
    written: int  # tick for which a force was last handed over
    age: int  # age of the acting force [ticks]
    oldest_age: int  # largest age so far [ticks]
    missed: int  # ticks without an answer in time
    overruns: int  # skipped ticks
    taken: int  # messages received
    states_sent: int  # states published
    asked: int  # tick of the last published sample
    stamp: float  # its time, as told in the message [s]

    # The message received
    got: Vector3  # its force [N]
    got_seq: int  # tick that it answers
    got_normal: Vector3  # normal of the surface of its force; 0 for none
    got_credit: float  # energy that a partner has put in so far [J]

    # Forces under way
    wanted: Vector3  # through ramp, guard and limits [N]
    force: Vector3  # last one decided, after all limits [N]
    handed: Vector3  # acting on the device [N]
    following: Vector3  # handed over at the next deadline [N]
    slewed: Vector3  # change of the force in this tick [N]
    mean: Vector3  # mean force of this tick up to `split` [N]
    split: float  # time in the tick up to which `mean` is complete [ticks]
    # time in the tick at which the first new force was written; 1 for none [ticks]
    changed_at: float
    # ticks without a write after which the device lets go by itself
    device_hold_ticks: float
    # forces from outside, in two places (nodes/driver/external.py) [N]
    external: Annotated[list[float], 6]
    external_until: Annotated[list[int], 2]  # tick up to which each is valid
    external_at: int  # the valid place

    # Motion
    place: Vector3  # position just read [m]
    target: Vector3  # point to which a simulated hand pulls [m]
    position: Vector3  # newest sample [m]
    before: Vector3  # previous sample [m]
    acting: Vector3  # mean force since the newest sample [N]
    acted: Vector3  # mean force between the two [N]
    velocity: Vector3  # [m/s]
    at: float  # time of the newest sample [s]
    at_before: float  # time of the previous sample [s]
    begun: int  # samples since the start or a jump, 2 at most
    elapsed: int  # ticks between the two newest samples
    covered: int  # ticks that `acting` covers
    samples: int  # address of the newest samples
    places: int  # address of positions before the newest
    places_count: int
    lines: int  # address of the forces under way, one line per axis
    line_length: int  # ticks of a line; 0 without latency
    line_part: float  # fraction of a tick in the latency
    energy: float  # generated by the virtual side so far [J]
    highest: float  # largest so far [J]
    longest: float  # longest time over which a velocity is taken [s]

    # Safety
    safety: int  # index into SAFETY
    force_seq: int  # tick that the force answers; -1 before the first
    since: int  # tick of the last fresh force
    limited_at: int  # tick of the last limiting
    max_age: int  # largest accepted age of a force [ticks]
    watchdog: int  # ticks without a fresh force before damping
    damping_ticks: int  # ticks of damping before zero
    damping: float  # gain of that damper [N s/m]
    start_ticks: int  # ramp of the first force [ticks]
    recovery_ticks: int  # ramp of a returning force after a whole gap [ticks]
    ramp_ticks: int  # length of the present ramp [ticks]
    ramp_seq: int  # tick of its last growth
    regained: float  # part of it that is done [ticks]
    away_from: float  # tick since which there was no force
    peak: float  # largest force on an axis [N]
    slew: float  # largest change of a force in a tick [N]
    unlimited: int  # 1 without any limit
    reach: float  # farthest valid position [m]
    bounded: int  # 1 if `workspace` is finite
    workspace: Annotated[list[float], 6]  # low and high by axis [m]
    brake: Vector3  # damper's force after a stop [N]
    entered: Annotated[list[int], len(SAFETY)]  # how often each state was entered
    refused_for: Annotated[list[int], len(REFUSED)]  # messages refused by reason
    limited_by: Annotated[list[int], len(LIMITED)]  # forces limited by which limit

    # Jumps without motion
    jumped: int  # 1 if the position just read has jumped
    rebased: int  # tick of the latest jump; 0 for none
    felt: Vector3  # force when the position jumped [N]
    felt_seq: int  # tick of that jump
    fading: float  # ticks for which `felt` still fades
    begins: int  # 1 if the next force has no cause in motion: a start, or a jump
    always_ramp: int  # 1 if the first force always has a ramp

    # Oscillations
    # times at the peak within STOP_WINDOW that stop the driver; 0: never
    stop_after: int
    peaked: int  # 1 if the force has just reached its peak
    peaks_count: int  # how often it has
    peaks: Annotated[list[float], 2 * PEAKS]  # ring of tick and energy of each
    sides: Annotated[list[int], 3]  # side on which each axis is at its peak; 0 for none
    stopped_at: int  # tick of the stop
    pressed_since: int  # tick since which the force is at its peak; -1: it is not
    pressed_at: int  # tick at which that last counted
    pressed_ticks: int  # ticks after which it counts again
    pressed_energy: float  # energy generated when the force reached its peak [J]

    # Motor heat
    continuous: float  # largest lasting force [N]
    heat: float  # mean square of the force [N²]
    heat_keep: float  # share of it that remains per tick
    heat_reserve: float  # share that remains over a gap
    heat_largest: float  # largest square of this tick [N²]
    heat_part: float  # heat as part of its limit; 0 without a limit

    # Guard
    guard_on: int
    guard_bounded: int  # 1 if `guard_stiffness` limits the stored energy
    guard_stiffness: float  # of the spring that the law stands for [N/m]
    guard_rate: float  # damping over T of the absorber [N/m]
    guard_allowance: float  # energy generated before the guard acts [J]
    guard_energy: Vector3  # accounts of generated energy [J]
    guard_owed: float  # sum of the accounts at the newest sample [J]
    guard_highest: float  # largest so far [J]
    guard_step: Vector3  # displacement expected in a tick [m]
    normal: Vector3  # normal of the acting force; 0 for none
    guard_surplus: float  # energy that a partner may generate, so far [J]
    guard_credit: float  # energy of a partner that was added, so far [J]
    guard_partner: int  # 1 once a partner has sent its energy
    lowered: int  # forces that the guard lowered
    raised: int  # forces that it raised

    # Response times
    recent: Annotated[list[float], RECENT]  # ring of the newest [s]
    recent_at: int  # its position
    counted: int  # response times so far
    bins: int  # address of their counts

    # What becomes an event after the tick
    notes: Annotated[list[float], NOTE * NOTES]
    notes_count: int
    texts: Annotated[list[int], len(SAFETY)]  # addresses of the states' names, encoded
    text_sizes: Annotated[list[int], len(SAFETY)]  # [bytes]


PUBLISHED: Final = published(
    DeviceState,
    DriverState,
    seq="asked",
    mean_force="acting",
    guard="guard_owed",
    surplus="guard_surplus",
    heat="heat_part",
)
"""Where the fields of a device state stand here; whatever is not named has the same name."""


@rule
def note(
    s: DriverState,
    code: int,
    seq: int,
    change: int,
    a: float = 0.0,
    b: float = 0.0,
    c: float = 0.0,
    d: float = 0.0,
    e: float = 0.0,
) -> None:
    """Queue a note; it becomes an event after the tick."""
    if s.notes_count >= NOTES:
        # No tick has so many; compiled code would write beyond the end.
        return
    at = NOTE * s.notes_count
    s.notes[at], s.notes[at + 1], s.notes[at + 2] = (
        float(code),
        float(seq),
        float(change),
    )
    (
        s.notes[at + 3],
        s.notes[at + 4],
        s.notes[at + 5],
        s.notes[at + 6],
        s.notes[at + 7],
    ) = (a, b, c, d, e)
    s.notes_count += 1


@rule
def seldom(count: int) -> bool:
    """Return whether the n-th of many alike is reported: at powers of two."""
    return count & (count - 1) == 0
