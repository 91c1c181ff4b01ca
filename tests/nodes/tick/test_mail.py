"""What a node tells while it is in compiled ticks: they do not stop for it, and nothing that it tells is old or lost."""

from __future__ import annotations

import statistics

import pytest

from messages.types import NodeStatus
from nodes.recording.accounts import accounts
from nodes.recording.reader import Recording
from tests.support.launching import launch_json

RATE = 1000.0
TICKS = {"driver": "/device/state", "environment": "/environment/proxy", "coupling": "/coupling/force"}


@pytest.fixture(scope="module")
def figures(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, object], Recording]:
    folder = tmp_path_factory.mktemp("mail")
    found = launch_json(folder, "floor_drop", f"rate:={RATE:g}", "duration:=3", "tick:=compiled", "stiffness:=500")
    return found, Recording(folder / str(found["recording"]))


@pytest.mark.parametrize("node", TICKS)
def test_a_status_says_where_the_node_is_now(figures: tuple[dict[str, object], Recording], node: str) -> None:
    recording = figures[1]
    newest, behind, ticks = 0, [], []
    for entry in recording.entries([TICKS[node], f"/{node}/status"]):
        if entry.topic == TICKS[node]:
            newest = entry.message.seq
        elif isinstance(status := entry.message, NodeStatus) and status.state == "running":
            behind.append(abs(newest - status.seq))
            ticks.append(status.ticks)
    # Every half second of three.
    assert len(ticks) >= 4
    assert ticks == sorted(set(ticks))
    # Messages leave in batches of 2 ms, and a status after one: two batches and the tick under way. A machine that stands still
    # in between may delay some.
    assert statistics.median(behind) <= 2 * 0.002 * RATE + 1


def test_all_that_was_told_was_sent_and_counted(figures: tuple[dict[str, object], Recording]) -> None:
    found, recording = figures
    assert found["tick"] == "compiled"
    for node, account in accounts(recording).items():
        assert account.finished, node
        assert account.lost == 0, node
