"""Rules of time on a scripted clock: late, lost and skipped ticks, both ticks bit-equal.

Nothing here runs in real time. Time passes as a script says (tests/support/scripted.py), so what a
busy machine does once in an hour is played in a millisecond, and repeated by the other tick.
"""

from __future__ import annotations

import math
import random
from itertools import pairwise
from pathlib import Path

import msgspec
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from messages import topics
from messages.codec import Decoder, encode
from messages.types import MAX_COUNT, DeviceState, Force, Vector
from nodes.compiled.choose_tick import choose
from nodes.coupling.node import Coupling
from nodes.driver.device import DeviceLimits
from nodes.driver.node import Driver
from nodes.environment.node import Environment
from tests.support.rules_of_time import ANSWERED, BEARS, RULES
from tests.support.scripted import AHEAD, Hand, assert_alike, played
from tests.support.scripted_world import EPOCH, TICK, Arrival, T, at
from tests.support.scripts import BOX, KINDS, TICKS, answer, driver, follower, moving

KERNELS = [Driver.kernel_module, Environment.kernel_module, Coupling.kernel_module]


@pytest.fixture(scope="module", autouse=True)
def compiled_before() -> None:
    assert choose("compiled", KERNELS, print) == "compiled"


# -- the driver: each rule of time, and that it acted
# ------------------------------------------------------------------


@pytest.mark.parametrize("apply", ["on_arrival", "next_tick"])
@pytest.mark.parametrize("rule", RULES)
def test_a_driver_keeps_every_rule_of_time_alike(
    rule: str, apply: str, tmp_path: Path
) -> None:
    script, acted = RULES[rule]
    outcome, node = assert_alike(script._replace(apply=apply), tmp_path)
    s = node.driving
    assert s.seq == TICKS
    assert s.ticks + s.overruns == TICKS
    # Every tick a state, and one more for where it came to rest; the ticks of the first are those
    # of the script.
    assert len(outcome.sent) == s.ticks + 1
    assert node.ticks_compiled == s.ticks
    if apply == "on_arrival":
        assert acted(s)
    # Whatever happened, the soft stop left nothing on the device.
    assert outcome.given[-1][1] == (0.0, 0.0, 0.0)
    if s.line_length == 0:
        # What acted is what gave out the energy: sums of 120 terms, each rounded once.
        states = [Decoder(DeviceState).decode(frames[1]) for _, frames in outcome.sent]
        for before, state in pairwise(states):
            if state.rebased == state.seq > 0:
                assert state.energy == before.energy  # a jump is no motion
                continue
            work = sum(
                f * (x - y)
                for f, x, y in zip(
                    state.mean_force, state.position, before.position, strict=True
                )
            )
            assert state.energy - before.energy == pytest.approx(work, abs=1e-12), (
                state.seq
            )


def test_the_guard_has_the_same_bits_along_several_axes(tmp_path: Path) -> None:
    """`** 2` is a power in the interpreter and a product in compiled code."""
    drawn = random.Random(1)  # noqa: S311  # no secret
    forces: list[Vector] = []
    while len(forces) < TICKS:
        x, y, z = (drawn.uniform(-4.0, 4.0) for _ in range(3))
        if math.sqrt(x**2 + y**2 + z**2) != math.sqrt(x * x + y * y + z * z):
            forces.append((x, y, z))
    script = driver(
        [answer(seq, force=force) for seq, force in enumerate(forces)],
        position=lambda seq: (
            1e-4 * (seq % 3),
            1e-4 * (seq * 7 % 5),
            1e-4 * (seq * 5 % 7),
        ),
        guard={"stiffness": 500.0, "damping": 5.0},
    )
    _, node = assert_alike(script, tmp_path)
    assert node.driving.lowered + node.driving.raised > TICKS / 4


def test_states_are_stamped_in_the_time_of_the_launchers_machine(
    tmp_path: Path,
) -> None:
    """Plain ticks used this machine's time, hours away from the forces'."""
    outcome, _ = assert_alike(RULES["nothing unusual"].script, tmp_path)
    stamps = [
        Decoder(DeviceState).decode(frames[1]).stamp - AHEAD
        for _, frames in outcome.sent
    ]
    # A scripted sleep ends one step of the script's grid late: 1 µs. A clock at 6000 s has steps of
    # 1e-12 s.
    assert stamps == pytest.approx(
        [EPOCH * 1e-9 + seq * T for seq in range(TICKS + 1)],
        rel=0.0,
        abs=1.0e-6 + 3e-12,
    )


