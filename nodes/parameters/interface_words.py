"""Ways out of an error as the reader's interface writes them: command line or Python.

Errors and warnings of a launch name actions: start one node less, repeat by force, rearm. The
command line and Python write them differently. A program in Python sets its words for the time of a
call, and for the processes that it starts by `VARIABLE`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from contextvars import ContextVar
from typing import Final, NamedTuple


class InterfaceWords(NamedTuple):
    """How one interface writes what a user may do."""

    # an argument of a launch file, and its value
    argument: Callable[[str, object], str]
    # where the arguments of a scenario are listed
    arguments: Callable[[str], str]
    force: str  # after "to study it anyway": repeat a refused change
    out_dir: str  # option for the folder of recordings
    rearm: str  # enable a stopped driver
    run: Callable[[str], str]  # choose a run, or one of its chains
    start: Callable[[str], str]  # start a launch by scenario
    study: Callable[[str], str]  # a study by name
    tick: Callable[[str], str]  # choose compiled or interpreted ticks


COMMAND_LINE: Final = InterfaceWords(
    argument=lambda name, value: f"{name}:={value}",
    arguments=lambda scenario: f"haptic launch --show-args {scenario}",
    force="use --force",
    out_dir="--out-dir",
    rearm="run haptic node rearm",
    run=lambda name: f"--run {name}",
    start=lambda scenario: f"haptic launch {scenario}",
    study=lambda name: f"haptic study {name}",
    tick=lambda how: f"--tick {how}",
)
PYTHON: Final = InterfaceWords(
    argument=lambda name, value: f"{name}={value!r}",
    arguments=lambda scenario: f'haptic.scenarios()["{scenario}"]["arguments"]',
    force="pass force=True",
    out_dir="out_dir=",
    rearm="call run.rearm()",
    run=lambda name: f'haptic.connect("{name}")',
    start=lambda scenario: f'haptic.launch("{scenario}")',
    study=lambda name: f'haptic.study("{name}")',
    tick=lambda how: f'tick="{how}"',
)

VARIABLE: Final = "HAPTIC_WORDS"
"""Environment variable of a launch that a program started: ``python``."""

interface: Final[ContextVar[InterfaceWords]] = ContextVar(
    "interface",
    default=PYTHON if os.environ.get(VARIABLE) == "python" else COMMAND_LINE,
)
