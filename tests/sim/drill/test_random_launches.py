"""Random launches: the oracle on constructed logs, and launches seeded by the commit."""

from __future__ import annotations

from random import Random
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, seed, settings
from hypothesis import strategies as st

from messages.types import DeviceState, Proxy, Vector
from nodes.coupling.renderer import ActiveLaw, Renderer
from nodes.laws import CompiledLaw
from sim.drill.device_log import Sample
from sim.drill.drawn_launches import DAMPING, LAWS, RAMP, STIFFNESS, drawn
from sim.drill.drill import PEAK, RATE
from sim.drill.random_launches import REACH, begins_in, launch_many, pushed, text
from sim.drill.writes import Promise, Write, judge
from tests.support.commit import commit

T = 1.0 / RATE
TICKS = round(RAMP / T)


def _given(
    seq: int,
    z: float,
    position: Vector = (0.0, 0.0, -0.001),
    jumps: int = 0,
    late: float = 0.0,
) -> Sample:
    return Sample(Write(seq * T + late, (0.0, 0.0, z), seq * T), seq, jumps, position)


def _state(seq: int, safety: str) -> DeviceState:
    return DeviceState(
        seq=seq,
        stamp=0.0,
        position=(0.0, 0.0, 0.0),
        force=(0.0, 0.0, 0.0),
        force_seq=0,
        safety=safety,
    )


def test_a_surface_that_is_moved_pushes_by_its_ramp_and_no_faster() -> None:
    # From 1 N to the peak, straight: a step a tick, of which two are the oracle's slack.
    line = [1.0 + (PEAK - 1.0) * min((n + 1) / TICKS, 1.0) for n in range(TICKS)]
    before = [_given(seq, 1.0) for seq in range(60)]
    wrong, steepest = pushed(
        [*before, *(_given(60 + n, force) for n, force in enumerate(line))], [60]
    )
    assert wrong == []
    assert 0.5 < steepest <= 1.0
    # In three ticks fewer it is faster than the ramp, from the third tick before its end on at the
    # latest.
    early = [1.0 + (PEAK - 1.0) * min((n + 4) / TICKS, 1.0) for n in range(TICKS)]
    wrong, steepest = pushed(
        [*before, *(_given(60 + n, force) for n, force in enumerate(early))], [60]
    )
    assert "moved at tick 60" in wrong[0]
    assert steepest > 1.0
    assert pushed([*before, _given(60, 2.5)], [60])[0] != []


def test_what_a_hand_moves_meanwhile_is_no_push() -> None:
    depth, force = 0.0005, 1.0 + STIFFNESS * 0.0005 + DAMPING * 0.0005 / T
    moved = [_given(seq, 1.0) for seq in range(60)] + [
        _given(60, 1.0),
        _given(61, force, (0.0, 0.0, -0.001 - depth)),
    ]
    assert pushed(moved, [60])[0] == []
    still = [*moved[:-1], _given(61, force)]
    assert pushed(still, [60])[0] != []


def test_a_ramp_counts_ticks_and_a_force_that_is_written_late_is_none_too_fast() -> (
    None
):
    step = PEAK / TICKS
    # The first force of the ramp comes 8 ms late, those after it in time.
    log = [
        _given(0, step, late=4 * T),
        *(_given(4 + n, step * (2 + n)) for n in range(1, TICKS - 2)),
        _given(TICKS + 2, 0.0),
    ]
    bounds = Promise(T, PEAK, hold=0.05, ramp=RAMP)
    assert judge([sample.write for sample in log], bounds).broken == []
    fast = [sample.write._replace(due=4 * T + n * T) for n, sample in enumerate(log)]
    assert (
        judge(
            [write._replace(force=(0.0, 0.0, 1.1 * write.force[2])) for write in fast],
            bounds,
        ).broken
        != []
    )


def test_each_tick_has_its_slew_however_late_it_is_written() -> None:
    bounds = Promise(T, PEAK, 0.04, ramp=0.0)

    def rising(step: float) -> list[Write]:
        """Four ticks within less than one of time; at the end nothing is left."""
        return [
            *(Write(n * 0.2 * T, (0.0, 0.0, step * n), n * T) for n in range(4)),
            Write(1.0, (0.0, 0.0, 2.0 * step), 1.0),
        ]

    # The force of the tick before, handed over again, and the tick's own have two slews together.
    assert judge(rising(0.08), bounds).broken[:-1] == []
    assert "within one tick" in judge(rising(0.081), bounds).broken[0]
    # Of one tick there is no more than that, however many writes it has.
    assert (
        len(judge([write._replace(due=0.0) for write in rising(0.08)], bounds).broken)
        > 1
    )


def test_figures_of_a_log_count_what_is_above_a_limit_and_the_steepest_rise() -> None:
    log = [
        Write(n * T, (0.0, 0.0, PEAK * min((n + 1) / TICKS, 1.0)))
        for n in range(2 * TICKS)
    ]
    right = judge(
        [*log, Write(2 * TICKS * T, (0.0, 0.0, 0.0))], Promise(T, PEAK, ramp=RAMP)
    )
    assert (right.broken, right.above) == ([], 0)
    assert 0.9 < right.steepest <= 1.0
    wrong = judge(
        [Write(at, (x, y, 1.2 * z)) for at, (x, y, z), _ in log],
        Promise(T, PEAK, ramp=RAMP),
    )
    # Above the peak from 1/1.2 of the ramp on.
    assert wrong.above == 2 * TICKS - round(TICKS / 1.2)
    assert wrong.steepest > 1.0


