"""Refusals and events in a page's own terms: its switch and buttons, no commands."""

from __future__ import annotations

import re
from typing import Final

_ANYWAY: Final = re.compile(r"; to study it anyway, use --force, or set \S+ to warn")
_REPLACED: Final = (
    (
        re.compile(
            r"choose a softer law, then (?:run )?haptic node rearm(?:, or launch again)?"
        ),
        "press Again, which softens the wall",
    ),
    (re.compile(r"^view: "), ""),
    (re.compile(r"; use: haptic param set \S+ \S+"), ""),
)


def in_page_words(text: str, beyond: bool = False) -> str:
    """Return a node's text as a page says it.

    `beyond` tells whether the page has a switch for going past the edge.
    """
    switch = "; to try it anyway, tick “past the edge”" if beyond else ""
    text = _ANYWAY.sub(switch, text)
    for pattern, words in _REPLACED:
        text = pattern.sub(words, text)
    return text[:1].upper() + text[1:] if text[:4] == "the " else text
