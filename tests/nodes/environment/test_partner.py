"""A partner as environment: its presented place never jumps, whatever the network does."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from messages.topics import DEVICE_STATE, PROXY
from messages.types import DeviceState
from nodes.environment.partner import HEARD, SILENT, UNHEARD, Partner, PartnerParameters
from nodes.recording.reader import Recording
from tests.support.launching import launch_json, typed_in

T = 0.002
LIMITS = PartnerParameters()


def state(seq: int, x: float, safety: str = "active") -> DeviceState:
    return DeviceState(seq=seq, stamp=seq * T, position=(x, 0.0, 0.0), safety=safety)


def presented(partner: Partner, own: float, seq: int) -> float:
    place, _ = partner.present((own, 0.0, 0.0), seq)
    return place[0]


def test_a_partner_that_is_first_heard_is_met_at_the_device_and_aligned_at_the_stated_speed() -> (
    None
):
    partner = Partner(T, LIMITS)
    assert partner.present((0.01, 0.0, 0.0), 0) == ((0.01, 0.0, 0.0), False)
    partner.hear(state(7, 0.04))
    # 30 mm apart: nothing at first but one tick of the alignment, and all of it after 0.3 s.
    first = presented(partner, 0.01, 1)
    # sums of a few numbers of this size
    assert first == pytest.approx(0.01 + LIMITS.align * T, abs=1e-15)
    ticks = round(0.03 / LIMITS.align / T)
    for k in range(2, ticks):
        partner.hear(state(7 + k, 0.04))
        presented(partner, 0.01, k)
    assert presented(partner, 0.01, ticks) < 0.04
    assert presented(partner, 0.01, ticks + 1) == 0.04


def test_a_partner_is_felt_exactly_where_it_is_once_aligned() -> None:
    partner = Partner(T, LIMITS)
    partner.hear(state(0, 0.0))
    presented(partner, 0.0, 0)
    for k in range(1, 50):
        partner.hear(state(k, 1e-4 * k))
        assert presented(partner, 0.0, k) == 1e-4 * k


def test_silence_lets_the_device_go_at_its_limit_and_not_before() -> None:
    partner = Partner(T, LIMITS)
    partner.hear(state(0, 0.002))
    for k in range(20):
        presented(partner, 0.0, k)
    partner.hear(state(20, 0.002))
    presented(partner, 0.0, 20)
    limit = 20 + round(LIMITS.silence / T)
    assert presented(partner, 0.0, limit) == 0.002
    assert partner.state == HEARD
    # as above
    assert presented(partner, 0.0, limit + 1) == pytest.approx(
        0.002 - LIMITS.align * T, abs=1e-15
    )
    assert partner.state == SILENT
    for k in range(2, 12):
        presented(partner, 0.0, limit + k)
    assert partner.state == UNHEARD
    assert partner.present((0.0, 0.0, 0.0), limit + 12) == ((0.0, 0.0, 0.0), False)


def test_what_is_old_or_no_position_does_not_count() -> None:
    partner = Partner(T, LIMITS)
    assert partner.hear(state(5, 0.0))
    partner.present((0.0, 0.0, 0.0), 0)
    assert not partner.hear(state(4, 0.001))  # overtaken
    assert not partner.hear(state(5, 0.001))  # twice
    assert not partner.hear(state(6, 0.001, safety="fault"))
    assert partner.hear(state(6, 0.001))


Steps = st.lists(
    st.tuples(
        st.sampled_from(("hear", "lose", "jump", "fault", "restart", "late")),
        st.floats(-1.0, 1.0),
        st.floats(-1.0, 1.0),
    ),
    min_size=1,
    max_size=120,
)


@given(steps=Steps, lost=st.integers(0, 80))
@example(
    steps=[
        ("hear", 0.0, 0.0),
        ("lose", 0.0, 0.0),
        ("lose", 1.0, 0.0),
        ("restart", 0.0, 0.0),
        ("late", 0.0, 0.0),
        ("hear", 1.0, 0.0),
    ],
    lost=24,
)
def test_what_is_presented_moves_no_faster_than_partner_device_and_alignment(
    steps: list[tuple[str, float, float]], lost: int
) -> None:
    partner = Partner(T, LIMITS)
    # Both move by at most 2 mm a tick, 1 m/s: motion. A jump is of 1 m, far beyond `fastest`.
    theirs, mine, before = 0.0, 0.0, 0.0
    seq = tick = 0
    # what counted last: the partner's tick, and where it was
    last: tuple[int, float] | None = None
    for what, a, b in steps:
        for _ in range(1 + (lost if what == "lose" else 0)):
            tick, seq = tick + 1, 0 if what == "restart" else seq + 1
            stepped = 0.002 * b
            mine, theirs = (
                mine + stepped,
                theirs + 0.002 * a + (math.copysign(1.0, a) if what == "jump" else 0.0),
            )
            known = partner.state
            counted, sent = False, seq
            if what in ("hear", "jump", "restart"):
                counted = partner.hear(state(seq, theirs))
            elif what == "late":
                # After silence it counts: nothing tells it from a restarted partner's.
                sent = max(seq - 3, 0)
                counted = (
                    last is not None
                    and last[0] >= sent
                    and partner.hear(state(sent, theirs))
                )
            elif what == "fault":
                assert not partner.hear(state(seq, 5.0, safety="fault"))
            where = presented(partner, mine, tick)
            moved = 0.0
            if counted:
                if known == HEARD and last is not None:
                    moved = abs(theirs - last[1])
                    if moved > LIMITS.fastest * T * max(sent - last[0], 1):
                        moved = 0.0  # a jump: none of it may show
                last = (sent, theirs)
            # Sums of some hundred steps of up to 1 m: epsilon times that.
            assert (
                abs(where - before) <= moved + abs(stepped) + LIMITS.align * T + 1e-12
            )
            before = where


@pytest.mark.process
def test_two_chains_feel_each_other_over_a_bad_network(tmp_path: Path) -> None:
    launch_json(tmp_path, "hands_apart", "duration:=1.5", "run.tick:=plain")
    (left,) = tmp_path.glob("recordings/*-left.mcap")
    rows = Recording(left).messages(PROXY)
    assert any(row.contact for row in rows)
    # The left hand is led 30 mm against the right one's grip: what it feels at the end is the
    # partner, not itself.
    last = rows[-1]
    assert last.proxy[0] < last.position[0] - 1e-3


def test_lockstep_is_refused_with_the_way_out(tmp_path: Path) -> None:
    told = typed_in(
        tmp_path, "launch", "hands_apart", "run.pace:=lockstep", code=2
    ).stderr
    assert "run.pace is lockstep" in told
    assert "haptic study hands" in told


@pytest.mark.slow
@pytest.mark.realtime
def test_guards_at_both_ends_hold_hands_that_a_network_would_set_swinging(
    tmp_path: Path,
) -> None:
    # 800 N/m over 60 ms there and back: ten times what any two hands bear (haptic study hands).
    words = ("stiffness:=800", "delay:=0.03", "duration:=3.0")
    unrest = {}
    for guard in ("on", "off"):
        folder = tmp_path / guard
        folder.mkdir()
        launch_json(folder, "hands_apart", f"guard:={guard}", *words)
        (right,) = folder.glob("recordings/*-right.mcap")
        held = [
            state.position[0]
            for state in Recording(right).messages(DEVICE_STATE)
            if 500 < state.seq < 1000
        ]
        # From 1 to 2 s the left hand rests at 30 mm: whatever moves is the loop's own.
        unrest[guard] = float(np.ptp(held))
    assert unrest["off"] > 1e-3
    assert unrest["on"] < 0.3 * unrest["off"]