def test_ramps_are_due_after_jumps_in_contact_faults_and_times_without_force() -> None:
    log = [_given(n, 1.0) for n in range(10)] + [
        _given(n, 1.0, jumps=1) for n in range(10, 20)
    ]
    assert begins_in(log, []) == [10 * T]
    air = [_given(n, 0.0) for n in range(10)] + [
        _given(n, 0.0, jumps=1) for n in range(10, 20)
    ]
    assert begins_in(air, []) == []
    # Nothing is given in ticks 10 to 39; the force of tick 40 is the first of a ramp.
    silent = [_given(n, 0.0 if 10 <= n < 40 else 1.0) for n in range(50)]
    states = [
        _state(n, "active" if n <= 10 else "zero" if n <= 40 else "ramp")
        for n in range(50)
    ]
    assert begins_in(silent, states) == [40 * T]
    # A gap that costs a part of the ramp only is judged by its length; a fault costs all of it.
    short = [_given(n, 0.0 if n == 10 else 1.0) for n in range(50)]
    assert (
        begins_in(short, [_state(10, "active"), _state(11, "zero"), _state(12, "ramp")])
        == []
    )
    assert begins_in(
        short, [_state(10, "fault"), _state(11, "zero"), _state(12, "ramp")]
    ) == [11 * T]


def test_a_launch_is_drawn_again_from_its_seed() -> None:
    found = [drawn(Random(f"x:{n % 8}")) for n in range(16)]  # noqa: S311  # no secret
    assert found[:8] == found[8:]
    assert len({what for _, what in found}) > 4


# -- moves and swaps, through the coupling's renderer
# -----------------------------------------------------------------

LENGTH = 300
MOVES = given(
    # Where a hand goes to, in equal spans of time, and when a wall is moved where, a law taken up
    # within how many ticks.
    path=st.lists(st.floats(-0.002, 0.002), min_size=1, max_size=6),
    moves=st.dictionaries(
        st.integers(1, LENGTH - 1), st.floats(-REACH, REACH), max_size=4
    ),
    swaps=st.dictionaries(
        st.integers(1, LENGTH - 1),
        st.tuples(st.sampled_from(sorted(LAWS)), st.sampled_from([5, 20, 75])),
        max_size=4,
    ),
    lost=st.sets(st.integers(1, LENGTH - 1), max_size=20),
)


def _felt(
    path: list[float],
    moves: dict[int, float],
    swaps: dict[int, tuple[str, int]],
    lost: set[int],
    ease: int = TICKS,
) -> list[Sample]:
    """Return the forces on a device that follows a path, with some ticks missed."""
    renderer = Renderer([2], 16)

    def law(name: str) -> ActiveLaw:
        one = SimpleNamespace(**LAWS[name])
        taps = one.stiffness + one.damping / T, -one.damping / T
        return ActiveLaw(name, "{}", CompiledLaw(taps), renderer.histories)

    renderer.law = law("pd")
    renderer.state.ease_usual = ease
    wall, rebased, z, last, felt = 0.0, 0, path[0], -1, 0.0
    samples = []
    for seq in range(LENGTH):
        # As fast as 0.1 m/s: what a hand adds by damping stays below a newton.
        goal = path[seq * len(path) // LENGTH]
        z += max(-0.1 * T, min(0.1 * T, goal - z))
        if seq in moves:
            wall, rebased = moves[seq], seq
        if seq in swaps and last >= 0:
            name, ramp = swaps[seq]
            renderer.swap(law(name), ramp)
        if seq not in lost:
            surface = max(z, wall)
            position, proxy, contact = (0.0, 0.0, z), (0.0, 0.0, surface), z < wall
            met: Any = {
                "position": position,
                "proxy": proxy,
                "normal": (0.0, 0.0, 1.0),
                "distance": z - wall,
                "contact": contact,
            }
            told = Proxy(seq=seq, stamp=0.0, rebased=rebased, **met)
            renderer.follow(told, last)
            felt, last = max(-PEAK, min(PEAK, renderer.render(told)[2])), seq
        samples.append(_given(seq, felt, (0.0, 0.0, z)))
    return samples


@seed(int(commit()[:12], 16))
@settings(max_examples=150)
@MOVES
def test_whatever_is_moved_and_swapped_the_coupling_gives_no_push(
    path: list[float],
    moves: dict[int, float],
    swaps: dict[int, tuple[str, int]],
    lost: set[int],
) -> None:
    assert (
        pushed(_felt(path, moves, swaps, lost), sorted(moves), sorted(swaps))[0] == []
    )


def test_a_coupling_that_does_not_ease_is_seen() -> None:
    assert pushed(_felt([-0.001], {100: 0.0015}, {}, set(), ease=0), [100])[0] != []
    assert pushed(_felt([-0.001], {100: 0.0015}, {}, set()), [100])[0] == []


# -- real launches
# --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_random_launches_give_no_push() -> None:
    """Each commit tries others; repeat with ``haptic drill random --seed COMMIT``."""
    found = launch_many(4, commit(), ("plain",))
    print(text(found))
    assert found.passed, text(found)
    assert found.above == 0
    assert found.steepest <= 1.0 + 1e-6
    assert found.forces > 500
