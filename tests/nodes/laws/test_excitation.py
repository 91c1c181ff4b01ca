"""The identifying push as a law: its signs, its reach, its beginning and its end."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import pytest

from nodes.laws import CompiledLaw
from nodes.laws.excitation import ASTRAY, Excitation, Telegraph, held_back
from nodes.laws.parse import parse_law

T = 0.002


def compiled(**values: Any) -> CompiledLaw:
    return parse_law({"kind": "excitation", "start": 0.0, **values}).compile(T)


def pushes(law: CompiledLaw, ring: Sequence[float], ticks: int) -> list[float]:
    assert law.evaluate is not None
    return [law.evaluate(ring, 0) for _ in range(ticks)]


def test_the_push_stays_within_its_amplitude_and_ends() -> None:
    forces = pushes(compiled(amplitude=0.5, duration=1.0), [0.0, 0.0], 600)
    assert max(map(abs, forces[:500])) <= 0.5
    assert len(set(forces[:500])) == 3  # two signs in equal shares: −, 0, +
    assert set(forces[500:]) == {0.0}


@pytest.mark.parametrize(("deflection", "sign"), [(0.0300001, 1.0), (-0.0300001, -1.0)])
def test_beyond_the_reach_it_only_pushes_back(deflection: float, sign: float) -> None:
    """A deflection points from device to centre, so a force of its sign returns it."""
    assert all(
        sign * force >= 0.0 for force in pushes(compiled(), [deflection, 0.0], 300)
    )
    inside = pushes(compiled(), [0.0299999 * sign, 0.0], 300)
    assert min(inside) < 0.0 < max(inside)
    assert held_back(-0.2, 0.01, 0.03) == -0.2


def test_a_device_that_stays_away_ends_it_for_good() -> None:
    law = compiled(reach=0.01)
    away = [0.0201, 0.0]
    assert any(pushes(law, away, ASTRAY)[:-1])
    assert set(pushes(law, away, 50)) == {0.0}
    away[0] = 0.0
    assert set(pushes(law, away, 50)) == {0.0}


def test_every_axis_has_a_push_of_its_own() -> None:
    law, x = compiled(), [0.0, 0.0]
    first_axis, second_axis = law.own_code(0), law.own_code(1)
    assert first_axis is not None
    assert second_axis is not None
    both = [(first_axis(x, 0), second_axis(x, 0)) for _ in range(300)]
    alone = pushes(compiled(), x, 300)
    assert [first for first, _ in both] == alone
    assert [second for _, second in both] != alone


def test_the_weight_is_carried_during_the_push_and_let_go_after_it() -> None:
    forces = pushes(compiled(duration=0.1, amplitude=1e-9, load=0.98), [0.0, 0.0], 600)
    assert forces[:50] == pytest.approx([0.98] * 50, abs=1e-8)
    # A second of fading: steps of 1/500 of it, down to nothing.
    assert max(abs(b - a) for a, b in pairwise(forces[50:])) <= 0.98 / 500 * (
        1.0 + 1e-9
    )
    assert set(forces[550:]) == {0.0}
    assert Excitation().load == 0.0


@pytest.mark.parametrize("clock", [1, 4])
def test_a_telegraph_may_change_its_sign_with_its_clock_from_the_first_tick(
    clock: int,
) -> None:
    signal = Telegraph(0.5, [clock], seed=3)
    forces = [signal.next() for _ in range(400 * clock)]
    for begin in range(0, len(forces), clock):
        assert len(set(forces[begin : begin + clock])) == 1
    signs = forces[::clock]
    assert set(signs) == {0.5, -0.5}
    # 400 signs of a fair coin: their sum has a deviation of 20, their changes one of 10.
    assert abs(sum(signs)) / 0.5 < 4.0 * 20.0
    changes = sum(a != b for a, b in pairwise(signs))
    assert abs(changes - 399 / 2) < 4.0 * 10.0


def test_the_push_grows_by_one_share_a_tick_to_all_of_it() -> None:
    """With one clock every force is ± the amplitude, so their sizes are the ramp."""
    law = compiled(amplitude=0.5, start=8 * T, clocks=[10], duration=20 * T)
    forces = pushes(law, [0.0, 0.0], 21)
    sizes = [0.5 * min(k / 8.0, 1.0) for k in range(1, 21)]
    assert list(map(abs, forces)) == pytest.approx([*sizes, 0.0], abs=1e-15)


def test_away_is_beyond_twice_the_reach_for_a_hundred_ticks_in_a_row() -> None:
    """At twice the reach, or back for one tick, the push goes on."""
    law = compiled(reach=0.25, duration=10.0)
    assert all(pushes(law, [0.5, 0.0], ASTRAY + 50)[-50:]) is False
    assert any(pushes(law, [0.5, 0.0], 50))
    pushes(law, [0.5 + 1e-9, 0.0], ASTRAY - 1)
    pushes(law, [-0.5, 0.0], 1)
    pushes(law, [-0.5 - 1e-9, 0.0], ASTRAY - 1)
    assert any(pushes(law, [0.0, 0.0], 50))
    pushes(law, [-0.5 - 1e-9, 0.0], ASTRAY)
    assert not any(pushes(law, [0.0, 0.0], 50))
