"""Errors and warnings in the words of Python: ``force=True`` in place of ``--force``.

Nodes and launcher word their texts for the command line. What they tell a program is put into its
own terms here, once.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator

import msgspec

from messages.errors import HapticError

# Words of the command line, and what a program writes in place of them; in this order.
WORDS: tuple[tuple[re.Pattern[str], str], ...] = tuple(
    (re.compile(pattern), instead)
    for pattern, instead in (
        (r"use --force", "pass force=True"),
        (r"with --force", "with force=True"),
        (r"because of --force", "because of force=True"),
        (r"\brun haptic node rearm\b", "call run.rearm()"),
        (r"\bhaptic node rearm\b", "run.rearm()"),
        (r"\bhaptic launch --list\b", "haptic.scenarios()"),
        (
            r"\bhaptic launch --show-args (\w+)",
            r'haptic.scenarios()["\1"]["arguments"]',
        ),
        (r"\bhaptic law list\b", "run.law.list()"),
        (r"\bhaptic law switch\b", "run.law.switch"),
        (r"\bhaptic study (\w+)", r'haptic.study("\1")'),
        (r"\bhaptic lab (\w+)", r'haptic.lab("\1")'),
        (r"choose one with --run (\S+)", r'choose one with haptic.connect("\1")'),
        (r"--tick (\w+)", r'tick="\1"'),
        (r"--out-dir\b", "out_dir="),
        (r"--without\b", "without="),
        (r"--view\b", "view=True"),
        (r":=(?=\S)", "="),  # an argument with its value
    )
)


def in_python(text: str) -> str:
    """Return a text for the command line in the words of Python."""
    for pattern, instead in WORDS:
        text = pattern.sub(instead, text)
    return text


@contextlib.contextmanager
def speaking_python() -> Iterator[None]:
    """Reword the errors that this block raises."""
    try:
        yield
    except HapticError as error:
        error.args = tuple(
            in_python(part) if isinstance(part, str) else part for part in error.args
        )
        error.remedies = tuple(
            msgspec.structs.replace(one, text=in_python(one.text))
            for one in error.remedies
        )
        raise
