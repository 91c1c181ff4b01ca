"""Errors in the words of Python: ``force=True`` in place of ``--force``."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator

from messages.errors import FORCE, HapticError, Remedy
from nodes.parameters.interface_words import COMMAND_LINE, PYTHON, VARIABLE, interface

_BY_FORCE = Remedy(
    FORCE,
    f"to study it anyway, {PYTHON.force}, or set stability to warn on its coupling",
)


def launch_environment() -> dict[str, str]:
    """Return the environment of a launch that words its errors for Python."""
    return {**os.environ, VARIABLE: "python"}


def in_python(text: str) -> str:
    """Return a sentence of a driver, which words it for the command line, for Python."""
    return text.replace(COMMAND_LINE.rearm, PYTHON.rearm)


@contextlib.contextmanager
def speaking_python() -> Iterator[None]:
    """Word the errors of this block for Python, those that a node returns included."""
    before = interface.set(PYTHON)
    try:
        yield
    except HapticError as error:
        error.remedies = tuple(
            _BY_FORCE if one.kind == FORCE else one for one in error.remedies
        )
        raise
    finally:
        interface.reset(before)
