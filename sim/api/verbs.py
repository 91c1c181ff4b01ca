"""From a device to its law, from Python: the command line's own verbs, run beside the notebook, with their figures back.

A verb runs as a process of its own, so that an interrupted cell ends it as Ctrl-C does: the device
safe, what is known written.
"""

from __future__ import annotations

import collections
import json
import re
import subprocess
import threading
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

from sim.api.laws import plain
from sim.api.notebook_results import Result, bars, new_figure, pandas
from sim.api.progress import progress
from sim.api.python_runs import LaunchError
from sim.measure.measured_launch import end, start_command

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Names under which studies tell their rows.
_TABLES = ("rows", "points", "drops", "edges", "curves", "cases", "terms", "parameters")
_ON_OR_OFF = ("land",)  # options that are on unless they are switched off
# how argparse begins what it says of an option that there is not
_USAGE = re.compile(r"^usage: .*\n(?: .*\n)*", re.MULTILINE)
# how a verb says how far it is, where nobody looks at a terminal (sim/measure/stopwatch.py)
_SHARE = re.compile(r"^(\d+) % ")


@dataclass(frozen=True, repr=False)
class Answer(Result):
    """The figures of a verb: what ``--json`` prints, by name."""

    command: str  # what was run
    answer: dict[str, Any]  # its figures; ``result["name"]`` reads one
    held: bool = True  # whether its verdict is yes: its exit code is 0

    def figures(self) -> dict[str, Any]:
        """List the figures."""
        return self.answer

    def to_pandas(self) -> Any:
        """Turn it into a table: the rows of a study that has some, else its figures in one row."""
        rows = next(
            (value for name, value in self.answer.items() if name in _TABLES and value), None
        )
        return pandas().DataFrame([self.answer] if rows is None else rows)

    def plot(self) -> Figure:
        """Draw it: the picture that the verb drew, or its figures beside each other."""
        picture = self.answer.get("plot")
        if not isinstance(picture, str) or not Path(picture).exists():
            return bars(_flat(self.answer), "as their names say", self.command)
        from matplotlib.image import imread

        drawn = imread(picture)
        figure, (axes,) = new_figure(width=drawn.shape[1] / 150.0, height=drawn.shape[0] / 150.0)
        axes.imshow(drawn)
        axes.set_axis_off()
        return figure

    def __getitem__(self, name: str) -> Any:
        """Read one figure."""
        if name not in self.answer:
            raise KeyError(
                f"{name!r} is no figure of {self.command}; there are {', '.join(self.answer)}"
            )
        return self.answer[name]

    def _ipython_key_completions_(self) -> list[str]:
        return list(self.answer)


