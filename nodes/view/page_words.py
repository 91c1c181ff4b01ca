"""Refusals and events in a page's own terms: its switch and buttons, no commands."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from messages.errors import FORCE, Remedy
from messages.types import Event
from nodes.driver.force_words import cause_of

_SWITCH: Final = Remedy(FORCE, "to try it anyway, tick “past the edge”")


def in_page_words(remedies: Iterable[Remedy], beyond: bool) -> tuple[Remedy, ...]:
    """Return ways out of a refusal as a page offers them.

    `beyond` tells whether the page has a switch for going past the edge.
    """
    found = tuple(one for one in remedies if one.kind != FORCE)
    return (*found, _SWITCH) if beyond and found != tuple(remedies) else found


def event_text(event: Event) -> str:
    """Return what a page logs about an event."""
    if event.kind == "stopped":
        return f"{cause_of(event)}; press Again, which softens the wall"
    return event.reason
