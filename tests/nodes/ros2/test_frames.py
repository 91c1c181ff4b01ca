"""ROS 2 messages in another frame are refused, with one event; without any graph."""

from __future__ import annotations

from collections import deque
from types import SimpleNamespace
from typing import Any

import pytest

from nodes.ros2.node import MAX_FRAMES, Ros2
from tests.support.setups import setup_of


def message(frame: str, **content: Any) -> Any:
    stamp = SimpleNamespace(sec=0, nanosec=0)
    return SimpleNamespace(
        header=SimpleNamespace(frame_id=frame, stamp=stamp), **content
    )


class Hand:
    """A hand that records its targets."""

    def __init__(self) -> None:
        self.targets: list[tuple[float, float, float]] = []

    def write(self, target: tuple[float, float, float]) -> None:
        """Record a target."""
        self.targets.append(target)


@pytest.fixture
def told() -> deque[tuple[str, str]]:
    return deque()


def node(
    told: deque[tuple[str, str]], monkeypatch: pytest.MonkeyPatch, **parameters: Any
) -> Ros2:
    made = Ros2(setup_of(name="ros2", kind="ros2", parameters=parameters))
    monkeypatch.setattr(
        made.events, "emit_each", lambda kind, text: told.append((kind, text))
    )
    return made


@pytest.mark.parametrize("given", [{}, {"frame": "base"}])
def test_ours_or_none_is_taken_and_another_is_refused_once(
    given: dict[str, str], told: deque[tuple[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A force in a tool's frame was applied as if it were in ours."""
    ros2, hand = node(told, monkeypatch, **given), Hand()
    ros2._hand = hand  # type: ignore[assignment]
    ours = given.get("frame", "haptic")
    for frame in ("", ours, f"/{ours}"):
        wrench = message(frame)
        ros2._take_wrench(wrench)
        assert ros2._wrench is wrench
        ros2._take_target(
            message(
                frame,
                pose=SimpleNamespace(position=SimpleNamespace(x=1.0, y=2.0, z=3.0)),
            )
        )
    assert hand.targets == [(1.0, 2.0, 3.0)] * 3
    assert not told
    ros2._wrench = None
    for frame in ("tool0", "tool0", ours.upper(), f"{ours}/tool", f" {ours}"):
        ros2._take_wrench(message(frame))
        ros2._take_target(
            message(
                frame,
                pose=SimpleNamespace(position=SimpleNamespace(x=9.0, y=9.0, z=9.0)),
            )
        )
    assert ros2._wrench is None
    assert len(hand.targets) == 3
    assert len(told) == 8
    kind, text = told[0]
    assert kind == "frame"
    assert text.startswith(
        f"wrench: in frame 'tool0', expected '{ours}' or none; refused"
    )
    assert told[1][1].startswith("target: in frame 'tool0'")


def test_frames_without_end_are_not_told_without_end(
    told: deque[tuple[str, str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    ros2 = node(told, monkeypatch)
    for n in range(1000):
        ros2._take_wrench(message(f"tool{n}" * 1000))
    assert ros2._wrench is None
    assert len(told) == MAX_FRAMES
    assert max(len(text) for _, text in told) < 400
