"""A page's refusals name what is on the page, and no command."""

from __future__ import annotations

import pytest

from nodes.driver import notes
from nodes.driver.force_words import NOTES
from nodes.view.page_words import in_page_words

REFUSED = (
    "coupling.laws.pd: pole radius 1.2; nothing was changed. The largest pd.stiffness that is"
    " accepted is 5797; to study it anyway, use --force, or set coupling.stability to warn"
)


@pytest.mark.parametrize("beyond", [False, True])
def test_a_refusal_names_the_switch_only_where_there_is_one(beyond: bool) -> None:
    told = in_page_words(REFUSED, beyond)
    assert "--force" not in told
    assert "largest pd.stiffness that is accepted is 5797" in told
    assert ("past the edge" in told) == beyond


def test_a_stop_names_the_button() -> None:
    told = in_page_words(NOTES[notes.SWINGS].text)
    assert "press Again" in told
    assert "haptic" not in told
    refused = "view: nothing to undo"
    assert in_page_words(refused) == "nothing to undo"
    assert in_page_words("driver: ended with SIGKILL") == "driver: ended with SIGKILL"
