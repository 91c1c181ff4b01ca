"""The line that is kept up to date on a terminal: written over and over, and never left behind in pieces.

The cursor rests at its beginning. A terminal that is made narrower breaks the line, and the cursor
stays with the first
piece: what is erased from there on is all of it.
"""

import os
from typing import TextIO

# from the beginning of the line to the end of the screen, below which nothing stands
ERASE = "\r\x1b[J"


def is_smart(stream: TextIO) -> bool:
    """Whether a stream is a terminal that knows escape sequences."""
    return stream.isatty() and os.environ.get("TERM") != "dumb"


def columns(stream: TextIO) -> int:
    """Tell how many columns a line may take: one less than there are, as some terminals break the line behind the last."""
    try:
        return os.get_terminal_size(stream.fileno()).columns - 1
    except OSError:
        return 79


def keep(stream: TextIO, text: str) -> None:
    """Write the line over; it fits, or is cut to fit by who colours nothing in it."""
    stream.write(f"{ERASE}{text}\r")
    stream.flush()


def erased(stream: TextIO) -> str:
    """Give what makes room for a line that stays, where the other line stood."""
    return ERASE if is_smart(stream) else ""
