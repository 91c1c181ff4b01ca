"""The state of a driver: one struct, which interpreted and compiled ticks read and write where it stands.

A new variable is a line here, and one where it is used. Whatever has no limit holds infinity. Rules
are plain functions on the struct, each in the module of what it rules; what they report is a code
with numbers (`note`), which nodes/driver/force_words.py turns into words when the tick is done.
"""

from __future__ import annotations

from typing import Annotated, Final

from nodes.compiled.layout import LoopState, Vector3, struct
from nodes.compiled.rules import rule

BETWEEN: Final = 0
WAITING: Final = 1  # stands after its sample, for the force that answers it; 0: before it
IDLE, RAMP, ACTIVE, DAMPING, NOTHING, FAULT, STOPPED = range(7)
SAFETY: Final = ("waiting", "ramp", "active", "damping", "zero", "fault", "stopped")
"""What the safety does with forces: its states, and their names in messages."""

REFUSED: Final = ("future", "replayed", "stale", "not_finite")
LIMITED: Final = ("peak", "slew", "continuous")

BINS: Final = 50_000
RECENT: Final = 512  # newest response times that are kept as they are, for the status line
PEAKS: Final = 64  # room for the moments at which the force came to its limit

NOTES: Final = 32
# numbers of a note on what the rules do in a tick: code, tick, change of state, and five more
NOTE: Final = 8


