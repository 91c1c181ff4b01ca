"""From a device to its law, from Python: the command line's own verbs, run beside the notebook, with their figures back.

A verb runs as a process of its own, so that an interrupted cell ends it as Ctrl-C does: the device safe, what is known written.
"""

from __future__ import annotations

import collections
import json
import os
import signal
import subprocess
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from nodes.base.realtime import die_with_parent
from sim.api.notebook_results import Result
from sim.api.progress import progress
from sim.api.python_runs import ENDS_WITHIN, HAPTIC, LaunchError
from sim.api.values import plain


@dataclass(frozen=True, repr=False)
class Answer(Result):
    """The figures of a verb: what ``--json`` prints, by name.

    Attributes
    ----------
    command : str
        What was run.
    answer : dict of str to object
        Its figures; ``result["name"]`` reads one.
    """

    command: str
    answer: dict[str, Any]

    def figures(self) -> dict[str, Any]:
        """List the figures."""
        return self.answer

    def __getitem__(self, name: str) -> Any:
        """Read one figure."""
        if name not in self.answer:
            raise KeyError(f"{name!r} is no figure of {self.command}; there are {', '.join(self.answer)}")
        return self.answer[name]

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.answer)


def _words(options: dict[str, Any]) -> list[str]:
    """Write keyword arguments as options: ``taps=4`` is ``--taps 4``, ``land=True`` is ``--land``."""
    words = []
    for name, value in plain(options).items():
        option = f"--{name.replace('_', '-')}"
        if value is True:
            words.append(option)
        elif isinstance(value, tuple | list):
            words += [option, *map(str, value)]
        elif value is not None and value is not False:
            words += [option, str(value)]
    return words


def _run(*words: str) -> Answer:
    command = " ".join(("haptic", *words))
    process = subprocess.Popen(
        [*HAPTIC, *words, "--json"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        process_group=0,
        preexec_fn=die_with_parent,
    )
    out_pipe, error_pipe = process.stdout, process.stderr
    assert out_pipe is not None  # noqa: S101  # it is a pipe
    assert error_pipe is not None  # noqa: S101
    told: collections.deque[str] = collections.deque(maxlen=20)
    try:
        with progress(command, None) as step:
            reader = threading.Thread(target=_collect, args=(error_pipe, told, step), daemon=True)
            reader.start()
            out = out_pipe.read()
            process.wait()
            reader.join(1.0)
    except KeyboardInterrupt:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(ENDS_WITHIN)
        except subprocess.TimeoutExpired:
            # A cell that was interrupted leaves nothing behind.
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        raise
    finally:
        out_pipe.close()
    lines = out.splitlines()
    if process.returncode or not lines:
        raise LaunchError(f"{command}: exit code {process.returncode}: {''.join(told).strip()}")
    return Answer(command, json.loads(lines[-1]))


def _collect(stream: IO[str], told: collections.deque[str], step: Any) -> None:
    with stream:
        for done, line in enumerate(stream, 1):
            told.append(line)
            step(done)


def design(**options: Any) -> Answer:
    """Search the taps that bear the stiffest wall on a range of devices: ``haptic study design``.

    Parameters
    ----------
    **options : object
        The verb's options: ``mass="0.05..0.2"``, ``delay=1``, ``taps=4``, ``rate=500``; ``haptic study design --help``.

    Returns
    -------
    Answer
        Its figures.

    Raises
    ------
    LaunchError
        When it refuses; the text says why.

    Examples
    --------
    >>> design(mass="0.05..0.2", taps=2)["taps_n_per_m"]  # doctest: +SKIP
    """
    return _run("study", "design", *_words(options))


def identify(recording: str | Path, **options: Any) -> Answer:
    """Identify the device of a recording: ``haptic study identify``.

    Parameters
    ----------
    recording : str or Path
        Of a launch, best of the scenario ``identify``.
    **options : object
        The verb's options.

    Returns
    -------
    Answer
        Mass, damping, friction, delay and encoder, each with its 95 % interval.

    Raises
    ------
    LaunchError
        When it refuses; the text says why.

    Examples
    --------
    >>> identify("identify.mcap")["mass_kg"]  # doctest: +SKIP
    """
    return _run("study", "identify", str(recording), *_words(options))


def tune(
    scenario: str, out: str | Path = "tuning", *, arguments: dict[str, Any] | None = None, **options: Any
) -> Answer:
    """From a device to its law: identify, design, predict, apply, verify: ``haptic tune``.

    Parameters
    ----------
    scenario : str
        Launch file to start for it.
    out : str or Path
        Directory of what it writes.
    arguments : dict, optional
        Arguments of the launch file.
    **options : object
        The verb's options.

    Returns
    -------
    Answer
        What was identified, designed and measured.

    Raises
    ------
    LaunchError
        When a step refuses; the text says why.

    Examples
    --------
    >>> tune("identify", arguments={"pace": "lockstep"})  # doctest: +SKIP
    """
    given = [f"{name}:={value}" for name, value in plain(arguments or {}).items()]
    return _run("tune", scenario, *given, "--out", str(out), *_words(options))
