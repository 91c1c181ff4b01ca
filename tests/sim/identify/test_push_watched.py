"""Watching a push tick by tick: when it is over, and why."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from messages.types import DeviceState
from sim.identify.borrowed import Borrowed, PushedLaunch
from sim.identify.push import Pushed, _centre, _watch

T = 0.002
FIRST = 100
"""Tick of the push's beginning."""


def states(ticks: int, first: int = FIRST - 5, **every: Any) -> list[DeviceState]:
    """Return states of a device that moves by 1 mm each tick."""
    return [
        DeviceState(
            seq=seq, stamp=0.0, **{"position": (0.0, 0.0, 1e-3 * (seq % 2)), **every}
        )
        for seq in range(first, FIRST + ticks)
    ]


class Scripted(PushedLaunch):
    """A launch of a driver with given states, whose changes are recorded."""

    def __init__(self, given: list[DeviceState]) -> None:
        self.coupling, self.period, self.axes = "coupling", T, (2,)
        self.environment = "wall"
        self.changes: list[tuple[str, str, dict[str, Any]]] = []
        self._given = given

    def states(self, silence: float = 0.0) -> Iterator[DeviceState]:  # noqa: ARG002  # ends
        """Yield the given states."""
        yield from self._given

    def change(self, node: str, operation: str, **words: Any) -> Any:
        """Record a change, which applies from the first tick of the push."""
        self.changes.append((node, operation, words))
        return {"seq": FIRST}

    def why_stopped(self) -> str:
        """Return a reason."""
        return "too hot"


class Held:
    """Leases that last."""

    checks = 0

    def check(self) -> None:
        """Count the checks."""
        self.checks += 1


def watched(
    given: list[DeviceState], duration: float = 1.0
) -> tuple[Pushed, list[str]]:
    result, said = Pushed(Path("r.mcap"), (0.0, 0.0, 0.0)), list[str]()
    _watch(Scripted(given), duration, cast(Borrowed, Held()), said.append, result)
    return result, said


def test_a_push_is_over_after_its_ticks_and_tells_its_progress() -> None:
    """One second of 2 ms: 500 ticks, told every 50; those before the law's first do not count."""
    result, said = watched(states(600))
    assert (result.reason, result.ticks) == ("done", (FIRST, FIRST + 500))
    assert said == [f"pushing: {k} %" for k in range(0, 101, 10)]
    result, _ = watched(states(500))
    assert (result.reason, result.ticks) == ("the launch ended", (FIRST, FIRST + 499))


@pytest.mark.parametrize(
    ("moves", "reason"), [(1e-4, "has not moved"), (1.01e-4, "done")]
)
def test_a_device_that_does_not_move_for_a_second_and_a_half_is_held_fast(
    moves: float, reason: str
) -> None:
    given = [replace_position(one, moves * (one.seq % 2)) for one in states(2000)]
    result, _ = watched(given, duration=3.0)
    assert reason in result.reason
    # 750 ticks without motion are not yet more than 1.5 s.
    assert result.ticks[1] - FIRST == (751 if moves == 1e-4 else 1500)


def replace_position(state: DeviceState, height: float) -> DeviceState:
    return DeviceState(seq=state.seq, stamp=0.0, position=(0.0, 0.0, height))


@pytest.mark.parametrize("safety", ["fault", "zero", "stopped"])
def test_a_second_without_force_ends_a_push_and_a_gap_does_not(safety: str) -> None:
    gone = states(499, first=FIRST - 5, safety=safety)
    back = states(500, first=FIRST + 499)
    result, _ = watched([*gone, *back], duration=0.998)
    assert result.reason == "done"
    result, _ = watched(states(600, safety=safety), duration=1.1)
    assert result.reason == f"the driver removed the force ({safety}): too hot"
    assert result.ticks[1] - FIRST == 500


@pytest.mark.parametrize(
    ("way", "steps"), [(0.0, 1), (0.4e-3, 1), (3e-3, 3), (-20e-3, 20)]
)
def test_the_anchor_goes_to_the_centre_by_millimetres(way: float, steps: int) -> None:
    loop = Scripted([])
    _centre(loop, (0.1, 0.2, 0.3), (0.1, 0.2 - 0.5 * way, 0.3 + way))
    places = [words["values"]["surface"]["position"] for _, _, words in loop.changes]
    assert len(places) == steps
    for n, place in enumerate(places, 1):
        share = n / steps
        assert place == pytest.approx(
            [0.1, 0.2 - 0.5 * share * way, 0.3 + share * way], abs=1e-15
        )
