"""The known name that somebody who mistyped one probably meant."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


def nearest(given: object, known: Iterable[str]) -> str:
    """Return the known name that is most like a given one; empty if none is."""
    close = (
        difflib.get_close_matches(given, list(known), 1)
        if isinstance(given, str)
        else []
    )
    return close[0] if close else ""


def did_you_mean(given: object, known: Iterable[str]) -> str:
    """Return the end of an error about an unknown name: ``; did you mean …?``, or nothing."""
    name = nearest(given, known)
    return f"; did you mean {name}?" if name else ""
