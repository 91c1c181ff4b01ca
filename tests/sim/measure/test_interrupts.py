"""A signal during a request: the request is answered first, then the verb ends, once."""

from __future__ import annotations

import os
import signal

import pytest

from sim.measure.interrupts import SIGNALS, deferred, interrupted_once, undisturbed


@pytest.mark.parametrize("number", SIGNALS)
def test_a_request_that_was_sent_is_answered_before_the_verb_leaves(
    number: signal.Signals,
) -> None:
    done: list[str] = []

    def ask() -> None:
        with deferred():
            done.append("sent")
            os.kill(os.getpid(), number)
            # Twice, as impatient people do.
            os.kill(os.getpid(), number)
            done.append("answered")
        done.append("went on")

    with interrupted_once() as signalled:
        with pytest.raises(KeyboardInterrupt):
            ask()
        with undisturbed(), deferred():
            done.append("put back")
        assert signalled() == number
    assert done == ["sent", "answered", "put back"]


def test_a_signal_between_requests_leaves_at_once() -> None:
    with interrupted_once():
        with deferred():
            pass
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGTERM)
