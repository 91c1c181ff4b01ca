"""The coupling's parts: rendering to the bit, warm-up, fades, swaps, the law book."""

from __future__ import annotations

import math
import random
import sys
import threading
import time
from array import array
from collections.abc import Sequence
from typing import Any, ClassVar

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from messages.types import Proxy
from nodes import arithmetic
from nodes.coupling.law_on_axis import (
    UNROLLED_TAPS,
    History,
    LawOnAxis,
    shares_of,
    sum_of_taps,
    weighted_taps,
)
from nodes.coupling.node import Coupling
from nodes.coupling.renderer import ActiveLaw, Renderer
from nodes.coupling.state import LEAVING
from nodes.coupling.time_budget import Budget
from nodes.laws import CompiledLaw, Law
from nodes.laws.pd import PD
from nodes.parameters.store import ParameterError
from tests.support.setups import setup_of

T = 0.002
RECURSIVE = CompiledLaw(
    (900.0, 50.0), ((300.0, -250.0, -1.2, 0.4), (-20.0, 10.0, 0.9, 0.1))
)
"""Two taps beside two decaying sections: the poles have radius sqrt(0.4) = 0.63 and 0.77."""


def deflections(count: int, seed: int = 1) -> list[float]:
    source = random.Random(seed)  # noqa: S311  # reproducible, not secret
    return [source.gauss(0.0, 1e-3) for _ in range(count)]


def filled(values: list[float], length: int) -> History:
    history = History(length)
    for value in values:
        history.push(value)
    return history


# -- taps
# --------------------------------------------------------------------------------------------------

finite = st.floats(-1e6, 1e6)


@given(st.lists(finite, max_size=80), st.lists(finite, max_size=90))
def test_taps_written_out_and_added_by_numpy_have_the_bits_of_the_kernel(
    taps: list[float], values: list[float]
) -> None:
    history = filled(values, 80)
    found = sum_of_taps(tuple(taps), history)(history.head)
    expected = arithmetic.fir(taps, history.values, history.head)
    assert found.hex() == expected.hex()


@pytest.mark.parametrize("count", [1, 2, UNROLLED_TAPS, UNROLLED_TAPS + 1, 2000])
def test_long_laws_have_the_bits_of_the_kernel_and_no_minus_zero(count: int) -> None:
    taps = tuple(deflections(count, 2))
    history = History(2048)
    render = sum_of_taps(taps, history)
    assert render(history.head).hex() == (0.0).hex()
    history.push(-0.0)
    assert render(history.head).hex() == (0.0).hex()
    for value in deflections(2100, 3):
        history.push(value)
    assert (
        render(history.head).hex()
        == arithmetic.fir(taps, history.values, history.head).hex()
    )


def test_a_law_longer_than_the_history_is_refused_at_the_edge() -> None:
    LawOnAxis(CompiledLaw((1.0,) * 8), History(8))
    with pytest.raises(ValueError, match="9 taps, but the history remembers 8"):
        LawOnAxis(CompiledLaw((1.0,) * 9), History(8))


# -- history
# --------------------------------------------------------------------------------------------------


def test_a_bridge_is_a_straight_line_up_to_the_next_deflection() -> None:
    renderer = Renderer([2], 16)
    renderer.law = ActiveLaw("r", "{}", CompiledLaw((1.0,)), renderer.histories)
    renderer.render(proxy_at(-0.001))
    renderer.bridge(proxy_at(-0.005), 3)
    renderer.render(proxy_at(-0.005))
    history = renderer.histories[0]
    newest_first = [history.values[history.head + age] for age in range(5)]
    assert newest_first == pytest.approx([0.005, 0.004, 0.003, 0.002, 0.001], rel=1e-15)


@pytest.mark.parametrize("missing", [7, 8, 9, 1000])
def test_a_gap_longer_than_the_history_fills_it_once(missing: int) -> None:
    renderer = Renderer([2], 8)
    renderer.law = ActiveLaw("r", "{}", CompiledLaw((1.0,)), renderer.histories)
    renderer.render(proxy_at(-1.0))
    renderer.bridge(proxy_at(-2.0), missing)
    history = renderer.histories[0]
    held = [history.values[history.head + age] for age in range(8)]
    assert held == sorted(held, reverse=True)
    assert held[0] == pytest.approx(2.0 - 1.0 / (missing + 1), rel=1e-15)
    assert history.pushes <= 9