def test_the_mean_force_of_a_tick_is_split_where_its_answers_came(
    tmp_path: Path,
) -> None:
    """A compiled tick interrupted by an unreadable message forgot the force so far."""
    arrivals = [
        *(answer(seq, force=(0.0, 0.0, 1.0)) for seq in range(4)),
        # The force of tick 4 comes in tick 5, then what cannot be read, then tick 5's own.
        answer(4, 2_600.0, (0.0, 0.0, 2.0)),
        Arrival(at(5, 700.0), (topics.FORCE.encode(), b"no message")),
        answer(5, 1_000.0, (0.0, 0.0, 3.0)),
    ]
    script = driver(arrivals, position=lambda seq: (0.0, 0.0, -1e-3 * seq), ticks=7)
    outcome, _ = assert_alike(script, tmp_path)
    states = [Decoder(DeviceState).decode(frames[1]) for _, frames in outcome.sent]
    # 1 N for 0.6 ms, 2 N until 1 ms, 3 N for the rest, while the device moves by -1 mm; arrivals
    # are 0.5 µs later than a whole number. A clock at 1000 s has steps of 1e-13 s: 6e-11 of a tick.
    mean = (600.5 * 1.0 + 400.0 * 2.0 + 999.5 * 3.0) / 2000.0
    assert states[6].energy - states[5].energy == pytest.approx(-1e-3 * mean, rel=1e-9)
    assert states[6].mean_force == pytest.approx((0.0, 0.0, mean), rel=1e-9)
    # Of tick 4 nothing came in its own time.
    assert [state.changed_at for state in states[4:7]] == pytest.approx(
        [0.30025, 1.0, 0.30025], abs=1e-9
    )


def test_who_was_silent_is_not_waited_for_whatever_else_comes(tmp_path: Path) -> None:
    """After an unreadable message the plain tick waited 1 ms too long."""
    damaged = Arrival(at(6, 1_700.0), (topics.FORCE.encode(), b"no message"))
    script = driver([*(answer(seq) for seq in range(4)), damaged], {6: 1_500}, ticks=9)
    outcome, _ = assert_alike(script, tmp_path)
    # Each wait ends 1 µs after the time that was asked for.
    assert [(moment - EPOCH) / TICK for moment, _ in outcome.sent][7] == pytest.approx(
        7.0005, abs=1e-9
    )


def test_an_environment_knows_its_tick_during_and_after_a_fault_of_the_driver(
    tmp_path: Path,
) -> None:
    script = follower("environment", [(seq, 100.0) for seq in range(20)])
    arrivals = []
    for seq, arrival in enumerate(script.arrivals):
        state = Decoder(DeviceState).decode(arrival.frames[1])
        fault = (
            msgspec.structs.replace(state, safety="fault")
            if 8 <= seq < 12 or seq >= 17
            else state
        )
        arrivals.append(arrival._replace(frames=(arrival.frames[0], encode(fault))))
        # Refusals are events, and say at which tick.
        arrivals.append(
            Arrival(arrival.at + 500_000, (arrival.frames[0], b"no message"))
        )
    outcome, node = assert_alike(script._replace(arrivals=arrivals), tmp_path)
    assert len(outcome.sent) == 20 - 4 - 3
    assert node.status().seq == 19
    # The 1st, 2nd, 4th, 8th and 16th.
    assert [seq for kind, _, seq, _ in outcome.events if kind == "refused"] == [
        0,
        1,
        3,
        7,
        15,
    ]


def test_a_call_that_fails_ends_the_run_of_either_tick(tmp_path: Path) -> None:
    script = driver(ANSWERED, ticks=60)
    limits = DeviceLimits(peak_force=8.0, hold=10.0, workspace=BOX, latency=0.0)
    failing = script._replace(hand=lambda: Hand(limits, moving, fails=[37]))
    for tick in ("plain", "compiled"):
        with pytest.raises(BlockingIOError, match="no position at tick 37"):
            played(failing, tick, tmp_path)


# -- the environment and the coupling
# ---------------------------------------------------------------------------------

