"""Text for a terminal or a picture that may quote files or messages of others."""

import re
import unicodedata

# colours of `haptic`, as SGR codes
COLOURS = {"red": 31, "green": 32, "yellow": 33, "bold": 1, "dim": 2}

_OURS = re.compile(f"(\x1b\\[(?:0|{'|'.join(map(str, COLOURS.values()))})m)")


def printable(text: str) -> str:
    """Return a text without control characters: escape sequences, bells, bidirectional marks.

    Colours of `haptic` itself stay.
    """
    # every second part is one of our colours
    return "".join(
        part if n % 2 else "".join(map(_shown, part))
        for n, part in enumerate(_OURS.split(text))
    )


def _shown(sign: str) -> str:
    return (
        sign
        if sign.isprintable() or sign in "\n\t" or unicodedata.category(sign) == "Zs"
        else "\ufffd"
    )
