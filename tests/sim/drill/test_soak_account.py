"""Soak accounts: a logger must have everything between its first and last message."""

from __future__ import annotations

from pathlib import Path

from messages.topics import FORCE
from nodes.recording.writer import RecordWriter
from sim.drill.soak import Soak, _account
from tests.support.recorded import PUBLISHES, drop


def recorded(path: Path, first: int, end: int, without: int | None = None) -> None:
    """Record these ticks of a drop, without one force."""
    with RecordWriter(path, {"publishes": PUBLISHES}) as writer:
        for topic, message in drop(end):
            if message.seq >= first and (topic, message.seq) != (FORCE, without):
                writer.write(topic, message, message.stamp)


def test_what_a_visiting_logger_heard_it_heard_without_a_gap(tmp_path: Path) -> None:
    recorded(tmp_path / "run.mcap", 0, 300)
    recorded(tmp_path / "whole.mcap", 100, 200)
    recorded(tmp_path / "gap.mcap", 100, 200, without=150)
    with RecordWriter(tmp_path / "silent.mcap", {}):
        pass
    found = Soak()
    _account(tmp_path, found, ["whole.mcap", "silent.mcap", "gap.mcap", "none.mcap"])
    gap, none = found.reasons
    assert gap == f"gap.mcap: 1 messages of {FORCE} that the launch's logger has"
    assert none.startswith("none.mcap: ")
    assert found.shared > 500