def test_a_snapshot_taken_while_the_loop_pushes_belongs_to_one_tick() -> None:
    history = History(64)
    ending = threading.Event()

    def loop() -> None:
        while not ending.is_set():
            # The value is its own number, so that a torn copy shows.
            history.push(float(history.pushes + 1))

    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    thread = threading.Thread(target=loop)
    thread.start()
    try:
        for _ in range(2000):
            copy = history.snapshot()
            known = [copy.values[copy.head + age] for age in range(copy.known)]
            assert known == [
                max(0.0, float(copy.pushes - age)) for age in range(copy.known)
            ]
    finally:
        ending.set()
        thread.join()
        sys.setswitchinterval(before)
    assert history.pushes > 64


class _Busy(array):  # type: ignore[type-arg]
    """A ring buffer that the loop writes while it is copied."""

    history: History
    copies: int

    def __getitem__(self, at: Any) -> Any:
        if not isinstance(at, slice):
            return super().__getitem__(at)
        self.copies += 1
        assert self.copies < 10, "a copy that begins again each time has no end"
        half = len(self) // 2
        first = super().__getitem__(slice(0, half))
        for _ in range(5):
            self.history.push(float(self.history.pushes + 1))
        return first + super().__getitem__(slice(half, None))


def test_a_snapshot_of_a_history_that_goes_on_all_the_time_has_an_end() -> None:
    history = History(64)
    for k in range(100):
        history.push(float(k + 1))
    ring = _Busy("d", history.values)
    ring.history, ring.copies = history, 0
    history.values = ring
    copy = history.snapshot()
    assert copy.pushes == 100
    # Five have taken the place of the oldest, and one more may be under way.
    assert copy.known == 64 - 1 - 5
    assert [copy.values[copy.head + age] for age in range(copy.known)] == [
        100.0 - age for age in range(copy.known)
    ]


# -- recursive sections
# --------------------------------------------------------------------------------------------------


def test_a_warmed_up_law_is_where_it_would_be_had_it_run_all_along() -> None:
    values = deflections(120)
    history = History(128)
    along = LawOnAxis(RECURSIVE, history)
    for value in values[:50]:
        history.push(value)
        along.force(history.head)
    late = LawOnAxis(RECURSIVE, history)
    late.warm_up(history.snapshot())
    # Ticks pass between the snapshot and the swap.
    for value in values[50:70]:
        history.push(value)
        along.force(history.head)
    late.catch_up()
    late.catch_up()
    assert late.present() == along.present()
    for value in values[70:]:
        history.push(value)
        assert late.force(history.head).hex() == along.force(history.head).hex()


def test_what_lies_before_the_history_is_forgotten_as_the_poles_decay() -> None:
    values = deflections(400)
    history = History(64)
    along = LawOnAxis(RECURSIVE, history)
    for value in values:
        history.push(value)
        along.force(history.head)
    late = LawOnAxis(RECURSIVE, history)
    late.warm_up(history.snapshot())
    # 63 known values, the largest pole has radius 0.7702: what is left of the force before them is
    # below 0.7702^62 times the largest force of a section, some 300 N/m · 4 mm · a few.
    assert abs(late.present() - along.present()) < 0.7702**62 * 10.0


def test_sections_see_the_ticks_that_were_bridged() -> None:
    # A law whose sections are the first-order difference equation y = x + 0.5 y₋₁: fed a line, it
    # has a closed form.
    law = CompiledLaw((0.0,), ((1.0, 0.0, -0.5, 0.0),))
    renderer = Renderer([2], 32)
    renderer.fallback = ActiveLaw(
        "fallback", "{}", CompiledLaw((0.0,)), renderer.histories
    )
    renderer.law = ActiveLaw("r", "{}", law, renderer.histories)
    whole = Renderer([2], 32)
    whole.law = ActiveLaw("r", "{}", law, whole.histories)
    inside = [proxy_at(-0.001 * k, k) for k in range(10)]
    for k, proxy in enumerate(inside):
        expected = whole.render(proxy)
        if k in (4, 5, 6):
            continue
        if k == 7:
            renderer.bridge(proxy, 3)
        found = renderer.render(proxy)
        assert found == pytest.approx(expected, rel=1e-12)


