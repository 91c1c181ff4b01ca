"""Colour for people: on a terminal only, and not where NO_COLOR is set (no-color.org)."""

import os
from typing import TextIO

from nodes.base.kept_line import is_smart

_CODES = {"red": 31, "green": 32, "yellow": 33, "bold": 1, "dim": 2}


def coloured(text: str, colour: str, stream: TextIO) -> str:
    """Colour a text for where it is printed."""
    return text if not is_smart(stream) or os.environ.get("NO_COLOR") else f"\x1b[{_CODES[colour]}m{text}\x1b[0m"
