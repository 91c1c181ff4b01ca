"""The hand shared by pages: one owner; a silent page's hand is kept, then returns."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import pytest

from messages.types import ZERO
from nodes.driver.pointer import PointerReader
from nodes.view.shared_hand import (
    DEPTH,
    EVERY,
    PRESS,
    REST,
    SILENCE_LIMIT,
    SLOWLY,
    SharedHand,
)


class Clock:
    """Time as seen by hand and pointer."""

    def __init__(self) -> None:
        self.now = 100.0

    def monotonic(self) -> float:
        """Return the time."""
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    found = Clock()
    monkeypatch.setattr("nodes.view.shared_hand.time.monotonic", found.monotonic)
    return found


def test_one_page_at_a_time_has_the_hand(tmp_path: Path) -> None:
    path = tmp_path / "p"
    assert "this launch has none" in SharedHand(path).move(1, [0.0, 0.0, 0.0])
    reader = PointerReader(path, 60.0)
    hand = SharedHand(path)
    assert hand.there
    assert hand.move(1, [0.01, 0.0, 0.0]) == ""
    assert hand.move(2, [0.5, 0.0, 0.0]) == "hand: another page holds it"
    assert hand.move(2, None) == ""
    assert reader.read() == (0.01, 0.0, 0.0)
    assert hand.move(1, None) == ""
    assert reader.read() is None
    assert hand.move(2, [0.5, 0.0, 0.0]) == ""
    assert "finite" in hand.move(2, [math.inf, 0.0, 0.0])
    assert reader.read() == (0.5, 0.0, 0.0)
    hand.close()
    reader.close()


def test_of_two_views_beside_one_launch_one_has_the_hand(
    tmp_path: Path, clock: Clock
) -> None:
    """Each view is a separate process with the same file."""
    reader = PointerReader(tmp_path / "p", 60.0)
    first, second = SharedHand(tmp_path / "p"), SharedHand(tmp_path / "p")
    for hand in (first, second):
        hand.step(ZERO)
    assert first.move(1, [0.01, 0.0, 0.0]) == ""
    assert second.move(1, [0.5, 0.0, 0.0]) == "hand: another page holds it"
    assert second.move(1, None) == ""
    clock.now += REST + EVERY
    for _ in range(round(100 * PRESS)):
        clock.now += 0.01
        assert first.move(1, [0.01, 0.0, 0.0]) == ""
        second.tap(0, 0.02, -1.0)
        assert reader.read() == (0.01, 0.0, 0.0), (
            "the other view does not tap meanwhile"
        )
    first.move(1, None)
    assert reader.read() is None
    assert second.move(1, [0.5, 0.0, 0.0]) == ""
    # A view that is killed leaves the hand to others.
    second.close()
    assert first.move(1, [0.02, 0.0, 0.0]) == ""
    assert reader.read() == (0.02, 0.0, 0.0)
    first.close()
    reader.close()


def test_a_tap_does_not_keep_a_page_of_another_view_from_the_hand(
    tmp_path: Path, clock: Clock
) -> None:
    reader = PointerReader(tmp_path / "p", 60.0)
    first, second = SharedHand(tmp_path / "p"), SharedHand(tmp_path / "p")
    for hand in (first, second):
        hand.step(ZERO)
    clock.now += REST
    first.tap(0, 0.02, -1.0)
    clock.now += 0.5 * PRESS
    first.tap(0, 0.02, -1.0)
    assert (reader.read() or ZERO)[0] > 0.02, "it taps"
    assert second.move(1, [0.001, 0.0, 0.0]) == ""
    for _ in range(100):
        clock.now += 0.01
        first.tap(0, 0.02, -1.0)
    assert reader.read() == (0.001, 0.0, 0.0)
    for hand in (first, second):
        hand.close()
    reader.close()


def test_a_page_that_stalls_keeps_the_hand_then_lets_it_go_slowly_and_takes_it_back_slowly(
    tmp_path: Path, clock: Clock
) -> None:
    reader, hand = PointerReader(tmp_path / "p", 1.0), SharedHand(tmp_path / "p")
    hand.step((0.001, 0.0, 0.0))
    assert hand.move(1, [0.021, 0.0, 0.0]) == ""

    def wait(seconds: float) -> list[float | None]:
        found: list[float | None] = []
        for _ in range(round(seconds * 100)):
            clock.now += 0.01
            hand.step((0.001, 0.0, 0.0))
            target = reader.read()
            found.append(None if target is None else target[0])
        return found

    # A stall of 0.5 s, or of 1.9 s: nothing moves.
    assert set(wait(SILENCE_LIMIT - 0.1)) == {0.021}
    away = [x for x in wait(1.0) if x is not None]
    steps = [b - a for a, b in itertools.pairwise(away)]
    assert min(steps) == pytest.approx(-SLOWLY * 0.01)
    assert max(steps) <= 0.0
    assert wait(0.1)[-1] is None, "home, after 0.4 s: its path has it again"
    # The finger was on the mouse all the time.
    assert hand.move(1, [0.021, 0.0, 0.0]) == ""
    back = []
    for _ in range(60):
        hand.move(1, [0.021, 0.0, 0.0])
        back += [x for x in wait(0.01) if x is not None]
    steps = [b - a for a, b in itertools.pairwise(back)]
    assert max(steps) == pytest.approx(SLOWLY * 0.01)
    assert back[0] < 0.002
    assert back[-1] == 0.021
    # Caught up, it follows at once again.
    hand.move(1, [0.011, 0.0, 0.0])
    assert reader.read() == (0.011, 0.0, 0.0)
    # Who lets go is not silent: the path has it this moment.
    hand.move(1, None)
    assert reader.read() is None
    hand.move(1, [0.02, 0.0, 0.0])
    assert reader.read() == (0.02, 0.0, 0.0)
    hand.close()
    reader.close()


def test_until_somebody_takes_it_the_hand_taps(tmp_path: Path, clock: Clock) -> None:
    reader, hand = PointerReader(tmp_path / "p", 1.0), SharedHand(tmp_path / "p")
    hand.step(ZERO)
    seen: list[tuple[float, float]] = []

    def wait(seconds: float) -> None:
        for _ in range(round(seconds * 100)):
            clock.now += 0.01
            target = reader.read()
            # What the driver tells: where it is dragged to, else its path, which rests.
            hand.step(target or (0.001 if clock.now < 101.0 else 0.0, 0.0, 0.0))
            hand.tap(0, 0.02, -1.0)
            if target is not None:
                seen.append((clock.now, target[0]))

    wait(1.0 + REST - 0.02)
    assert not seen, "its own path comes first"
    wait(2.0 * EVERY)
    assert max(x for _, x in seen) == pytest.approx(0.02 + DEPTH)
    begins = [b for (a, _), (b, _) in itertools.pairwise(seen) if b - a > PRESS]
    assert begins
    assert begins[0] - seen[0][0] == pytest.approx(EVERY, abs=0.05)
    wait(EVERY)
    hand.move(7, [0.0, 0.0, 0.0])
    hand.move(7, None)
    seen.clear()
    wait(2.0 * EVERY)
    assert not seen, "somebody has touched it: it is theirs"
    hand.close()
    reader.close()


def test_a_hand_whose_path_has_long_come_to_rest_taps_too(
    tmp_path: Path, clock: Clock
) -> None:
    """Also if the view starts late, or again."""
    reader, hand = PointerReader(tmp_path / "p", 1.0), SharedHand(tmp_path / "p")
    for _ in range(round(100 * (REST + PRESS))):
        clock.now += 0.01
        hand.step(reader.read() or ZERO)
        hand.tap(0, 0.02, -1.0)
    assert reader.read() is not None
    hand.close()
    reader.close()