# -- fades and swaps
# --------------------------------------------------------------------------------------------------


def proxy_at(z: float, seq: int = 0) -> Proxy:
    """Return the contact with a floor at z = 0."""
    surface = (0.0, 0.0, 0.0 if z < 0.0 else z)
    return Proxy(
        seq=seq,
        stamp=0.0,
        position=(0.0, 0.0, z),
        proxy=surface,
        normal=(0.0, 0.0, 1.0),
        distance=z,
        contact=z < 0.0,
    )


def renderer_with(*taps: float) -> Renderer:
    renderer = Renderer([2], 64)
    renderer.law = ActiveLaw(
        "first", '{"law":"first"}', CompiledLaw(taps), renderer.histories
    )
    renderer.fallback = ActiveLaw(
        "fallback", '{"law":"fallback"}', CompiledLaw((0.0, 0.0)), renderer.histories
    )
    return renderer


def law_of(renderer: Renderer, *taps: float, **more: Any) -> ActiveLaw:
    return ActiveLaw(
        "next", '{"law":"next"}', CompiledLaw(taps, **more), renderer.histories
    )


def test_a_fade_is_the_kernels_and_ends_after_its_ramp() -> None:
    renderer = renderer_with(1000.0)
    depth = -0.001
    renderer.render(proxy_at(depth))
    step = renderer.swap(law_of(renderer, 3000.0), 4)
    assert step == pytest.approx(2.0, rel=1e-15)
    forces = [renderer.render(proxy_at(depth))[2] for _ in range(6)]
    old, new = 1000.0 * 0.001, 3000.0 * 0.001
    assert forces[:4] == [arithmetic.cross_fade(old, new, done, 4) for done in range(4)]
    assert forces[3:] == [new] * 3


@given(
    st.lists(
        st.tuples(st.floats(100.0, 5000.0), st.integers(0, 30), st.integers(1, 12)),
        min_size=1,
        max_size=14,
    )
)
@settings(max_examples=60)
def test_a_swap_during_a_fade_does_not_make_the_force_jump(
    swaps: list[tuple[float, int, int]],
) -> None:
    # Held at 1 mm every law's force is constant, so a fade's largest step is the whole difference
    # over its ramp; a hard swap's is the difference itself. More than LEAVING laws are joined,
    # which must not show either.
    renderer = renderer_with(1000.0)
    before = renderer.render(proxy_at(-0.001))[2]
    present = before
    for stiffness, ramp, ticks in swaps:
        target = stiffness * 0.001
        told = renderer.swap(law_of(renderer, stiffness), ramp)
        assert told == pytest.approx(abs(target - present), rel=1e-9, abs=1e-12)
        for tick in range(ticks):
            force = renderer.render(proxy_at(-0.001))[2]
            left = max(ramp - tick, 1)
            assert abs(force - present) <= abs(target - present) / left + 1e-12
            present = force
    assert all(len(leaving) <= LEAVING for leaving in renderer._leaving)


@pytest.mark.parametrize("counts", [(1, 3, 2), (30, 3, 70)])
def test_laws_of_taps_are_joined_exactly(counts: tuple[int, ...]) -> None:
    laws = [
        (tuple(deflections(count, 7 + count)), weight)
        for count, weight in zip(counts, (0.5, 0.2, 0.3), strict=True)
    ]
    history = filled(deflections(100), 80)
    joined = arithmetic.fir(weighted_taps(laws), history.values, history.head)
    apart = sum(
        weight * arithmetic.fir(taps, history.values, history.head)
        for taps, weight in laws
    )
    # Sums of 100 products of size 1e-6 in another order.
    assert joined == pytest.approx(apart, abs=100 * 1e-6 * 2**-52)