COMING: dict[str, list[tuple[int, float]]] = {
    "in time": [(seq, 100.0) for seq in range(40)],
    "one stall, then all at once": [
        (seq, 100.0 if seq < 10 else max(100.0, 2000.0 * (25 - seq)))
        for seq in range(40)
    ],
    "two stalls": [
        (seq, max(100.0, 2000.0 * (12 - seq % 20)) if seq > 5 else 100.0)
        for seq in range(40)
    ],
    "late, but nothing newer is there": [
        (seq, 100.0 + 2500.0 * (seq % 5 == 4)) for seq in range(40)
    ],
    "at the edge of a period": [(seq, 1_999.0 + seq % 3) for seq in range(40)],
    "ticks that the driver lost": [
        (seq + 3 * (seq > 10) + 40 * (seq > 20), 100.0) for seq in range(40)
    ],
    "a driver that is started again": [(seq % 23, 100.0) for seq in range(40)],
    "a driver that is started again, in a stall": [
        (seq % 23, max(100.0, 2000.0 * (26 - seq)) if seq > 18 else 100.0)
        for seq in range(40)
    ],
    "a driver that is started again, right after a stall": [
        # The last one before it is not late at all.
        *(
            (seq, 100.0 if seq < 10 else 2000.0 * (15 - seq) + 100.0)
            for seq in range(16)
        ),
        *((seq, -1900.0 if seq == 3 else 100.0) for seq in range(3, 27)),
    ],
    "asked again": [(seq // 2, 100.0) for seq in range(40)],
    "asked again, in a stall": [
        (seq // 2, max(100.0, 2000.0 * (20 - seq))) for seq in range(40)
    ],
    "jumps to the end of all ticks": [
        (seq, 100.0) for seq in (0, 1, MAX_COUNT - 1, MAX_COUNT, 0, 1, MAX_COUNT)
    ],
}


@pytest.mark.parametrize("pace", ["realtime", "lockstep"])
@pytest.mark.parametrize("coming", COMING)
@pytest.mark.parametrize("kind", KINDS)
def test_who_follows_a_driver_follows_alike(
    kind: str, coming: str, pace: str, tmp_path: Path
) -> None:
    outcome, node = assert_alike(follower(kind, COMING[coming], pace), tmp_path)
    assert len(outcome.sent) + node.counters.skipped == len(COMING[coming])
    if "stall" in coming and pace == "realtime":
        assert node.counters.skipped > 5
    if pace == "lockstep":
        assert node.counters.skipped == 0


# -- in every order
# --------------------------------------------------------------------------------------------------

micros = st.integers(0, 9_000)
lates = st.dictionaries(
    st.integers(0, 40), st.integers(0, 3_000).map(lambda tens: 10 * tens), max_size=6
)
stalls = st.dictionaries(
    st.tuples(
        st.integers(0, 40), st.sampled_from(["read", "publish", "answer", "stamped"])
    ),
    st.integers(0, 3_000).map(lambda tens: 10 * tens),
    max_size=4,
)
answers = st.lists(
    st.tuples(
        st.integers(0, 40),
        st.integers(-2_500, 9_000),
        st.integers(-6, 1),
        st.floats(-9.0, 9.0),
        st.booleans(),
    ),
    max_size=60,
)
quick = settings(max_examples=60)


@quick
@given(
    late=lates,
    held=stalls,
    coming=answers,
    apply=st.sampled_from(["on_arrival", "next_tick"]),
    patient=st.integers(1, 12),
    jumps=st.lists(st.integers(0, 40), max_size=3),
)
@example(  # the wait of whole milliseconds ended at the deadline itself, before the finer one
    late={},
    held={},
    coming=[
        (tick, after, 0, 0.0, False)
        for tick, after in ((0, 0), (0, 0), (1, 1), (28, 1), (30, -1))
    ],
    apply="on_arrival",
    patient=1,
    jumps=[],
)
def test_a_driver_does_the_same_in_whatever_order(
    late: dict[int, int],
    held: dict[tuple[int, str], int],
    coming: list[tuple[int, int, int, float, bool]],
    apply: str,
    patient: int,
    jumps: list[int],
    tmp_path: Path,
) -> None:
    topic = topics.FORCE.encode()
    arrivals = []
    for tick, after, age, size, whole in coming:
        message = encode(
            Force(seq=max(tick + age, 0), stamp=0.0, force=(0.0, 0.0, size))
        )
        arrivals.append(
            Arrival(at(tick, after), (topic, message if whole else message[:-3]))
        )
    script = driver(
        arrivals,
        late,
        ticks=42,
        limits={"hold": 7 * T, "latency": 0.4 * T},
        watchdog=patient,
        damping_ticks=3,
        recovery=0.01,
        slew=900.0,
        continuous_force=2.0,
        thermal_time=0.05,
        ramp=None,
    )
    limits = msgspec.structs.replace(BEARS, hold=7 * T, latency=0.4 * T)
    script = script._replace(
        apply=apply, stalls=held, hand=lambda: Hand(limits, moving, jumps_at=jumps)
    )
    assert_alike(script, tmp_path)


@quick
@given(
    kind=st.sampled_from(sorted(KINDS)),
    coming=st.lists(st.tuples(st.integers(-2, 4), micros, st.booleans()), max_size=40),
)
def test_who_follows_does_the_same_in_whatever_order(
    kind: str, coming: list[tuple[int, int, bool]], tmp_path: Path
) -> None:
    seq, ticks, cut = 0, [], []
    for step, late, whole in coming:
        seq = max(seq + step, 0)
        ticks.append((seq, float(late)))
        cut.append(not whole)
    script = follower(kind, ticks)
    arrivals = [
        arrival._replace(frames=(arrival.frames[0], arrival.frames[1][:-3]))
        if is_cut
        else arrival
        for arrival, is_cut in zip(script.arrivals, cut, strict=True)
    ]
    assert_alike(script._replace(arrivals=arrivals), tmp_path)
