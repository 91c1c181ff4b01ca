"""A status line on a terminal that is rewritten in place.

The cursor stays at its beginning. If a terminal is narrowed, it breaks the line and the cursor
stays with the first piece, so that erasing from there removes all of it.
"""

import os
from typing import TextIO

# erases from the beginning of the line to the end of the screen
ERASE = "\r\x1b[J"


def is_smart(stream: TextIO) -> bool:
    """Return whether a stream is a terminal that supports escape sequences."""
    return stream.isatty() and os.environ.get("TERM") != "dumb"


def columns(stream: TextIO) -> int:
    """Return the columns of a line, one less than the terminal has; some break full lines."""
    try:
        return os.get_terminal_size(stream.fileno()).columns - 1
    except OSError:
        return 79


def rewrite(stream: TextIO, text: str) -> None:
    """Rewrite the line, which must fit the terminal."""
    stream.write(f"{ERASE}{text}\r")
    stream.flush()


def erased(stream: TextIO) -> str:
    """Return what erases the status line, to print a permanent line in its place."""
    return ERASE if is_smart(stream) else ""
