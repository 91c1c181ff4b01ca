"""Counting a user's requests for the end, and commands interrupted before their verb."""

from __future__ import annotations

import signal
import sys

import pytest

from nodes.cli import command
from nodes.launcher import launch_file
from nodes.launcher.supervisor import Supervisor


def test_a_node_that_fails_is_no_user_who_asks(
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The first Ctrl-C after a failed node counted as the second: loggers had only 0.3 s."""
    supervisor = Supervisor(launch_file.read("floor_drop", {}), print, print)
    supervisor.stop("driver: ended with exit code 1")
    supervisor.stop("coupling: ended with exit code 1")
    assert (supervisor.ending, supervisor._hurry) == (True, False)
    supervisor.interrupt("SIGINT")
    assert not supervisor._hurry
    assert supervisor._stop_asked == "driver: ended with exit code 1"
    supervisor.interrupt("SIGINT")
    assert supervisor._hurry
    supervisor.context.term()


@pytest.mark.parametrize("when", ["before", "after"])
def test_ctrl_c_beside_a_verb_ends_without_a_word(
    when: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ctrl-C just before or after a verb printed a traceback."""

    def run() -> int:
        if when == "before":
            signal.raise_signal(signal.SIGINT)
        return 0

    def freeze() -> None:
        # What comes now ends the process as if it were killed: no Python is run for it.
        assert signal.getsignal(signal.SIGINT) is signal.SIG_DFL

    monkeypatch.setattr("nodes.cli.main.main", run)
    monkeypatch.setattr("nodes.cli.command.gc.freeze", freeze)
    monkeypatch.setattr("nodes.cli.command.gc.set_threshold", lambda _: None)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        assert command.main() == (130 if when == "before" else 0)
    finally:
        signal.signal(signal.SIGINT, before)
    assert "Traceback" not in capsys.readouterr().err
    assert sys.exc_info() == (None, None, None)