def test_shares_add_up_and_the_least_are_joined() -> None:
    history = History(8)
    sections = ((1.0, 0.0, -0.5, 0.0),)
    laws = [
        LawOnAxis(CompiledLaw((1.0,), sections if k % 2 else ()), history)
        for k in range(3 * LEAVING)
    ]
    shares = [(laws[0], 1.0)]
    for law in laws[1:]:
        shares = shares_of(shares, law, 0.1)
        assert math.fsum(share for _, share in shares) == pytest.approx(1.0, rel=1e-12)
        assert len(shares) <= LEAVING


def test_a_fade_interrupted_before_its_first_tick_has_no_share_of_the_new_law() -> None:
    history = History(8)
    old, new = (LawOnAxis(CompiledLaw((k,)), history) for k in (1.0, 2.0))
    assert shares_of([(old, 1.0)], new, 0.0) == [(old, 1.0)]


def broken(ring: Any, head: int) -> float:
    raise RuntimeError(f"no force at {ring[head]:g}")


@pytest.mark.parametrize(
    ("more", "told"),
    [
        ({"evaluate": broken}, "raised RuntimeError: no force at 0.001"),
        ({"evaluate": lambda *_: math.nan}, "nan, which is not a finite force"),
        ({"evaluate": lambda *_: "strong"}, "raised TypeError"),
    ],
)
def test_a_law_that_fails_at_once_is_not_swapped_in(
    more: dict[str, Any], told: str
) -> None:
    renderer = renderer_with(1000.0)
    renderer.render(proxy_at(-0.001))
    running = renderer.law
    with pytest.raises(ParameterError, match="law 'next'") as raised:
        renderer.swap(law_of(renderer, 500.0, **more), 5)
    assert told in str(raised.value)
    assert renderer.law is running
    assert renderer.render(proxy_at(-0.001))[2] == 1.0


def test_taps_that_overflow_at_the_present_deflection_are_not_swapped_in() -> None:
    renderer = renderer_with(1000.0)
    renderer.render(proxy_at(-1e3))
    with pytest.raises(ParameterError, match="force step of inf"):
        renderer.swap(law_of(renderer, 1e308), 0)
    assert renderer.law.name == "first"


def test_a_failed_law_is_replaced_within_the_tick_whose_deflection_it_kept_from_the_history() -> (
    None
):
    renderer = renderer_with(1000.0)
    renderer.fallback = ActiveLaw(
        "fallback", "{}", CompiledLaw((5.0 / T, -5.0 / T)), renderer.histories
    )
    renderer.law = law_of(renderer, 1000.0, evaluate=broken)
    assert renderer.watched
    due = renderer.due()
    with pytest.raises(RuntimeError):
        renderer.render(proxy_at(-0.001))
    force = renderer.fall_back(proxy_at(-0.001), due)
    # From 0 to 1 mm within one tick, times 5 N s/m; the deflection is in the history once.
    assert force[2] == pytest.approx(5.0 * 0.001 / T, rel=1e-12)
    assert renderer.histories[0].pushes == 1
    assert renderer.law.name == "fallback"
    assert not renderer.watched


def test_a_fallback_that_overflows_renders_nothing() -> None:
    renderer = renderer_with(1000.0)
    renderer.fallback = ActiveLaw(
        "fallback", "{}", CompiledLaw((1e308, -1e308)), renderer.histories
    )
    assert renderer.fall_back(proxy_at(-1e3), renderer.due()) == (0.0, 0.0, 0.0)


def test_a_law_that_fades_out_is_watched_until_it_is_gone() -> None:
    renderer = renderer_with(1000.0)
    renderer.law = law_of(renderer, 1000.0, evaluate=lambda *_: 1.0)
    renderer.render(proxy_at(-0.001))
    renderer.swap(law_of(renderer, 2000.0), 3)
    watched = []
    for _ in range(4):
        watched.append(renderer.watched)
        renderer.render(proxy_at(-0.001))
    assert watched == [True, True, True, False]


# -- budget
# --------------------------------------------------------------------------------------------------


