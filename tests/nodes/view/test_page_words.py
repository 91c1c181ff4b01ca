"""A page's refusals name what is on the page, and no command."""

from __future__ import annotations

import pytest

from messages.errors import AT_MOST, FORCE, Remedy
from messages.types import Event
from nodes.driver import notes
from nodes.driver.force_words import NOTES
from nodes.view.page_words import event_text, in_page_words

LARGEST = Remedy(
    AT_MOST, "the largest pd.stiffness that is accepted is 5797", {"pd.stiffness": 5797}
)
BY_FORCE = Remedy(FORCE, "to study it anyway, use --force")


@pytest.mark.parametrize("beyond", [False, True])
def test_a_refusal_names_the_switch_only_where_there_is_one(beyond: bool) -> None:
    told = in_page_words((LARGEST, BY_FORCE), beyond)
    assert told[0] == LARGEST
    assert [one.kind for one in told] == [AT_MOST, FORCE][: 1 + beyond]
    assert not any("--force" in one.text for one in told)
    assert all("past the edge" in one.text for one in told[1:])


@pytest.mark.parametrize("beyond", [False, True])
def test_a_refusal_that_no_force_passes_names_no_switch(beyond: bool) -> None:
    assert in_page_words((LARGEST,), beyond) == (LARGEST,)


def test_a_stop_names_the_button() -> None:
    note = NOTES[notes.SWINGS]
    numbers = dict.fromkeys(note.fields, 2.0)
    reason = note.text.format_map(numbers) + ": " + note.remedy
    data = {"cause": float(notes.SWINGS), "tick": 7.0, **numbers}
    stop = Event(
        seq=7, stamp=0.0, node="driver", kind="stopped", reason=reason, data=data
    )
    told = event_text(stop)
    assert "2 strokes" in told
    assert "press Again" in told
    assert "haptic" not in told
    ended = Event(
        seq=7, stamp=0.0, node="driver", kind="lost", reason="ended with SIGKILL"
    )
    assert event_text(ended) == "ended with SIGKILL"