@struct
class DriverState(LoopState):
    """Everything a driver keeps from tick to tick."""

    # The device
    device_read: int  # address of its compiled read, 0 for one in Python
    device_write: int  # address of its compiled write
    device_context: int  # what both are called with
    device_room: int  # room for six floats: position and target, or a force
    virtual: int  # 1 for a simulated device
    axes: int  # computed axes
    axis: Annotated[list[int], 3]  # which ones
    attention: int  # 1 where another thread asks compiled ticks to come back
    fd: int  # descriptor of the inbox
    poll: int  # address of its struct pollfd

    # The tick
    phase: int  # WAITING: sample published, awaiting its force; BETWEEN: before the sample
    next_tick: int  # 1 where a force takes effect at the next deadline
    epoch: float  # time of tick 0 [s]
    sampled: float  # time at which this tick's sample was published [s]
    arrival: float  # time at which the message taken came [s]
    late_answer_at: float  # time at which one came that is kept for the next tick [s]
    lateness: float  # how long after its deadline the tick was sampled [s]
    response: float  # time from publishing the sample to its answer [s]
    delay: float  # from the last tick's sample to its force taking effect [ticks]
    place_given: int  # 1 where the position was read by somebody else
    given: int  # what somebody else made of a message, plus 1
    failed: int  # 1 after a call of the device that failed
    late_answer: int  # 1 where a message is kept for the next tick
    heard: int  # 1 where a message came in this tick
    unanswered: int  # ticks in a row without their answer
    patient: int  # 1 where one came in the last tick: a late answer is waited for
    has_following: int  # 1 where `following` is handed over at the next deadline
    written: int  # tick for which a force was handed over last
    age: int  # age of the force that acts [ticks]
    oldest_age: int  # largest of all [ticks]
    missed: int  # ticks without an answer in time
    overruns: int  # ticks that were left out
    taken: int  # messages taken
    states_sent: int  # states published
    asked: int  # tick whose sample was published last

    # The message taken
    got: Vector3  # its force [N]
    got_seq: int  # tick that it answers
    got_normal: Vector3  # normal of the surface that its force comes from; 0 for none
    got_credit: float  # energy that a partner has put in so far [J]

    # Forces on their way
    wanted: Vector3  # through ramp, guard and limits [N]
    force: Vector3  # decided last, after all limits [N]
    handed: Vector3  # on the device [N]
    following: Vector3  # handed over at the next deadline [N]
    slewed: Vector3  # how far the force has changed in this tick [N]
    mean: Vector3  # mean force of this tick up to `split` [N]
    split: float  # place in the tick up to which `mean` is complete [ticks]
    # place in the tick at which the first new force was written; 1 for none [ticks]
    changed_at: float
    device_hold_ticks: float  # ticks without a write after which the device lets go by itself
    # forces from outside, two places (nodes/driver/external.py) [N]
    external: Annotated[list[float], 6]
    external_until: Annotated[list[int], 2]  # tick up to which each holds
    external_at: int  # which one counts

    # Motion
    place: Vector3  # position just read [m]
    target: Vector3  # where a simulated hand pulls to [m]
    position: Vector3  # newest sample [m]
    before: Vector3  # the sample before it [m]
    acting: Vector3  # mean force since the newest sample [N]
    acted: Vector3  # mean force between the two [N]
    velocity: Vector3  # [m/s]
    at: float  # time of the newest sample [s]
    at_before: float  # time of the sample before it [s]
    begun: int  # samples since the start or a jump, 2 at most
    elapsed: int  # ticks between the two newest samples
    covered: int  # ticks that `acting` covers
    samples: int  # address of the newest samples
    places: int  # address of positions before the newest
    places_count: int
    lines: int  # address of the forces under way, a line an axis
    line_length: int  # ticks of a line; 0 for a device without latency
    line_part: float  # fraction of a tick in the latency
    energy: float  # given out by the virtual side so far [J]
    highest: float  # largest of all [J]
    longest: float  # largest time that a velocity is taken over [s]

    # Safety
    safety: int  # index into SAFETY
    force_seq: int  # tick that the force answers; -1 before the first
    since: int  # tick at which the last fresh force came
    limited_at: int  # tick for which limits were applied last
    max_age: int  # largest age of a force that is taken [ticks]
    watchdog: int  # ticks without a fresh force before damping
    damping_ticks: int  # ticks of damping before zero
    damping: float  # of that damper [N s/m]
    start_ticks: int  # ramp of the first force [ticks]
    recovery_ticks: int  # ramp of a force that comes back after a whole gap [ticks]
    ramp_ticks: int  # ramp under way [ticks]
    ramp_seq: int  # tick at which it grew last
    regained: float  # how much of it is done [ticks]
    away_from: float  # tick from which there was no force
    peak: float  # largest force on an axis [N]
    slew: float  # largest change of a force in a tick [N]
    unlimited: int  # 1 without any limit
    reach: float  # farthest position that is believed [m]
    bounded: int  # 1 where `workspace` bounds anything
    workspace: Annotated[list[float], 6]  # low and high by axis [m]
    brake: Vector3  # damper's force of a driver that has stopped [N]
    entered: Annotated[list[int], len(SAFETY)]  # how often each state was entered
    refused_for: Annotated[list[int], len(REFUSED)]  # messages refused by reason
    limited_by: Annotated[list[int], len(LIMITED)]  # forces limited by which limit

    # Jumps that no motion made
    jumped: int  # 1 where the position just read is elsewhere without a motion
    rebased: int  # tick of the latest jump; 0 for none
    felt: Vector3  # force felt when the position jumped [N]
    felt_seq: int  # tick of that
    fading: float  # ticks for which `felt` still fades
    begins: int  # 1 where no motion made the next force: a start, or a jump
    always_ramp: int  # 1 where the first force has a ramp in any case

    # Swings
    stop_after: int  # times at the peak within STOP_WINDOW that stop the driver; 0 for never
    peaked: int  # 1 where the force came to its peak just now
    peaks_count: int  # how often it has
    peaks: Annotated[list[float], 2 * PEAKS]  # ring of tick and energy of each
    sides: Annotated[list[int], 3]  # side on which each axis is at its peak; 0 for none
    stopped_at: int  # tick of the stop
    pressed_since: int  # tick since which the force is at its peak; -1: it is not
    pressed_at: int  # tick at which that counted last
    pressed_ticks: int  # ticks after which it counts again
    pressed_energy: float  # energy given out when the force came to its peak [J]

    # Motor heat
    continuous: float  # largest lasting force [N]
    heat: float  # mean square of the force [N²]
    heat_keep: float  # share of it that is kept per tick
    heat_reserve: float  # share that is kept over a gap
    heat_largest: float  # largest square of this tick [N²]

    # Guard
    guard_on: int
    guard_bounded: int  # 1 where `guard_stiffness` bounds what is in store
    guard_stiffness: float  # of the spring that the law stands for [N/m]
    guard_rate: float  # damping over T of what is taken back [N/m]
    guard_allowance: float  # energy given out before the guard acts [J]
    guard_energy: Vector3  # accounts, counted as given out [J]
    guard_highest: float  # largest of all [J]
    guard_step: Vector3  # displacement expected in a tick [m]
    normal: Vector3  # normal of the force that acts; 0 for none
    guard_surplus: float  # energy that a partner may give out, so far [J]
    guard_credit: float  # energy of a partner that was taken up, so far [J]
    guard_partner: int  # 1 once a partner has told its energy
    lowered: int  # forces that the guard lowered
    raised: int  # forces that it raised

    # Response times
    recent: Annotated[list[float], RECENT]  # ring of the newest [s]
    recent_at: int  # where it stands
    counted: int  # response times so far
    bins: int  # address of their counts

    # What becomes an event after the tick
    notes: Annotated[list[float], NOTE * NOTES]
    notes_count: int
    texts: Annotated[list[int], len(SAFETY)]  # addresses of the states' names, encoded
    text_sizes: Annotated[list[int], len(SAFETY)]  # [bytes]


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
    """Take down what is to be said when the tick is done."""
    if s.notes_count >= NOTES:
        # No tick has so many, and each ends with them told; compiled code would write beyond the
        # end.
        return
    at = NOTE * s.notes_count
    s.notes[at], s.notes[at + 1], s.notes[at + 2] = float(code), float(seq), float(change)
    s.notes[at + 3], s.notes[at + 4], s.notes[at + 5], s.notes[at + 6], s.notes[at + 7] = (
        a,
        b,
        c,
        d,
        e,
    )
    s.notes_count += 1


@rule
def seldom(count: int) -> bool:
    """Whether the n-th of many alike is one that is said: at powers of two."""
    return count & (count - 1) == 0