def test_sleeping_and_computing_overrun_and_waiting_for_the_interpreter_is_excused() -> (
    None
):
    budget = Budget(0.005)
    budget.start()
    assert budget.overrun() == ""
    time.sleep(0.01)
    assert "slept" in budget.overrun()
    assert budget.overrun(excused=True) == ""
    budget.start()
    until = time.thread_time() + 0.006
    while time.thread_time() < until:
        pass
    assert "computed for" in budget.overrun()
    assert "budget 5000 µs" in budget.overrun(excused=True)
    # One alone may be the machine's; just within a second the next one is the law's, just beyond it
    # is alone again.
    assert [budget.again(seconds) for seconds in (3.0, 4.0, 5.002, 6.0)] == [
        False,
        True,
        False,
        True,
    ]


class Slow(Law, frozen=True, kw_only=True):
    """A law that takes 20 ms."""

    kind: ClassVar[str] = "slow"

    def compile(self, period: float) -> CompiledLaw:
        """Compile to taps and slow code."""
        del period

        def evaluate(history: Sequence[float], head: int) -> float:
            time.sleep(0.02)
            return history[head]

        return CompiledLaw((0.0,), (), evaluate)


def test_a_law_is_tried_with_the_budget_that_it_comes_with(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("nodes.laws.parse.load_law", {"slow": Slow, "pd": PD}.get)
    monkeypatch.setattr("nodes.laws.parse.law_names", lambda: ["pd", "slow"])
    laws = {
        "slow": {"kind": "slow"},
        "pd": {"kind": "pd", "stiffness": 500.0, "damping": 3.0},
    }
    node = Coupling(
        setup_of(
            name="coupling",
            period=0.1,
            parameters={"law": "pd", "laws": laws, "stability": "off"},
        )
    )
    node.configure()
    # 20 ms within 50 ms; not within 10 ms, and 100 ms are no reason to refuse it.
    node.prepare(node.store.changed({"law": "slow"}))
    with pytest.raises(ParameterError, match="budget 10000 µs"):
        node.prepare(node.store.changed({"law": "slow", "budget": 0.1}))
    node.store.accept(node.store.changed({"budget": 0.1}))
    node._settle(node.store.current, node._renderer.fallback)
    node.prepare(node.store.changed({"law": "slow", "budget": 1.0}))


def test_a_law_that_is_scheduled_follows_a_change_before_its_time() -> None:
    """Only the one that was changed is compiled again; the others are the same objects."""

    def pd(stiffness: float) -> dict[str, Any]:
        return {"kind": "pd", "stiffness": stiffness, "damping": 3.0}

    laws = {"first": pd(500.0), "second": pd(600.0), "third": pd(700.0)}
    schedule = [{"at": 0.1, "law": "second"}, {"at": 0.2, "law": "third"}]
    more = {"law": "first", "laws": laws, "schedule": schedule, "stability": "off"}
    node = Coupling(setup_of(name="coupling", parameters=more))
    node.configure()
    second, third = (swap.law for swap in node._schedule.swaps)
    node.prepare(node.store.changed({"laws.second.stiffness": 650.0}))(0)
    changed, same = node._schedule.swaps
    assert same.law is third
    assert changed.law is not second
    assert changed.law.compiled.h1 == pytest.approx(650.0)
    assert (changed.tick, same.tick) == (50, 100)


@pytest.mark.parametrize("pushed", [1, 2, 5])
def test_a_law_on_standby_catches_up_from_the_first_deflection_on(pushed: int) -> None:
    """Its sections have seen all that one has seen tick by tick, to the bit."""
    law = CompiledLaw((100.0, -100.0), ((5.0, -4.0, -0.5, 0.25),))
    history = History(8)
    waiting, seeing = LawOnAxis(law, history), LawOnAxis(law, history)
    for k in range(pushed):
        history.push(1e-3 * (k + 1))
        seeing.see(history.head)
    waiting.catch_up()
    assert list(waiting.state) == list(seeing.state) != [0.0, 0.0]
    # Filled, it rests under what all deflections are now, as one that settles does.
    history.fill(2e-3)
    waiting.catch_up()
    seeing.settle(2e-3)
    assert list(waiting.state) == list(seeing.state)