def _flat(said: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Name every number of an answer by its path."""
    found: dict[str, Any] = {}
    for name, value in said.items():
        found |= (
            _flat(value, f"{before}{name}.")
            if isinstance(value, Mapping)
            else {f"{before}{name}": value}
        )
    return found


def _words(options: dict[str, Any]) -> list[str]:
    """Write keyword arguments as options: ``taps=4`` is ``--taps 4``, ``land=True`` is ``--land``."""
    words = []
    for name, value in plain(options).items():
        option = f"--{name.replace('_', '-')}"
        if isinstance(value, bool):
            # Off is said only where it can be; other options are off when they are left out.
            words += [option] if value else [f"--no-{name}"] if name in _ON_OR_OFF else []
        elif isinstance(value, tuple | list):
            words += [option, *map(str, value)]
        elif value is not None:
            words += [option, str(value)]
    return words


def _run(*words: str) -> Answer:
    command = " ".join(("haptic", *words))
    process = start_command(
        *words, "--json", stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    out_pipe, error_pipe = process.stdout, process.stderr
    assert out_pipe is not None  # noqa: S101  # it is a pipe
    assert error_pipe is not None  # noqa: S101
    said: collections.deque[str] = collections.deque(maxlen=20)
    try:
        with progress(command, 100) as step:
            reader = threading.Thread(target=_collect, args=(error_pipe, said, step), daemon=True)
            reader.start()
            out = out_pipe.read()
            process.wait()
            reader.join(1.0)
    except KeyboardInterrupt:
        end(process)
        raise
    finally:
        out_pipe.close()
    lines = out.splitlines()
    if process.returncode not in (0, 1) or not lines:
        raise LaunchError(f"{command}: exit code {process.returncode}: {_refusal(said)}")
    return Answer(command, json.loads(lines[-1]), process.returncode == 0)


def _refusal(said: Iterable[str]) -> str:
    """Take the refusal from what a verb wrote; how it is used is told by ``haptic ... --help``."""
    return _USAGE.sub("", "".join(said)).strip()


def _collect(stream: IO[str], said: collections.deque[str], step: Any) -> None:
    with stream:
        for line in stream:
            said.append(line)
            if (share := _SHARE.match(line)) is not None:
                step(int(share[1]))


def study(name: str, *words: str, client: Any = None, **options: Any) -> Answer:
    """Run a study: ``haptic study NAME``; one that sweeps runs on the workers of a Dask client where one is given.

    Parameters
    ----------
    name : str
        E.g. ``kmax`` or ``edge``; ``haptic study --help`` lists them.
    *words : str
        What stands without an option, e.g. a recording.
    client : distributed.Client, optional
        Whose workers do the jobs; same figures to the bit.
    **options : object
        The study's options: ``gain="1..40"``, ``points=41``; ``haptic study kmax --help``.

    Returns
    -------
    Answer
        Its figures; ``.held`` says whether its verdict is yes.

    Raises
    ------
    LaunchError
        When it refuses; the text says why.

    Examples
    --------
    >>> study("kmax", law="pd", gain=3)["k_max_n_per_m"]
    3781.8664...
    """
    return _run("study", name, *words, *_words(options | _cluster(client)))


def lab(name: str, *words: str, client: Any = None, **options: Any) -> Answer:
    """Run an experiment that checks a claim of this project: ``haptic lab NAME``.

    Parameters
    ----------
    name : str
        E.g. ``fig4`` or ``coverage``; ``haptic lab --help`` lists them.
    *words : str
        What stands without an option.
    client : distributed.Client, optional
        Whose workers do the jobs; same figures to the bit.
    **options : object
        The experiment's options, as of `study`.

    Returns
    -------
    Answer
        Its figures; ``.held`` says whether its verdict is yes.

    Raises
    ------
    LaunchError
        When it refuses; the text says why.

    Examples
    --------
    >>> lab("fig2", taps=4)["taps"]
    4
    """
    return _run("lab", name, *words, *_words(options | _cluster(client)))


def _cluster(client: Any) -> dict[str, Any]:
    """Name the scheduler of a client, and its certificates."""
    if client is None:
        return {}
    address, security = client.scheduler.address, client.security
    if not address.startswith(("tcp://", "tls://")):
        raise LaunchError(
            f"client: {address} is inside this process; make it of processes:"
            " LocalCluster(processes=True)"
        )
    if address.startswith("tcp://"):
        return {"cluster": address}
    files = {
        "tls_ca_file": security.tls_ca_file,
        "tls_cert": security.tls_client_cert,
        "tls_key": security.tls_client_key,
    }
    if any(not isinstance(file, str) or "\n" in file for file in files.values()):
        raise LaunchError(
            "client: its certificates are in memory; give distributed.Security their files"
        )
    return {"cluster": address, **files}


def design(**options: Any) -> Answer:
    """Search the taps that bear the stiffest wall on a range of devices: ``haptic study design``.

    Parameters
    ----------
    **options : object
        The verb's options: ``mass="0.05..0.2"``, ``delay=1``, ``taps=4``, ``rate=500``; ``haptic
        study design --help``.

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
    >>> design(mass="0.05..0.2", taps=2, land=False)["designed"]["h1_n_per_m"]
    1866...
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
    scenario: str,
    out: str | Path = "tuning",
    *,
    arguments: dict[str, Any] | None = None,
    **options: Any,
) -> Answer:
    """From a device to its law: identify, design, predict, verify, apply: ``haptic tune``.

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
        When a step refuses; the text says why. What was found before it is in ``tune.json``.

    Examples
    --------
    >>> tune("identify", arguments={"pace": "lockstep"})  # doctest: +SKIP
    """
    given = [f"{name}:={value}" for name, value in plain(arguments or {}).items()]
    found = _run("tune", scenario, *given, "--out", str(out), *_words(options))
    if "refused" in found.answer:
        raise LaunchError(f"{found.command}: {found['refused']}")
    return found
