"""A hanging loop: the time is counted per activity."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from nodes.base import hang_watchdog


def test_what_begins_has_not_stood_however_long_the_wait_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A driver that waited long for its start counted as hung in its first ticks."""
    clock = [0.0]
    monkeypatch.setattr(
        hang_watchdog, "time", SimpleNamespace(monotonic=lambda: clock[0])
    )
    watched = hang_watchdog.HangWatchdog()
    for clock[0] in (0.5, 1.0, 1.5, 20.0):
        stood = watched.check("waits for the start")
    # A look after 18.5 s counts as two at most: the thread that looks was held up itself.
    assert stood == pytest.approx(0.5 + 0.5 + 2.0 * hang_watchdog.CHECK_INTERVAL)
    clock[0] += 0.5 * hang_watchdog.CHECK_INTERVAL
    assert watched.check("a tick") == 0.0
    clock[0] += 0.5
    assert watched.check("a tick") == pytest.approx(0.5)
