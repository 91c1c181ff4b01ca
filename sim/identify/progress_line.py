"""How a verb that takes its time goes: one line that is written over on a terminal, a line now and then in a pipe."""

from __future__ import annotations

import sys
import time

from nodes.base.kept_line import columns, is_smart, keep

SILENT = 5.0
"""In a pipe a line comes at most so often [s]."""

_last = [-SILENT]


def say(words: str, always: bool = False) -> None:
    """Tell how it goes, on standard error; no words end the line."""
    if is_smart(sys.stderr):
        keep(sys.stderr, words[: columns(sys.stderr)])
    elif words and (always or words.endswith("...") or time.monotonic() - _last[0] >= SILENT):
        _last[0] = time.monotonic()
        print(words, file=sys.stderr, flush=True)
